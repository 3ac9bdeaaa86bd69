"""Checks of the chapter on what appendix A proves."""

from collections.abc import Callable
from math import isclose, log

import numpy as np
import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare, parts
from detden_lite.checks.failure import explained
from detden_lite.theory.bound import total_variation
from detden_lite.theory.finite_mdp import FiniteMDP


@explained
def check_counterexample(counterexample: Callable[[float], tuple[FiniteMDP, np.ndarray]]) -> None:
    """``counterexample(gamma)`` is an MDP and a constant policy whose values differ."""
    for gamma in (0.5, 0.9):
        result = counterexample(gamma)
        mdp, policy = parts(f"counterexample({gamma})", result, "a FiniteMDP", "the policy [S, A]")
        assert isinstance(mdp, FiniteMDP), (
            f"counterexample({gamma}) gives a {type(mdp).__name__} first, and should give a FiniteMDP"
        )
        policy = array(f"the policy of counterexample({gamma})", policy)
        assert mdp.gamma == gamma, f"the MDP's gamma is {mdp.gamma}; it should be the one that is given, {gamma}"
        states, actions, _ = mdp.reward.shape
        assert policy.shape == (states, actions), (
            f"the policy has the shape {policy.shape}; with {states} states and {actions} actions it is "
            f"{(states, actions)}"
        )
        assert (policy >= 0).all() and np.allclose(policy.sum(1), 1), (
            "a row of the policy is a distribution over the actions: not negative, and its sum is 1"
        )
        apart = 0.5 * np.abs(policy[:, None] - policy[None]).sum(-1).max()
        assert apart < 1e-9, (
            f"the policy is not constant: two of its rows have a total variation of {apart:.3g}, so that the right "
            "side is not 0. Give every state the same row"
        )
        value = mdp.value(policy)
        assert np.ptp(value) > 1e-6, (
            f"every state has the value {value[0]:.4g}, so that both sides are 0. The policy is the same in all "
            "states, but the rewards need not be: let one state pay more, whatever the action"
        )
    print(
        f"Right. The total variation is 0, and the values are {np.round(value, 3).tolist()}: the left side is "
        f"{np.ptp(value):.3g}, the right side 0. There is no attack in it."
    )


@explained
def check_exact_and_pinsker(exact_and_pinsker: Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]) -> None:
    """``exact_and_pinsker(mean_1, mean_2, std)`` is the exact TV and Pinsker's bound of it, ``[N]`` each."""
    mean_1 = torch.tensor([[0.0, 0.0], [0.3, -0.2], [1.0, 1.0]])
    mean_2 = torch.tensor([[0.1, 0.0], [0.3, -0.2], [0.0, 2.0]])
    std = torch.tensor([0.2, 0.5])
    call = "exact_and_pinsker(mean_1, mean_2, std)"
    result = parts(call, exact_and_pinsker(mean_1, mean_2, std), "the exact TV", "Pinsker's bound")
    moved = mean_2 - mean_1
    distance = (moved / std).norm(dim=-1)
    wrong = {
        "Divide the difference of the means by the standard deviations": moved.norm(dim=-1),
        "Divide by the standard deviation, not by the variance": (moved / std.square()).norm(dim=-1),
        "Several actions: square, sum, and take the root, as for any distance": (moved / std).abs().sum(-1),
        "Several actions: square them, and sum inside the root": (moved / std).sum(-1).abs(),
    }
    hints = {hint: total_variation(d) for hint, d in wrong.items()}
    hints |= {
        "Phi is taken at HALF the distance": 2 * torch.special.ndtr(distance) - 1,
        "erf(x) is 2 Phi(x sqrt(2)) - 1: the root of two is missing": torch.erf(distance / 2),
        "This is the whole l1 distance; the total variation is half of it": 2 * total_variation(distance),
        "That is Phi(d / 2); the total variation is 2 Phi(d / 2) - 1": torch.special.ndtr(distance / 2),
    }
    compare("the exact TV", result[0], total_variation(distance), hints)
    hints = {hint: d / 2 for hint, d in wrong.items()}
    hints |= {
        "The root of half the KL, and the KL is half the squared distance": distance / 2**0.5,
        "Both halves are missing: KL / 2, and KL = distance^2 / 2": distance,
        "The root is missing: Pinsker's bound is the root of KL / 2": distance.square() / 4,
        "A bound may be larger than 1: do not clip it": (distance / 2).clamp(max=1),
    }
    compare("Pinsker's bound", result[1], distance / 2, hints)
    print("Right. In the third row Pinsker's bound is above 1. No total variation is, so it says nothing there.")


STEPS = ("Pinsker", "C_1", "C_2", "Lipschitz")


@explained
def check_false_step(false_step: Callable[[], tuple[str, tuple, tuple, float, float]]) -> None:
    """``false_step()`` is (step, (mean, variance), (mean, variance), the KL, what C_1 multiplies)."""
    names = ("the step", "(mean_1, variance_1)", "(mean_2, variance_2)", "the KL", "what C_1 multiplies")
    step, first, second, kl, right = parts("false_step()", false_step(), *names)
    mean_1, var_1 = (float(number) for number in parts(f"{names[1]} of false_step()", first, "mean", "variance"))
    mean_2, var_2 = (float(number) for number in parts(f"{names[2]} of false_step()", second, "mean", "variance"))
    kl, right = (float(array(name, number)) for name, number in ((names[3], kl), (names[4], right)))
    assert step in STEPS, f"the step is one of {', '.join(STEPS)}; yours is {step!r}"
    reasons = {
        "Pinsker": "Pinsker's inequality holds for any two distributions. Look further down",
        "C_2": (
            "the REASON given for C_2 is wrong, but there is one: the largest eigenvalue of the inverse covariance. "
            "Which step has no constant at all?"
        ),
        "Lipschitz": "that step is an assumption, and true of every network of linear layers, ReLU and tanh",
    }
    assert step == "C_1", reasons.get(step)
    assert var_1 > 0 and var_2 > 0, f"variances are positive; yours are {var_1} and {var_2}"
    true_kl = 0.5 * (log(var_2 / var_1) - 1 + var_1 / var_2) + 0.5 * (mean_2 - mean_1) ** 2 / var_2
    true_right = (mean_2 - mean_1) ** 2 / var_2
    assert var_1 != var_2, (
        "with equal variances the first part of the KL is 0, and C_1 = 1/2 will do for all means. It fails for others"
    )
    assert mean_1 == mean_2, (
        f"for your numbers the KL is {true_kl:.4g} and what C_1 multiplies is {true_right:.4g}: C_1 = "
        f"{true_kl / true_right:.4g} would do. Let the means come closer: which C_1 is large enough for all of them?"
    )
    assert isclose(right, true_right, abs_tol=1e-9), (
        f"C_1 multiplies (mean_2 - mean_1)^2 / variance_2, here {true_right:.4g}; yours is {right:.4g}"
    )
    swapped = 0.5 * (log(var_1 / var_2) - 1 + var_2 / var_1)
    assert not isclose(kl, swapped, abs_tol=1e-6), "that is the KL in the other direction: the second variance divides"
    assert isclose(kl, true_kl, abs_tol=1e-6), f"the KL should be {true_kl:.6g} here; yours is {kl:.6g}"
    print(f"Right. {kl:.4f} <= C_1 * 0 is false for every C_1.")
