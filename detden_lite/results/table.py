"""All result records of a run as one table, a line each, for a spreadsheet or a data frame."""

import csv
import io
from pathlib import Path

from detden_lite.core import files
from detden_lite.store import manifest

COLUMNS = (
    "row", "attack", "timing", "defense", "n", "mean", "low", "high", "attack_rate",
    "accuracy", "f1", "false_negative_rate", "auroc", "auroc_clean", "delay", "missed", "mae", "mae_live",
)  # fmt: skip


def collect_records(root: Path) -> list[dict]:
    """The records of a run, each as one line: a value for each of ``COLUMNS``.

    ``row`` is "hopper-td3"; ``mean``, ``low`` and ``high`` are of the return; ``mae`` is in the observations' own
    units. What is not defined (the false negatives where nothing is attacked) or not in an older record is None.

    Raises:
        ArtifactError: if there is no record, or one is altered.
    """
    paths = sorted((Path(root) / "results").glob("*.json"))
    if not paths:
        raise files.ArtifactError(f"{Path(root) / 'results'} holds no record; run the evaluate stage first")
    return [_line(path.name.split(".")[0], manifest.read_json(path, root)) for path in paths]


def write_table(root: Path) -> Path:
    """Write ``tables/returns.csv`` of a run."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    writer.writerows(collect_records(root))
    path = Path(root) / "tables" / "returns.csv"
    manifest.write_bytes(path, text.getvalue().encode(), Path(root))
    return path


def _line(row: str, record: dict) -> dict:
    values = {**record["cell"], **record["estimate"], **record["detector"]}
    values |= dict(row=row, attack_rate=record["attack_rate"], mae=record["denoiser_mae"])
    delay = record.get("delay", {})
    values |= dict(delay=delay.get("mean"), missed=delay.get("missed"), mae_live=record.get("denoiser_mae_live"))
    values |= dict(auroc=record.get("auroc"), auroc_clean=record.get("auroc_clean"))
    return {column: values[column] for column in COLUMNS}
