"""C_anomaly: thresholds from held-out clean scores, or tuned on attacked ones as the paper does (appendix C.2)."""

from collections.abc import Sequence

import numpy as np
import torch

from detden_lite.core.types import Detector, Trajectories
from detden_lite.defense.augmentation import check_trajectories


def clean_scores(detector: Detector, trajectories: Trajectories, batch: int = 128) -> np.ndarray:
    """The scores that a detector gives to every observation of these trajectories, one after the other, ``[n]``.

    Args:
        detector: is reset, and so forgets the episodes under way.
        trajectories: clean ones, for a threshold.
        batch: episodes at once.

    Raises:
        ValueError: if the trajectories break their contract.

    Example:
        >>> from detden_lite import Gaussian, MahalanobisDetector
        >>> detector = MahalanobisDetector(Gaussian(torch.zeros(1), torch.eye(1)), threshold=np.inf)
        >>> clean_scores(detector, Trajectories(np.array([[[1.0], [2.0], [0.0]]], np.float32), np.array([2])))
        array([1., 2.], dtype=float32)
    """
    check_trajectories("trajectories", trajectories)
    scores = []
    for start in range(0, len(trajectories), batch):
        part = trajectories.select(slice(start, start + batch))
        detector.reset(range(start, start + len(part)))
        steps = [detector.step(torch.from_numpy(obs))[0] for obs in part.obs.swapaxes(0, 1)]
        scores.append(torch.stack(steps, 1).numpy()[part.mask])
    return np.concatenate(scores)


def calibrate(clean_scores: np.ndarray, false_alarm_rate: float = 0.01) -> float:
    """The threshold that this fraction of clean scores exceeds: C_anomaly without any knowledge of attacks.

    It describes these scores, and guarantees nothing for others: see ``conformal_threshold``.

    Args:
        clean_scores: scores of held-out normal observations, any shape, without padding.
        false_alarm_rate: between 0 and 1.

    Raises:
        ValueError: for another rate, or if there is no score or one that is not finite.

    Example:
        >>> calibrate(np.arange(100.0), false_alarm_rate=0.05)
        95.0
    """
    _check_rate(false_alarm_rate)
    if clean_scores.size == 0 or not np.isfinite(clean_scores).all():
        raise ValueError("clean_scores must hold at least one score, all of them finite")
    return float(np.quantile(clean_scores, 1 - false_alarm_rate, method="higher"))


def conformal_threshold(episodes: Sequence[np.ndarray], false_alarm_rate: float = 0.01) -> float:
    """The split-conformal C_anomaly: a random step of a new clean episode is a false alarm with at most this chance.

    The guarantee holds for any number of episodes and any detector that was not trained on them, on average over random
    calibration episodes, as long as the new episode comes from the same distribution. It ends where the defence acts on
    a false alarm: the rest of that episode has another distribution. The steps of an episode resemble each other, so
    that episodes are counted, not steps: each weighs 1 / (n + 1), shared by its steps, and the last 1 / (n + 1) is for
    the new one, whose scores could be anything (hierarchical conformal prediction, Lee et al., 2023). With one score an
    episode this is the ceil((n + 1) (1 - rate))-th smallest of n.

    Args:
        episodes: scores of each held-out clean episode, ``[steps]`` each.
        false_alarm_rate: between 0 and 1.

    Returns:
        The threshold; infinite if there are too few episodes to guarantee that, fewer than 1 / rate - 1.

    Raises:
        ValueError: for another rate, or if there is no episode, one without a score, or a score that is not finite.
    """
    _check_rate(false_alarm_rate)
    if not len(episodes) or not all(len(scores) and np.isfinite(scores).all() for scores in episodes):
        raise ValueError("episodes must be at least one, each of at least one score, all of them finite")
    scores = np.concatenate(episodes)
    weights = np.concatenate([np.full(len(scores), 1 / len(scores)) for scores in episodes]) / (len(episodes) + 1)
    order = np.argsort(scores)
    enough = np.flatnonzero(weights[order].cumsum() >= 1 - false_alarm_rate - 1e-9)  # up to rounding
    return float(scores[order[enough[0]]]) if len(enough) else np.inf


def tuned_threshold(scores: np.ndarray, attacked: np.ndarray, misses: float = 0.01) -> float:
    """The paper's C_anomaly: the false-negative rate near 0, and then the best F1 (appendix C.2).

    The paper does not say on which episodes. They must be others than those reported. The detector is then fitted to
    the attacks in them.

    Args:
        scores: of tuning steps, clean and attacked, any shape, without padding.
        attacked: which of them are attacked, of the same shape.
        misses: the largest false-negative rate that counts as near 0.

    Returns:
        The threshold, half-way between two scores; minus infinity if every step must raise the alarm.

    Raises:
        ValueError: if the shapes differ, a score is not finite, no step is clean or none attacked, or for other misses.

    Example:
        >>> tuned_threshold(np.array([0.0, 1.0, 4.0, 5.0]), attacked=np.array([False, False, True, True]))
        2.5
    """
    scores, attacked = np.asarray(scores).ravel(), np.asarray(attacked, dtype=bool).ravel()
    if scores.shape != attacked.shape or not np.isfinite(scores).all():
        raise ValueError("scores and attacked must be of one shape, and all scores finite")
    if attacked.all() or not attacked.any():
        raise ValueError("attacked must hold clean steps and attacked ones: the threshold is between them")
    if not 0 <= misses < 1:
        raise ValueError(f"misses must be at least 0 and less than 1, not {misses}")
    order = np.argsort(scores)
    values, is_attacked = scores[order].astype(np.float64), attacked[order]
    # With the first k scores silent and all others alarming, for every k between two different scores:
    apart = np.flatnonzero(np.diff(values, prepend=-np.inf) > 0)
    missed = np.append(0, is_attacked.cumsum())[apart]
    hits = is_attacked.sum() - missed
    f1 = 2 * hits / (len(values) - apart + is_attacked.sum())
    allowed = missed <= misses * is_attacked.sum()
    best = apart[np.argmax(np.where(allowed, f1, -1))]
    return float((values[best - 1] + values[best]) / 2) if best else -np.inf


def _check_rate(false_alarm_rate: float) -> None:
    if not 0 < false_alarm_rate < 1:
        raise ValueError(f"false_alarm_rate must be between 0 and 1, not {false_alarm_rate}")
