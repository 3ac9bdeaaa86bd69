"""The optimal attack: perturbations by a policy that learned to harm the victim (section 3.2.1, equation 3)."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.attacks.base import BallAttack
from detden_lite.core.budget import Budget
from detden_lite.core.types import World


def perturb(budget: Budget, obs: Tensor, direction: Tensor) -> Tensor:
    """proj_B(o + epsilon * scale * a), the point of B(o) that a ``direction`` a means, all ``[N, obs_dim]``."""
    return budget.project(obs, obs + budget.epsilon * budget.scale * direction)


class OptimalAttack(BallAttack):
    """The perturbation is the action of an adversarial policy, which sees the true observation.

    During an episode it does not query the victim. The adversary has learned before, by acting on the victim in the
    simulator and watching the reward: to it the policy was a black box. So the attack ``needs`` an adversary.

    Args:
        adversary: maps observations ``[N, obs_dim]`` to as many numbers in [-1, 1], in units of the ball's radius: a
            ``Victim`` whose actions are perturbations, see ``detden_lite.load_adversary``.
        budget: the ball.

    Raises:
        ValueError: if the adversary is a policy with another number of actions, or, at the first call, of another task.

    Example:
        >>> from detden_lite import Budget, OptimalAttack
        >>> attack = OptimalAttack(lambda obs: -obs.sign(), Budget(0.1))  # an adversary that shrinks every number
        >>> attack.reset([0])
        >>> attack(torch.tensor([[1.0, -2.0, 0.0]]))
        tensor([[ 0.9000, -1.9000,  0.0000]])
    """

    needs = frozenset({"adversary"})

    def __init__(self, adversary: Callable[[Tensor], Tensor], budget: Budget) -> None:
        super().__init__(budget, getattr(adversary, "obs_dim", None), "adversary")
        self.adversary = adversary
        self._check_size(getattr(adversary, "action_dim", self.obs_dim), self.obs_dim)

    @torch.no_grad()
    def __call__(self, obs: Tensor, world: World | None = None) -> Tensor:
        """The perturbed observations ``[N, obs_dim]``."""
        self.check(obs)
        direction = self.adversary(obs)
        self._check_size(direction.shape[-1], obs.shape[1])
        return perturb(self.budget, obs, direction)

    @staticmethod
    def _check_size(found: int | None, right: int | None) -> None:
        if found != right:
            raise ValueError(f"adversary: it perturbs {found} numbers of {right}; give the adversary of this task")
