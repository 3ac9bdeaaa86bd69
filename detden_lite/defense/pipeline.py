"""Detect and denoise: the policy sees the denoised observation where the detector raises an alarm (figure 2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector


@dataclass(frozen=True)
class Verdict:
    """What the defence says of one observation of N episodes."""

    obs: Tensor  # what the policy is to see, [N, obs_dim]
    alarm: Tensor  # [N] bool
    score: Tensor  # the detector's, [N]
    denoised: Tensor  # what the denoiser would show, [N, obs_dim]


class DetectAndDenoise:
    """The paper's defence. Both networks see every observation, so that their memories stay in step with the episode.

    Args:
        detector: raises the alarm.
        denoiser: cleans what is alarming.
        always: denoise at every step, whatever the detector says; an ablation.
    """

    def __init__(self, detector: Detector, denoiser: Denoiser, always: bool = False):
        self.detector, self.denoiser, self.always = detector, denoiser, always

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self.detector.reset(episodes)
        self.denoiser.reset(episodes)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.detector.restart(i, episode)
        self.denoiser.restart(i, episode)

    def __call__(self, obs: Tensor) -> Verdict:
        """Judge one observation of each episode, ``[N, obs_dim]``.

        Raises:
            ValueError: if an observation is not finite: it would poison the networks' memory for the whole episode.
        """
        if not torch.isfinite(obs).all():
            raise ValueError("obs holds NaN or infinity; check the sensor before the defence")
        score, alarm, _ = self.detector.step(obs)
        denoised = self.denoiser.step(obs)
        use = torch.ones_like(alarm) if self.always else alarm
        return Verdict(torch.where(use[:, None], denoised, obs), alarm, score, denoised)
