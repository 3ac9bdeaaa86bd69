"""What an attacker may do to an observation: the ball B(o) (section 2.2 of the paper)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from numbers import Real

import torch
from torch import Tensor

from detden_lite.core.arguments import check_between
from detden_lite.core.random_streams import RandomStreams


@dataclass(frozen=True)
class Budget:
    """B(o) = {o' : ||(o' - o) / scale||_norm <= epsilon}.

    Args:
        epsilon: the radius, in units of ``scale``.
        norm: inf, 2 or 1.
        scale: 1.0 for the paper's ball in raw units, or ``[obs_dim]`` numbers (any sequence; kept as a float32 tensor),
            such as an observation normaliser's standard deviations (the convention of Zhang et al., 2021).

    Raises:
        ValueError: for a negative or infinite epsilon, another norm, or a scale that is not positive and finite; and
            from the methods, if the scale has another length than the observations.

    Example:
        >>> budget, obs = Budget(0.1), torch.zeros(1, 3)
        >>> budget.project(obs, torch.tensor([[0.5, -0.05, -2.0]]))
        tensor([[ 0.1000, -0.0500, -0.1000]])
        >>> budget.contains(obs, obs + 0.2)
        tensor([False])
    """

    epsilon: float
    norm: float = inf
    scale: float | Tensor = 1.0

    def __post_init__(self) -> None:
        check_between(0, inf, epsilon=self.epsilon)
        if self.norm not in (inf, 2, 1):
            raise ValueError(f"norm must be inf, 2 or 1, not {self.norm!r}")
        try:
            scale = torch.as_tensor(self.scale, dtype=torch.float32)
            good = scale.ndim < 2 and scale.numel() and ((scale > 0) & scale.isfinite()).all()
        except (TypeError, ValueError, RuntimeError):
            good = False
        if not good:
            raise ValueError(f"scale must be a number or one row, positive and finite everywhere, not {self.scale!r}")
        # A plain number stays one: it is exact, and 1.0 is skipped in ``steepest``.
        object.__setattr__(self, "scale", float(self.scale) if isinstance(self.scale, Real) else scale)

    def check_fits(self, obs_dim: int) -> None:
        """Refuse observations of a length that the scale is not made for; a ValueError says both lengths."""
        if isinstance(self.scale, Tensor) and self.scale.numel() not in (1, obs_dim):
            raise ValueError(
                f"scale: it has {self.scale.numel()} numbers, and an observation {obs_dim}; give one for each"
            )

    def size(self, obs: Tensor, perturbed: Tensor) -> Tensor:
        """||(perturbed - obs) / scale||, ``[N]``."""
        self.check_fits(obs.shape[-1])
        return torch.linalg.vector_norm((perturbed - obs) / self.scale, ord=self.norm, dim=-1)

    def contains(self, obs: Tensor, perturbed: Tensor, atol: float = 1e-5) -> Tensor:
        """Whether ``perturbed`` is in B(obs), ``[N]`` bool, up to ``atol`` for rounding."""
        return self.size(obs, perturbed) <= self.epsilon + atol

    def project(self, obs: Tensor, perturbed: Tensor) -> Tensor:
        """The point of B(obs) that is nearest to ``perturbed`` (in l2, after dividing by scale), ``[N, obs_dim]``."""
        if self.norm == inf:
            return self.projection(obs)(perturbed)
        self.check_fits(obs.shape[-1])
        delta = (perturbed - obs) / self.scale
        if self.norm == 1:
            delta = _soft_threshold(delta, self.epsilon)  # exact but for rounding, which the next lines take back
        size = torch.linalg.vector_norm(delta, ord=self.norm, dim=-1, keepdim=True)
        return obs + delta * (self.epsilon / size.clamp_min(torch.finfo(delta.dtype).tiny)).clamp(max=1) * self.scale

    def projection(self, obs: Tensor) -> Callable[[Tensor], Tensor]:
        """``project`` on the balls of these observations, for many calls."""
        self.check_fits(obs.shape[-1])
        if self.norm == inf:
            radius = self.epsilon * self.scale
            low, high = obs - radius, obs + radius
            return lambda perturbed: perturbed.clamp(low, high)
        return partial(self.project, obs)

    def steepest(self, gradient: Tensor) -> Tensor:
        """The step of size 1 in this norm that climbs fastest along ``gradient``, both ``[N, obs_dim]``."""
        if self.norm == inf:
            direction = gradient.sign()
            return direction if isinstance(self.scale, float) and self.scale == 1 else direction * self.scale
        g = gradient * self.scale
        if self.norm == 2:
            direction = g / torch.linalg.vector_norm(g, dim=-1, keepdim=True).clamp_min(torch.finfo(g.dtype).tiny)
        else:
            largest = g.abs().argmax(dim=-1, keepdim=True)
            direction = torch.zeros_like(g).scatter(-1, largest, g.gather(-1, largest).sign())
        return direction * self.scale

    def sample(self, obs: Tensor, streams: RandomStreams) -> Tensor:
        """A uniformly random point of B(obs), ``[N, obs_dim]``."""
        self.check_fits(obs.shape[-1])
        n, dim = obs.shape
        if self.norm == inf:
            delta = 2 * streams.uniform(n, dim) - 1
        else:
            if self.norm == 2:
                direction = streams.normal(n, dim)
            else:  # a Laplace vector has a direction that is uniform on the l1 sphere
                u = streams.uniform(n, dim) - 0.5
                direction = -u.sign() * torch.log1p(-2 * u.abs().clamp(max=0.5 - 1e-7))
            length = torch.linalg.vector_norm(direction, ord=self.norm, dim=-1, keepdim=True)
            radius = streams.uniform(n, 1) ** (1 / dim)
            delta = direction / length.clamp_min(torch.finfo(direction.dtype).tiny) * radius
        return obs + self.epsilon * delta.to(obs.dtype) * self.scale


def _soft_threshold(delta: Tensor, epsilon: float) -> Tensor:
    """Euclidean projection on the l1 ball (Duchi et al., 2008)."""
    ordered = delta.abs().sort(dim=-1, descending=True).values
    count = torch.arange(1, delta.shape[-1] + 1, dtype=delta.dtype)
    candidates = (ordered.cumsum(-1) - epsilon) / count
    support = (ordered > candidates).sum(-1, keepdim=True).clamp_min(1)
    threshold = candidates.gather(-1, support - 1).clamp_min(0)
    return delta.sign() * (delta.abs() - threshold).clamp_min(0)
