"""The detector: an observation that its GRU-VAE cannot reproduce is an anomaly (section 3.1.1)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from detden_lite.core.random_streams import RandomStreams
from detden_lite.defense.gruvae import GRUVAE, forget


def linf_score(obs: Tensor, reconstruction: Tensor, scale: Tensor) -> Tensor:
    """The l-infinity distance of observation and reconstruction in units of ``scale``, over the last dimension.

    With D_normal's standard deviations as ``scale`` it is the error of the worst observation, in its deviations.
    """
    return ((obs - reconstruction) / scale).abs().amax(-1)


class Detector:
    """A GRU-VAE with a threshold, remembering N episodes.

    Args:
        model: trained on normal observations.
        threshold: C_anomaly; an alarm is a score above it. Both are in standard deviations of D_normal: the largest
            error over the observations.
        seed: of the latent samples.
        sample: whether to sample the latent, as the paper does, or to take its mean.
    """

    def __init__(self, model: GRUVAE, threshold: float, seed: int = 2, sample: bool = True):
        self.model, self.threshold, self.seed, self.sample = model, float(threshold), seed, sample

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self.state, self.streams = None, RandomStreams(self.seed, episodes)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.state = forget(self.state, i)
        self.streams.restart(i, episode)

    @torch.no_grad()
    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The score ``[N]``, the alarm ``[N]`` bool and the reconstruction o' of one observation ``[N, obs_dim]``."""
        noise = self.streams.normal(len(obs), self.model.latent_dim)[:, None] if self.sample else None
        result = self.model(obs[:, None], noise, self.state)
        self.state = result.state
        reconstruction = result.output[:, 0]
        score = linf_score(obs, reconstruction, self.model.obs_std)
        return score, score > self.threshold, reconstruction
