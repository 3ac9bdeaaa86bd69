"""Training a TD3 victim with sbx-rl (stable-baselines3's algorithms in JAX), in segments that survive a kill."""

import json
import os
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

import gymnasium
import numpy as np
from safetensors.torch import save
from tqdm import tqdm

from detden_lite.artifacts import replace_file
from detden_lite.draws import derived_seed
from detden_lite.tasks import Task
from detden_lite.victims import Victim

# One thread: XLA's own threads would fight with the other runs on the machine for nothing.
XLA_FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


@dataclass(frozen=True)
class TD3Recipe:
    """Hyperparameters of TD3 (Fujimoto et al., 2018) and of its training in segments.

    A segment is what is trained between two checkpoints. Each starts from a new episode and from random generators
    that are seeded by (seed, segment), so that a run that was killed and resumed equals one that was not.
    """

    steps: int = 500_000
    segment: int = 20_000
    net: int = 256
    learning_rate: float = 1e-3
    batch: int = 128
    buffer: int = 1_000_000  # transitions in the replay buffer
    learning_starts: int = 10_000
    action_noise: float = 0.1
    updates: int = 50  # environment steps, and as many gradient steps, in one compiled call

    def __post_init__(self):
        if self.steps % self.segment or self.segment % self.updates:
            raise ValueError("steps must be a multiple of segment, and segment of updates")


def train_td3(task: Task, recipe: TD3Recipe, seed: int, folder: Path) -> list[Path]:
    """Train, or go on training, and return the snapshots: one victim a segment, ``folder/snapshots/*.safetensors``.

    The checkpoint (model and replay buffer) in ``folder/checkpoint`` is replaced after every segment; a kill loses at
    most the segment under way.

    Raises:
        ValueError: if ``folder`` holds a run of another recipe.
    """
    os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)
    from sbx import TD3
    from stable_baselines3.common.noise import NormalActionNoise

    folder = Path(folder)
    _claim(folder, dict(task=task.name, seed=seed, **asdict(recipe)))
    checkpoint, snapshots = folder / "checkpoint", folder / "snapshots"
    snapshots.mkdir(exist_ok=True)
    env = gymnasium.make(task.env_id)
    if not checkpoint.exists() and (old := checkpoint.with_name("checkpoint.old")).exists():
        old.rename(checkpoint)  # a kill came between the two renames of _save_checkpoint
    if checkpoint.exists():
        model = TD3.load(checkpoint / "model.zip", env=env)
        model.load_replay_buffer(checkpoint / "buffer.pkl")
        done = json.loads((checkpoint / "segments.json").read_text())
    else:
        action_dim = env.action_space.shape[0]
        model = TD3(
            "MlpPolicy",
            env,
            learning_rate=recipe.learning_rate,
            batch_size=recipe.batch,
            learning_starts=recipe.learning_starts,
            buffer_size=recipe.buffer,
            train_freq=recipe.updates,
            gradient_steps=recipe.updates,
            action_noise=NormalActionNoise(np.zeros(action_dim), np.full(action_dim, recipe.action_noise)),
            policy_kwargs=dict(net_arch=[recipe.net, recipe.net]),
            seed=seed,
        )
        done = 0

    segments = recipe.steps // recipe.segment
    label = f"TD3 {task.name} seed {seed}"
    with tqdm(total=recipe.steps, initial=done * recipe.segment, desc=label, unit="step") as bar:
        for segment in range(done, segments):
            model.set_env(gymnasium.make(task.env_id))  # forgets the episode under way
            model.set_random_seed(derived_seed(seed, segment))
            model.learn(recipe.segment, reset_num_timesteps=False)
            steps = (segment + 1) * recipe.segment
            replace_file(snapshots / f"{steps:08d}.safetensors", save(Victim.from_sb3(model).state_dict()))
            _save_checkpoint(model, checkpoint, segment + 1)
            returns = [episode["r"] for episode in model.ep_info_buffer]
            bar.set_postfix(training_return=f"{np.mean(returns):.0f}" if returns else "-")
            bar.update(recipe.segment)
    return sorted(snapshots.glob("*.safetensors"))


def _claim(folder: Path, description: dict) -> None:
    description = {key: value for key, value in description.items() if key != "steps"}  # a run may be prolonged
    folder.mkdir(parents=True, exist_ok=True)
    recipe_file = folder / "recipe.json"
    if recipe_file.exists() and json.loads(recipe_file.read_text()) != description:
        raise ValueError(f"{recipe_file} describes another run; choose another folder, or remove {folder}")
    replace_file(recipe_file, json.dumps(description, indent=1).encode())


def _save_checkpoint(model, checkpoint: Path, segments: int) -> None:
    new = checkpoint.with_name("checkpoint.new")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir()
    model.save(new / "model.zip")
    model.save_replay_buffer(new / "buffer.pkl")
    (new / "segments.json").write_text(json.dumps(segments))
    old = checkpoint.with_name("checkpoint.old")
    if checkpoint.exists():
        shutil.rmtree(old, ignore_errors=True)
        checkpoint.rename(old)
    new.rename(checkpoint)
    shutil.rmtree(old, ignore_errors=True)
