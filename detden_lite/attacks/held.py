"""Held offsets: one perturbation for many steps. They know nothing of the policy, and need no gradient.

To a detector of changes a held offset is invisible after its first step, and a denoiser that adds a correction to its
input lets it through. ``CornerAttack`` is a control beside noise; ``OffsetAttack`` holds the most harmful offset that
was found with the victim as a black box (``detden_lite.recipe.offset_search``).
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import inf

import torch
from torch import Tensor

from detden_lite.attacks.base import BallAttack
from detden_lite.attacks.optimal import perturb
from detden_lite.core.arguments import check_whole
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import World


def extreme_points(norm: float, n: int, dim: int, streams: RandomStreams) -> Tensor:
    """Random points on the border of the unit ball, ``[n, dim]``: corners (inf), the sphere (2), tips of axes (1).

    Example:
        >>> extreme_points(torch.inf, 2, 3, RandomStreams(0)).abs()
        tensor([[1., 1., 1.],
                [1., 1., 1.]])
    """
    points = streams.normal(n, dim)
    if norm == inf:
        return torch.where(points < 0, -1.0, 1.0)
    if norm == 2:
        return torch.nn.functional.normalize(points, dim=-1)
    largest = points.abs().argmax(-1, keepdim=True)
    return torch.zeros(n, dim).scatter(-1, largest, points.gather(-1, largest).sign())


class HeldAttack(BallAttack, ABC):
    """A sequence of offsets, each held for a while.

    Args:
        budget: the ball.
        every: steps until the next offset; None holds the first one for the whole episode.
        drift: whether to walk to the next offset in a straight line over these steps, instead of jumping.
        obs_dim: as of ``BallAttack``.

    Raises:
        ValueError: if ``every`` is no whole number of at least 1, or missing where the offset is to drift.

    Example:
        >>> class Left(HeldAttack):  # always the same side of the ball
        ...     def next(self, n, dim):
        ...         return -torch.ones(dim)
        >>> attack = Left(Budget(0.5))
        >>> attack.reset([0])
        >>> attack(torch.zeros(1, 2))
        tensor([[-0.5000, -0.5000]])
    """

    def __init__(
        self, budget: Budget, every: int | None = None, drift: bool = False, obs_dim: int | None = None
    ) -> None:
        if every is not None:
            check_whole(1, every=every)
        elif drift:
            raise ValueError("every: say in how many steps the offset drifts to the next one")
        super().__init__(budget, obs_dim, "offset")
        self.every, self.drift = every, drift

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        super().reset(episodes)
        self.step = 0

    @abstractmethod
    def next(self, n: int, dim: int) -> Tensor:
        """The next offset of each row, ``[n, dim]`` or ``[dim]``, in units of the ball's radius."""

    def __call__(self, obs: Tensor, world: World | None = None) -> Tensor:
        """Perturbed observations ``[N, obs_dim]``."""
        self.check(obs)
        phase = self.step % self.every if self.every else 0
        if self.step == 0:
            self.here = self.there = self.next(*obs.shape)
        if self.every and phase == 0:
            self.here, self.there = self.there, self.next(*obs.shape)
        self.step += 1
        way = phase / self.every if self.every and self.drift else 0.0
        return perturb(self.budget, obs, self.here + way * (self.there - self.here))


class CornerAttack(HeldAttack):
    """A random corner of the ball in each episode, or a random point of the sphere for other norms.

    Args:
        budget: the ball.
        every: see ``HeldAttack``; the next offset is a new corner.
        drift: see ``HeldAttack``.
        seed: of the corners.

    Example:
        >>> attack = CornerAttack(Budget(0.5))
        >>> attack.reset([0, 1])
        >>> first, second = (attack(torch.zeros(2, 11)) for _ in range(2))
        >>> bool((first == second).all()), first.abs().unique()
        (True, tensor([0.5000]))
    """

    def __init__(self, budget: Budget, every: int | None = None, drift: bool = False, seed: int = 0) -> None:
        super().__init__(budget, every, drift)
        self.seed = seed

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        super().reset(episodes)
        self.streams = RandomStreams(self.seed, episodes)

    def next(self, n: int, dim: int) -> Tensor:
        return extreme_points(self.budget.norm, n, dim, self.streams)


class OffsetAttack(HeldAttack):
    """The same offset in each episode; at every change it turns to its opposite.

    Args:
        offset: in units of the ball's radius, ``[obs_dim]``, or one a row ``[N, obs_dim]``.
        budget: the ball.
        every: see ``HeldAttack``; the next offset is the opposite one.
        drift: see ``HeldAttack``.

    Raises:
        ValueError: as ``HeldAttack``; and if the offset is no finite tensor of one or two dimensions.

    Example:
        >>> attack = OffsetAttack(torch.tensor([1.0, -1.0]), Budget(0.5), every=2, drift=True)
        >>> attack.reset([0])
        >>> torch.cat([attack(torch.zeros(1, 2)) for _ in range(4)])[:, 0]
        tensor([ 0.5000,  0.0000, -0.5000,  0.0000])
    """

    needs = frozenset({"adversary"})

    def __init__(self, offset: Tensor, budget: Budget, every: int | None = None, drift: bool = False) -> None:
        if not isinstance(offset, Tensor) or offset.ndim not in (1, 2) or not offset.isfinite().all():
            raise ValueError("offset must be a finite tensor [obs_dim], in units of the ball's radius, or one a row")
        super().__init__(budget, every, drift, offset.shape[-1])
        self.offset = offset

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        super().reset(episodes)
        self.sign = -1

    def next(self, n: int, dim: int) -> Tensor:
        self.sign = -self.sign
        return self.sign * self.offset
