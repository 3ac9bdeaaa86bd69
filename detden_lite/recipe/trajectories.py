"""Trajectories of a run, in files of a batch each."""

from pathlib import Path

import numpy as np
import torch

from detden_lite.core.files import ArtifactError
from detden_lite.core.types import Trajectories
from detden_lite.recipe.run import ADVERSARIAL, Run
from detden_lite.recipe.scales import DefenseScale
from detden_lite.store import tensors

SHARD = 128  # trajectories of one file: what a killed run loses at most


def load_trajectories(run: Run[DefenseScale], folder: str) -> Trajectories:
    """All trajectories of a folder.

    Args:
        run: where.
        folder: "normal-DATA", "calibration", or "PART-DATA" with a part of D_adv.

    Raises:
        ValueError: if the folder is empty.
        ArtifactError: if a file is missing or damaged.
    """
    paths = sorted((run.folder / folder).glob("*.safetensors"))
    if not paths:
        raise ValueError(f"{run.folder / folder} is empty; run the {_stage(folder)} stage first")
    read = [load_shard(run, path) for path in paths]
    starts = np.cumsum([0, *(len(shard) for shard in read[:-1])])
    for path, start in zip(paths, starts, strict=True):  # each file is named by the number of its first trajectory
        if int(path.stem) != start:
            missing = path.with_stem(f"{start:05d}")
            raise ArtifactError(f"{missing} is missing or too short; run the {_stage(folder)} stage again")
    action = [shard.action for shard in read if shard.action is not None]
    return Trajectories(
        np.concatenate([shard.obs for shard in read]),
        np.concatenate([shard.lengths for shard in read]),
        np.concatenate(action) if len(action) == len(read) else None,
    )


def shards(run: Run[DefenseScale], folder: str, n: int) -> list[tuple[Path, slice]]:
    """The files of a folder of n trajectories, each with the positions of its own among them."""
    return [(run.folder / folder / f"{i:05d}.safetensors", slice(i, min(i + SHARD, n))) for i in range(0, n, SHARD)]


def save_shard(run: Run[DefenseScale], path: Path, shard: Trajectories) -> None:
    """Write one file of trajectories."""
    arrays = dict(obs=shard.obs, lengths=shard.lengths, action=shard.action)
    state = {name: torch.from_numpy(array) for name, array in arrays.items() if array is not None}
    tensors.save_tensors(path, state, dict(task=run.task.name, episodes=len(shard)), run.root)


def load_shard(run: Run[DefenseScale], path: Path) -> Trajectories:
    """Read one file of trajectories.

    Raises:
        ArtifactError: if it is missing, altered, or holds no trajectories of the run's task.
    """
    state, _ = tensors.load_tensors(path, run.root)
    obs, lengths = (state.get(name, torch.empty(0)).numpy() for name in ("obs", "lengths"))
    action = state["action"].numpy() if "action" in state else None  # those of attacked ones are those of the clean
    shard = Trajectories(obs, lengths, action)
    if shard.obs.ndim != 3 or shard.obs.shape[-1] != run.task.obs_dim or shard.lengths.shape != shard.obs.shape[:1]:
        raise ArtifactError(
            f"{path} holds no trajectories of {run.task.name}; remove it and run the {_stage(path.parent.name)} stage "
            "again"
        )
    return shard


def _stage(folder: str) -> str:
    """The stage that fills a folder of trajectories."""
    return "augment" if folder.startswith(tuple(ADVERSARIAL)) else "collect"
