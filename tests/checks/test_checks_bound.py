"""Every check passes on a solution and fails on plausible mistakes."""

import math

import numpy as np
import pytest
import torch

from detden_lite.checks import bound as checks
from detden_lite.theory.finite_mdp import FiniteMDP

CONSTANT = np.array([[1.0, 0.0], [1.0, 0.0]])
FALSE_KL = 0.5 * (math.log(2) - 0.5)


def counterexample(gamma, pays=(1.0, 0.0), policy=CONSTANT):
    stay = np.repeat(np.eye(2)[:, None], 2, axis=1)
    return FiniteMDP(stay, np.broadcast_to(pays, (2, 2, 2)), gamma), policy


def exact_and_pinsker(mean_1, mean_2, std):
    distance = ((mean_2 - mean_1) / std).norm(dim=-1)
    return torch.erf(distance / 8**0.5), distance / 2


def false_step(**changed):
    answer = dict(step="C_1", first=(0.0, 1.0), second=(0.0, 2.0), kl=FALSE_KL, right=0.0) | changed
    return tuple(answer.values())


def test_the_solutions_pass(capsys):
    checks.check_counterexample(counterexample)
    checks.check_exact_and_pinsker(exact_and_pinsker)
    checks.check_false_step(false_step)
    assert capsys.readouterr().out.count("Right") == 3


def test_another_counterexample_passes_too():
    """Random actions, three states, and a value that differs because of where one ends up."""

    def walk(gamma):
        transition = np.zeros((3, 2, 3))
        transition[0, :, 1] = transition[1, :, 2] = transition[2, :, 2] = 1
        reward = np.zeros((3, 2, 3))
        reward[1] = -1
        return FiniteMDP(transition, reward, gamma), np.full((3, 2), 0.5)

    checks.check_counterexample(walk)


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda gamma: counterexample(gamma)[0], "two things"),
        (lambda gamma: counterexample(0.9), "the one that is given, 0.5"),
        (lambda gamma: counterexample(gamma, policy=CONSTANT[:, :1]), r"the shape \(2, 1\)"),
        (lambda gamma: counterexample(gamma, policy=np.ones((2, 2))), "its sum is 1"),
        (lambda gamma: counterexample(gamma, policy=np.eye(2)), "not constant"),
        (lambda gamma: counterexample(gamma, pays=(1.0, 1.0)), "every state has the value 2"),
        (lambda gamma: (counterexample(gamma)[0], None), "gives None"),
    ],
)
def test_a_wrong_counterexample_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_counterexample(mistake)


def _with_distance(distance):
    return lambda m, n, s: (torch.erf(distance(n - m, s) / 8**0.5), distance(n - m, s) / 2)


def _changed(exact=lambda d: torch.erf(d / 8**0.5), pinsker=lambda d: d / 2):
    return lambda m, n, s: tuple(f(((n - m) / s).norm(dim=-1)) for f in (exact, pinsker))


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda m, n, s: exact_and_pinsker(m, n, s)[0], "two things"),
        (_with_distance(lambda moved, s: moved.norm(dim=-1)), "by the standard deviations"),
        (_with_distance(lambda moved, s: (moved / s**2).norm(dim=-1)), "not by the variance"),
        (_with_distance(lambda moved, s: (moved / s).abs().sum(-1)), "take the root"),
        (_with_distance(lambda moved, s: (moved / s).sum(-1).abs()), "inside the root"),
        (_with_distance(lambda moved, s: (moved / s).norm()), "shape"),
        (_changed(exact=lambda d: 2 * torch.special.ndtr(d) - 1), "HALF"),
        (_changed(exact=lambda d: torch.erf(d / 2)), "root of two"),
        (_changed(exact=lambda d: 2 * torch.erf(d / 8**0.5)), "whole l1"),
        (_changed(exact=lambda d: torch.special.ndtr(d / 2)), r"That is Phi\(d / 2\)"),
        (_changed(pinsker=lambda d: d / 2**0.5), "root of half the KL"),
        (_changed(pinsker=lambda d: d), "Both halves"),
        (_changed(pinsker=lambda d: d**2 / 4), "root is missing"),
        (_changed(pinsker=lambda d: (d / 2).clamp(max=1)), "do not clip it"),
    ],
)
def test_a_wrong_total_variation_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_exact_and_pinsker(mistake)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (dict(extra=1), "five things"),
        (dict(step="C_3"), "one of Pinsker, C_1"),
        (dict(step="Pinsker"), "any two distributions"),
        (dict(step="C_2"), "largest eigenvalue"),
        (dict(step="Lipschitz"), "assumption"),
        (dict(second=(0.0, 0.0)), "positive"),
        (dict(second=(0.0, 1.0)), "equal variances"),
        (dict(second=(0.1, 2.0)), "come closer"),
        (dict(right=0.1), "C_1 multiplies .*yours is 0.1"),
        (dict(kl=0.5 * (1 - math.log(2))), "other direction"),
        (dict(kl=0.1), "should be 0.0965"),
    ],
)
def test_a_wrong_step_is_explained(changed, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_false_step(lambda: false_step(**changed))
