"""Checks of the chapter on the ball of allowed perturbations."""

from collections.abc import Callable

import numpy as np


def check_project(project: Callable[[np.ndarray, np.ndarray, float], np.ndarray]) -> None:
    """``project(obs, perturbed, epsilon)`` is the nearest point to ``perturbed`` in the l-infinity ball around ``obs``."""
    obs = np.array([[0.0, 1.0, -2.0]])
    perturbed = np.array([[0.3, 1.05, -2.3]])
    result = project(obs, perturbed, 0.1)
    expected = np.array([[0.1, 1.05, -2.1]])
    assert np.allclose(result, expected), f"project({obs}, {perturbed}, 0.1) should be {expected}; yours gives {result}"
    print("Right: what is outside comes to the border, what is inside stays.")


def check_inside(inside: Callable[[np.ndarray, np.ndarray, float], np.ndarray]) -> None:
    """``inside(obs, perturbed, epsilon)`` tells for each row whether it is in the ball."""
    obs = np.zeros((2, 3))
    perturbed = np.array([[0.1, -0.1, 0.0], [0.0, 0.11, 0.0]])
    result = np.asarray(inside(obs, perturbed, 0.1))
    assert result.tolist() == [True, False], f"for {perturbed} and 0.1 it should be [True, False]; yours gives {result}"
    print("Right: the largest coordinate decides.")
