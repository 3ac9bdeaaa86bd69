"""The detector: an observation that its GRU-VAE cannot reproduce is an anomaly (section 3.1.1)."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from detden_lite.defense.augmentation import Trajectories
from detden_lite.defense.gruvae import GRUVAE, forget
from detden_lite.draws import Draws


def linf_score(obs: Tensor, reconstruction: Tensor, scale: Tensor) -> Tensor:
    """The l-infinity distance of observation and reconstruction in units of ``scale``, over the last dimension."""
    return ((obs - reconstruction) / scale).abs().amax(-1)


class Detector:
    """A GRU-VAE with a threshold, remembering N episodes.

    Args:
        model: trained on normal observations.
        threshold: C_anomaly; an alarm is a score above it.
        seed: of the latent samples.
        sample: whether to sample the latent, as the paper does, or to take its mean.
    """

    def __init__(self, model: GRUVAE, threshold: float, seed: int = 2, sample: bool = True):
        self.model, self.threshold, self.seed, self.sample = model, float(threshold), seed, sample

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self.state, self.draws = None, Draws(self.seed, episodes)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.state = forget(self.state, i)
        self.draws.restart(i, episode)

    @torch.no_grad()
    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The score ``[N]``, the alarm ``[N]`` bool and the reconstruction o' of one observation ``[N, obs_dim]``."""
        noise = self.draws.normal(len(obs), self.model.latent_dim)[:, None] if self.sample else None
        result = self.model(obs[:, None], noise, self.state)
        self.state = result.state
        reconstruction = result.output[:, 0]
        score = linf_score(obs, reconstruction, self.model.obs_std)
        return score, score > self.threshold, reconstruction


def clean_scores(detector: Detector, trajectories: Trajectories, batch: int = 128) -> np.ndarray:
    """The scores that a detector gives to every observation of these trajectories, one after the other, ``[n]``."""
    scores = []
    for start in range(0, len(trajectories), batch):
        part = trajectories.select(slice(start, start + batch))
        detector.reset(range(start, start + len(part)))
        steps = [detector.step(torch.from_numpy(obs))[0] for obs in part.obs.swapaxes(0, 1)]
        scores.append(torch.stack(steps, 1).numpy()[part.mask])
    return np.concatenate(scores)


def calibrate(clean_scores: np.ndarray, false_alarm_rate: float = 0.01) -> float:
    """The threshold that this fraction of clean scores exceeds, C_anomaly without having seen any attack.

    Args:
        clean_scores: scores of held-out normal observations, any shape, without padding.
        false_alarm_rate: between 0 and 1.
    """
    if not 0 < false_alarm_rate < 1:
        raise ValueError(f"false_alarm_rate must be between 0 and 1, not {false_alarm_rate}")
    if clean_scores.size == 0 or not np.isfinite(clean_scores).all():
        raise ValueError("clean_scores must hold at least one score, all of them finite")
    return float(np.quantile(clean_scores, 1 - false_alarm_rate, method="higher"))
