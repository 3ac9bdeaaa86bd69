"""How a victim is trained: hyperparameters of TD3 and PPO, a new model, and how a segment begins.

``worlds(n)`` makes n worlds to train in, as one ``VecEnv`` of stable-baselines3.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from detden_lite.core.arguments import check_between, check_positive, check_whole
from detden_lite.core.networks import ACTIVATIONS
from detden_lite.core.tasks import Task

if TYPE_CHECKING:  # a defence of a victim that is already trained needs no trainer
    from sbx import PPO, TD3
    from stable_baselines3.common.vec_env import VecEnv, VecNormalize

Worlds = Callable[[int], "VecEnv"]


@dataclass(frozen=True)
class TD3Recipe:
    """Hyperparameters of TD3 (Fujimoto et al., 2018) on raw observations, or on normalised ones.

    A segment is what is trained between two snapshots. Each starts from a new episode and from random generators that
    are seeded by (seed, segment), so that a run that was killed and resumed equals one that was not. A finished run
    may be prolonged: ``steps`` is no part of its identity.

    Example:
        >>> from detden_lite import get_task
        >>> TD3Recipe(net=64).config(get_task("hopper"))["actor"]
        [11, 64, 64, 3]
    """

    steps: int = 500_000
    segment: int = 20_000
    net: int = 256
    learning_rate: float = 1e-3
    batch: int = 128
    buffer: int = 1_000_000  # transitions in the replay buffer
    learning_starts: int = 10_000
    action_noise: float = 0.1
    envs: int = 1
    updates: int = 50  # steps of each environment between two compiled calls of as many gradient steps
    normalize: bool = False  # observations, by the mean and deviation of the replay buffer when a segment begins

    def __post_init__(self) -> None:
        check_whole(1, steps=self.steps, segment=self.segment, net=self.net, batch=self.batch, buffer=self.buffer)
        check_whole(1, envs=self.envs, updates=self.updates)
        check_whole(0, learning_starts=self.learning_starts)
        check_positive(learning_rate=self.learning_rate)
        check_between(0, inf, action_noise=self.action_noise)
        if self.steps % self.segment or self.segment % (self.envs * self.updates):
            raise ValueError("steps must be a multiple of segment, and segment of envs * updates")
        if self.normalize and self.learning_starts < self.segment:
            raise ValueError("learning_starts: there is nothing to normalise by before the first segment is over")

    @property
    def identity(self) -> dict[str, Any]:
        """The settings that all snapshots of a folder have in common."""
        return {key: value for key, value in asdict(self).items() if key != "steps"}

    def config(self, task: Task) -> dict[str, Any]:
        """The arguments of the ``Victim`` that is trained."""
        net = [self.net, self.net]
        return dict(actor=[task.obs_dim, *net, task.action_dim], critic=[task.obs_dim + task.action_dim, *net, 1])

    def start(self, task: Task, worlds: Worlds, seed: int) -> "TD3":
        """A new model, untrained."""
        from sbx import TD3
        from stable_baselines3.common.noise import NormalActionNoise

        env = self._normalized(worlds)
        zero = np.zeros(env.action_space.shape or ())
        return TD3(
            "MlpPolicy", env, learning_rate=self.learning_rate, batch_size=self.batch,
            learning_starts=self.learning_starts, buffer_size=self.buffer, train_freq=self.updates,
            gradient_steps=self.envs * self.updates, action_noise=NormalActionNoise(zero, zero + self.action_noise),
            policy_kwargs=dict(net_arch=[self.net, self.net]), seed=seed,
        )  # fmt: skip

    def begin_segment(self, model: "TD3", worlds: Worlds, done: float) -> None:
        """Begin new episodes. ``done`` is the completed share of the training."""
        from stable_baselines3.common.vec_env import VecNormalize

        env, buffer = self._normalized(worlds), model.replay_buffer
        if isinstance(env, VecNormalize) and buffer is not None and buffer.size():
            assert not isinstance(env.obs_rms, dict)  # which it is for dictionaries of observations
            seen = buffer.observations[: buffer.size()]
            # In float32: in float64 the normalising of batches would take longer than learning from them.
            some = seen[:: max(1, len(seen) // 20_000)].reshape(-1, seen.shape[-1])
            env.obs_rms.mean, env.obs_rms.var = some.mean(0), some.var(0)
        model.set_env(env)

    def _normalized(self, worlds: Worlds) -> "VecEnv":
        from stable_baselines3.common.vec_env import VecNormalize

        env = worlds(self.envs)
        return VecNormalize(env, training=False, norm_reward=False) if self.normalize else env


@dataclass(frozen=True)
class PPORecipe:
    """Hyperparameters of PPO (Schulman et al., 2017) on normalised observations and rewards.

    The learning rate falls linearly to zero, from segment to segment; so a finished run cannot be prolonged.

    Example:
        >>> from detden_lite import get_task
        >>> PPORecipe().config(get_task("hopper"))["value"]
        [11, 64, 64, 1]
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

    def __post_init__(self) -> None:
        check_whole(1, steps=self.steps, segment=self.segment, net=self.net, envs=self.envs, rollout=self.rollout)
        check_whole(2, batch=self.batch)  # advantages are normalised in each
        check_whole(1, epochs=self.epochs)
        check_positive(learning_rate=self.learning_rate, clip=self.clip)
        check_between(0, 1, gamma=self.gamma, gae_lambda=self.gae_lambda)
        check_between(-inf, inf, log_std=self.log_std)
        if self.activation not in ACTIVATIONS:
            raise ValueError(f"activation must be {' or '.join(ACTIVATIONS)}, not {self.activation!r}")
        if self.steps % self.segment or self.segment % (self.envs * self.rollout):
            raise ValueError("steps must be a multiple of segment, and segment of envs * rollout")

    @property
    def identity(self) -> dict[str, Any]:
        """The settings that all snapshots of a folder have in common."""
        return asdict(self)

    def config(self, task: Task) -> dict[str, Any]:
        """The arguments of the ``Victim`` that is trained."""
        layers = [task.obs_dim, self.net, self.net]
        return dict(
            actor=[*layers, task.action_dim], value=[*layers, 1], n_critics=0, activation=self.activation, gaussian=True
        )

    @property
    def algorithm(self) -> "type[PPO]":
        """The class of the model."""
        from sbx import PPO

        return PPO

    def start(self, task: Task, worlds: Worlds, seed: int) -> "PPO":
        """A new model, untrained."""
        import jax

        activation = dict(tanh=jax.numpy.tanh, relu=jax.nn.relu)[self.activation]
        networks = dict(net_arch=[self.net, self.net], activation_fn=activation, log_std_init=self.log_std)
        return self.algorithm(
            "MlpPolicy", self._normalized(worlds), learning_rate=self.learning_rate, n_steps=self.rollout,
            batch_size=self.batch, n_epochs=self.epochs, gamma=self.gamma, gae_lambda=self.gae_lambda,
            clip_range=self.clip, policy_kwargs=networks | dict(ortho_init=True), seed=seed,
        )  # fmt: skip

    def begin_segment(self, model: "PPO", worlds: Worlds, done: float) -> None:
        """Begin new episodes. ``done`` is the completed share of the training."""
        env, old = self._normalized(worlds), model.get_vec_normalize_env()
        assert old is not None  # its worlds come from ``start`` or from here
        env.obs_rms, env.ret_rms = old.obs_rms, old.ret_rms
        model.set_env(env)
        model.lr_schedule = lambda _: self.learning_rate * (1 - done)

    def _normalized(self, worlds: Worlds) -> "VecNormalize":
        from stable_baselines3.common.vec_env import VecNormalize

        return VecNormalize(worlds(self.envs), gamma=self.gamma)
