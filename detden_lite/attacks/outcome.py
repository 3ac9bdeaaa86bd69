"""The consequences of a perturbed observation, as an attacker who knows the defence predicts them."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from detden_lite.attacks.informed import View

FORBIDDEN = -1e12  # below any damage: the scale of a surrogate where the detector does the opposite of what is wanted


@dataclass(frozen=True)
class Outcome:
    """The predicted consequences of n perturbed observations, in K samples of the defence's noise.

    Example:
        >>> from detden_lite import Outcome
        >>> deviation = torch.tensor([[[0.5, 1.0], [3.0, 0.0]]])  # one sample, two observations of two numbers
        >>> outcome = Outcome(deviation, torch.tensor([8.0, 8.0]), torch.tensor([[1.0, 1.0]]), threshold=2.0)
        >>> outcome.alarm, outcome.damage
        (tensor([[False,  True]]), tensor([8., 1.]))
    """

    deviation: Tensor  # see ``View``, [K, n, obs_dim]
    bare: Tensor  # the damage of pi(o_hat), [n]
    denoised: Tensor  # the damage of pi(den(o_hat)), [K, n]
    threshold: float

    @classmethod
    def of(
        cls, perturbed: Tensor, view: View, policy: Callable[[Tensor], Tensor], of_action: Callable[[Tensor], Tensor]
    ) -> "Outcome":
        """The outcome of ``perturbed`` ``[n, obs_dim]``.

        Args:
            perturbed: what the defence is shown.
            view: the defence.
            policy: from observations ``[..., obs_dim]`` to actions.
            of_action: the damage ``[n]`` of actions ``[n, action_dim]``.
        """
        denoised = torch.vmap(of_action)(policy(view.denoise(perturbed)))
        return cls(view.deviation(perturbed), of_action(policy(perturbed)), denoised, view.threshold)

    @property
    def alarm(self) -> Tensor:
        """``[K, n]`` bool."""
        return self.deviation.amax(-1) > self.threshold

    @property
    def damage(self) -> Tensor:
        """The expected damage of what the defended policy really does, ``[n]``."""
        return torch.where(self.alarm, self.denoised, self.bare).mean(0)

    def quiet(self, allowed: float = 0.5) -> Tensor:
        """A surrogate for undetected damage, ``[n]``: that of pi(o_hat), and minus the excess where samples alarm.

        The excess is summed over the components that deviate too far, so that one step takes all of them back.

        Args:
            allowed: the part of the samples that may alarm.
        """
        excess = (self.deviation - self.threshold).relu().sum(-1).mean(0)
        return torch.where(self.alarm.float().mean(0) > allowed, FORBIDDEN * (1 + excess), self.bare)

    def loud(self) -> Tensor:
        """A surrogate for damage through the denoiser, ``[n]``: that of pi(den(o_hat)) where most samples alarm.

        Elsewhere it is minus the distance to the threshold.
        """
        missing = (self.threshold - self.deviation.amax(-1)).relu().mean(0)
        return torch.where(self.alarm.float().mean(0) > 0.5, self.denoised.mean(0), FORBIDDEN * (1 + missing))
