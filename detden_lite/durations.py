"""How long each stage of the recipe takes: from what Snakemake measured in a run, into one record that is shipped."""

import csv
import math
import os
import platform
from pathlib import Path

from detden_lite import artifacts

STAGES = (
    "victim", "select", "qfunction", "trajectories", "augmentation", "detector", "denoiser", "timing", "adversary",
    "choose", "linear", "attacks", "evaluation", "look", "portrait", "epsilon", "planning", "gallery",
)  # fmt: skip
RECORD = "durations.json"  # in data/


def measure(root: Path) -> dict:
    """Sum up ``benchmarks/STAGE/TASK-ALGO*.tsv`` of a run.

    Returns:
        The record: by row and stage the number of its jobs, their CPU and wall-clock seconds, and the most memory that
        one of them took, in MB. A stage that was interrupted counts from where it went on.

    Raises:
        ArtifactError: if nothing was measured in ``root``.
    """
    rows: dict[str, dict] = {}
    for stage in STAGES:
        for path in sorted((Path(root) / "benchmarks" / stage).glob("*.tsv")):
            spent = rows.setdefault(path.name.split(".")[0], {}).setdefault(
                stage, dict(jobs=0, cpu_seconds=0.0, wall_seconds=0.0, memory_mb=0.0)
            )
            with path.open() as file:
                (line,) = csv.DictReader(file, delimiter="\t")
            spent["jobs"] += 1
            spent["cpu_seconds"] += _number(line["cpu_time"])
            spent["wall_seconds"] += _number(line["s"])
            spent["memory_mb"] = max(spent["memory_mb"], _number(line["max_rss"]))
    if not rows:
        raise artifacts.ArtifactError(f"{Path(root) / 'benchmarks'} holds no measurement; run `make data` first")
    machine = dict(cores=os.cpu_count(), processor=platform.machine())
    return dict(run=Path(root).resolve().name, machine=machine, rows=rows, versions=artifacts.versions())


def show(root: Path, store: bool = False, data: Path = artifacts.DATA) -> None:
    """Print the stored record as a table; before that, if asked to, measure a run and store what was found."""
    if store:
        artifacts.write_json(data / RECORD, measure(root), data)
    lines = table(artifacts.read_json(data / RECORD, data))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        print("  ".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)))


def table(record: dict) -> list[list[str]]:
    """CPU time, a line for each row and a column for each stage, and the sum; the first line has the names."""
    stages = [stage for stage in STAGES if any(stage in spent for spent in record["rows"].values())]
    lines = [["row", *stages, "all"]]
    for row, spent in record["rows"].items():
        seconds = [spent[stage]["cpu_seconds"] if stage in spent else None for stage in stages]
        lines.append([row, *(map(clock, seconds)), clock(sum(filter(None, seconds)))])
    return lines


def clock(seconds: float | None) -> str:
    """A duration as one reads it: "42 s", "7 min", "3.5 h"; "–" for None."""
    if seconds is None:
        return "–"
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 3_600 else f"{seconds / 3_600:.1f} h"


def _number(text: str) -> float:
    """What was not measured, in a job too short for it, is written "NA" or "-"."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0
