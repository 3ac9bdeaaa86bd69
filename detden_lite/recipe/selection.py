"""The choice of a snapshot among several trainings: screening for all of them, selection for the best of these."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from safetensors import SafetensorError
from safetensors.torch import load_file
from tqdm import tqdm

from detden_lite.core.files import ArtifactError
from detden_lite.core.tasks import Task
from detden_lite.victims.victim import Victim


@dataclass(frozen=True)
class Choice:
    """The chosen snapshot, and the learning curves of all trainings."""

    policy: Victim
    recipe: dict  # of its training, as in recipe.json
    step: int
    selection: float  # its mean return in the selection episodes
    curves: list[dict]  # of each training: its recipe, steps, mean screening returns, and the best selection mean


def choose(
    task: Task, folders: Mapping[Path, type[Any]], measure: Callable[[Victim, str], float], sign: int = 1, n: int = 10,
) -> Choice:  # fmt: skip
    """The best snapshot of some trainings.

    Every snapshot plays screening episodes (the learning curves); the n best of these, and the best of each training,
    play selection episodes; the best of those is chosen. One that is to be robust may be chosen when it has grown up;
    see ``OnlineRecipe``.

    Args:
        task: what they were trained for.
        folders: one a training, with the class of its recipe; together they hold at least one snapshot.
        measure: the mean return with a snapshot's policy in the episodes called "screening" or "selection".
        sign: 1 if a large return is good, -1 if a small one is.
        n: how many play the selection episodes.

    Raises:
        ArtifactError: if there is no snapshot, one cannot be read or is of another recipe, or a recipe.json is damaged.
    """
    rows: list[tuple[float, Path, dict, int]] = []
    curves: list[dict] = []
    for folder, kind in folders.items():
        recipe = read_recipe(folder)
        config = kind(**{key: recipe[key] for key in recipe.keys() & kind.__dataclass_fields__}).config(task)
        own = []
        for path in tqdm(sorted((folder / "snapshots").glob("*.safetensors")), desc=folder.name, unit="snapshot"):
            own.append((measure(_load(path, config), "screening"), path, config, len(curves)))
        curves.append(dict(recipe=recipe, steps=[int(row[1].stem) for row in own], mean=[row[0] for row in own]))
        grown = recipe.get("grown")
        rows += [row for row in own if not grown or int(row[1].stem) > grown * recipe["steps"]]
    if not rows:
        raise ArtifactError(f"there is no snapshot to choose for {task.name}; train first")
    rows.sort(key=lambda row: -sign * row[0])
    first = {row[3]: row for row in reversed(rows)}  # the best of each training
    best = []
    for row in tqdm([*rows[:n], *(row for row in first.values() if row not in rows[:n])], desc="selection"):
        _, path, config, training = row
        policy = _load(path, config)
        best.append((measure(policy, "selection"), path, policy, training))
    best.sort(key=lambda row: -sign * row[0])
    for selection, _, _, training in reversed(best):
        curves[training]["selection"] = selection
    selection, path, policy, training = best[0]
    return Choice(policy, curves[training]["recipe"], int(path.stem), selection, curves)


def read_recipe(folder: Path) -> dict[str, Any]:
    """What the folder of a training says that it is of; an ArtifactError if it cannot be read."""
    try:
        return json.loads((folder / "recipe.json").read_text())
    except (OSError, ValueError) as error:
        raise ArtifactError(f"{folder / 'recipe.json'} is missing or damaged ({error}); train anew") from None


def _load(path: Path, config: dict) -> Victim:
    try:
        return Victim.from_state(config, load_file(path))
    except (SafetensorError, RuntimeError):
        raise ArtifactError(
            f"{path} is truncated, or of another recipe than its folder; remove {path.parents[1]} and train anew"
        ) from None
