"""The robots in the page are gymnasium's."""

import numpy as np
import pytest
from scipy import stats

from detden_lite import get_task, load_record
from detden_lite.simulation.simulator import Simulator

# HalfCheetah's contacts double a rounding error every few steps, so that only a short while can be compared.
STEPS = {"hopper": 300, "walker2d": 300, "halfcheetah": 20}


@pytest.mark.parametrize("task", STEPS)
def test_an_open_loop_gives_the_same_observations_rewards_and_ends(ask, task):
    simulator, random = Simulator(get_task(task).env_id, [0]), np.random.default_rng(0)
    simulator.reset()
    # Small actions, so that the robots still stand or sway for a while before they fall.
    actions = random.uniform(-0.4, 0.4, (STEPS[task], get_task(task).action_dim)).astype(np.float32)
    (rows,) = ask(f"{task}-td3", dict(ask="physics", state=simulator.state()[0].tolist(), actions=actions.tolist()))
    for action, row in zip(actions, rows, strict=True):
        simulator.alive[:] = True  # it goes on after the end of an episode
        obs, reward, ended = simulator.step(action[None])
        assert np.abs(simulator.state()[0] - row["state"]).max() < 1e-6
        assert np.abs(obs[0] - row["obs"]).max() < 1e-5
        assert abs(reward[0] - row["reward"]) < 1e-4
        assert ended[0] == row["fallen"]


@pytest.mark.parametrize("task", STEPS)
def test_episodes_begin_as_gymnasiums_do(ask, task):
    seeds = list(range(100))
    (found,) = ask(f"{task}-td3", dict(ask="starts", seeds=seeds))
    wanted = Simulator(get_task(task).env_id, seeds).reset()
    assert np.array(found).shape == wanted.shape and len(np.unique(found, axis=0)) == len(seeds)
    for mine, theirs in zip(np.array(found).T, wanted.T, strict=True):
        assert stats.ks_2samp(mine, theirs).pvalue > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    "cell",
    ["hopper-td3.none.always.none", "hopper-td3.opposite.always.none", "hopper-ppo.opposite.always.none"],
)
def test_returns_over_twenty_seeds_are_distributed_as_the_librarys(ask, cell):
    victim, attack, *_ = cell.split(".")
    (episodes,) = ask(victim, dict(ask="episodes", seeds=list(range(20)), attack=attack))
    mine, theirs = [episode["return"] for episode in episodes], load_record(cell).returns
    assert stats.ks_2samp(mine, theirs).pvalue > 1e-3
    assert {episode["strikes"] > 0 for episode in episodes} == {attack != "none"}


@pytest.mark.slow
def test_the_defence_keeps_a_robot_on_its_leg_that_falls_without(ask):
    bare, defended = ask(
        "hopper-td3",
        *(dict(ask="episodes", seeds=[1, 2, 3], attack="opposite", defense=defense) for defense in ("none", "mixed")),
    )
    assert all(episode["fallen"] and episode["alarms"] == 0 for episode in bare)
    assert all(not episode["fallen"] and episode["alarms"] > 500 for episode in defended)


def test_a_timing_strikes_when_it_says(ask):
    about = dict(ask="episodes", seeds=[1, 2], attack="uniform", epsilon=0.0)
    timings = [dict(timing="random", rate=0.25), dict(timing="after"), dict(timing="key"), dict(timing="vulnerable")]
    chance, after, key, vulnerable = ask("hopper-td3", *(about | timing for timing in timings))
    assert all(200 < episode["strikes"] < 300 for episode in chance)
    assert all(episode["strikes"] == episode["steps"] - 100 for episode in after)
    assert not any(episode["strikes"] for episode in key)
    assert all(0 < episode["strikes"] < 100 for episode in vulnerable)  # its threshold strikes at few steps
