"""The worlds that a victim is trained in, and its training there."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import gymnasium
import numpy as np

from detden_lite.core.tasks import Task
from detden_lite.simulation.simulator import make
from detden_lite.training.online_recipes import OnlineRecipe
from detden_lite.training.recipes import PPORecipe, TD3Recipe
from detden_lite.training.resumable import train

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv


def task_worlds(task: Task, n: int) -> "VecEnv":
    """n worlds of a task, where a victim is trained."""
    from stable_baselines3.common.env_util import make_vec_env

    return make_vec_env(lambda: _make(task), n)


def _make(task: Task) -> gymnasium.Env:
    # Networks compute in float32; a replay buffer of float64 would be twice as large without benefit.
    space = gymnasium.spaces.Box(-np.inf, np.inf, (task.obs_dim,), np.float32)
    env = make(task.env_id)
    return gymnasium.wrappers.TransformObservation(env, lambda obs: obs.astype(np.float32), space)


def train_victim(
    task: Task, recipe: TD3Recipe | PPORecipe, seed: int, folder: Path, checkpoint_seconds: float = 600
) -> list[Path]:
    """Train, or go on training, and return the snapshots; see ``train`` for what it raises."""
    about = dict(epsilon=task.epsilon) if isinstance(recipe, OnlineRecipe) else None
    return train(task, recipe, seed, folder, partial(task_worlds, task), about, checkpoint_seconds)
