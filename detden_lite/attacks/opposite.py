"""The opposite attack: make the policy do something as different as possible (section 3.2.1, equation 1)."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.victims.action_gradients import ActionObjective
from detden_lite.victims.victim import Victim


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


class OppositeAttack(GradientAttack):
    """Projected gradient ascent on l_op; see ``GradientAttack`` for the arguments."""

    needs = frozenset({"policy"})
    clips = False

    def objective(self, obs: Tensor, world=None) -> ActionObjective:
        """``opposite_objective``, with the policy's gradient by hand."""
        action = self.policy.forward(obs).clone()
        weight = 1.0 if self.victim.action_std is None else self.victim.action_std**-2
        return ActionObjective(self.policy, lambda seen: ((seen - action).square() * weight).sum(-1))
