"""The opposite attack: make the policy do something as different as possible (section 3.2.1, equation 1)."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from detden_lite.ascent import ascend
from detden_lite.budget import Budget
from detden_lite.draws import Draws
from detden_lite.victims import Victim


def opposite_objective(victim: Victim, obs: Tensor) -> Callable[[Tensor], Tensor]:
    """l_op(o, .): how far the policy's action moves when it sees ``[N, obs_dim]`` perturbed instead of ``obs``.

    For a deterministic policy this is the squared Euclidean distance of the actions, which has the same maximiser as
    the paper's distance and a gradient everywhere; for a Gaussian one the squared Mahalanobis distance of the means.
    """
    with torch.no_grad():
        action = victim.mean(obs)
    weight = 1.0 if victim.action_std is None else victim.action_std**-2

    def objective(perturbed: Tensor) -> Tensor:
        return ((victim.mean(perturbed) - action).square() * weight).sum(-1)

    return objective


class OppositeAttack:
    """Projected gradient ascent on l_op from a random start, at every call.

    Args:
        victim: the policy under attack.
        budget: the ball.
        steps: gradient steps (1 is FGSM).
        restarts: random starts; the best is taken.
        seed: of the random starts.
    """

    needs = frozenset({"policy"})

    def __init__(self, victim: Victim, budget: Budget, steps: int = 20, restarts: int = 1, seed: int = 0):
        self.victim, self.budget, self.steps, self.restarts, self.seed = victim, budget, steps, restarts, seed

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        self.draws = Draws(self.seed, episodes)

    def __call__(self, obs: Tensor, world=None) -> Tensor:
        objective = opposite_objective(self.victim, obs)
        return ascend(objective, obs, self.budget, self.draws, self.steps, restarts=self.restarts)
