"""Trajectories of a run, in files of a batch each."""

from pathlib import Path

import numpy as np
import torch

from detden_lite.core.types import Trajectories
from detden_lite.recipe.run import ADVERSARIAL, Run
from detden_lite.store import tensors

SHARD = 128  # trajectories of one file: what a killed run loses at most


def load_trajectories(run: Run, folder: str) -> Trajectories:
    """All shards of a folder of trajectories: "normal-DATA", "calibration", or "PART-DATA" with a part of D_adv."""
    paths = sorted((run.folder / folder).glob("*.safetensors"))
    if not paths:
        stage = "augment" if folder.startswith(tuple(ADVERSARIAL)) else "collect"
        raise ValueError(f"{run.folder / folder} is empty; run the {stage} stage first")
    shards = [load_shard(run, path) for path in paths]
    return Trajectories(np.concatenate([s.obs for s in shards]), np.concatenate([s.lengths for s in shards]))


def shards(run: Run, folder: str, n: int) -> list[tuple[Path, slice]]:
    """The files of a folder of n trajectories, each with the positions of its own among them."""
    return [(run.folder / folder / f"{i:05d}.safetensors", slice(i, min(i + SHARD, n))) for i in range(0, n, SHARD)]


def save_shard(run: Run, path: Path, shard: Trajectories) -> None:
    """Write one file of trajectories."""
    state = dict(obs=torch.from_numpy(shard.obs), lengths=torch.from_numpy(shard.lengths))
    tensors.save_tensors(path, state, dict(task=run.task.name, episodes=len(shard)), run.root)


def load_shard(run: Run, path: Path) -> Trajectories:
    """Read one file of trajectories."""
    state, _ = tensors.load_tensors(path, run.root)
    return Trajectories(state["obs"].numpy(), state["lengths"].numpy())
