"""Training of a victim, or of its adversary, in segments that can be resumed after a kill.

The algorithms are stable-baselines3's in JAX, from sbx-rl.
"""

import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.torch import save
from tqdm import tqdm

from detden_lite.core.files import ArtifactError, replace_file
from detden_lite.core.random_streams import derived_seed
from detden_lite.core.tasks import Task
from detden_lite.training import checkpoints
from detden_lite.training.progress import Tally, record_progress
from detden_lite.training.recipes import PPORecipe, TD3Recipe, Worlds
from detden_lite.victims.victim import Victim

# One thread: more threads of XLA would compete with the other runs on the machine without benefit.
XLA_FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


def train(
    task: Task, recipe: TD3Recipe | PPORecipe, seed: int, folder: Path, worlds: Worlds,
    about: Mapping[str, object] | None = None, checkpoint_seconds: float = 600,
    prepare: Callable[[Any], None] | None = None,
) -> list[Path]:  # fmt: skip
    """Train, or go on training, and return the snapshots: one policy a segment, ``folder/snapshots/*.safetensors``.

    ``folder/progress.json`` tells what happened in each segment; see ``detden_lite.training.progress``.

    Args:
        task: what is trained for.
        recipe: hyperparameters.
        seed: of everything.
        folder: for snapshots and the checkpoint.
        worlds: ``worlds(n)`` makes n worlds to train in.
        about: what else the snapshots of this folder have in common, ready for JSON.
        checkpoint_seconds: see below.
        prepare: what is done to a new model before its first segment.

    The checkpoint in ``folder/checkpoint`` is replaced after a segment when the last one is older than
    ``checkpoint_seconds``, and at the end; a kill loses what was trained since.

    Raises:
        ValueError: if ``folder`` holds a run of another recipe.
        ArtifactError: if a snapshot or a checkpoint cannot be written (the last checkpoint is then as it was), or the
            checkpoint is damaged; see ``detden_lite.training.checkpoints``.
    """
    os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)
    folder = Path(folder)
    snapshots = claim(folder, dict(task=task.name, seed=seed, **(about or {}), **recipe.identity))
    checkpoint = folder / "checkpoint"
    model: Any = recipe.start(task, worlds, seed)  # of the recipe's own kind
    done = checkpoints.load(model, checkpoint)
    if prepare is not None and not done:
        prepare(model)

    segments, saved = recipe.steps // recipe.segment, time.monotonic()
    label = f"{type(model).__name__} {task.name} seed {seed}"
    with tqdm(total=recipe.steps, initial=done * recipe.segment, desc=label, unit="step") as bar:
        for segment in range(done, segments):
            recipe.begin_segment(model, worlds, segment / segments)
            model.set_random_seed(derived_seed(seed, segment))
            tally, began = Tally(), (time.monotonic(), time.process_time())
            model.learn(recipe.segment, callback=tally, reset_num_timesteps=False)
            steps = (segment + 1) * recipe.segment
            spent = dict(seconds=time.monotonic() - began[0], cpu_seconds=time.process_time() - began[1])
            record_progress(folder, steps, tally.take() | spent | getattr(model, "told", dict)())
            victim = Victim.from_sb3(model, model.get_vec_normalize_env())
            replace_file(snapshots / f"{steps:08d}.safetensors", save(victim.state_dict()))
            if segment + 1 == segments or time.monotonic() - saved >= checkpoint_seconds:
                checkpoints.save(model, checkpoint, segment + 1)
                saved = time.monotonic()
            returns = [episode["r"] for episode in model.ep_info_buffer]
            bar.set_postfix(training_return=f"{np.mean(returns):.0f}" if returns else "-")
            bar.update(recipe.segment)
    return sorted(snapshots.glob("*.safetensors"))


def claim(folder: Path, description: Mapping[str, object]) -> Path:
    """Make the folder of a training or search, and write down what it is for; gives the folder of its snapshots.

    Raises:
        ValueError: if the folder holds another run.
        ArtifactError: if its recipe.json is damaged, or cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    recipe_file = folder / "recipe.json"
    try:
        if recipe_file.exists() and json.loads(recipe_file.read_text()) != description:
            raise ValueError(f"{recipe_file} describes another run; choose another folder, or remove {folder}")
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError):
        raise ArtifactError(f"{recipe_file} is damaged; restore it, or remove {folder} to train anew") from None
    replace_file(recipe_file, json.dumps(description, indent=1).encode())
    snapshots = folder / "snapshots"
    snapshots.mkdir(exist_ok=True)
    return snapshots
