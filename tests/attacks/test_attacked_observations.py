"""The wrapper's perturbations: inside the ball, reported in info, and equal to those of rollout."""

import gymnasium
import numpy as np
import pytest
import torch
from builders import make_victim
from gymnasium.utils.env_checker import check_env

from detden_lite.attacks.attacked_observations import AttackedObservations
from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.noise import UniformNoise
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.timing import Always, Random
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.simulation.rollout import rollout

TASK = Task("swimmer", "Swimmer-v5", 0.1, 8, 2)
VICTIM, BUDGET = make_victim(TASK), Budget(TASK.epsilon)


def attacked(timing=None, budget=BUDGET) -> AttackedObservations:
    return AttackedObservations(gymnasium.make("Swimmer-v5"), OppositeAttack(VICTIM, budget, steps=4), timing)


def episode(env, steps: int = 30, **reset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The observations that were seen, the true ones, and when they were attacked; the policy acts on the former."""
    obs, info = env.reset(**reset)
    rows = []
    for _ in range(steps):
        rows.append((obs, info["true_obs"], info["attacked"]))
        action = VICTIM(torch.as_tensor(obs, dtype=torch.float32)[None])[0].numpy()
        obs, _, _, _, info = env.step(action)
    return tuple(np.stack(part) for part in zip(*rows, strict=True))


@pytest.mark.parametrize("timing", [None, Random(0.5)])
def test_perturbations_equal_those_of_rollout(timing):
    seen, true, when = episode(attacked(timing), seed=7)
    expected = rollout(VICTIM, TASK, [7], attack=OppositeAttack(VICTIM, BUDGET, steps=4), timing=timing, steps=30)
    assert np.array_equal(when, expected.attacked[:, 0]) and when.any()
    assert np.array_equal(true.astype(np.float32), expected.obs[:, 0])
    assert np.array_equal(seen.astype(np.float32), expected.perturbed[:, 0])


@pytest.mark.parametrize("budget", [BUDGET, Budget(0.2, 2, torch.linspace(0.5, 2, 8))])
def test_attacked_observations_stay_in_the_ball_and_others_are_true(budget):
    seen, true, when = episode(attacked(Random(0.5), budget), seed=1)
    size = budget.size(torch.from_numpy(true), torch.from_numpy(seen)).numpy()
    assert 0 < when.mean() < 1
    assert size[when].min() > 0 and size.max() <= budget.epsilon + 1e-6
    assert np.array_equal(seen[~when], true[~when])


def test_the_world_does_not_depend_on_the_attack():
    """The same actions lead to the same true observations, rewards and info, attacked or not."""
    plain, env = gymnasium.make("Swimmer-v5"), attacked()
    obs, info = plain.reset(seed=3)
    _, told = env.reset(seed=3)
    assert np.array_equal(told["true_obs"], obs) and info.items() <= told.items()
    for action in np.random.default_rng(0).uniform(-1, 1, (10, 2)):
        obs, *rest, info = plain.step(action)
        seen, *others, told = env.step(action)
        assert rest == others and told["attacked"] and info.items() <= told.items()
        assert np.array_equal(told["true_obs"], obs) and not np.array_equal(seen, obs)


def test_episodes_without_a_seed_follow_from_the_last_seed():
    first, second = (attacked(Random(0.5)) for _ in range(2))
    runs = []
    for env in (first, second):
        runs.append([episode(env, 5, seed=2), episode(env, 5), episode(env, 5)])
    for one, other in zip(*runs, strict=True):
        assert all(np.array_equal(*pair) for pair in zip(one, other, strict=True))
    assert not np.array_equal(runs[0][1][0], runs[0][2][0])


def test_it_is_a_gymnasium_environment_with_a_wrapper_spec():
    env = AttackedObservations(gymnasium.make("Swimmer-v5"), UniformNoise(BUDGET))
    check_env(env, skip_render_check=True)
    assert env.observation_space == env.unwrapped.observation_space and env.observation_space.contains(env.reset()[0])
    assert [wrapper.name for wrapper in env.spec.additional_wrappers] == ["AttackedObservations"]
    assert isinstance(env.timing, Always)


def test_an_attack_that_plans_is_refused():
    planning = EnchantingAttack(VICTIM, BUDGET, CEMPlanner("Hopper-v5"))
    with pytest.raises(ValueError, match="attack: EnchantingAttack needs the simulator; use detden_lite.rollout"):
        AttackedObservations(gymnasium.make("Swimmer-v5"), planning)
