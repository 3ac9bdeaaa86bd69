"""The part of the return that a defence keeps: the records of defended victims, beside those of the bare ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from detden_lite.attacks import catalogue
from detden_lite.defense.variants import MAIN
from detden_lite.results import cells, records
from detden_lite.results.bare_victims import UNATTACKED
from detden_lite.results.records import Record
from detden_lite.store import manifest


@dataclass(frozen=True)
class Share:
    """A part of a clean return, with its 95 % bootstrap interval.

    Example:
        >>> print(Share(0.8, 0.75, 0.84))
        80% [75%, 84%]
    """

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:z.0%} [{self.low:z.0%}, {self.high:z.0%}]"


def load_defended(
    task: str, algo: str, defense: str = MAIN, root: Path = manifest.DATA
) -> dict[tuple[str, str], Record]:
    """The records of a victim with this defence that are there, by (attack, timing).

    Raises:
        ArtifactError: if one of them is altered.

    Example:
        >>> worst(load_defended("hopper", "td3"))
        ('linear', 'always')
    """
    return records.load_cells(cells.table_cells((defense,)), task, algo, root)


def worst(records: Mapping[tuple[str, str], Record]) -> tuple[str, str] | None:
    """The (attack, timing) that leaves the smallest mean return; None if there is no attacked record."""
    means = {cell: record.estimate.mean for cell, record in records.items() if cell != UNATTACKED}
    return min(means, key=means.__getitem__) if means else None


def of_clean(record: Record, bare: Record) -> Share:
    """The part of the bare victim's clean return that a record keeps: the ratio of the two means.

    Both are of the same episodes; the interval's episodes are drawn with both of their returns.

    Args:
        record: of the defended victim.
        bare: of the undefended victim when nobody attacks.

    Raises:
        ValueError: if the two do not begin with the same episode.
    """
    if record.seeds[0] != bare.seeds[0]:
        raise ValueError(f"the records are of other episodes, from {record.seeds[0]} and {bare.seeds[0]} on")
    n = min(len(record.returns), len(bare.returns))
    return _ratio([np.array(record.returns[:n])], np.array(bare.returns[:n]))


def at_worst(records: Mapping[tuple[str, str], Record], bare: Record) -> tuple[tuple[str, str], Share] | None:
    """The ``worst`` (attack, timing) and the part that it leaves; None if there is no attacked record.

    Args:
        records: of the defended victim.
        bare: of the undefended victim when nobody attacks.
    """
    cell = worst(records)
    return cell and (cell, of_clean(records[cell], bare))


def on_average(records: Mapping[tuple[str, str], Record], bare: Record, timing: str = "always") -> Share | None:
    """The part that is kept, as a mean over the four attacks, as the paper's table 2 averages; None if one is missing.

    Args:
        records: of the defended victim, from ``load_defended``.
        bare: of the undefended victim when nobody attacks.
        timing: of the attacks.
    """
    if not all((attack, timing) in records for attack in catalogue.FOUR):
        return None
    four = [records[attack, timing] for attack in catalogue.FOUR]
    n = min(len(record.returns) for record in (*four, bare))
    return _ratio([np.array(record.returns[:n]) for record in four], np.array(bare.returns[:n]))


def _ratio(parts: list[np.ndarray], whole: np.ndarray, resamples: int = 2_000) -> Share:
    mean = np.mean(parts, axis=0)
    drawn = np.random.default_rng(0).integers(len(whole), size=(resamples, len(whole)))
    low, high = np.quantile(mean[drawn].mean(1) / whole[drawn].mean(1), [0.025, 0.975])
    return Share(mean.mean() / whole.mean(), low, high)
