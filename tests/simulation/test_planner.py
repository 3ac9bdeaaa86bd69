import gymnasium
import mujoco
import numpy as np
import pytest

from detden_lite.core.tasks import TASKS
from detden_lite.simulation.planner import CEMPlanner, OpenLoop


def forward_position(env) -> float:
    """Where the robot is after a step: what it would be if gymnasium asked for it anew."""
    if "humanoid" not in env.fullpath:
        return env.data.qpos[0]
    data = mujoco.MjData(env.model)
    data.qpos[:] = env.data.qpos
    mujoco.mj_fwdPosition(env.model, data)
    return env.model.body_mass @ data.xipos[:, 0] / env.model.body_mass.sum()


def play(env, actions):
    """Gymnasium's rewards of an action sequence, with fresh positions and without contact costs; 0 after a fall."""
    rewards, own, alive = [], [], True
    for action in actions:
        before = forward_position(env)
        _, reward, terminated, _, info = env.step(action)
        fresh = env._forward_reward_weight * (forward_position(env) - before) / env.dt
        rest = sum(value for name, value in info.items() if name in ("reward_ctrl", "reward_survive"))
        rewards.append((fresh + rest) * alive)
        own.append((reward - info.get("reward_contact", 0.0)) * alive)
        alive = alive and not terminated
    return rewards, own


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", TASKS)
def test_rewards_are_gymnasiums(name, threads):
    """Sequences from states in the middle of episodes, past falls."""
    worlds = OpenLoop(TASKS[name].env_id, threads)
    rng, space = np.random.default_rng(0), worlds.env.action_space
    starts, actions, expected, own = [], [], [], []
    for seed in range(6):
        env = gymnasium.make(TASKS[name].env_id).unwrapped
        env.reset(seed=seed)
        for _ in range(4 * seed):
            env.step(rng.uniform(space.low, space.high))
        starts.append(worlds.start(env))
        actions.append(rng.uniform(space.low, space.high, (20, *space.shape)))
        rewards, gymnasiums = play(env, actions[-1])
        expected.append(rewards)
        own.append(gymnasiums)
    states, warmstarts, x = (np.array(part) for part in zip(*starts, strict=True))
    found = worlds.rewards(states, warmstarts, x, np.array(actions))
    assert np.allclose(found, expected, atol=1e-6)
    if name not in ("ant", "humanoid"):
        assert np.allclose(found, own, atol=1e-6)
    assert np.abs(found.sum(1) - np.sum(own, axis=1)).max() < 0.02  # over the whole way the difference stays small


def test_another_environment_is_refused():
    with pytest.raises(ValueError, match="Swimmer-v5"):
        OpenLoop("Swimmer-v5")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in ("horizon", "population", "iterations", "elites", "threads") for value in (0, 1.5)),
        *(("floor", value) for value in (-0.1, np.nan, np.inf)),
        ("elites", 65),
        ("seed", -1),
    ],
)
def test_a_planner_with_a_bad_number_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"{name} must be"):
        CEMPlanner("Hopper-v5", **{name: value})


def halfcheetahs(n: int) -> list:
    envs = [gymnasium.make("HalfCheetah-v5").unwrapped for _ in range(n)]
    for seed, env in enumerate(envs):
        env.reset(seed=seed)
    return envs


class Quadratic(OpenLoop):
    """A world whose most harmful action, at every step, is known."""

    worst = np.array([0.5, -0.5, 0.25, 0.0, -0.25, 1.0])

    def rewards(self, states, warmstarts, x, actions):
        return np.square(actions - self.worst).sum(-1)


def test_a_one_step_planner_finds_the_worst_action():
    planner = CEMPlanner("HalfCheetah-v5", horizon=1, population=256, iterations=40, elites=32, floor=0.0)
    planner.worlds.__class__ = Quadratic
    planner.reset([3, 4])
    assert np.allclose(planner.plan(halfcheetahs(2), np.ones(2, dtype=bool)), Quadratic.worst, atol=1e-3)


def test_the_next_search_begins_with_the_rest_of_the_last_plan():
    """So that it is never worse than going on with it, and gets better from step to step."""
    planner = CEMPlanner("HalfCheetah-v5", horizon=8, population=16, iterations=4, elites=4)
    planner.worlds.__class__ = Quadratic
    planner.reset([3])
    found, envs = [], halfcheetahs(1)
    for _ in range(20):
        rest = np.square(planner.mean - Quadratic.worst).sum()
        planner.plan(envs, np.ones(1, dtype=bool))
        assert planner.least[0] <= rest
        found.append(planner.least[0])
    assert found[-1] < 0.5 * found[0]


def test_plans_harm_and_more_iterations_harm_more():
    def planned_return(iterations: int) -> float:
        envs = halfcheetahs(4)
        planner = CEMPlanner("HalfCheetah-v5", horizon=10, iterations=iterations)
        planner.reset(range(4))
        planner.plan(envs, np.ones(4, dtype=bool))
        return planner.least.mean()

    starts = [OpenLoop("HalfCheetah-v5").start(env) for env in halfcheetahs(4)]
    states, warmstarts, x = (np.array(part) for part in zip(*starts, strict=True))
    idle = OpenLoop("HalfCheetah-v5").rewards(states, warmstarts, x, np.zeros((4, 10, 6))).sum(1).mean()
    assert planned_return(6) < planned_return(1) < idle


def test_an_episode_is_planned_as_it_would_be_alone():
    """Whoever runs beside it, and whenever it is attacked; and planning changes no world."""

    def plans(seeds, wanted):
        envs = halfcheetahs(4)
        planner = CEMPlanner("HalfCheetah-v5", horizon=4, population=16)
        planner.reset(seeds)
        before = [env.state_vector() for env in envs]
        first = [planner.plan([envs[s] for s in seeds], np.array(w)) for w in wanted]
        assert all(np.array_equal(env.state_vector(), state) for env, state in zip(envs, before, strict=True))
        return first[-1]

    together = plans([0, 1, 2], [[True] * 3] * 2)
    assert np.allclose(plans([1], [[True]] * 2), together[1:2])
    late = plans([0, 1, 2], [[False, True, False]] * 2)
    assert np.allclose(late[1], together[1])
