"""What it cost to train a policy online: steps under attack, falls before it was robust and afterwards, core hours."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from detden_lite.core.files import ArtifactError
from detden_lite.results.victim_cards import LearningCurve, load_card
from detden_lite.store import manifest


@dataclass(frozen=True)
class Counted:
    """What was counted until a policy was robust, and from then on.

    Example:
        >>> Counted(3, 2).total
        5
    """

    before: int
    after: int

    @property
    def total(self) -> int:
        """In the whole training."""
        return self.before + self.after


@dataclass(frozen=True)
class OnlineTraining:
    """The costs of one seed's training.

    Args:
        seed: of the training.
        robust_from: after how many of its steps the policy was robust (``robust_from``); None for one that was not to
            be, of which everything counts as before.
        steps: of the policy's worlds.
        episodes: in the policy's worlds.
        falls: of these episodes, those that ended in a fall.
        attacked_steps: under attack, in the adversary's turns too.
        attacked_episodes: likewise.
        attacked_falls: of those.
        core_hours: of one core.
    """

    seed: int
    robust_from: int | None
    steps: Counted
    episodes: Counted
    falls: Counted
    attacked_steps: Counted
    attacked_episodes: Counted
    attacked_falls: Counted
    core_hours: float


def robust_from(curve: LearningCurve, share: float = 0.9) -> int | None:
    """The first snapshot that is about as robust as the training's end; None without attacked episodes.

    That is: whose attacked return reaches this share of the mean of the last quarter of the snapshots.

    Example:
        >>> steps, clean = np.arange(1, 9) * 100, np.zeros(8)
        >>> robust_from(LearningCurve(0, steps, clean, np.array([0, 10, 50, 95, 80, 99, 100, 100])))
        400
    """
    if curve.attacked is None:
        return None
    last = curve.attacked[-max(1, len(curve.attacked) // 4) :].mean()
    return int(curve.steps[int(np.argmax(curve.attacked >= min(share * last, curve.attacked.max())))])


def load_trainings(task: str, algo: str, root: Path = manifest.DATA) -> tuple[OnlineTraining, ...]:
    """The trainings of a row that was trained online, one a seed.

    Raises:
        ArtifactError: if the row is not shipped, altered, or was trained otherwise and tells nothing of its training.
    """
    card = load_card(task, algo, root)
    if not card.training:
        raise ArtifactError(f"{card.name} has no record of its training; choose a row that was trained online")
    curves = {curve.seed: curve for curve in card.curves}
    return tuple(_training(told, robust_from(curves[told["seed"]])) for told in card.training)


def _training(told: Mapping[str, Any], robust: int | None) -> OnlineTraining:
    early = np.array(told["end"]) <= (np.inf if robust is None else robust)

    def count(column: Sequence[int]) -> Counted:
        return Counted(int(np.array(column)[early].sum()), int(np.array(column)[~early].sum()))

    names = ("steps", "episodes", "falls")
    counted = {name: count(told[name]) for name in (*names, *(f"attacked_{name}" for name in names))}
    return OnlineTraining(told["seed"], robust, **counted, core_hours=sum(told["cpu_seconds"]) / 3_600)
