"""The optimal attack: perturbations by a policy that learned to harm the victim (section 3.2.1, equation 3)."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from detden_lite.core.budget import Budget


def perturb(budget: Budget, obs: Tensor, direction: Tensor) -> Tensor:
    """proj_B(o + epsilon * scale * a), the point of B(o) that a ``direction`` a means, all ``[N, obs_dim]``."""
    return budget.project(obs, obs + budget.epsilon * budget.scale * direction)


class OptimalAttack:
    """The perturbation is the action of an adversarial policy, which sees the true observation.

    During an episode it asks the victim nothing: what it knows of it was learned before, by acting on it in the
    simulator and watching the reward. So it ``needs`` an adversary, and whoever has one had the policy as a black box
    and the simulator.

    Args:
        adversary: maps observations ``[N, obs_dim]`` to as many numbers in [-1, 1], in units of the ball's radius: a
            ``Victim`` whose actions are perturbations. See ``detden_lite.adversaries``.
        budget: the ball.
    """

    needs = frozenset({"adversary"})

    def __init__(self, adversary: Callable[[Tensor], Tensor], budget: Budget):
        self.adversary, self.budget = adversary, budget

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        pass

    @torch.no_grad()
    def __call__(self, obs: Tensor, world=None) -> Tensor:
        """The perturbed observations ``[N, obs_dim]``.

        Raises:
            ValueError: if the adversary is of another task.
        """
        seen = getattr(self.adversary, "obs_dim", obs.shape[-1])
        direction = self.adversary(obs) if seen == obs.shape[-1] else None
        if direction is None or direction.shape != obs.shape:
            raise ValueError(
                f"adversary: it does not map {obs.shape[-1]} observations to as many perturbations; "
                "give the adversary of this task"
            )
        return perturb(self.budget, obs, direction)
