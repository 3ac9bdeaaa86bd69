"""Scores of victims, detectors and denoisers (section 4 of the paper), and the intervals they are reported with."""

from dataclasses import asdict, dataclass

import numpy as np

from detden_lite.rollout import Episodes


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % bootstrap interval, and the interquartile mean with its own."""

    mean: float
    low: float
    high: float
    iqm: float
    iqm_low: float
    iqm_high: float
    n: int

    def __str__(self) -> str:
        return f"{self.mean:,.0f} [{self.low:,.0f}, {self.high:,.0f}]"


def iqm(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Interquartile mean: the mean of the middle half (Agarwal et al., 2021)."""
    values = np.sort(values, axis=axis)
    cut = values.shape[axis] // 4
    return np.take(values, np.arange(cut, values.shape[axis] - cut), axis=axis).mean(axis)


def estimate(values: np.ndarray, seed: int = 0, resamples: int = 2_000) -> Estimate:
    """Mean and interquartile mean of ``[N]`` values with percentile bootstrap intervals."""
    values = np.asarray(values, dtype=float)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise ValueError("values must be one row of at least one number, all of them finite")
    draws = values[np.random.default_rng(seed).integers(len(values), size=(resamples, len(values)))]
    low, high = np.quantile(draws.mean(-1), [0.025, 0.975])
    iqm_low, iqm_high = np.quantile(iqm(draws), [0.025, 0.975])
    return Estimate(values.mean(), low, high, float(iqm(values)), iqm_low, iqm_high, len(values))


@dataclass(frozen=True)
class DetectorScores:
    """How alarms and attacks agree. A rate whose denominator is empty is None."""

    accuracy: float
    f1: float | None
    false_negative_rate: float | None
    false_positive_rate: float | None


def detector_scores(attacked: np.ndarray, alarm: np.ndarray) -> DetectorScores:
    """Scores of boolean alarms against boolean truth, of the same shape."""
    attacked, alarm = np.asarray(attacked, dtype=bool), np.asarray(alarm, dtype=bool)
    if attacked.shape != alarm.shape or not attacked.size:
        raise ValueError(
            f"attacked and alarm must be of one shape and not empty, not {attacked.shape} and {alarm.shape}"
        )
    hit, miss = (attacked & alarm).sum(), (attacked & ~alarm).sum()
    false, right = (~attacked & alarm).sum(), (~attacked & ~alarm).sum()

    def ratio(part: int, whole: int) -> float | None:
        return float(part / whole) if whole else None

    return DetectorScores(
        accuracy=float((hit + right) / attacked.size),
        f1=ratio(2 * hit, 2 * hit + false + miss) if attacked.any() else None,
        false_negative_rate=ratio(miss, hit + miss),
        false_positive_rate=ratio(false, false + right),
    )


def mean_absolute_error(episodes: Episodes) -> float | None:
    """MAE of the denoised observation on attacked steps (table 3), in raw units; None if nothing was attacked."""
    rows = episodes.mask & episodes.attacked
    return float(np.abs(episodes.denoised[rows] - episodes.obs[rows]).mean()) if rows.any() else None


def summarize(episodes: Episodes) -> dict:
    """Everything that a result record says of its episodes, as plain numbers."""
    mask = episodes.mask
    return dict(
        returns=episodes.returns.tolist(),
        lengths=episodes.lengths.tolist(),
        estimate=asdict(estimate(episodes.returns)),
        attack_rate=float(episodes.attacked[mask].mean()),
        detector=asdict(detector_scores(episodes.attacked[mask], episodes.alarm[mask])),
        denoiser_mae=mean_absolute_error(episodes),
    )
