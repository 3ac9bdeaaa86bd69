"""All result records of a run as one table, a line each, for a spreadsheet or a data frame."""

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from detden_lite.core import files
from detden_lite.results import strength
from detden_lite.results.records import Record, load_record
from detden_lite.store import manifest

COLUMNS = (
    "row", "attack", "timing", "defense", "n", "mean", "low", "high", "attack_rate",
    "accuracy", "f1", "false_negative_rate", "auroc", "auroc_clean", "delay", "missed", "mae", "mae_live", "beaten_by",
)  # fmt: skip


def collect_records(root: Path) -> list[dict[str, str | float | None]]:
    """The records of a run, each as one line: a value for each of ``COLUMNS``.

    ``row`` is "hopper-td3"; ``mean``, ``low`` and ``high`` are of the return; ``mae`` is in the observations' own
    units; ``beaten_by`` has the attacks that show that this one has failed (``strength.beaten_by``), the strongest
    first, and is empty if there are none. Another entry that is not defined (the false negatives where nothing is
    attacked) or that an older record lacks is None.

    Raises:
        ArtifactError: if there is no record, or one is altered.
    """
    paths = sorted((Path(root) / "results").glob("*.json"))
    if not paths:
        raise files.ArtifactError(f"{Path(root) / 'results'} holds no record; run the evaluate stage first")
    victims: dict[tuple[str, str], dict[tuple[str, str], Record]] = {}
    for path in paths:
        record = load_record(path.stem, Path(root))
        of_one = victims.setdefault((path.name.split(".")[0], record.cell.defense), {})
        of_one[record.cell.attack, record.cell.timing] = record
    lines = []
    for (row, _), found in victims.items():
        beaten = strength.beaten_by(found)
        lines += [_line(row, record, beaten.get(key, ())) for key, record in found.items()]
    return lines


def write_table(root: Path) -> Path:
    """Write ``tables/returns.csv`` of a run."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(collect_records(root))
    path = Path(root) / "tables" / "returns.csv"
    manifest.write_bytes(path, text.getvalue().encode(), Path(root))
    return path


def _line(row: str, record: Record, beaten: Sequence[str]) -> dict[str, str | float | None]:
    values = asdict(record.cell) | asdict(record.estimate) | asdict(record.detector)
    values |= dict(row=row, attack_rate=record.attack_rate, mae=record.denoiser_mae, mae_live=record.denoiser_mae_live)
    values |= dict(auroc=record.auroc, auroc_clean=record.auroc_clean)
    values |= dict(delay=record.delay and record.delay.mean, missed=record.delay and record.delay.missed)
    values |= dict(beaten_by=" ".join(beaten))
    return {column: values[column] for column in COLUMNS}
