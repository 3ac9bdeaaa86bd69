"""How long each stage of the recipe takes: measured by Snakemake in a run, and stored in one record that is shipped.

``python book/tools/durations.py [--root runs/lite --store] [--trainings]`` prints the record, or measures it first.
"""

import argparse
import csv
import math
import os
import platform
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from detden_lite.core import files
from detden_lite.core.tasks import Task, get_task
from detden_lite.recipe.scales import VICTIMS
from detden_lite.recipe.stage_list import STAGES
from detden_lite.store import manifest
from detden_lite.training.recipes import PPORecipe, TD3Recipe
from detden_lite.training.worlds import train_victim

RULES = tuple(rule for stage in STAGES.values() for rule in stage.rules)  # of data/Snakefile
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
    for stage in RULES:
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
        raise files.ArtifactError(f"{Path(root) / 'benchmarks'} holds no measurement; run `make data` first")
    machine = dict(cores=os.cpu_count(), processor=platform.machine())
    return dict(run=Path(root).resolve().name, machine=machine, rows=rows, versions=manifest.versions())


def training_speed(task: Task, recipe: TD3Recipe | PPORecipe) -> float:
    """Steps that a victim's training makes in a second of wall-clock time, after its start, on this machine."""
    segment = 2_000 if isinstance(recipe, TD3Recipe) else 4 * recipe.envs * recipe.rollout
    short = replace(recipe, steps=3 * segment, segment=segment)
    if isinstance(short, TD3Recipe):
        short = replace(short, learning_starts=segment)
    with tempfile.TemporaryDirectory() as folder:
        # The first segment is random steps or has the compilation in it, and the second may have the rest of that.
        *_, begin, end = (path.stat().st_mtime for path in train_victim(task, short, 0, Path(folder)))
    return segment / (end - begin)


def measure_trainings(
    victims: Mapping[tuple[str, str], TD3Recipe | PPORecipe] = VICTIMS,
) -> dict[str, dict[str, float]]:
    """By row the steps of a victim's training, and the steps that it makes in a second.

    Args:
        victims: recipes, by task and algorithm.
    """
    return {
        f"{task}-{algo}": dict(steps=recipe.steps, steps_per_second=training_speed(get_task(task), recipe))
        for (task, algo), recipe in victims.items()
    }


def show(root: Path, store: bool = False, trainings: bool = False, data: Path = manifest.DATA) -> None:
    """Print the stored record as tables; if asked to, measure and store it first.

    New measurements replace those of the same stage and row; all others stay.

    Args:
        root: of the run that is measured.
        store: whether to measure the run.
        trainings: whether to measure the victims' trainings, which takes some minutes.
        data: where the record is.
    """
    path = data / RECORD
    if store or trainings:
        record = manifest.read_json(path, data) if path.exists() else {}
        record |= _merged(measure(root), record.get("rows", {})) if store else {}
        record |= dict(trainings=measure_trainings()) if trainings else {}
        manifest.write_json(path, record, data)
    record = manifest.read_json(path, data)
    for lines in (table(record), trainings_table(record)):
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        for line in lines:
            print("  ".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)))
        print()


def trainings_table(record: dict) -> list[list[str]]:
    """The victims' trainings, a line for each row; the first line has the names."""
    lines = [["row", "steps", "steps a second", "a seed takes"]]
    for row, found in record.get("trainings", {}).items():
        speed = found["steps_per_second"]
        lines.append([row, f"{found['steps']:,}", f"{speed:,.0f}", clock(found["steps"] / speed)])
    return lines


def table(record: dict) -> list[list[str]]:
    """CPU time, a line for each row and a column for each stage, and the sum; the first line has the names."""
    stages = [stage for stage in RULES if any(stage in spent for spent in record.get("rows", {}).values())]
    lines = [["row", *stages, "all"]]
    for row, spent in record.get("rows", {}).items():
        seconds = [spent[stage]["cpu_seconds"] if stage in spent else None for stage in stages]
        lines.append([row, *(map(clock, seconds)), clock(sum(filter(None, seconds)))])
    return lines


def clock(seconds: float | None) -> str:
    """A duration in words: "42 s", "7 min", "3.5 h"; "–" for None."""
    if seconds is None:
        return "–"
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 3_600 else f"{seconds / 3_600:.1f} h"


def _merged(record: dict, stored: dict) -> dict:
    rows = {row: stored.get(row, {}) | record["rows"].get(row, {}) for row in sorted({*stored, *record["rows"]})}
    return record | dict(rows=rows)


def _number(text: str) -> float:
    """A measured number; 0 for "NA" or "-", which stand for a job that was too short to be measured."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("--root", type=Path, default=Path("runs/lite"), help="of the run; default: %(default)s")
    arguments.add_argument("--store", action="store_true", help="measure the run first, and store it in data/")
    arguments.add_argument(
        "--trainings", action="store_true", help="measure how fast victims train, and store it in data/"
    )
    try:
        show(**vars(arguments.parse_args()))
    except (OSError, files.ArtifactError) as error:
        raise SystemExit(f"error: {error}") from None
