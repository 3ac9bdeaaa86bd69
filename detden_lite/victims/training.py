"""Training a victim, or its adversary, with sbx-rl (stable-baselines3's algorithms in JAX), in segments that survive a
kill."""

import json
import os
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from safetensors.torch import save
from tqdm import tqdm

from detden_lite.core.files import replace_file, unwritable
from detden_lite.core.random_streams import derived_seed
from detden_lite.core.tasks import Task
from detden_lite.victims.recipes import PPORecipe, TD3Recipe
from detden_lite.victims.victim import Victim

# One thread: XLA's own threads would fight with the other runs on the machine for nothing.
XLA_FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


def train(
    task: Task, recipe: TD3Recipe | PPORecipe, seed: int, folder: Path, worlds: Callable, about: Mapping | None = None,
    checkpoint_seconds: float = 600,
) -> list[Path]:  # fmt: skip
    """Train, or go on training, and return the snapshots: one policy a segment, ``folder/snapshots/*.safetensors``.

    Args:
        task: what is trained for.
        recipe: hyperparameters.
        seed: of everything.
        folder: for snapshots and the checkpoint.
        worlds: ``worlds(n)`` makes n worlds to train in.
        about: what else the snapshots of this folder have in common, ready for JSON.
        checkpoint_seconds: see below.

    The checkpoint in ``folder/checkpoint`` is replaced after a segment when the last one is older than
    ``checkpoint_seconds``, and at the end; a kill loses what was trained since.

    Raises:
        ValueError: if ``folder`` holds a run of another recipe.
        ArtifactError: if there is no room for a snapshot or a checkpoint; the last checkpoint is then as it was.
    """
    os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)
    folder = Path(folder)
    claim(folder, dict(task=task.name, seed=seed, **(about or {}), **recipe.identity))
    checkpoint, snapshots = folder / "checkpoint", folder / "snapshots"
    snapshots.mkdir(exist_ok=True)
    if not checkpoint.exists() and (old := checkpoint.with_name("checkpoint.old")).exists():
        old.rename(checkpoint)  # a kill came between the two renames of _save_checkpoint
    if checkpoint.exists():
        model = recipe.resume(worlds, checkpoint)
        done = json.loads((checkpoint / "segments.json").read_text())
    else:
        model, done = recipe.start(worlds, seed), 0

    segments, saved = recipe.steps // recipe.segment, time.monotonic()
    label = f"{type(model).__name__} {task.name} seed {seed}"
    with tqdm(total=recipe.steps, initial=done * recipe.segment, desc=label, unit="step") as bar:
        for segment in range(done, segments):
            recipe.begin_segment(model, worlds, segment / segments)
            model.set_random_seed(derived_seed(seed, segment))
            model.learn(recipe.segment, reset_num_timesteps=False)
            steps = (segment + 1) * recipe.segment
            victim = Victim.from_sb3(model, model.get_vec_normalize_env())
            replace_file(snapshots / f"{steps:08d}.safetensors", save(victim.state_dict()))
            if segment + 1 == segments or time.monotonic() - saved >= checkpoint_seconds:
                _save_checkpoint(recipe, model, checkpoint, segment + 1)
                saved = time.monotonic()
            returns = [episode["r"] for episode in model.ep_info_buffer]
            bar.set_postfix(training_return=f"{np.mean(returns):.0f}" if returns else "-")
            bar.update(recipe.segment)
    return sorted(snapshots.glob("*.safetensors"))


def claim(folder: Path, description: dict) -> None:
    """Make a folder and write down what it is for; a ValueError if it is there for something else."""
    folder.mkdir(parents=True, exist_ok=True)
    recipe_file = folder / "recipe.json"
    if recipe_file.exists() and json.loads(recipe_file.read_text()) != description:
        raise ValueError(f"{recipe_file} describes another run; choose another folder, or remove {folder}")
    replace_file(recipe_file, json.dumps(description, indent=1).encode())


def _save_checkpoint(recipe: TD3Recipe | PPORecipe, model, checkpoint: Path, segments: int) -> None:
    new, old = (checkpoint.with_name(f"checkpoint.{name}") for name in ("new", "old"))
    shutil.rmtree(new, ignore_errors=True)
    try:
        new.mkdir()
        recipe.save(model, new)
        (new / "segments.json").write_text(json.dumps(segments))
    except OSError as error:
        shutil.rmtree(new, ignore_errors=True)
        raise unwritable(checkpoint, error) from None
    if checkpoint.exists():
        shutil.rmtree(old, ignore_errors=True)
        checkpoint.rename(old)
    new.rename(checkpoint)
    shutil.rmtree(old, ignore_errors=True)
