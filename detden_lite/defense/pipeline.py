"""Detect and denoise: the policy sees the denoised observation where the detector raises an alarm (figure 2)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from detden_lite.core.budget import Budget
from detden_lite.core.types import Denoiser, Detector, Verdict


class DetectAndDenoise:
    """The paper's defence. Both parts see every observation, so that their memories stay in step with the episode.

    The contracts of both parts are in ``detden_lite.core.types``. The GRU-VAEs of the paper, the baselines and the
    oracles may be put together freely.

    Args:
        detector: raises the alarm.
        denoiser: cleans what is alarming; None for the detector's own reconstruction, an ablation.
        always: denoise at every step, whatever the detector says; an ablation.
        budget: if given, what is denoised is projected into B(o_hat): the truth lies there if the attacker kept to the
            budget. The paper does not do this (its released code does).
    """

    def __init__(
        self, detector: Detector, denoiser: Denoiser | None = None, always: bool = False, budget: Budget | None = None
    ):
        self.detector, self.denoiser, self.always, self.budget = detector, denoiser, always, budget
        self._rows: int | None = None  # episodes under way

    @property
    def parts(self) -> list[Detector | Denoiser]:
        """The detector, and the denoiser if there is one."""
        return [part for part in (self.detector, self.denoiser) if part is not None]

    @property
    def needs(self) -> frozenset[str]:
        """What no defender knows and an oracle has to be told: "truth", or nothing."""
        return frozenset().union(*(getattr(part, "needs", ()) for part in self.parts))

    @property
    def ablations(self) -> list[str]:
        """The names of what is not as the paper has it, for a result record."""
        changes = dict(
            always=self.always,
            projected=self.budget is not None,
            detector_only=self.denoiser is None,
            latent_mean=not all(getattr(part, "sample", True) for part in self.parts),
            truth="truth" in self.needs,
        )
        return [name for name, changed in changes.items() if changed]

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self._rows = len(episodes)
        for part in self.parts:
            part.reset(episodes)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        for part in self.parts:
            part.restart(i, episode)

    def reveal(self, true: Tensor, attacked: Tensor) -> None:
        """Tell the parts that are oracles what no defender knows of the next observation; only ``rollout`` does."""
        for part in self.parts:
            if "truth" in getattr(part, "needs", ()):
                part.reveal(true, attacked)

    def __call__(self, obs: Tensor, action: Tensor | None = None) -> Verdict:
        """Judge one observation of each episode.

        Args:
            obs: what is shown, ``[N, obs_dim]`` float32, in raw units.
            action: what the policy did one step before; see ``detden_lite.core.types.Denoiser.step``.

        Raises:
            ValueError: if no episodes were begun, or not as many as there are rows, or an observation is not finite: it
                would poison the networks' memory for the whole episode.
        """
        if self._rows is None:
            raise ValueError("no episode is under way; call reset(episodes) first, with one seed for each row of obs")
        if len(obs) != self._rows:
            raise ValueError(f"obs has {len(obs)} rows, but {self._rows} episodes are under way; call reset(episodes)")
        if not torch.isfinite(obs).all():
            raise ValueError("obs holds NaN or infinity; check the sensor before the defence")
        score, alarm, reconstruction = self.detector.step(obs)
        denoised = reconstruction if self.denoiser is None else self.denoiser.step(obs, action)
        if self.budget is not None:
            denoised = self.budget.project(obs, denoised)
        use = torch.ones_like(alarm) if self.always else alarm
        return Verdict(torch.where(use[:, None], denoised, obs), alarm, score, denoised)
