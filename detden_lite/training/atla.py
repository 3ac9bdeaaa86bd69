"""ATLA-PPO (Zhang et al., 2021): a policy and an adversary who perturbs its observations learn in turns, both by PPO.

Each has worlds, and a normaliser, of its own. In one's turn the other acts and does not learn: neither its parameters
nor the statistics of its normaliser move.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from sbx import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper
from torch import Tensor

from detden_lite.attacks.optimal import perturb
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import derived_seed
from detden_lite.training.progress import Tally


class Frozen:
    """How a model in training looks from the other's turn: it maps raw observations to actions, and learns nothing.

    Args:
        model: PPO of sbx-rl with a normaliser.
        deterministic: whether it acts with the mean of its policy, or explores.
    """

    def __init__(self, model: Any, deterministic: bool) -> None:
        self.model, self.deterministic = model, deterministic
        (self.obs_dim,), (self.action_dim,) = model.observation_space.shape, model.action_space.shape

    def __call__(self, obs: Tensor) -> Tensor:
        """Actions ``[N, action_dim]`` for raw observations ``[N, obs_dim]``."""
        seen = self.model.get_vec_normalize_env().normalize_obs(obs.numpy())  # which does not count them
        return torch.from_numpy(self.model.predict(seen.astype(np.float32), deterministic=self.deterministic)[0])


class AttackedWorlds(VecEnvWrapper):
    """Worlds in which the policy that learns sees perturbed observations only.

    Attributes:
        attack: maps true observations ``[N, obs_dim]`` to perturbed ones; None at the very beginning.
    """

    attack: Callable[[Tensor], Tensor] | None = None

    def _shown(self, obs: Any) -> np.ndarray:
        return obs if self.attack is None else self.attack(torch.from_numpy(obs)).numpy()

    def reset(self) -> np.ndarray:
        """Begin an episode in every world. Returns perturbed observations ``[N, obs_dim]``."""
        return self._shown(self.venv.reset())

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        """One step of every world; the last observation of an episode is perturbed like all others."""
        obs, rewards, dones, infos = self.venv.step_wait()
        for i in np.flatnonzero(dones):
            infos[i]["terminal_observation"] = self._shown(infos[i]["terminal_observation"][None])[0]
        return self._shown(obs), rewards, dones, infos


def _worlds(model: PPO) -> Any:
    """The worlds that a model learns in, without their normaliser: ``AttackedWorlds``, or an ``AdversaryEnv``."""
    normalizer: Any = model.get_env()
    return normalizer.venv


class ATLA(PPO):
    """PPO of sbx-rl whose observations are perturbed by an adversary, who learns in turns with it.

    A turn is one rollout and the epochs on it. See ``ATLARecipe``, which gives it its adversary and its worlds.

    Attributes:
        adversary: PPO of sbx-rl, who learns in an ``AdversaryEnv``.
        epsilon: the ball's radius.
        normalized: whether that is in units of the normaliser's deviations, and not in the environment's.
        tally: what happened in the adversary's turns.
    """

    adversary: PPO | None = None
    epsilon, normalized = 0.0, False

    def _setup_model(self) -> None:
        super()._setup_model()
        self.tally = Tally()

    @property
    def ball(self) -> Budget:
        """B(o), in raw units."""
        normalizer: Any = self.get_vec_normalize_env()
        std = torch.from_numpy(np.sqrt(normalizer.obs_rms.var + normalizer.epsilon)).float()
        return Budget(self.epsilon, scale=std if self.normalized else 1.0)

    def face_adversary(self) -> None:
        """Let the adversary, as they are now, perturb what is seen in the worlds of the policy."""
        assert self.adversary is not None  # from the start on
        adversary, ball = Frozen(self.adversary, deterministic=False), self.ball
        _worlds(self).attack = lambda obs: perturb(ball, obs, adversary(obs))

    def train(self) -> None:
        """PPO's epochs on the policy's rollout; then the adversary's turn, of as many steps."""
        super().train()
        self.adversary_turn()
        self.face_adversary()

    def adversary_turn(self) -> None:
        """The adversary plays against the policy's mean, and learns from that."""
        assert self.adversary is not None
        arena = _worlds(self.adversary)
        arena.victim, arena.follow = Frozen(self, deterministic=True), partial(perturb, self.ball)
        self.adversary.learn(self.n_steps * self.n_envs, callback=self.tally, reset_num_timesteps=False)

    def set_random_seed(self, seed: int | None = None) -> None:
        """Seed both."""
        super().set_random_seed(seed)
        if self.adversary is not None:
            self.adversary.set_random_seed(None if seed is None else derived_seed(seed, 1))

    def told(self) -> dict[str, Any]:
        """What happened in the adversary's turns since this was asked before; for ``progress.json``."""
        return dict(adversary=self.tally.take())
