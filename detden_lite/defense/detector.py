"""The detector: an observation that its GRU-VAE cannot reproduce is an anomaly (section 3.1.1)."""

from torch import Tensor

from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.memory import Recurrent


def linf_score(obs: Tensor, reconstruction: Tensor, scale: Tensor) -> Tensor:
    """The l-infinity distance of observation and reconstruction in units of ``scale``, over the last dimension.

    With D_normal's standard deviations as ``scale`` it is the error of the worst observation, in its deviations.
    """
    return ((obs - reconstruction) / scale).abs().amax(-1)


class Detector(Recurrent):
    """A GRU-VAE with a threshold, remembering N episodes.

    Args:
        model: trained on normal observations.
        threshold: C_anomaly; an alarm is a score above it. Both are in standard deviations of D_normal: the largest
            error over the observations.
        seed: of the latent samples.
        sample: whether to sample the latent, as the paper does, or to take its mean.
    """

    def __init__(self, model: GRUVAE, threshold: float, seed: int = 2, sample: bool = True):
        super().__init__(model, seed, sample)
        self.threshold = float(threshold)

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The score ``[N]``, the alarm ``[N]`` bool and the reconstruction o' of one observation ``[N, obs_dim]``."""
        reconstruction = self.advance(obs)
        score = linf_score(obs, reconstruction, self.model.obs_std)
        return score, score > self.threshold, reconstruction
