"""Projected gradient ascent in the ball: FGSM (Goodfellow et al., 2015) is one step, PGD (Madry et al., 2018) more."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.budget import Budget
from detden_lite.draws import Draws


def ascend(
    objective: Callable[[Tensor], Tensor],
    obs: Tensor,
    budget: Budget,
    draws: Draws | None,
    steps: int = 20,
    step_size: float | None = None,
    restarts: int = 1,
) -> Tensor:
    """The perturbed observations in B(obs) with the largest objective that was met on the way.

    Args:
        objective: maps perturbed observations ``[N, obs_dim]`` to values ``[N]``, row by row.
        obs: true observations ``[N, obs_dim]``.
        budget: the ball.
        draws: where random starts come from; None starts at ``obs`` itself, which is a stationary point of some
            objectives (the opposite attack's among them).
        steps: gradient steps of each restart.
        step_size: length of a step in the budget's norm; by default 2.5 epsilon / steps, and epsilon for one step.
        restarts: how many starts are tried.

    Returns:
        ``[N, obs_dim]``, inside the ball. As the best point met is kept, row by row, more restarts are never weaker.
    """
    if steps < 1 or restarts < 1:
        raise ValueError(f"steps and restarts must be at least 1, not {steps} and {restarts}")
    if step_size is None:
        step_size = budget.epsilon * (2.5 / steps if steps > 1 else 1.0)
    best, best_value = obs, torch.full(obs.shape[:1], -torch.inf, dtype=obs.dtype)

    def keep_best(x: Tensor, value: Tensor) -> None:
        nonlocal best, best_value
        better = value > best_value
        best = torch.where(better[:, None], x, best)
        best_value = torch.where(better, value, best_value)

    for _ in range(restarts):
        x = budget.project(obs, budget.sample(obs, draws)) if draws is not None else obs
        for _ in range(steps):
            x = x.detach().requires_grad_()
            with torch.enable_grad():
                value = objective(x)
                (gradient,) = torch.autograd.grad(value.sum(), x)
            keep_best(x.detach(), value.detach())
            x = budget.project(obs, x.detach() + step_size * budget.steepest(gradient))
        with torch.no_grad():
            keep_best(x, objective(x))
    return best
