"""Result records: the results of one cell, typed, and read from and written to JSON."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from detden_lite.core.estimates import Estimate
from detden_lite.core.files import ArtifactError
from detden_lite.core.metrics import DetectionDelay, DetectorScores
from detden_lite.core.types import Episodes
from detden_lite.results.cells import Cell
from detden_lite.results.typed_json import plain, typed
from detden_lite.store.manifest import DATA, REMEDY, read_json

SCHEMA = 2  # of new records; those of schema 1 have no "schema" entry and no scores per episode


@dataclass(frozen=True)
class EpisodeScores:
    """How the detector and the denoiser did in each episode; one number an episode.

    Args:
        attacked: the attacked steps.
        alarms_attacked: the alarms on attacked steps.
        alarms_clean: the alarms on the other steps, which are false.
        denoiser_mae: the denoiser's mean absolute error on attacked steps, in raw units; None where there is none.

    Example:
        >>> scores = EpisodeScores((4, 0), alarms_attacked=(3, 0), alarms_clean=(1, 2), denoiser_mae=(0.1, None))
        >>> sum(scores.alarms_attacked) / sum(scores.attacked)
        0.75
    """

    attacked: tuple[int, ...]
    alarms_attacked: tuple[int, ...]
    alarms_clean: tuple[int, ...]
    denoiser_mae: tuple[float | None, ...]

    @classmethod
    def of(cls, episodes: Episodes) -> "EpisodeScores":
        """The scores of these episodes."""
        attacked, alarm = episodes.mask & episodes.attacked, episodes.mask & episodes.alarm
        errors = np.abs(episodes.denoised - episodes.obs).mean(-1)
        return cls(
            attacked=tuple(attacked.sum(0).tolist()),
            alarms_attacked=tuple((attacked & alarm).sum(0).tolist()),
            alarms_clean=tuple((~attacked & alarm).sum(0).tolist()),
            denoiser_mae=tuple(
                float(error[rows].mean()) if rows.any() else None
                for error, rows in zip(errors.T, attacked.T, strict=True)
            ),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Record(Mapping[str, Any]):
    """The results of one cell.

    Its entries are attributes, and can be read like those of the JSON file as well: ``record["estimate"]["mean"]`` is
    ``record.estimate.mean``. Two records are equal if their JSON is.

    Args:
        schema: the version of the format; see ``SCHEMA``.
        task: "hopper".
        cell: the attack, its timing and the defence.
        settings: of the attack and of the defence: epsilon, norm, steps, c_anomaly and the like.
        seeds: the seed of the first episode, and the number of episodes N.
        returns: of each episode.
        lengths: of each episode, in steps.
        estimate: the mean of the returns with its intervals.
        attack_rate: the part of all steps that was attacked.
        detector: rates of the alarms, over all steps.
        auroc: of the detector's score, attacked steps against the others; None without one of them, or in a record
            that is older than this score.
        delay: from the beginning of an attack to its first alarm; None in a record that is older than this score.
        denoiser_mae: mean absolute error on attacked steps, in raw units; None if nothing was attacked.
        auroc_clean: of the score on attacked steps against clean episodes, where the cell was compared with those.
        denoiser_mae_live: over the dimensions that vary in those episodes.
        live_dimensions: how many do; None where there was nothing to compare with.
        episodes: scores of each episode; None in records of schema 1.
        seconds: of wall time.
        versions: of the packages that computed it.

    Example:
        >>> from detden_lite import load_record
        >>> record = load_record("hopper-td3.opposite.always.none")
        >>> record.cell.attack, record.attack_rate, record.estimate.n
        ('opposite', 1.0, 100)
        >>> record["estimate"]["mean"] == record.estimate.mean
        True
    """

    schema: int = SCHEMA
    task: str
    cell: Cell
    settings: Mapping[str, Any]
    seeds: tuple[int, int]
    returns: tuple[float, ...]
    lengths: tuple[int, ...]
    estimate: Estimate
    attack_rate: float
    detector: DetectorScores
    auroc: float | None = None
    delay: DetectionDelay | None = None
    denoiser_mae: float | None
    auroc_clean: float | None = None
    denoiser_mae_live: float | None = None
    live_dimensions: int | None = None
    episodes: EpisodeScores | None = None
    seconds: float
    versions: Mapping[str, str]

    @classmethod
    def from_json(cls, content: object, source: Path | str = "the record") -> "Record":
        """The record that a JSON object is.

        Args:
            content: what ``json.loads`` gives.
            source: where it is from, for the error.

        Raises:
            ArtifactError: if it is of an unknown schema, lacks an entry or has one too many, or has one of a wrong type
                or length, or a number that is not finite.
        """
        try:
            if not isinstance(content, dict):
                raise ValueError("it must be a JSON object")
            return cls._of(content)
        except (TypeError, ValueError) as error:
            raise ArtifactError(f"{source} is not a result record ({error}); {REMEDY}") from None

    @classmethod
    def _of(cls, content: dict[str, Any]) -> "Record":
        if content.get("schema", 1) not in (1, SCHEMA):
            known = f"this version of detden-lite reads 1 and {SCHEMA}: update it"
            raise ValueError(f"its schema is {content['schema']!r}, and {known}")
        json.dumps(content, allow_nan=False)
        record = typed(cls, {"schema": 1} | content, "it")
        if misplaced := set(content) ^ set(record._entries):
            raise ValueError(f"{', '.join(sorted(misplaced))}: without the entries that belong to it, or missing")
        if {len(record.returns), len(record.lengths), record.estimate.n} != {record.seeds[1]}:
            raise ValueError("seeds, returns, lengths and estimate are of different numbers of episodes")
        if record.episodes and {len(row) for row in vars(record.episodes).values()} != {record.seeds[1]}:
            raise ValueError("episodes and seeds are of different numbers of episodes")
        return record

    @property
    def _entries(self) -> list[str]:
        """The names of the JSON's entries: an older record lacks some."""
        absent = ["schema", "episodes"] if self.schema == 1 else []
        absent += ["auroc", "delay"] if self.delay is None else []
        absent += ["auroc_clean", "denoiser_mae_live", "live_dimensions"] if self.live_dimensions is None else []
        return [field.name for field in fields(self) if field.name not in absent]

    def to_json(self) -> dict[str, Any]:
        """The record as a JSON object, without the entries that an older record lacks."""
        return {name: plain(getattr(self, name)) for name in self._entries}

    def __getitem__(self, name: str) -> Any:
        return self._json[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    @cached_property
    def _json(self) -> dict[str, Any]:
        return self.to_json()


def load_record(name: str, root: Path = DATA) -> Record:
    """A result record, ``results/<name>.json``.

    Args:
        name: "hopper-td3.opposite.always.none": victim, attack, timing and defence.
        root: as data/ is laid out.

    Raises:
        ArtifactError: if it is missing, altered, or not a record.
    """
    path = root / "results" / f"{name}.json"
    return Record.from_json(read_json(path, root), path)


def load_cells(wanted: Iterable[Cell], task: str, algo: str, root: Path = DATA) -> dict[tuple[str, str], Record]:
    """The records of a victim's cells that are there, by (attack, timing); the cells are of one defence.

    Raises:
        ArtifactError: if one of them is altered, or not a record.
    """
    names = {(cell.attack, cell.timing): cell.record_name(task, algo) for cell in wanted}
    there = {cell: name for cell, name in names.items() if (root / "results" / f"{name}.json").exists()}
    return {cell: load_record(name, root) for cell, name in there.items()}
