"""The stage that copies what is shipped into data/."""

from pathlib import Path

from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import DefenseScale
from detden_lite.store import manifest


def publish(run: Run[DefenseScale], data: Path = manifest.DATA) -> None:
    """The stage: copy what is shipped from the run to data/: models, sidecars and records, films and recordings.

    Trajectories and checkpoints stay where they are.

    Args:
        run: that is finished.
        data: where to copy to.

    Raises:
        ValueError: if the run has nothing of this victim.
        ArtifactError: if a file is altered.
    """
    stored = sorted([*run.folder.glob("*.*"), *(run.root / "results").glob(f"{run.folder.name}.*.json")])
    if not stored:
        raise ValueError(f"{run.root} has nothing of {run.folder.name} to publish; make it first, or give another root")
    for path in stored:
        manifest.write_bytes(data / path.relative_to(run.root), manifest.read_bytes(path, run.root), data)
    for folder in ("recordings", "films"):
        for path in sorted((run.root / folder).glob(f"{run.folder.name}-*")):
            manifest.write_bytes(data / folder / path.name, path.read_bytes(), data)
