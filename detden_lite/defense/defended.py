"""A victim behind its defence, to be used as one uses a model of stable-baselines3."""

import copy
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch

from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.tasks import Task
from detden_lite.core.types import Verdict
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.victims.victim import Victim


class Defended:
    """A policy that looks at its observations before it believes them (figure 2 of the paper).

    It remembers the episodes that are under way, one a row, as detector and denoiser must: one ``predict`` for each
    step, and ``episode_start`` (or ``reset``) where an episode begins. For a second loop beside the first, in a thread
    or not, make a second one of the same parts. Episodes are numbered as they begin, and the numbers are the seeds of
    all random numbers in them: the same episodes begun in the same order get the same actions.

    Args:
        victim: the policy.
        task: where it acts.
        defense: is copied; its memory does not matter.

    Attributes:
        verdict: the ``Verdict`` on the last observations, with ``alarm`` and ``score`` ``[N]``; None before the first.

    Raises:
        ValueError: if the victim or the defence is of another task, or the defence is no ``DetectAndDenoise``.

    Example:
        >>> from detden_lite import get_task, load_defense, load_victim
        >>> policy = Defended(
        ...     load_victim("hopper", "td3"), get_task("hopper"), load_defense("hopper", "td3", "mixed")
        ... )
        >>> action, _ = policy.predict(np.zeros((2, 11)))  # one observation of each of two episodes
        >>> action.shape, policy.verdict.alarm.shape
        ((2, 3), torch.Size([2]))
    """

    verdict: Verdict | None
    _rows: int | None
    _action: torch.Tensor | None

    def __init__(self, victim: Victim, task: Task, defense: DetectAndDenoise):
        task.check_fits(victim.obs_dim, victim.action_dim)
        if not isinstance(defense, DetectAndDenoise):
            raise ValueError(f"defense: give a DetectAndDenoise, not {defense!r}")
        if defense.obs_dim not in (None, task.obs_dim):
            raise ValueError(f"defense: it is for {defense.obs_dim} observations, and {task.env_id} has {task.obs_dim}")
        self.victim, self.task = victim, task
        self._defense = copy.deepcopy(defense)
        self._begun = 0  # episodes so far
        self._turn = [None]  # taken by the thread that is at work; a lock could not be copied
        self.reset()

    def __repr__(self) -> str:
        return f"Defended({self.task.env_id}, {self.victim!r}, {self._defense!r})"

    def __getstate__(self) -> dict[str, object]:
        return self.__dict__ | dict(_turn=[None])  # no thread is inside the copy, even if one is inside the original

    @property
    def defense(self) -> DetectAndDenoise:
        """A copy, for ``rollout``. To change a part, build another ``Defended`` of it: this one does not notice."""
        return copy.deepcopy(self._defense)

    def reset(self) -> None:
        """Forget the episodes under way: with the next observations as many begin as there are rows.

        Raises:
            RuntimeError: if another thread is inside ``predict``.
        """
        with self._alone():
            self._rows, self.verdict, self._action = None, None, None

    @torch.no_grad()
    def predict(
        self, obs: np.ndarray, state: object = None, episode_start: np.ndarray | None = None, deterministic: bool = True
    ) -> tuple[np.ndarray, object]:
        """The actions for one observation of each episode, which may be attacked.

        Args:
            obs: raw, ``[N, obs_dim]``, or ``[obs_dim]`` for one episode.
            state: is returned as it is; the memory is kept here.
            episode_start: whose episode begins with this observation, ``[N]`` bool; None for nobody's but at the very
                first observation.
            deterministic: the policy's mean; False samples a Gaussian policy.

        Returns:
            The actions, ``[N, action_dim]`` or ``[action_dim]``, inside the action bounds, and ``state``.

        Raises:
            ValueError: for observations of another shape or not finite, or other episodes than those under way.
            RuntimeError: if another thread is inside ``predict``.
        """
        seen, dim = np.asarray(obs), self.victim.obs_dim
        if seen.dtype.kind not in "fiu" or seen.ndim not in (1, 2) or seen.shape[-1] != dim or not seen.size:
            raise ValueError(f"obs must be numbers [{dim}] or [N >= 1, {dim}], not {list(seen.shape)} of {seen.dtype}")
        rows = torch.tensor(seen.reshape(-1, dim), dtype=torch.float32)
        self._defense.check(rows)  # before an episode begins: a call that is refused changes nothing
        with self._alone():
            self._begin(len(rows), episode_start)
            self.verdict = verdict = self._defense(rows, self._action)
            action = self.victim(verdict.obs)
            if not deterministic and self.victim.action_std is not None:
                noise = self._streams.normal(*action.shape)
                noisy = self.victim.mean(verdict.obs) + self.victim.action_std * noise
                action = noisy.clamp(self.victim.action_low, self.victim.action_high)
            self._action = action
        return action.numpy().copy().reshape(*seen.shape[:-1], -1), state

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Refuse a second thread at once: it would mix the memories of two loops."""
        try:
            turn = self._turn.pop()  # of two threads only one gets it
        except IndexError:
            raise RuntimeError("two threads use this Defended: make one Defended for each loop") from None
        try:
            yield
        finally:
            self._turn.append(turn)

    def _begin(self, n: int, episode_start: np.ndarray | None) -> None:
        """Begin the episodes that begin now."""
        starts = np.zeros(n, bool) if episode_start is None else np.atleast_1d(np.asarray(episode_start, bool))
        if starts.shape != (n,):
            raise ValueError(f"episode_start: it must have one entry for each of the {n} episodes, not {starts.shape}")
        if self._rows is None or starts.all():
            episodes = range(self._begun, self._begun + n)
            self._defense.reset(episodes)
            self._rows, self._streams, self._action = n, RandomStreams(4, episodes), None
            self._begun += n
            return
        if n != self._rows:
            raise ValueError(f"obs: it is of {n} episodes, and {self._rows} are under way; call reset() before others")
        for i in np.flatnonzero(starts).tolist():
            self._defense.restart(i, self._begun)
            self._streams.restart(i, self._begun)
            if self._action is not None:
                self._action[i] = torch.nan  # there is no action before the first
            self._begun += 1
