import gymnasium
import numpy as np
import pytest

from detden_lite.core.tasks import TASKS
from detden_lite.simulation.simulator import Simulator


@pytest.mark.parametrize("name", TASKS)
def test_it_is_gymnasiums_own_environment_step_by_step(name):
    """Observations, rewards, ends of episodes and states of every task, to the last bit."""
    task, seeds = TASKS[name], [3, 4, 5]
    simulator, envs = Simulator(task.env_id, seeds), [gymnasium.make(task.env_id) for _ in seeds]
    obs, ended = simulator.reset(), np.zeros(3, bool)
    expected = np.stack([env.reset(seed=seed)[0] for env, seed in zip(envs, seeds, strict=True)])
    rng = np.random.default_rng(0)
    for _ in range(60):
        assert obs.dtype == np.float32 and np.array_equal(obs, expected.astype(np.float32))
        positions = [np.concatenate([env.unwrapped.data.qpos, env.unwrapped.data.qvel]) for env in envs]
        assert np.array_equal(simulator.state(), positions)
        limit = envs[0].action_space.high
        action = rng.uniform(-limit, limit, size=(3, task.action_dim)).astype(np.float32)
        reward = np.zeros(3)
        for i in np.flatnonzero(~ended):
            expected[i], reward[i], ended[i], _, _ = envs[i].step(action[i])
        obs, rewards, terminated = simulator.step(action)
        assert np.array_equal(rewards, reward) and np.array_equal(terminated, ended)
    assert ended.any() == (name != "halfcheetah")  # a random policy makes everything fall that can
    for env in envs:
        env.close()


def test_an_ended_world_stays_until_the_next_reset():
    simulator = Simulator("Hopper-v5", [0, 1])
    first, action = simulator.reset(), np.ones((2, 3), np.float32)
    while simulator.alive.all():
        simulator.step(action)
    dead = int(np.flatnonzero(~simulator.alive)[0])
    state = simulator.state()[dead].copy()
    obs = simulator.step(action)[0][dead].copy()
    for _ in range(3):
        after, reward, terminated = simulator.step(action)
        assert np.array_equal(after[dead], obs) and np.array_equal(simulator.state()[dead], state)
        assert reward[dead] == 0 and terminated[dead]
    assert np.array_equal(simulator.reset(), first) and simulator.alive.all()


def test_one_world_restarts_and_the_others_go_on():
    simulator, alone = Simulator("Hopper-v5", [0, 1]), Simulator("Hopper-v5", [7])
    simulator.reset()
    action = np.ones((2, 3), np.float32)
    while simulator.alive[1]:
        obs, _, _ = simulator.step(action)
    first = simulator.restart(1, 7)
    assert np.array_equal(first, alone.reset()[0]) and simulator.alive[1] and simulator.seeds == [0, 7]
    before = simulator.state()[0]
    simulator.alive[0] = True
    for _ in range(5):
        obs, reward, _ = simulator.step(action)
        expected = alone.step(action[:1])
        assert np.array_equal(obs[1], expected[0][0]) and reward[1] == expected[1][0]
    assert not np.array_equal(simulator.state()[0], before)


def test_returned_arrays_are_not_overwritten():
    simulator = Simulator("Hopper-v5", [0])
    first = simulator.reset()
    kept = first.copy()
    second = simulator.step(np.zeros((1, 3), np.float32))[0]
    kept_second = second.copy()
    simulator.step(np.zeros((1, 3), np.float32))
    assert np.array_equal(first, kept) and np.array_equal(second, kept_second)


def test_no_seeds_are_refused():
    with pytest.raises(ValueError, match="seeds"):
        Simulator("Hopper-v5", [])


@pytest.mark.parametrize("env_id", ["HalfCheetah-v5", "Hopper-v5"])
def test_making_worlds_prints_nothing(env_id, capfd, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Simulator(env_id, [0, 1]).reset()
    assert capfd.readouterr() == ("", "") and not list(tmp_path.iterdir())
