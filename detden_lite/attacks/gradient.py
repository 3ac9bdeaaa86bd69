"""Attacks that climb an objective of their own by projected gradient ascent."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from torch import Tensor

from detden_lite.ascent import ascend
from detden_lite.budget import Budget
from detden_lite.draws import Draws
from detden_lite.victims import Victim


class GradientAttack(ABC):
    """Projected gradient ascent from a random start, at every call.

    Args:
        victim: the policy under attack.
        budget: the ball.
        steps: gradient steps (1 is FGSM).
        restarts: random starts; the best is taken.
        seed: of the random starts.
    """

    needs: frozenset[str]

    def __init__(self, victim: Victim, budget: Budget, steps: int = 20, restarts: int = 1, seed: int = 0):
        self.victim, self.budget, self.steps, self.restarts, self.seed = victim, budget, steps, restarts, seed

    @abstractmethod
    def objective(self, obs: Tensor, world=None) -> Callable[[Tensor], Tensor]:
        """What is to be large: maps perturbed observations ``[N, obs_dim]`` of ``obs`` to values ``[N]``."""

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        self.draws = Draws(self.seed, episodes)

    def __call__(self, obs: Tensor, world=None) -> Tensor:
        return ascend(self.objective(obs, world), obs, self.budget, self.draws, self.steps, restarts=self.restarts)
