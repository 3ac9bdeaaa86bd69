"""Result records: what one cell came to."""

from collections.abc import Iterable
from pathlib import Path

from detden_lite.results.cells import Cell
from detden_lite.store.manifest import DATA, read_json


def load_cells(wanted: Iterable[Cell], task: str, algo: str, root: Path = DATA) -> dict[tuple[str, str], dict]:
    """The records of a victim's cells that are there, by (attack, timing); the cells are of one defence.

    Raises:
        ArtifactError: if one of them is altered.
    """
    names = {(cell.attack, cell.timing): cell.record_name(task, algo) for cell in wanted}
    there = {cell: name for cell, name in names.items() if (root / "results" / f"{name}.json").exists()}
    return {cell: load_record(name, root) for cell, name in there.items()}


def load_record(name: str, root: Path = DATA) -> dict:
    """A result record, ``results/<name>.json``."""
    return read_json(root / "results" / f"{name}.json", root)
