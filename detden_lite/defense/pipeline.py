"""Detect and denoise: the policy sees the denoised observation where the detector raises an alarm (figure 2)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from detden_lite.core.budget import Budget
from detden_lite.core.types import Denoiser, Detector, Verdict


class DetectAndDenoise:
    """The paper's defence. Both parts see every observation, so that their memories stay in step with the episode.

    The contracts of both parts are in ``detden_lite.core.types``. The GRU-VAEs of the paper, the baselines and the
    oracles may be combined freely.

    Args:
        detector: raises the alarm.
        denoiser: cleans alarming observations; None for the detector's own reconstruction, an ablation.
        always: denoise at every step, whatever the detector says; an ablation.
        budget: if given, the denoised observation is projected into B(o_hat): the truth lies there if the attacker kept
            to the budget. The paper does not do this (its released code does).

    Attributes:
        obs_dim: size of an observation, if one of the parts says it; otherwise None.

    Raises:
        ValueError: if the parts are for observations of different sizes.

    Example:
        >>> from detden_lite import load_defense
        >>> defense = load_defense("hopper", "td3", "mixed")
        >>> defense.reset(episodes=[0, 1])  # one seed for each row of the observations
        >>> verdict = defense(torch.full((2, 11), 9.0))  # no robot looks like that
        >>> verdict.alarm
        tensor([True, True])
        >>> defense
        DetectAndDenoise(Detector > 0.1253, Denoiser)
    """

    def __init__(
        self, detector: Detector, denoiser: Denoiser | None = None, always: bool = False, budget: Budget | None = None
    ):
        self.detector, self.denoiser, self.always, self.budget = detector, denoiser, always, budget
        self._rows: int | None = None  # episodes under way
        sizes: list[int] = [part.obs_dim for part in self.parts if hasattr(part, "obs_dim")]
        self.obs_dim = sizes[0] if sizes else None
        if len(set(sizes)) > 1:
            raise ValueError(f"denoiser: its observations have {sizes[1]} numbers, and the detector's {sizes[0]}")

    def __repr__(self) -> str:
        denoiser = "None" if self.denoiser is None else type(self.denoiser).__name__
        changes = "".join(f", {name}" for name in self.ablations)
        return f"DetectAndDenoise({type(self.detector).__name__} > {self.detector.threshold:.4g}, {denoiser}{changes})"

    @property
    def parts(self) -> list[Detector | Denoiser]:
        """The detector, and the denoiser if there is one."""
        return [part for part in (self.detector, self.denoiser) if part is not None]

    @property
    def needs(self) -> frozenset[str]:
        """The knowledge that no defender has and an oracle must be told: "truth", or nothing."""
        return frozenset().union(*(getattr(part, "needs", ()) for part in self.parts))

    @property
    def ablations(self) -> list[str]:
        """The names of all differences from the paper's defence, for a result record."""
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
        """Tell the oracles among the parts the truth of the next observation, which only ``rollout`` knows."""
        for part in self.parts:
            if "truth" in getattr(part, "needs", ()) and hasattr(part, "reveal"):
                part.reveal(true, attacked)

    def check(self, obs: Tensor) -> None:
        """Refuse observations of another shape or type, or that are not finite; the memories stay as they are.

        Raises:
            ValueError: says what is wrong.
        """
        if obs.ndim != 2 or obs.dtype != torch.float32 or obs.shape[1] != (self.obs_dim or obs.shape[1]):
            wanted = f"[{self._rows or 'N'}, {self.obs_dim or 'obs_dim'}]"
            raise ValueError(f"obs must be a float32 tensor {wanted}, not {list(obs.shape)} of {obs.dtype}")
        if not torch.isfinite(obs).all():
            raise ValueError("obs holds NaN or infinity; check the sensor before the defence")

    def __call__(self, obs: Tensor, action: Tensor | None = None) -> Verdict:
        """Judge one observation of each episode.

        Args:
            obs: the observations as the policy would see them, ``[N, obs_dim]`` float32, in raw units.
            action: what the policy did one step before; see ``detden_lite.core.types.Denoiser.step``.

        Raises:
            ValueError: if no episodes were begun, or not as many as there are rows; if the observations have another
                shape or type; or if one is not finite: it would spoil the networks' memory for the whole episode.
        """
        if self._rows is None:
            raise ValueError("no episode is under way; call reset(episodes) first, with one seed for each row of obs")
        self.check(obs)
        if len(obs) != self._rows:
            raise ValueError(f"obs has {len(obs)} rows, but {self._rows} episodes are under way; call reset(episodes)")
        denoised = None if self.denoiser is None else self.denoiser.step(obs, action)
        score, alarm, reconstruction = self.detector.step(obs)  # after the denoiser, since it may judge what that found
        denoised = reconstruction if denoised is None else denoised
        if self.budget is not None:
            denoised = self.budget.project(obs, denoised)
        use = torch.ones_like(alarm) if self.always else alarm
        return Verdict(torch.where(use[:, None], denoised, obs), alarm, score, denoised)
