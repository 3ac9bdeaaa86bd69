"""The opposite attack: make the policy do something as different as possible (section 3.2.1, equation 1)."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.core.distances import mahalanobis
from detden_lite.core.types import World
from detden_lite.victims.action_gradients import ActionObjective
from detden_lite.victims.victim import Victim


def action_distance(victim: Victim, action: Tensor) -> Callable[[Tensor], Tensor]:
    """l_op as a function of other actions ``[N, action_dim]``: how far each is from ``action``, ``[N]``.

    For a deterministic policy this is the squared Euclidean distance, which has the same maximiser as the paper's
    distance and a gradient everywhere. For a Gaussian one it is the squared Mahalanobis distance of the means.
    """
    precision = 1.0 if victim.action_std is None else victim.action_std**-2
    return lambda other: mahalanobis(other, action, precision=precision)


def opposite_objective(victim: Victim, obs: Tensor) -> Callable[[Tensor], Tensor]:
    """l_op(o, .): how far the policy's action moves when it sees ``[N, obs_dim]`` perturbed instead of ``obs``.

    Example:
        >>> from detden_lite import Victim, opposite_objective
        >>> victim, obs = Victim([11, 8, 3]), torch.zeros(2, 11)
        >>> opposite_objective(victim, obs)(obs)
        tensor([0., 0.])
    """
    with torch.no_grad():
        distance = action_distance(victim, victim.mean(obs))
    return lambda perturbed: distance(victim.mean(perturbed))


class OppositeAttack(GradientAttack):
    """Projected gradient ascent on l_op; see ``GradientAttack`` for the arguments.

    Example:
        >>> from detden_lite import Budget, OppositeAttack, Victim
        >>> victim, obs = Victim([2, 1], gaussian=True), torch.zeros(1, 2)
        >>> attack = OppositeAttack(victim, Budget(0.1))
        >>> attack.reset([0])
        >>> attack(obs).abs()  # of a linear policy a corner of the ball is the worst point
        tensor([[0.1000, 0.1000]])
    """

    needs = frozenset({"policy"})
    clips = False

    def objective(self, obs: Tensor, world: World | None = None) -> ActionObjective:
        """``opposite_objective``, with the policy's gradient by hand."""
        return ActionObjective(self.policy, action_distance(self.victim, self.policy.forward(obs).clone()))
