"""A gymnasium environment whose observations are attacked: for loops other than ``rollout`` (section 2.2)."""

from typing import SupportsFloat

import gymnasium
import numpy as np
import torch
from gymnasium.utils import RecordConstructorArgs

from detden_lite.attacks.timing import Always
from detden_lite.core.types import Attack, Timing, World
from detden_lite.simulation.guests import check_guests


class AttackedObservations(gymnasium.Wrapper, RecordConstructorArgs):
    """The observations that come out are attacked; the world behind them is not.

    ``info`` has "true_obs", and "attacked", whether this step was attacked: a policy must not use either. An episode
    that is reset with a seed is attacked as ``rollout`` attacks the episode of that seed.

    Args:
        env: one environment of the attack's victim; its observations are vectors, and raw: a ``VecNormalize`` belongs
            around this wrapper.
        attack: see ``detden_lite.attacks``. It belongs to this environment alone: it remembers the episode.
        timing: when to attack; always by default.

    Raises:
        ValueError: if the attack needs the simulator or the defence, which only ``rollout`` hands out; if attack or
            timing break their contract; or if the environment's observations have another length than the attack's.

    Example:
        >>> import gymnasium
        >>> from detden_lite import AttackedObservations, Budget, UniformNoise
        >>> env = AttackedObservations(gymnasium.make("Hopper-v5"), UniformNoise(Budget(0.1)))
        >>> obs, info = env.reset(seed=0)
        >>> bool(0 < abs(obs - info["true_obs"]).max() <= 0.1 + 1e-6), info["attacked"]
        (True, True)
    """

    def __init__(self, env: gymnasium.Env, attack: Attack, timing: Timing | None = None) -> None:
        name, made_for = type(attack).__name__, getattr(attack, "obs_dim", None)
        if online := set(getattr(attack, "needs", ())) & {"simulator", "defense"}:
            needs = " and the ".join(sorted(online))
            raise ValueError(f"attack: {name} needs the {needs}; use detden_lite.rollout for it")
        check_guests(attack, timing, None)
        shape = env.observation_space.shape or ()
        if len(shape) != 1 or made_for not in (None, *shape):
            size = made_for or "any number of"
            raise ValueError(f"env: an observation has the shape {shape}, and {name} attacks {size} numbers in a row")
        RecordConstructorArgs.__init__(self, attack=attack, timing=timing)
        gymnasium.Wrapper.__init__(self, env)
        self.attack, self.timing = attack, timing or Always()
        self._seeds = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; without a seed, the next one of those that follow from the last seed, as in gymnasium."""
        obs, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._seeds = np.random.default_rng(seed)
        episode = int(self._seeds.integers(2**63)) if seed is None else seed
        for part in (self.attack, self.timing):
            part.reset([episode])
        return self._shown(obs, info)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict]:
        """One step of the environment; the observation that comes out is attacked where the timing says so."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        obs, info = self._shown(obs, info)
        return obs, reward, terminated, truncated, info

    @torch.no_grad()
    def _shown(self, obs: np.ndarray, info: dict) -> tuple[np.ndarray, dict]:
        true = torch.as_tensor(obs, dtype=torch.float32)[None]
        attacked = bool(self.timing(true))
        shown = self.attack(true, World(np.array([attacked])))[0]  # at every step, for the same random numbers
        return shown.numpy().astype(obs.dtype) if attacked else obs, dict(info, true_obs=obs, attacked=attacked)
