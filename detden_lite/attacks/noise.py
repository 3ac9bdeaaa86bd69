"""Noise in the attacker's ball: the control that every attack must beat."""

from collections.abc import Sequence

from torch import Tensor

from detden_lite.attacks.base import BallAttack
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import World


class UniformNoise(BallAttack):
    """A uniformly random point of the ball.

    Args:
        budget: the ball.
        seed: of the noise.

    Raises:
        ValueError: if ``budget`` is no ``Budget``; and at the first call, if the observations are not sound.

    Example:
        >>> import torch
        >>> from detden_lite import Budget, UniformNoise
        >>> attack, obs = UniformNoise(Budget(0.1)), torch.zeros(2, 3)
        >>> attack.reset([0, 1])
        >>> attack.budget.contains(obs, attack(obs))
        tensor([True, True])
    """

    def __init__(self, budget: Budget, seed: int = 0) -> None:
        super().__init__(budget)
        self.seed = seed

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        super().reset(episodes)
        self.streams = RandomStreams(self.seed, episodes)

    def __call__(self, obs: Tensor, world: World | None = None) -> Tensor:
        """Perturbed observations ``[N, obs_dim]``."""
        self.check(obs)
        return self.budget.project(obs, self.noisy(obs))

    def noisy(self, obs: Tensor) -> Tensor:
        """The observations with noise, which may still be outside the ball."""
        return self.budget.sample(obs, self.streams)


class GaussianNoise(UniformNoise):
    """Gaussian noise of standard deviation epsilon (times scale), projected into the ball; see ``UniformNoise``.

    Example:
        >>> import torch
        >>> from detden_lite import Budget, GaussianNoise
        >>> attack, obs = GaussianNoise(Budget(0.1)), torch.zeros(2, 3)
        >>> attack.reset([0, 1])
        >>> attack.budget.contains(obs, attack(obs))
        tensor([True, True])
    """

    def noisy(self, obs: Tensor) -> Tensor:
        return obs + self.streams.normal(*obs.shape) * self.budget.epsilon * self.budget.scale
