"""Two searches that are led by a surrogate objective, and keep the point with the largest value."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.core.ascent import Best
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams

Project = Callable[[Tensor], Tensor]  # into the set of points [n, obs_dim] that must not be left

Measure = Callable[[Tensor], tuple[Tensor, Tensor]]  # the value of points [n, obs_dim] and its surrogate, [n] each


def climb(measure: Measure, start: Tensor, project: Project, budget: Budget, steps: int) -> Tensor:
    """The point with the largest value that was met on the way up a surrogate's gradient.

    Steps shrink from 15 epsilon / steps (at most 2 epsilon) on, with the square of the remaining share of steps. So a
    walk of 100 steps crosses the ball more than twice, and then settles at the border of a constraint, if there is one.

    Args:
        measure: the value and the surrogate, row by row.
        start: ``[n, obs_dim]``.
        project: keeps the walk inside.
        budget: in whose norm steps are measured.
        steps: how many.

    Example:
        >>> from detden_lite import Budget, climb
        >>> obs, budget = torch.zeros(1, 2), Budget(0.1)
        >>> climb(lambda x: (x.sum(-1), x.sum(-1)), obs, budget.projection(obs), budget, steps=10).detach()
        tensor([[0.1000, 0.1000]])
    """
    x = project(start)
    best = Best(x)
    for step in range(steps):
        length = budget.epsilon * min(2.0, 15 / steps) * (1 - step / steps) ** 2
        x.requires_grad_()
        with torch.enable_grad():
            value, surrogate = measure(x)
            (gradient,) = torch.autograd.grad(surrogate.sum(), x)
        x = x.detach()
        best.meet(x, value.detach())
        x = project(x.add(budget.steepest(gradient), alpha=length))
    best.meet(x, measure(x)[0])
    return best.point


def evolve(
    measure: Measure, start: Tensor, project: Project, budget: Budget, steps: int, population: int, elites: int,
    streams: RandomStreams,
) -> Tensor:  # fmt: skip
    """The point with the largest value that was met in a cross-entropy search, which uses no gradient.

    Args:
        measure: the value and the surrogate, row by row; points are ordered by the surrogate.
        start: mean of the first points, ``[n, obs_dim]``; their standard deviation is epsilon, times scale.
        project: keeps the points inside.
        budget: the ball whose size that is.
        steps: how often mean and standard deviation are fitted to the elites.
        population: points of each fit.
        elites: how many of them are elites.
        streams: of the points, of n rows.

    Example:
        >>> from detden_lite import Budget, RandomStreams, evolve
        >>> obs, budget = torch.zeros(1, 2), Budget(0.1)
        >>> rise = lambda x: (x.sum(-1), x.sum(-1))
        >>> found = evolve(rise, obs, budget.projection(obs), budget, 10, 16, 4, RandomStreams(0))
        >>> bool(found.sum() > 0.19)
        True
    """
    mean, spread = project(start), torch.as_tensor(budget.epsilon * budget.scale)
    best = Best(mean)
    for _ in range(steps):
        points = [project(mean + spread * streams.normal(*start.shape)) for _ in range(population)]
        surrogates = []
        for point in points:
            value, surrogate = measure(point)
            best.meet(point, value)
            surrogates.append(surrogate)
        first = torch.stack(surrogates).argsort(0, descending=True)[:elites]
        elite = torch.stack(points).gather(0, first[..., None].expand(-1, *start.shape))
        mean, spread = elite.mean(0), elite.std(0)
    return best.point
