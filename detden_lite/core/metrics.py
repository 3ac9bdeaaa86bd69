"""Scores of victims, detectors and denoisers (section 4 of the paper), and the intervals they are reported with."""

from dataclasses import asdict, dataclass

import numpy as np

from detden_lite.core.estimates import estimate
from detden_lite.core.types import Episodes


@dataclass(frozen=True)
class DetectorScores:
    """How alarms and attacks agree. A rate whose denominator is empty is None."""

    accuracy: float
    f1: float | None
    false_negative_rate: float | None
    false_positive_rate: float | None


def detector_scores(attacked: np.ndarray, alarm: np.ndarray) -> DetectorScores:
    """Scores of boolean alarms against boolean truth, of the same shape.

    Raises:
        ValueError: if the shapes differ, or are empty.

    Example:
        >>> scores = detector_scores(np.array([True, True, False, False]), np.array([True, False, False, False]))
        >>> scores.accuracy, scores.false_negative_rate, scores.false_positive_rate
        (0.75, 0.5, 0.0)
    """
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


def f1_at(rate: float, misses: float, false_alarms: float) -> float:
    """The F1 of a detector with these error rates where this part of the steps is attacked.

    Args:
        rate: of the attack, above 0 and at most 1.
        misses: the false-negative rate, 0 to 1.
        false_alarms: the false-positive rate, 0 to 1.

    Raises:
        ValueError: if one of them is out of its range.

    Example:
        >>> f1_at(rate=0.5, misses=0.0, false_alarms=0.0), f1_at(rate=0.5, misses=1.0, false_alarms=0.0)
        (1.0, 0.0)
    """
    if not (0 < rate <= 1 and 0 <= misses <= 1 and 0 <= false_alarms <= 1):
        raise ValueError(
            f"rate must be above 0, and rate, misses and false_alarms at most 1 and not negative, not {rate}, {misses} "
            f"and {false_alarms}"
        )
    hit = rate * (1 - misses)
    return 2 * hit / (2 * hit + rate * misses + (1 - rate) * false_alarms)


def auroc(positive: np.ndarray, negative: np.ndarray) -> float | None:
    """The area under the ROC curve: the probability that a positive's score is above a negative's, ties counting half.

    Args:
        positive: scores of attacked observations, ``[n]``.
        negative: scores of others, ``[m]``.

    Returns:
        None if there is no such pair.

    Raises:
        ValueError: if a score is not finite.

    Example:
        >>> auroc(np.array([2.0, 3.0]), np.array([1.0, 2.0]))
        0.875
    """
    positive, negative = np.ravel(positive), np.sort(np.ravel(negative))
    if not (np.isfinite(positive).all() and np.isfinite(negative).all()):
        raise ValueError("positive and negative must hold finite scores only")
    if not positive.size or not negative.size:
        return None
    below, not_above = (np.searchsorted(negative, positive, side) for side in ("left", "right"))
    return float((below + not_above).mean() / (2 * len(negative)))


def score_auroc(episodes: Episodes, clean: Episodes | None = None) -> float | None:
    """AUROC of the detector's score on attacked steps against those that are not, whatever the threshold.

    Args:
        episodes: attacked ones.
        clean: if given, its steps are the negatives. They exist even if ``episodes`` are always attacked, and their
            scores show no earlier attack. None: the steps of ``episodes`` that are not attacked.

    Returns:
        None if there are no positives or no negatives.
    """
    negative = episodes.score[episodes.mask & ~episodes.attacked] if clean is None else clean.score[clean.mask]
    return auroc(episodes.score[episodes.mask & episodes.attacked], negative)


def detection_delays(episodes: Episodes) -> np.ndarray:
    """Steps from the beginning of each attack to its first alarm; infinity if it ended without one.

    An attack is a run of attacked steps of one episode; only an alarm within the run counts. An alarm at its very first
    step is a delay of 0.

    Returns:
        One number for each attack, in the order in which they begin.
    """
    attacked = episodes.mask & episodes.attacked
    begins = attacked & ~np.vstack([np.zeros_like(attacked[:1]), attacked[:-1]])
    delays, later = [], np.full(attacked.shape[1], np.inf)
    for attack, alarm, begin in zip(attacked[::-1], episodes.alarm[::-1], begins[::-1], strict=True):
        later = np.where(attack, np.where(alarm, 0, later + 1), np.inf)
        delays.append(later[begin])
    return np.concatenate(delays[::-1])


@dataclass(frozen=True)
class DetectionDelay:
    """How long the detector needs; ``mean`` and ``longest`` are over the attacks it noticed, None if it missed all."""

    attacks: int
    missed: int
    mean: float | None
    longest: int | None


def detection_delay(episodes: Episodes) -> DetectionDelay:
    """The delays of ``detection_delays`` in short; attacks that were never detected are counted, not averaged."""
    delays = detection_delays(episodes)
    noticed = delays[np.isfinite(delays)]
    mean, longest = (float(noticed.mean()), int(noticed.max())) if noticed.size else (None, None)
    return DetectionDelay(len(delays), len(delays) - len(noticed), mean, longest)


def live_dimensions(clean: Episodes) -> np.ndarray:
    """The observations that vary in clean episodes, ``[obs_dim]`` bool: those with a standard deviation above 1e-4.

    A denoiser's error is measured on these: a constant is easy to denoise.
    """
    return clean.obs[clean.mask].std(0, dtype=np.float64) > 1e-4


def mean_absolute_error(episodes: Episodes, dimensions: np.ndarray | slice = slice(None)) -> float | None:
    """MAE of the denoised observation on attacked steps (table 3), in raw units; None if nothing was attacked.

    Args:
        episodes: attacked ones.
        dimensions: over which the mean is, such as ``live_dimensions``; all by default.
    """
    rows = episodes.mask & episodes.attacked
    errors = np.abs(episodes.denoised[rows] - episodes.obs[rows])[:, dimensions]
    return float(errors.mean()) if errors.size else None


def summarize(episodes: Episodes, clean: Episodes | None = None) -> dict:
    """Everything that a result record says about its episodes, as plain numbers.

    Args:
        episodes: those of the cell.
        clean: the same victim and defence without an attack. If given, the record says the score's AUROC against these
            as well, and the denoiser's error over the dimensions that vary in them.
    """
    mask = episodes.mask
    summary = dict(
        returns=episodes.returns.tolist(),
        lengths=episodes.lengths.tolist(),
        estimate=asdict(estimate(episodes.returns)),
        attack_rate=float(episodes.attacked[mask].mean()),
        detector=asdict(detector_scores(episodes.attacked[mask], episodes.alarm[mask])),
        auroc=score_auroc(episodes),
        delay=asdict(detection_delay(episodes)),
        denoiser_mae=mean_absolute_error(episodes),
    )
    if clean is not None:
        live = live_dimensions(clean)
        summary |= dict(
            auroc_clean=score_auroc(episodes, clean),
            denoiser_mae_live=mean_absolute_error(episodes, live),
            live_dimensions=int(live.sum()),
        )
    return summary
