"""The stage that copies what is shipped into data/."""

from pathlib import Path

from detden_lite.recipe.run import Run
from detden_lite.store import manifest


def publish(run: Run, data: Path = manifest.DATA) -> None:
    """Copy what is shipped (models, sidecars, records; no trajectories, no checkpoints) from the run to data/."""
    for path in sorted([*run.folder.glob("*.*"), *(run.root / "results").glob(f"{run.folder.name}.*.json")]):
        manifest.write_bytes(data / path.relative_to(run.root), manifest.read_bytes(path, run.root), data)
    for folder in ("recordings", "films"):
        for path in sorted((run.root / folder).glob(f"{run.folder.name}-*")):
            manifest.write_bytes(data / folder / path.name, path.read_bytes(), data)
