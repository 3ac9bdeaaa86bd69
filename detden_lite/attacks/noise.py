"""Noise in the attacker's ball: the control that every attack must beat."""

from collections.abc import Sequence

from torch import Tensor

from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams


class UniformNoise:
    """A uniformly random point of the ball."""

    needs: frozenset[str] = frozenset()

    def __init__(self, budget: Budget, seed: int = 0):
        self.budget, self.seed = budget, seed

    def reset(self, episodes: Sequence[int]) -> None:
        self.streams = RandomStreams(self.seed, episodes)

    def __call__(self, obs: Tensor, world=None) -> Tensor:
        return self.budget.project(obs, self.budget.sample(obs, self.streams))


class GaussianNoise(UniformNoise):
    """Gaussian noise of standard deviation epsilon (times scale), projected into the ball."""

    def __call__(self, obs: Tensor, world=None) -> Tensor:
        noise = self.streams.normal(*obs.shape) * self.budget.epsilon * self.budget.scale
        return self.budget.project(obs, obs + noise)
