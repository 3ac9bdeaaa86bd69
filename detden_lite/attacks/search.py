"""Two searches whose aim is not what leads them: a stand-in says where to go, the true value says what is kept."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.budget import Budget
from detden_lite.draws import Draws
from detden_lite.gradients import value_and_gradient

Function = Callable[[Tensor], Tensor]  # of points [n, obs_dim], row by row


def climb(value: Function, stand_in: Function, start: Tensor, project: Function, budget: Budget, steps: int) -> Tensor:
    """The point with the largest value that was met on the way up a stand-in's gradient.

    Steps shrink from 15 epsilon / steps (at most 2 epsilon) on, with the square of what is left of the way. So a walk
    of 100 steps crosses the ball more than twice, and then settles at the border of a constraint, if there is one.

    Args:
        value: what is to be large, ``[n]``.
        stand_in: whose gradient is followed, ``[n]``.
        start: ``[n, obs_dim]``.
        project: into the set that must not be left, ``[n, obs_dim]``.
        budget: in whose norm steps are measured.
        steps: how many.
    """
    x = project(start)
    keep = _Best(value, x)
    for step in range(steps):
        length = budget.epsilon * min(2.0, 15 / steps) * (1 - step / steps) ** 2
        _, gradient = value_and_gradient(stand_in, x)
        x = project(x.add(budget.steepest(gradient), alpha=length))
        keep(x)
    return keep.point


def evolve(
    value: Function,
    stand_in: Function,
    start: Tensor,
    project: Function,
    budget: Budget,
    steps: int,
    population: int,
    elites: int,
    draws: Draws,
) -> Tensor:
    """The point with the largest value among the leaders of a cross-entropy search, which asks for no gradient.

    Args:
        value: as in ``climb``.
        stand_in: by which points are ordered, ``[n]``.
        start: mean of the first points; their standard deviation is epsilon, times scale.
        project: as in ``climb``.
        budget: the ball whose size that is.
        steps: how often mean and standard deviation are fitted to the elites.
        population: points of each time.
        elites: how many of them are elites.
        draws: of the points, of n rows.
    """
    mean, spread = project(start), torch.as_tensor(budget.epsilon * budget.scale)
    keep = _Best(value, mean)
    for _ in range(steps):
        points = torch.stack([project(mean + spread * draws.normal(*start.shape)) for _ in range(population)])
        order = torch.stack([stand_in(point) for point in points]).argsort(0, descending=True)
        elite = points.gather(0, order[:elites, :, None].expand(-1, -1, start.shape[1]))
        keep(elite[0])
        mean, spread = elite.mean(0), elite.std(0)
    return keep.point


class _Best:
    """The best point met so far, row by row."""

    def __init__(self, value: Function, point: Tensor):
        self.value, self.point, self.most = value, point, value(point)

    def __call__(self, point: Tensor) -> None:
        here = self.value(point)
        better = here > self.most
        self.point = torch.where(better[:, None], point, self.point)
        self.most = torch.where(better, here, self.most)
