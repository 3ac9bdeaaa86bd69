"""Training a TD3 or PPO victim with sbx-rl (stable-baselines3's algorithms in JAX), in segments that survive a kill."""

import json
import os
import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import gymnasium
import numpy as np
from safetensors.torch import save
from tqdm import tqdm

from detden_lite.artifacts import ArtifactError, replace_file
from detden_lite.draws import derived_seed
from detden_lite.simulator import make
from detden_lite.tasks import Task
from detden_lite.victims import Victim

# One thread: XLA's own threads would fight with the other runs on the machine for nothing.
XLA_FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"


@dataclass(frozen=True)
class TD3Recipe:
    """Hyperparameters of TD3 (Fujimoto et al., 2018) on raw observations.

    A segment is what is trained between two snapshots. Each starts from a new episode and from random generators that
    are seeded by (seed, segment), so that a run that was killed and resumed equals one that was not. A finished run
    may be prolonged: ``steps`` is no part of what it is.
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

    @property
    def identity(self) -> dict:
        """What a folder's snapshots have in common."""
        return {key: value for key, value in asdict(self).items() if key != "steps"}

    def config(self, task: Task) -> dict:
        """The arguments of the ``Victim`` that is trained."""
        net = [self.net, self.net]
        return dict(actor=[task.obs_dim, *net, task.action_dim], critic=[task.obs_dim + task.action_dim, *net, 1])

    def start(self, task: Task, seed: int):
        """A new model, untrained."""
        from sbx import TD3
        from stable_baselines3.common.noise import NormalActionNoise

        return TD3(
            "MlpPolicy",
            _make(task),
            learning_rate=self.learning_rate,
            batch_size=self.batch,
            learning_starts=self.learning_starts,
            buffer_size=self.buffer,
            train_freq=self.updates,
            gradient_steps=self.updates,
            action_noise=NormalActionNoise(np.zeros(task.action_dim), np.full(task.action_dim, self.action_noise)),
            policy_kwargs=dict(net_arch=[self.net, self.net]),
            seed=seed,
        )

    def resume(self, task: Task, checkpoint: Path):
        """The model of a checkpoint."""
        from sbx import TD3

        model = TD3.load(checkpoint / "model.zip", env=_make(task))
        model.load_replay_buffer(checkpoint / "buffer.pkl")
        return model

    def save(self, model, checkpoint: Path) -> None:
        """Write what ``resume`` needs."""
        model.save(checkpoint / "model.zip")
        model.save_replay_buffer(checkpoint / "buffer.pkl")

    def begin_segment(self, model, task: Task, done: float) -> None:
        """Forget the episode under way. ``done`` is the share of the training that lies behind."""
        model.set_env(_make(task))


@dataclass(frozen=True)
class PPORecipe:
    """Hyperparameters of PPO (Schulman et al., 2017) on normalised observations and rewards.

    The learning rate falls linearly to zero, from segment to segment; so a finished run cannot be prolonged.
    """

    steps: int = 2_048_000
    segment: int = 40_960
    net: int = 64
    activation: str = "tanh"
    learning_rate: float = 3e-4
    envs: int = 16
    rollout: int = 128  # steps of each environment between two updates
    batch: int = 64
    epochs: int = 10
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip: float = 0.2
    log_std: float = 0.0  # at the start

    def __post_init__(self):
        if self.steps % self.segment or self.segment % (self.envs * self.rollout):
            raise ValueError("steps must be a multiple of segment, and segment of envs * rollout")

    @property
    def identity(self) -> dict:
        """What a folder's snapshots have in common."""
        return asdict(self)

    def config(self, task: Task) -> dict:
        """The arguments of the ``Victim`` that is trained."""
        layers = [task.obs_dim, self.net, self.net]
        return dict(
            actor=[*layers, task.action_dim], value=[*layers, 1], n_critics=0, activation=self.activation, gaussian=True
        )

    def start(self, task: Task, seed: int):
        """A new model, untrained."""
        import jax
        from sbx import PPO

        return PPO(
            "MlpPolicy",
            self._normalized(task),
            learning_rate=self.learning_rate,
            n_steps=self.rollout,
            batch_size=self.batch,
            n_epochs=self.epochs,
            gamma=self.gamma,
            gae_lambda=self.gae_lambda,
            clip_range=self.clip,
            policy_kwargs=dict(
                net_arch=[self.net, self.net],
                activation_fn=dict(tanh=jax.numpy.tanh, relu=jax.nn.relu)[self.activation],
                log_std_init=self.log_std,
                ortho_init=True,
            ),
            seed=seed,
        )

    def resume(self, task: Task, checkpoint: Path):
        """The model of a checkpoint, with its normaliser."""
        from sbx import PPO
        from stable_baselines3.common.vec_env import VecNormalize

        env = VecNormalize.load(str(checkpoint / "normalizer.pkl"), self._normalized(task).venv)
        return PPO.load(checkpoint / "model.zip", env=env)

    def save(self, model, checkpoint: Path) -> None:
        """Write what ``resume`` needs."""
        model.save(checkpoint / "model.zip")
        model.get_vec_normalize_env().save(str(checkpoint / "normalizer.pkl"))

    def begin_segment(self, model, task: Task, done: float) -> None:
        """Forget the episodes under way. ``done`` is the share of the training that lies behind."""
        env, old = self._normalized(task), model.get_vec_normalize_env()
        env.obs_rms, env.ret_rms = old.obs_rms, old.ret_rms
        model.set_env(env)
        model.lr_schedule = _Constant(self.learning_rate * (1 - done))

    def _normalized(self, task: Task):
        from stable_baselines3.common.env_util import make_vec_env
        from stable_baselines3.common.vec_env import VecNormalize

        return VecNormalize(make_vec_env(lambda: _make(task), self.envs), gamma=self.gamma)


@dataclass(frozen=True)
class _Constant:
    """A learning-rate schedule that can be saved."""

    rate: float

    def __call__(self, _) -> float:
        return self.rate


def train_victim(
    task: Task, recipe: TD3Recipe | PPORecipe, seed: int, folder: Path, checkpoint_seconds: float = 600
) -> list[Path]:
    """Train, or go on training, and return the snapshots: one victim a segment, ``folder/snapshots/*.safetensors``.

    The checkpoint in ``folder/checkpoint`` is replaced after a segment when the last one is older than
    ``checkpoint_seconds``, and at the end; a kill loses what was trained since.

    Raises:
        ValueError: if ``folder`` holds a run of another recipe.
        ArtifactError: if there is no room for a snapshot or a checkpoint; the last checkpoint is then as it was.
    """
    os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)
    folder = Path(folder)
    _claim(folder, dict(task=task.name, seed=seed, **recipe.identity))
    checkpoint, snapshots = folder / "checkpoint", folder / "snapshots"
    snapshots.mkdir(exist_ok=True)
    if not checkpoint.exists() and (old := checkpoint.with_name("checkpoint.old")).exists():
        old.rename(checkpoint)  # a kill came between the two renames of _save_checkpoint
    if checkpoint.exists():
        model = recipe.resume(task, checkpoint)
        done = json.loads((checkpoint / "segments.json").read_text())
    else:
        model, done = recipe.start(task, seed), 0

    segments, saved = recipe.steps // recipe.segment, time.monotonic()
    label = f"{type(model).__name__} {task.name} seed {seed}"
    with tqdm(total=recipe.steps, initial=done * recipe.segment, desc=label, unit="step") as bar:
        for segment in range(done, segments):
            recipe.begin_segment(model, task, segment / segments)
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


def _make(task: Task) -> gymnasium.Env:
    # Networks compute in float32; a replay buffer of float64 would be twice as large for nothing.
    space = gymnasium.spaces.Box(-np.inf, np.inf, (task.obs_dim,), np.float32)
    env = make(task.env_id)
    return gymnasium.wrappers.TransformObservation(env, lambda obs: obs.astype(np.float32), space)


def _claim(folder: Path, description: dict) -> None:
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
        raise ArtifactError(
            f"{checkpoint} could not be written ({error.strerror}); free some space and run again"
        ) from None
    if checkpoint.exists():
        shutil.rmtree(old, ignore_errors=True)
        checkpoint.rename(old)
    new.rename(checkpoint)
    shutil.rmtree(old, ignore_errors=True)
