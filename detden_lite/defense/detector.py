"""The detector: an observation that its GRU-VAE cannot reproduce is an anomaly (section 3.1.1)."""

from math import isnan
from numbers import Real

from torch import Tensor

from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.memory import Recurrent


def linf_score(obs: Tensor, reconstruction: Tensor, scale: Tensor) -> Tensor:
    """The l-infinity distance of observation and reconstruction in units of ``scale``, over the last dimension.

    With D_normal's standard deviations as ``scale`` it is the error of the worst observation, in its deviations.

    Example:
        >>> import torch
        >>> linf_score(torch.tensor([[1.0, 2.0]]), torch.zeros(1, 2), scale=torch.tensor([0.1, 1.0]))
        tensor([10.])
    """
    return ((obs - reconstruction) / scale).abs().amax(-1)


def as_threshold(threshold: float) -> float:
    """C_anomaly as a number; infinity never raises the alarm.

    Raises:
        ValueError: for NaN, which would never raise the alarm either and say nothing, or no number.
    """
    if not isinstance(threshold, Real | Tensor) or isnan(threshold):
        raise ValueError(f"threshold must be a number, not {threshold!r}; calibrate gives one")
    return float(threshold)


class Detector(Recurrent):
    """A GRU-VAE with a threshold, remembering N episodes.

    Args:
        model: trained on normal observations.
        threshold: C_anomaly; an alarm is a score above it. Both are in standard deviations of D_normal: the largest
            error over the observations.
        seed: of the latent samples.
        sample: whether to sample the latent, as the paper does, or to take its mean.

    Raises:
        ValueError: if the threshold is not a number.

    Example:
        >>> import torch
        >>> detector = Detector(GRUVAE(obs_dim=3, hidden=8, latent=2), threshold=5.0)
        >>> detector.reset(episodes=[0, 1])  # one seed for each row of the observations
        >>> score, alarm, reconstruction = detector.step(torch.tensor([[0.0, 0.0, 0.0], [0.0, 100.0, 0.0]]))
        >>> alarm
        tensor([False,  True])
    """

    def __init__(self, model: GRUVAE, threshold: float, seed: int = 2, sample: bool = True):
        super().__init__(model, seed, sample)
        self.threshold = as_threshold(threshold)

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The score ``[N]``, the alarm ``[N]`` bool and the reconstruction o' of one observation ``[N, obs_dim]``."""
        reconstruction = self.advance(obs)
        score = linf_score(obs, reconstruction, self.model.obs_std)
        return score, score > self.threshold, reconstruction
