from dataclasses import fields

import gymnasium
import numpy as np
import pytest
from builders import BUDGET, HOPPER, make_defense, make_victim

from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.timing import Random
from detden_lite.core.tasks import TASKS
from detden_lite.core.types import Episodes
from detden_lite.simulation import rollout as rollout_module
from detden_lite.simulation.fast_simulator import FastSimulator, make_simulator
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.simulation.rollout import rollout
from detden_lite.simulation.simulator import Simulator

SEEDS = [3, 2**40, 5]


def state(env) -> np.ndarray:
    return np.concatenate([env.unwrapped.data.qpos, env.unwrapped.data.qvel])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", TASKS)
def test_episodes_are_gymnasiums_to_the_last_bit(name, dtype):
    """Whole ones with random actions: each world begins anew where it ends, at the time limit at the latest."""
    task = TASKS[name]
    simulator, envs = make_simulator(task.env_id, SEEDS), [gymnasium.make(task.env_id) for _ in SEEDS]
    assert isinstance(simulator, FastSimulator)
    rng, limit = np.random.default_rng(0), envs[0].action_space.high
    for first in (0, 10):  # two resets
        simulator.seeds = [seed + first for seed in SEEDS]
        obs = simulator.reset()
        expected = np.stack([env.reset(seed=seed)[0] for env, seed in zip(envs, simulator.seeds, strict=True)])
        restarts = 0
        for step in range(1_000 if name in ("halfcheetah", "ant") else 100):
            assert np.array_equal(simulator.obs, expected) and np.array_equal(obs, expected.astype(np.float32))
            assert np.array_equal(simulator.state(), [state(env) for env in envs])
            action = rng.uniform(-limit, limit, size=(3, task.action_dim)).astype(dtype)
            expected, reward, terminated, truncated, _ = map(
                np.array, zip(*(env.step(a) for env, a in zip(envs, action, strict=True)), strict=True)
            )
            obs, rewards, ended = simulator.step(action)
            assert np.array_equal(rewards, reward) and np.array_equal(ended, terminated)
            for i in np.flatnonzero(terminated | truncated):
                restarts, seed = restarts + 1, 100 + step
                obs[i], (expected[i], _) = simulator.restart(i, seed), envs[i].reset(seed=seed)
        assert restarts >= 3
    for env in envs:
        env.close()


def test_one_switch_gives_the_version_to_read():
    assert type(make_simulator("Hopper-v5", [0], fast=False)) is Simulator


def test_an_ended_world_stays_and_the_others_go_on():
    fast, plain = make_simulator("Hopper-v5", range(4)), Simulator("Hopper-v5", range(4))
    assert np.array_equal(fast.reset(), plain.reset())
    rng, counts = np.random.default_rng(0), set()
    while plain.alive.any():
        action = rng.uniform(-1, 1, (4, 3)).astype(np.float32)
        for found, expected in zip(fast.step(action), plain.step(action), strict=True):
            assert np.array_equal(found, expected)
        assert np.array_equal(fast.state(), plain.state()) and np.array_equal(fast.alive, plain.alive)
        counts.add(plain.alive.sum())
    assert len(counts) > 2  # they ended one after the other


@pytest.mark.parametrize(("env_id", "square"), [("Ant-v5", 1), ("Humanoid-v5", 10 / 5e-7)])
def test_forces_and_their_costs_are_clipped_as_gymnasium_does(env_id, square):
    """A robot thrown to the ground: the sum of its squared contact forces reaches what is cut off."""
    fast, plain = make_simulator(env_id, [0, 1]), Simulator(env_id, [0, 1])
    fast.reset(), plain.reset()
    for env in fast.envs + plain.envs:
        env.data.qvel[2] = -30
    largest, action = 0.0, np.zeros((2, fast.env.model.nu))
    for _ in range(20):
        for found, expected in zip(fast.step(action), plain.step(action), strict=True):
            assert np.array_equal(found, expected)
        largest = max(largest, np.square(plain.envs[0].data.cfrc_ext).sum())
        fast.alive[:] = plain.alive[:] = True
    assert largest > square


@pytest.mark.parametrize("attack", ["opposite", "enchanting"])
def test_a_rollout_is_the_same_with_either_simulator(attack, monkeypatch):
    victim = make_victim(seed=8)

    def play() -> Episodes:
        planner = CEMPlanner("Hopper-v5", horizon=3, population=8, iterations=2, elites=2)
        opposite, enchanting = OppositeAttack(victim, BUDGET, steps=3), EnchantingAttack(victim, BUDGET, planner, 3)
        parts = dict(attack=opposite if attack == "opposite" else enchanting, timing=Random(0.5))
        return rollout(victim, HOPPER, range(20, 26), defense=make_defense(), steps=25, **parts)

    fast = play()
    monkeypatch.setattr(rollout_module, "make_simulator", Simulator)
    plain = play()
    assert plain.attacked.any() and len(set(plain.lengths)) > 1
    for field in fields(Episodes):
        assert np.array_equal(getattr(fast, field.name), getattr(plain, field.name)), field.name


def test_other_environments_have_gymnasiums_loop():
    simulator = make_simulator("InvertedPendulum-v5", [0, 1])
    assert type(simulator) is Simulator and simulator.reset().shape == (2, 4)


def test_actions_of_another_shape_are_refused():
    simulator = make_simulator("Hopper-v5", [0, 1])
    simulator.reset()
    with pytest.raises(ValueError, match=r"action has shape \(2, 1\): give one row of 3 to each of 2"):
        simulator.step(np.zeros((2, 1)))
