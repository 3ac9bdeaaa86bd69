"""Two searches whose aim is not what leads them: a stand-in says where to go, the value says what is kept."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.core.ascent import Best
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams

Project = Callable[[Tensor], Tensor]  # into the set of points [n, obs_dim] that must not be left

Measure = Callable[[Tensor], tuple[Tensor, Tensor]]  # the value of points [n, obs_dim] and its stand-in, [n] each


def climb(measure: Measure, start: Tensor, project: Project, budget: Budget, steps: int) -> Tensor:
    """The point with the largest value that was met on the way up a stand-in's gradient.

    Steps shrink from 15 epsilon / steps (at most 2 epsilon) on, with the square of what is left of the way. So a walk
    of 100 steps crosses the ball more than twice, and then settles at the border of a constraint, if there is one.

    Args:
        measure: what is to be large, and the stand-in, row by row.
        start: ``[n, obs_dim]``.
        project: keeps the walk inside.
        budget: in whose norm steps are measured.
        steps: how many.
    """
    x = project(start)
    best = Best(x)
    for step in range(steps):
        length = budget.epsilon * min(2.0, 15 / steps) * (1 - step / steps) ** 2
        x.requires_grad_()
        with torch.enable_grad():
            value, stand_in = measure(x)
            (gradient,) = torch.autograd.grad(stand_in.sum(), x)
        x = x.detach()
        best.meet(x, value.detach())
        x = project(x.add(budget.steepest(gradient), alpha=length))
    best.meet(x, measure(x)[0])
    return best.point


def evolve(
    measure: Measure, start: Tensor, project: Project, budget: Budget, steps: int, population: int, elites: int,
    streams: RandomStreams,
) -> Tensor:  # fmt: skip
    """The point with the largest value that was met in a cross-entropy search, which asks for no gradient.

    Args:
        measure: what is to be large, and the stand-in, by which points are ordered, row by row.
        start: mean of the first points, ``[n, obs_dim]``; their standard deviation is epsilon, times scale.
        project: keeps the points inside.
        budget: the ball whose size that is.
        steps: how often mean and standard deviation are fitted to the elites.
        population: points of each time.
        elites: how many of them are elites.
        streams: of the points, of n rows.
    """
    mean, spread = project(start), torch.as_tensor(budget.epsilon * budget.scale)
    best = Best(mean)
    for _ in range(steps):
        points = [project(mean + spread * streams.normal(*start.shape)) for _ in range(population)]
        stand_ins = []
        for point in points:
            value, stand_in = measure(point)
            best.meet(point, value)
            stand_ins.append(stand_in)
        first = torch.stack(stand_ins).argsort(0, descending=True)[:elites]
        elite = torch.stack(points).gather(0, first[..., None].expand(-1, *start.shape))
        mean, spread = elite.mean(0), elite.std(0)
    return best.point
