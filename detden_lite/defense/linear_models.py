"""Linear models of D_normal: a Gaussian of its observations, and how one observation follows another."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from detden_lite.core.arguments import check_positive
from detden_lite.core.types import Trajectories
from detden_lite.defense.augmentation import check_trajectories


@dataclass(frozen=True)
class Gaussian:
    """N(mean, covariance), float64: ``[obs_dim]`` and ``[obs_dim, obs_dim]``.

    Example:
        >>> normal = Trajectories(np.array([[[1.0], [3.0]]], np.float32), np.array([2]))
        >>> Gaussian.fit(normal).mean
        tensor([2.], dtype=torch.float64)
    """

    mean: Tensor
    covariance: Tensor

    @classmethod
    def fit(cls, normal: Trajectories, ridge: float = 1e-6) -> "Gaussian":
        """The Gaussian of all observations of D_normal.

        Args:
            normal: D_normal.
            ridge: added to each variance, as a part of it (in raw units where an observation hardly varies): a
                direction that never varies would make every deviation infinitely unlikely.

        Raises:
            ValueError: if ``ridge`` is not positive, or ``normal`` cannot be learned from.
        """
        check_trajectories("normal", normal)
        mean, covariance = _moments(normal, lambda obs: obs)
        return cls(mean, covariance + _ridge(covariance, ridge))


@dataclass(frozen=True)
class LinearModel:
    """o_{t+1} = A o_t + b + w with w ~ N(0, Q): the robot and its policy, as far as they are linear. All float64.

    Example:
        >>> halving = np.array([[[8.0], [4.0], [2.0], [1.0]]], np.float32)
        >>> model = LinearModel.fit(Trajectories(halving, np.array([4])))
        >>> round(model.predict(torch.tensor([[1.0]])).item(), 4)
        0.5
    """

    transition: Tensor  # A, [obs_dim, obs_dim]
    offset: Tensor  # b, [obs_dim]
    noise: Tensor  # Q, [obs_dim, obs_dim]
    start: Tensor  # the mean of an episode's first observation, [obs_dim]

    @classmethod
    def fit(cls, normal: Trajectories, ridge: float = 1e-6) -> "LinearModel":
        """Least squares over all pairs of successive observations; Q is the covariance of the residuals.

        Args:
            normal: D_normal.
            ridge: as in ``Gaussian.fit``, added to the variance of the observations and to Q.

        Raises:
            ValueError: if ``ridge`` is not positive, ``normal`` cannot be learned from, or no trajectory has two
                observations.
        """
        check_trajectories("normal", normal)
        if not (normal.lengths > 1).any():
            raise ValueError("normal: no trajectory has two observations, so nothing says how one follows another")
        d = normal.obs.shape[-1]
        mean, joint = _moments(normal, lambda obs: np.hstack([obs[:-1], obs[1:]]))
        before, cross, after = joint[:d, :d], joint[:d, d:], joint[d:, d:]
        transition = torch.cholesky_solve(cross, torch.linalg.cholesky(before + _ridge(before, ridge))).T
        explained = transition @ cross
        noise = after - explained - explained.T + transition @ before @ transition.T
        return cls(
            transition, mean[d:] - transition @ mean[:d], (noise + noise.T) / 2 + _ridge(after, ridge),
            torch.from_numpy(normal.obs[:, 0].mean(0, dtype=np.float64)),
        )  # fmt: skip

    def predict(self, obs: Tensor) -> Tensor:
        """A o + b, ``[N, obs_dim]`` float64."""
        return obs.double() @ self.transition.T + self.offset


def steady_gain(model: LinearModel, measurement: Tensor, steps: int = 1_000) -> Tensor:
    """The Kalman gain that the textbook's recursion of covariances settles at, ``[obs_dim, obs_dim]`` float64.

    Args:
        model: how observations follow each other.
        measurement: R, the covariance of the noise on the observation, ``[obs_dim, obs_dim]``.
        steps: the most steps of the recursion: no episode is longer.
    """
    gain, predicted = torch.full_like(measurement, torch.nan), model.noise
    for _ in range(steps):
        before = gain
        gain = torch.cholesky_solve(predicted, torch.linalg.cholesky(predicted + measurement)).T
        if torch.allclose(gain, before, rtol=0, atol=1e-9):
            break
        filtered = predicted - gain @ predicted
        predicted = model.transition @ (filtered + filtered.T) / 2 @ model.transition.T + model.noise
    return gain


def _moments(normal: Trajectories, rows: Callable[[np.ndarray], np.ndarray]) -> tuple[Tensor, Tensor]:
    """Mean and covariance of the rows that each episode gives, one episode after the other to save memory."""
    episodes = [obs[:length] for obs, length in zip(normal.obs, normal.lengths, strict=True)]
    n = sum(len(rows(obs)) for obs in episodes)
    mean = sum(rows(obs).sum(0, dtype=np.float64) for obs in episodes) / n
    centred = (rows(obs) - mean for obs in episodes)
    return torch.from_numpy(mean), torch.from_numpy(sum(part.T @ part for part in centred) / n)


def _ridge(covariance: Tensor, ridge: float) -> Tensor:
    check_positive(ridge=ridge)
    variance = covariance.diagonal()
    return torch.diag(ridge * torch.where(variance > 1e-8, variance, 1.0))
