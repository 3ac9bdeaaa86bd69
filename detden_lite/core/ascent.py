"""Projected gradient ascent in the ball: FGSM (Goodfellow et al., 2015) is one step, PGD (Madry et al., 2018) more."""

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from detden_lite.core.arguments import check_whole
from detden_lite.core.budget import Budget
from detden_lite.core.gradients import value_and_gradient
from detden_lite.core.random_streams import RandomStreams

Objective = Callable[[Tensor], Tensor]

ROWS = 4_096  # points that are climbed at once: enough for full speed, and few in memory


def ascend(
    objective: Objective,
    obs: Tensor,
    budget: Budget,
    streams: RandomStreams | None,
    steps: int = 20,
    step_size: float | None = None,
    restarts: int = 1,
    wanted: Tensor | None = None,
) -> Tensor:
    """The perturbed observations in B(obs) with the largest value of the objective among all points visited.

    Args:
        objective: maps perturbed observations ``[n, obs_dim]`` to values ``[n]``, row by row, and is differentiated by
            autograd (``detden_lite.core.gradients.value_and_gradient``), one restart after another. If it has a method
            ``value_and_gradient``, as an ``ActionObjective`` does, that gives the gradient, and both see many restarts
            at once, ``[restarts, n, obs_dim]``, which is faster and has the same result.
        obs: true observations ``[N, obs_dim]``.
        budget: the ball.
        streams: where random starts come from; None starts at ``obs`` itself, which is a stationary point of some
            objectives (the opposite attack's among them).
        steps: gradient steps of each restart.
        step_size: length of every step in the budget's norm. By default steps shrink evenly, from epsilon towards 0:
            long ones leave poor maxima behind, short ones settle.
        restarts: how many starts are tried.
        wanted: which of the N rows to perturb, ``[N]`` bool; by default all. ``objective`` sees only these. All rows
            use their random numbers, so that ``wanted`` does not change the others' starts.

    Returns:
        ``[N, obs_dim]``, inside the ball. As the best point is kept, row by row, more restarts are never weaker.

    Raises:
        ValueError: if ``steps`` or ``restarts`` is no whole number of at least 1.

    Example:
        >>> obs = torch.zeros(1, 3)
        >>> ascend(lambda x: x @ torch.tensor([2.0, -1.0, 0.5]), obs, Budget(0.1), None, steps=1)
        tensor([[ 0.1000, -0.1000,  0.1000]])
    """
    check_whole(1, steps=steps, restarts=restarts)
    shrinking = [budget.epsilon * (1 - step / steps) for step in range(steps)]
    sizes = shrinking if step_size is None else [step_size] * steps
    starts = torch.stack([budget.sample(obs, streams) if streams is not None else obs for _ in range(restarts)])
    if wanted is not None and not wanted.all():
        found = obs.clone()
        if wanted.any():
            found[wanted] = _climb(objective, obs[wanted], budget, starts[:, wanted], sizes)
        return found
    return _climb(objective, obs, budget, starts, sizes)


def _climb(objective: Objective, obs: Tensor, budget: Budget, starts: Tensor, sizes: list[float]) -> Tensor:
    slope = getattr(objective, "value_and_gradient", None)
    at_once = max(1, ROWS // max(1, len(obs))) if slope else 1
    slope = slope or partial(value_and_gradient, objective)
    best, project = Best(obs), budget.projection(obs)
    for group in starts.split(at_once):
        x = project(group if len(group) > 1 else group[0])
        met = Best(obs.expand_as(x))
        for size in sizes:
            value, gradient = slope(x)
            met.meet(x, value)
            x = project(x.add(budget.steepest(gradient), alpha=size))
        with torch.no_grad():
            met.meet(x, objective(x))
        for point, value in zip(met.point.view(-1, *obs.shape), met.value.view(-1, len(obs)), strict=True):
            best.meet(point, value)
    return best.point


class Best:
    """The best point so far, row by row.

    Args:
        point: ``[..., obs_dim]``, replaced by the first point whose value is above minus infinity.

    Example:
        >>> best = Best(torch.zeros(2, 1))
        >>> best.meet(torch.ones(2, 1), torch.tensor([1.0, 1.0]))
        >>> best.meet(torch.full((2, 1), 2.0), torch.tensor([0.0, 3.0]))
        >>> best.point.squeeze(-1)
        tensor([1., 2.])
    """

    def __init__(self, point: Tensor) -> None:
        self.point, self.value = point, torch.full(point.shape[:-1], -torch.inf, dtype=point.dtype)

    def meet(self, point: Tensor, value: Tensor) -> None:
        """Keep the rows of ``point`` ``[..., obs_dim]`` whose value ``[...]`` is above those kept."""
        better = value > self.value
        self.point = torch.where(better[..., None], point, self.point)
        self.value = torch.where(better, value, self.value)
