"""A gymnasium environment whose observations are attacked: an attack in anybody's loop (section 2.2 of the paper)."""

import gymnasium
import numpy as np
import torch
from gymnasium.utils import RecordConstructorArgs

from detden_lite.attacks.timing import Always
from detden_lite.core.types import World


class AttackedObservations(gymnasium.Wrapper, RecordConstructorArgs):
    """The observations that come out are attacked; the world behind them is not.

    ``info`` tells what nobody under attack knows: "true_obs", and whether it was "attacked". An episode that is reset
    with a seed is attacked as ``rollout`` attacks the episode of that seed.

    Args:
        env: one environment of the attack's victim; its observations are vectors, and raw: a ``VecNormalize`` belongs
            around this wrapper.
        attack: see ``detden_lite.attacks``. It belongs to this environment alone: it remembers the episode.
        timing: when to attack; always by default.

    Raises:
        ValueError: if the attack needs the simulator or the defence, which a loop of one's own does not hand out.
    """

    def __init__(self, env: gymnasium.Env, attack, timing=None):
        online = attack.needs & {"simulator", "defense"}
        if online:
            needs = " and the ".join(sorted(online))
            raise ValueError(f"attack: {type(attack).__name__} needs the {needs}; use detden_lite.rollout for it")
        RecordConstructorArgs.__init__(self, attack=attack, timing=timing)
        gymnasium.Wrapper.__init__(self, env)
        self.attack, self.timing = attack, timing or Always()
        self._seeds = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; one without a seed follows from the last seed that there was, as with gymnasium itself."""
        obs, info = self.env.reset(seed=seed, options=options)
        if seed is not None:
            self._seeds = np.random.default_rng(seed)
        episode = int(self._seeds.integers(2**63)) if seed is None else seed
        for part in (self.attack, self.timing):
            part.reset([episode])
        return self._shown(obs, info)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        obs, reward, terminated, truncated, info = self.env.step(action)
        obs, info = self._shown(obs, info)
        return obs, reward, terminated, truncated, info

    @torch.no_grad()
    def _shown(self, obs: np.ndarray, info: dict) -> tuple[np.ndarray, dict]:
        true = torch.as_tensor(obs, dtype=torch.float32)[None]
        attacked = bool(self.timing(true))
        shown = self.attack(true, World(np.array([attacked])))[0]  # it draws at every step, attacked or not
        return shown.numpy().astype(obs.dtype) if attacked else obs, dict(info, true_obs=obs, attacked=attacked)
