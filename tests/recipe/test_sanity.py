"""Sanity rules: the shipped Hopper obeys them, and attacks with a planted mistake break the rule that it is about."""

import numpy as np
import pytest
import torch
from builders import HOPPER

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.qfunction import QFunctionAttack, q_objective
from detden_lite.core.budget import Budget
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.sanity import RuleCheck, check_attack
from detden_lite.store.models import load_victim

EPISODES = seeds("tuning", 8)


@pytest.fixture(scope="module")
def victims():
    torch.set_num_threads(1)
    return load_victim("hopper", "td3"), load_victim("hopper", "ppo")


def broken(found) -> set[str]:
    return {comparison.rule for comparison in found if not comparison.holds}


def test_the_q_function_attack_obeys_every_rule(victims):
    found = check_attack(QFunctionAttack, *victims, HOPPER, EPISODES, steps=100)
    assert len(found) == 5 and broken(found) == set()
    by_rule = {comparison.rule: comparison for comparison in found}
    assert all(len(one) == len(other) == 8 for one, other in (c.returns for c in found))
    noise = by_rule["a gradient beats noise"]
    assert noise.gain.mean == pytest.approx(noise.returns[0].mean() - noise.returns[1].mean())
    assert noise.gain.low > 150, "noise is survived for 100 steps, and the attack is not"


class Uphill(QFunctionAttack):
    """The sign is wrong."""

    def objective(self, obs, world=None):
        right = q_objective(self.victim, obs)
        return lambda perturbed: -right(perturbed)


class FromTheCentre(OppositeAttack):
    """It starts where the gradient is zero."""

    def __call__(self, obs, world=None):
        self.streams = None
        return super().__call__(obs, world)


class FixedSize(QFunctionAttack):
    """It forgets how large the ball is."""

    def __init__(self, victim, budget, steps):
        super().__init__(victim, Budget(0.1 * HOPPER.epsilon), steps)


@pytest.mark.parametrize(
    ("attack", "rules"),
    [
        (Uphill, {"a white box beats transfer", "a huge ball destroys any policy"}),
        (FromTheCentre, {"a white box beats transfer", "a huge ball destroys any policy"}),
        (FixedSize, {"a huge ball destroys any policy"}),
    ],
)
def test_an_attack_with_a_mistake_breaks_a_rule(victims, attack, rules):
    assert broken(check_attack(attack, *victims, HOPPER, EPISODES[:4], steps=60)) >= rules


@pytest.mark.parametrize(
    ("weaker", "stronger", "must_win", "holds"),
    [
        ([5, 6, 7], [1, 2, 3], True, True),
        ([5, 6, 7], [5, 6, 7], True, False),
        ([5, 6, 7], [5, 6, 7], False, True),
        ([1, 9, 1, 9], [9, 1, 9, 1], False, True),
        ([1, 9, 1, 9], [9, 1, 9, 1], True, False),
        ([1, 2, 3], [5, 6, 7], False, False),
    ],
)
def test_a_rule_is_broken_only_by_a_clear_loss(weaker, stronger, must_win, holds):
    returns = np.array(weaker, dtype=float), np.array(stronger, dtype=float)
    assert RuleCheck("rule", "weaker", "stronger", returns, must_win).holds == holds
