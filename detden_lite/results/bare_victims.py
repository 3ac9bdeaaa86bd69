"""Returns of the undefended victims under each attack: the result records, beside the paper's own numbers."""

from pathlib import Path

import numpy as np

from detden_lite.attacks import catalogue
from detden_lite.core.estimates import Estimate, estimate
from detden_lite.core.tasks import get_task
from detden_lite.results import cells, records
from detden_lite.results.records import Record
from detden_lite.store import manifest

COMPARED = (*catalogue.FOUR, "linear")  # the last is the released code's surrogate of the optimal one

CELLS = tuple((cell.attack, cell.timing) for cell in cells.table_cells(("none",)))

UNATTACKED = ("none", "always")


def load_bare(task: str, algo: str, root: Path = manifest.DATA) -> dict[tuple[str, str], Record]:
    """The records of an undefended victim that are there, by (attack, timing): clean, noise and the attacks.

    Raises:
        ArtifactError: if one of them is altered.

    Example:
        >>> records = load_bare("hopper", "td3")
        >>> round(share(records["linear", "always"], records[UNATTACKED]), 2)
        0.0
    """
    return records.load_cells(cells.table_cells(("none",)), task, algo, root)


def gaps(one: Record, other: Record) -> np.ndarray:
    """How much more return a record has than another, ``[N]``, in each of the episodes that both have.

    Raises:
        ValueError: if the two do not begin with the same episode.
    """
    if one.seeds[0] != other.seeds[0]:
        raise ValueError(f"the records are of other episodes, from seeds {one.seeds[0]} and {other.seeds[0]} on")
    n = min(len(one.returns), len(other.returns))
    return np.subtract(one.returns[:n], other.returns[:n])


def difference(one: Record, other: Record) -> Estimate:
    """The mean of the ``gaps``, with its interval.

    Raises:
        ValueError: if the two do not begin with the same episode.
    """
    return estimate(gaps(one, other))


def failed(adaptive: Record, plain: Record) -> bool:
    """Whether an adaptive attack leaves more return than the attack that does not know the defence, beyond chance.

    Then it says nothing about the defence: an attacker who knows more could always do what the other attacker does
    (Carlini et al., 2019).

    Args:
        adaptive: the record of the one.
        plain: the record of the other, of the same timing and defence.

    Raises:
        ValueError: if the two are of other timings, defences or episodes.
    """
    for what in ("timing", "defense"):
        one, other = getattr(adaptive.cell, what), getattr(plain.cell, what)
        if one != other:
            raise ValueError(f"the records are of other cells: their {what} is {one} and {other}")
    return bool(difference(adaptive, plain).low > 0)


def share(record: Record, clean: Record) -> float:
    """The mean return of a record as a part of the clean one; below 0 where the return is."""
    return record.estimate.mean / clean.estimate.mean


def fallen(record: Record) -> float:
    """The part of the episodes that ended before the task's horizon: in MuJoCo's tasks, because the robot fell.

    Example:
        >>> fallen(load_bare("hopper", "td3")[UNATTACKED])
        0.0
    """
    return float(np.mean(np.less(record.lengths, get_task(record.task).horizon)))


def strikes(record: Record) -> float:
    """The mean number of attacked steps of an episode."""
    return record.attack_rate * float(np.mean(record.lengths))
