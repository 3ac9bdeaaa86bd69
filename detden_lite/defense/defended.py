"""A victim behind its defence, to be used as one uses a model of stable-baselines3."""

import copy

import numpy as np
import torch

from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.tasks import Task
from detden_lite.core.types import Verdict
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.victims.victim import Victim


class Defended:
    """A policy that looks at what it is shown before it believes it (figure 2 of the paper).

    It remembers the episodes that are under way, one a row, as detector and denoiser must: one ``predict`` for each
    step, and ``episode_start`` (or ``reset``) where an episode begins. For a second loop beside the first, make a
    second one of the same parts. Episodes are numbered as they begin, and the numbers are the seeds of all that is
    drawn in them: the same episodes begun in the same order get the same actions.

    Args:
        victim: the policy.
        task: where it acts.
        defense: is copied; what it remembers does not matter.

    Attributes:
        verdict: the ``Verdict`` on the last observations, with ``alarm`` and ``score`` ``[N]``; None before the first.
    """

    def __init__(self, victim: Victim, task: Task, defense: DetectAndDenoise):
        self.victim, self.task = victim, task
        self._defense = copy.deepcopy(defense)
        self._begun = 0  # episodes so far
        self.reset()

    @property
    def defense(self) -> DetectAndDenoise:
        """A copy, for ``rollout``. To change a part, build another ``Defended`` of it: this one does not notice."""
        return copy.deepcopy(self._defense)

    def reset(self) -> None:
        """Forget the episodes under way: with the next observations as many begin as there are rows."""
        self._rows, self.verdict, self._action = None, None, None

    @torch.no_grad()
    def predict(
        self, obs: np.ndarray, state=None, episode_start: np.ndarray | None = None, deterministic: bool = True
    ) -> tuple[np.ndarray, object]:
        """The actions for one observation of each episode, which may be attacked.

        Args:
            obs: raw, ``[N, obs_dim]``, or ``[obs_dim]`` for one episode.
            state: comes back as it is; what is remembered is kept here.
            episode_start: whose episode begins with this observation, ``[N]`` bool; None for nobody's but at the very
                first observation.
            deterministic: the policy's mean; False draws from a Gaussian policy.

        Returns:
            The actions, ``[N, action_dim]`` or ``[action_dim]``, inside the action bounds, and ``state``.

        Raises:
            ValueError: for observations of another shape or not finite, or other episodes than those under way.
        """
        seen = np.asarray(obs, dtype=np.float32)
        if seen.ndim not in (1, 2) or seen.shape[-1] != self.victim.obs_dim:
            dim = self.victim.obs_dim
            raise ValueError(f"obs: its shape must be [{dim}] or [N, {dim}], not {list(seen.shape)}")
        rows = torch.from_numpy(seen.reshape(-1, self.victim.obs_dim).copy())
        self._begin(len(rows), episode_start)
        self.verdict: Verdict = self._defense(rows, self._action)
        action = self.victim(self.verdict.obs)
        if not deterministic and self.victim.action_std is not None:
            drawn = self.victim.mean(self.verdict.obs) + self.victim.action_std * self._draws.normal(*action.shape)
            action = drawn.clamp(self.victim.action_low, self.victim.action_high)
        self._action = action
        return action.numpy().copy().reshape(*seen.shape[:-1], -1), state

    def _begin(self, n: int, episode_start) -> None:
        """Begin the episodes that begin now."""
        starts = np.zeros(n, bool) if episode_start is None else np.atleast_1d(np.asarray(episode_start, bool))
        if starts.shape != (n,):
            raise ValueError(f"episode_start: it must have one entry for each of the {n} episodes, not {starts.shape}")
        if self._rows is None or starts.all():
            episodes = range(self._begun, self._begun + n)
            self._defense.reset(episodes)
            self._rows, self._draws, self._begun = n, RandomStreams(4, episodes), self._begun + n
            self._action = None
            return
        if n != self._rows:
            raise ValueError(f"obs: it is of {n} episodes, and {self._rows} are under way; call reset() before others")
        for i in np.flatnonzero(starts):
            self._defense.restart(i, self._begun)
            self._draws.restart(i, self._begun)
            self._action[i] = torch.nan  # there is no action before the first
            self._begun += 1
