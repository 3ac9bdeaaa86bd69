"""The policy with its input gradient, and attack objectives that see an observation through its action alone.

The version to read is autograd's: ``value_and_gradient`` of the objective through ``Policy.readable``. By default the
same gradient is computed by hand, which is faster. ``by_hand`` switches, and a test asserts that both are equal.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from detden_lite.core.gradients import Backprop, clamp_backward, value_and_gradient
from detden_lite.victims.victim import Victim


class Policy:
    """pi of a victim, forward and backward; a Gaussian policy's gradient is that of the unclipped mean.

    Args:
        victim: the policy.
        clip: whether to clip a Gaussian policy's mean to the action bounds, as the world does.
        dtype: see ``Backprop``.
        by_hand: whether objectives take their gradients from ``backward``, or from autograd through ``readable``.

    Example:
        >>> victim, obs = Victim([11, 64, 3]), torch.ones(2, 11)
        >>> policy = Policy(victim, clip=False)
        >>> bool(torch.allclose(policy.forward(obs), victim(obs)))
        True
        >>> policy.backward(torch.ones(2, 3)).shape
        torch.Size([2, 11])
    """

    def __init__(self, victim: Victim, clip: bool, dtype: torch.dtype = torch.float32, by_hand: bool = True) -> None:
        self.victim, self.clip, self.by_hand, self.actor = victim, clip, by_hand, Backprop(victim.actor, dtype)
        self.obs_clip = victim.obs_clip.item()  # a clamp to numbers takes a fraction of the time of one to tensors
        self.normalizes = bool((victim.obs_std != 1).any() or (victim.obs_mean != 0).any())
        self.normalizes |= bool(victim.obs_clip.isfinite())
        self.half_range = None if victim.action_std is not None else (victim.action_high - victim.action_low) / 2

    def readable(self, obs: Tensor) -> Tensor:
        """What ``forward`` computes, for autograd, ``[N, action_dim]``."""
        return self.victim.straight_through(obs) if self.clip else self.victim.mean(obs)

    def forward(self, obs: Tensor) -> Tensor:
        """``victim.mean(obs)``, or ``victim(obs)`` if it clips, ``[N, action_dim]``."""
        victim = self.victim
        if self.normalizes:
            obs = self.shown = (obs - victim.obs_mean).div_(victim.obs_std).clamp_(-self.obs_clip, self.obs_clip)
        action = self.actor.forward(obs)
        if self.half_range is not None:
            action = victim.action_low + (action + 1) * self.half_range
        return action.clamp(victim.action_low, victim.action_high) if self.clip else action

    def backward(self, gradient: Tensor) -> Tensor:
        """From a gradient with respect to the action to that with respect to the observation."""
        gradient = self.actor.backward(gradient if self.half_range is None else gradient * self.half_range)
        if not self.normalizes:
            return gradient
        clamp_backward(gradient, self.shown, -self.obs_clip, self.obs_clip, grad_input=gradient)
        return gradient.div_(self.victim.obs_std)


@dataclass(frozen=True)
class ActionObjective:
    """An attack's objective that sees the perturbed observation through the policy's action alone.

    Args:
        policy: the policy under attack.
        of_action: maps actions ``[N, action_dim]`` to values ``[N]``, row by row. For K points a row it is mapped over
            ``[K, N, action_dim]`` by ``torch.vmap``: it has to do without ``.item()`` and without a branch on a value.

    Example:
        >>> victim, obs = Victim([11, 64, 3]), torch.ones(2, 11)
        >>> objective = ActionObjective(Policy(victim, clip=False), lambda action: action.square().sum(-1))
        >>> value, gradient = objective.value_and_gradient(obs)
        >>> expected, slope = value_and_gradient(lambda x: victim(x).square().sum(-1), obs)
        >>> bool(torch.allclose(value, expected) and torch.allclose(gradient, slope, atol=1e-6))
        True
    """

    policy: Policy
    of_action: Callable[[Tensor], Tensor]

    def __call__(self, perturbed: Tensor) -> Tensor:
        """Values ``[N]`` of ``perturbed`` ``[N, obs_dim]``; ``[K, N]`` of K points a row, ``[K, N, obs_dim]``."""
        return self._of(perturbed)(self._act(perturbed))

    def value_and_gradient(self, perturbed: Tensor) -> tuple[Tensor, Tensor]:
        """Values and their gradients, of the shape of ``perturbed``: by autograd to the action, then by hand."""
        of_action = self._of(perturbed)
        if not self.policy.by_hand:
            return value_and_gradient(lambda obs: of_action(self.policy.readable(obs)), perturbed)
        value, gradient = value_and_gradient(of_action, self._act(perturbed))
        return value, self.policy.backward(gradient.flatten(0, -2)).view_as(perturbed)

    def _of(self, perturbed: Tensor) -> Callable[[Tensor], Tensor]:
        """``of_action`` for as many dimensions as ``perturbed`` has."""
        return self.of_action if perturbed.ndim == 2 else torch.vmap(self.of_action)

    def _act(self, perturbed: Tensor) -> Tensor:
        return self.policy.forward(perturbed.flatten(0, -2)).unflatten(0, perturbed.shape[:-1])
