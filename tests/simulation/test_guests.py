"""What ``rollout`` refuses of its arguments and guests, before or at the first step."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, NORMS, make_defense, make_victim

from detden_lite.attacks.adaptive import AdaptiveAttack
from detden_lite.attacks.noise import UniformNoise
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.timing import Always
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import get_task
from detden_lite.simulation.collection import collect_normal
from detden_lite.simulation.rollout import rollout

VICTIM = make_victim()


def play(seeds=range(2), **changes):
    return rollout(VICTIM, HOPPER, seeds, **dict(steps=2) | changes)


def refused(message: str, *args, **changes) -> None:
    with pytest.raises(ValueError, match=message):
        play(*args, **changes)


class Attack:
    """Gives what it is told to give."""

    def __init__(self, give=lambda obs: obs, needs=frozenset(), budget=None):
        self.give, self.needs, self.budget = give, frozenset(needs), budget

    def reset(self, episodes):
        pass

    def __call__(self, obs, world):
        return self.give(obs)


class Timing:
    def __init__(self, give):
        self.give = give

    def reset(self, episodes):
        pass

    def __call__(self, obs):
        return self.give(len(obs))


class Defense:
    """A real defence whose verdict is changed on the way."""

    needs = frozenset()

    def __init__(self, change):
        self.inner, self.change = make_defense(), change

    def reset(self, episodes):
        self.inner.reset(episodes)

    def restart(self, i, episode):
        self.inner.restart(i, episode)

    def __call__(self, obs, action=None):
        return self.change(self.inner(obs, action))


@pytest.mark.parametrize("seed", [1.5, -1, "a", None, nan])
def test_a_seed_that_is_no_whole_number_is_refused(seed):
    refused("each of seeds must be a whole number of at least 0", [0, seed])


def test_no_seeds_are_refused():
    refused("seeds is empty", [])


@pytest.mark.parametrize("steps", [0, -1, 1.5, "all"])
def test_a_number_of_steps_that_is_none_is_refused(steps):
    refused("steps must be a whole number of at least 1", steps=steps)


@pytest.mark.parametrize("noise", [-0.1, nan, inf, [0.1, -0.1]])
def test_noise_that_is_no_standard_deviation_is_refused(noise):
    refused("action_noise must be finite and at least 0", action_noise=noise)


@pytest.mark.parametrize("shape", [(3,), (3, 3), (2, 2), (1, 4)])
def test_noise_that_fits_neither_episodes_nor_actions_is_refused(shape):
    refused(r"action_noise must be one number, \[2\] or \[2, 3\]", action_noise=np.full(shape, 0.1))


@pytest.mark.parametrize("attack", ["opposite", 1, object(), UniformNoise])
def test_an_object_that_is_no_attack_is_refused(attack):
    refused("attack: .*give an", attack=attack)


@pytest.mark.parametrize("timing", ["always", 1, Always])
def test_an_object_that_is_no_timing_is_refused(timing):
    refused("timing: .*give a", attack=Attack(), timing=timing)


@pytest.mark.parametrize("defense", ["mixed", 1, Defense])
def test_an_object_that_is_no_defence_is_refused(defense):
    refused("defense: .*give a", defense=defense)


def test_a_defence_that_needs_the_truth_must_take_it():
    defense = Defense(lambda verdict: verdict)
    defense.needs = frozenset({"truth"})
    refused("defense: .* has no reveal", defense=defense)


def test_an_attack_with_unknown_needs_is_refused():
    refused("attack: it needs root password; an attack can need policy, ", attack=Attack(needs={"root password"}))


def test_an_attack_on_a_defence_needs_one():
    refused("attack: it needs a defense", attack=AdaptiveAttack(OppositeAttack(VICTIM, BUDGET)))
    refused("attack: it needs a defense", attack=Attack(needs={"defense"}))


@pytest.mark.parametrize("norm", NORMS)
def test_an_attack_that_leaves_its_ball_is_refused(norm):
    budget = Budget(0.1, norm, [0.5] * 11)
    far = torch.zeros(11).index_fill(0, torch.tensor(3), 0.051)
    refused("attack: Attack leaves its ball: 0.10", attack=Attack(lambda obs: obs + far, budget=budget))
    play(attack=Attack(lambda obs: obs + far * (0.05 / 0.051), budget=budget))  # it may go as far as the sphere
    play(attack=Attack(lambda obs: obs + far))  # it promises nothing


def test_rows_that_are_not_attacked_may_hold_anything():
    never = Timing(lambda n: torch.zeros(n, dtype=torch.bool))
    attack = Attack(lambda obs: torch.full_like(obs, nan), budget=BUDGET)
    assert np.isfinite(play(attack=attack, timing=never).perturbed).all()


@pytest.mark.parametrize(
    ("give", "message"),
    [
        (lambda obs: obs[:, 1:], r"it gives \[2, 10\] torch.float32, and must be \[2, 11\] torch.float32"),
        (lambda obs: obs[:1], r"it gives \[1, 11\]"),
        (lambda obs: obs.double(), r"it gives \[2, 11\] torch.float64"),
        (lambda obs: obs.numpy(), "it gives ndarray, and must be a tensor"),
        (lambda obs: None, "it gives NoneType"),
        (lambda obs: obs * nan, "it gives NaN or infinity"),
        (lambda obs: obs + inf, "it gives NaN or infinity"),
    ],
    ids=["shape", "rows", "dtype", "array", "nothing", "nan", "inf"],
)
def test_an_attack_that_breaks_its_contract_is_refused(give, message):
    refused(f"attack: {message}", attack=Attack(give))


@pytest.mark.parametrize(
    "give", [torch.ones, lambda n: torch.ones(n + 1, dtype=torch.bool), lambda n: True, lambda n: np.ones(n, bool)]
)
def test_a_timing_that_breaks_its_contract_is_refused(give):
    refused("timing: it says when to attack with", attack=Attack(), timing=Timing(give))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda verdict: verdict.obs, "it gives Tensor, and must give a detden_lite.Verdict"),
        (lambda verdict: (verdict.obs, verdict.alarm), "it gives tuple"),
        (lambda verdict: replace(verdict, obs=verdict.obs.double()), "verdict.obs is"),
        (lambda verdict: replace(verdict, denoised=verdict.denoised[:, 1:]), "verdict.denoised is"),
        (lambda verdict: replace(verdict, alarm=verdict.alarm.float()), "verdict.alarm is"),
        (lambda verdict: replace(verdict, score=verdict.score[:, None]), "verdict.score is"),
    ],
    ids=["tensor", "tuple", "obs", "denoised", "alarm", "score"],
)
def test_a_defence_that_breaks_its_contract_is_refused(change, message):
    refused(f"defense: {message}", defense=Defense(change))


def test_a_victim_of_another_task_is_refused():
    with pytest.raises(ValueError, match="victim.*17 observations.*Hopper-v5 has 11"):
        rollout(make_victim(get_task("walker2d")), HOPPER, [0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(lockstep=-1), "lockstep must be"),
        (dict(lockstep=0), "lockstep must be"),
        (dict(lockstep=1.5), "lockstep must be"),
        (dict(seeds=[]), "seeds is empty"),
        (dict(seeds=[1.5]), "each of seeds must be"),
        (dict(action_noise=()), "action_noise is empty"),
        (dict(action_noise=(0.0, -0.1)), "action_noise must be"),
        (dict(noise_memory=()), "noise_memory is empty"),
        (dict(noise_memory=(-1.0,)), "noise_memory must be finite and at least 0"),
        (dict(steps=0), "steps must be"),
    ],
    ids=str,
)
def test_a_collection_with_a_bad_argument_is_refused_by_name(change, message):
    with pytest.raises(ValueError, match=message):
        collect_normal(VICTIM, HOPPER, **dict(seeds=range(2), steps=2) | change)


def test_episodes_collected_in_parts_are_those_collected_together():
    parts, whole = (collect_normal(VICTIM, HOPPER, range(5), lockstep=n, steps=4) for n in (2, 5))
    assert np.allclose(parts.obs, whole.obs, atol=1e-4) and np.array_equal(parts.lengths, whole.lengths)
