"""The baselines that the GRU-VAEs have to beat: detectors and denoisers of a few lines, with the same interface."""

from collections.abc import Sequence
from math import inf, nan

import torch
from torch import Tensor

from detden_lite.core.budget import Budget
from detden_lite.core.distances import mahalanobis
from detden_lite.defense.detector import as_threshold
from detden_lite.defense.linear_models import Gaussian, LinearModel, steady_gain
from detden_lite.defense.memory import Memoryless


class Identity(Memoryless):
    """The denoiser that does nothing. Its error is the attack's size, so that an MAE near epsilon is no merit.

    Example:
        >>> Identity().step(torch.tensor([[1.0, 2.0]]))
        tensor([[1., 2.]])
    """

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """o_hat itself, ``[N, obs_dim]``; the policy's last ``action`` is not used."""
        return obs


class KalmanFilter:
    """The best linear denoiser, if the robot were linear and the attack independent noise as large as the ball allows.

    The model covers all dimensions together. It knows all that one filter a dimension could know, and in addition that
    velocities tell something of positions. Its gain is the one at which the recursion settles, so that a step is two
    matrix products, the same for all episodes.

    Args:
        model: fitted on D_normal.
        budget: the attacker's ball, which sets the measurement noise: epsilon (times scale) squared is the largest
            variance of a dimension; for the norms 2 and 1, which all dimensions share, its mean over them.

    Raises:
        ValueError: if the budget's scale has another length than the observations.

    Example:
        >>> one = torch.ones(1, 1, dtype=torch.float64)
        >>> still = LinearModel(transition=one, offset=0 * one[0], noise=0.02 * one, start=0 * one[0])
        >>> kalman = KalmanFilter(still, Budget(0.1))
        >>> kalman.reset(episodes=[0])
        >>> [round(kalman.step(torch.ones(1, 1)).item(), 3) for _ in range(3)]
        [0.732, 0.928, 0.981]
    """

    def __init__(self, model: LinearModel, budget: Budget):
        self.obs_dim = len(model.start)
        budget.projection(torch.zeros(1, self.obs_dim))  # refuses a scale of another length
        size = torch.as_tensor(budget.epsilon * budget.scale, dtype=torch.float64).expand_as(model.start)
        share = 1 if budget.norm == inf else self.obs_dim
        self.model, self.gain = model, steady_gain(model, torch.diag(size.square() / share))

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, whose first observation is expected to be as in D_normal."""
        self.expected = self.model.start.repeat(len(episodes), 1)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.expected[i] = self.model.start

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """The filtered observation ``[N, obs_dim]``; the policy's last ``action`` is not used."""
        filtered = self.expected + (obs - self.expected) @ self.gain.T
        self.expected = self.model.predict(filtered)
        return filtered.to(obs.dtype)


class MahalanobisDetector(Memoryless):
    """An observation far from all of D_normal is an anomaly; without memory.

    Args:
        gaussian: fitted on D_normal.
        threshold: an alarm is a score above it; ``calibrate`` gives it.

    Raises:
        ValueError: if the threshold is not a number.

    Example:
        >>> detector = MahalanobisDetector(Gaussian(torch.zeros(1), torch.tensor([[4.0]])), threshold=3.0)
        >>> detector.step(torch.tensor([[2.0], [8.0]]))[:2]
        (tensor([1., 4.]), tensor([False,  True]))
    """

    def __init__(self, gaussian: Gaussian, threshold: float):
        self.mean, self.threshold = gaussian.mean, as_threshold(threshold)
        self.obs_dim, self.factor = len(gaussian.mean), torch.linalg.cholesky(gaussian.covariance)

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The distance from the mean ``[N]``, the alarm ``[N]`` bool, and the mean as reconstruction."""
        score = mahalanobis(obs, self.mean, factor=self.factor).sqrt().to(obs.dtype)
        return score, score > self.threshold, self.mean.to(obs.dtype).expand_as(obs)


class PredictionDetector:
    """An observation that does not follow from the one before is an anomaly: the error of the linear model's step.

    The error's size is its Mahalanobis distance, under Q. The observation after an attacked one may be alarming too,
    since it is predicted from that one. An episode's first observation follows from nothing; its score is 0.

    Args:
        model: fitted on D_normal.
        threshold: an alarm is a score above it; ``calibrate`` gives it.

    Raises:
        ValueError: if the threshold is not a number.

    Example:
        >>> one = torch.ones(1, 1, dtype=torch.float64)
        >>> still = LinearModel(transition=one, offset=0 * one[0], noise=0.01 * one, start=0 * one[0])
        >>> detector = PredictionDetector(still, threshold=5.0)
        >>> detector.reset(episodes=[0])
        >>> [detector.step(torch.full((1, 1), obs))[1].item() for obs in (0.0, 0.1, 1.1)]
        [False, False, True]
    """

    def __init__(self, model: LinearModel, threshold: float):
        self.model, self.threshold = model, as_threshold(threshold)
        self.obs_dim, self.factor = len(model.offset), torch.linalg.cholesky(model.noise)

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes."""
        self.expected = torch.full((len(episodes), self.obs_dim), nan, dtype=torch.float64)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.expected[i] = nan

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The prediction's error ``[N]``, the alarm ``[N]`` bool, and the prediction as reconstruction."""
        expected = torch.where(self.expected.isnan(), obs, self.expected)
        self.expected = self.model.predict(obs)
        score = mahalanobis(obs, expected, factor=self.factor).sqrt().to(obs.dtype)
        return score, score > self.threshold, expected.to(obs.dtype)
