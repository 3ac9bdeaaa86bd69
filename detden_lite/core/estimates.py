"""Means with bootstrap intervals."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % bootstrap interval, and the interquartile mean with its own.

    Example:
        >>> print(Estimate(mean=3_012, low=2_950, high=3_060, iqm=3_020, iqm_low=2_990, iqm_high=3_070, n=100))
        3,012 [2,950, 3,060]
    """

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
    """Interquartile mean: the mean of the middle half (Agarwal et al., 2021).

    Example:
        >>> float(iqm(np.array([0.0, 1.0, 2.0, 100.0])))
        1.5
    """
    values = np.sort(values, axis=axis)
    cut = values.shape[axis] // 4
    return np.take(values, np.arange(cut, values.shape[axis] - cut), axis=axis).mean(axis)


def estimate(values: np.ndarray, seed: int = 0, resamples: int = 2_000) -> Estimate:
    """Mean and interquartile mean of ``[N]`` values with percentile bootstrap intervals.

    Raises:
        ValueError: if there are no values, or one is not finite.

    Example:
        >>> found = estimate(np.arange(100.0))
        >>> found.mean, found.low < found.mean < found.high, found.n
        (np.float64(49.5), np.True_, 100)
    """
    values = np.asarray(values, dtype=float)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise ValueError("values must be one row of at least one number, all of them finite")
    streams = values[np.random.default_rng(seed).integers(len(values), size=(resamples, len(values)))]
    low, high = np.quantile(streams.mean(-1), [0.025, 0.975])
    iqm_low, iqm_high = np.quantile(iqm(streams), [0.025, 0.975])
    return Estimate(values.mean(), low, high, float(iqm(values)), iqm_low, iqm_high, len(values))
