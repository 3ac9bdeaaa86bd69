"""What flows between the rooms: episodes, trajectories, worlds and verdicts; and the contracts of their makers.

An attack, a timing, a detector, a denoiser or a defence is whatever has the methods of its protocol here; it needs no
base class. ``detden_lite.simulation.rollout`` checks its guests against these contracts at the first step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:  # reading records needs this module, and no torch
    from torch import Tensor

# What an attack may declare in its ``needs``.
KNOWLEDGE = dict(
    policy="the policy, with its gradients",
    critic="the policy's Q-function",
    simulator="the present state of the simulator",
    defense="the networks of the defence and their memory",
    adversary="a policy that learned to harm the victim, which was a black box to it",
)


@dataclass(frozen=True)
class Episodes:
    """N episodes, step by step. Arrays are ``[steps, N, ...]``; entries outside ``mask`` are after an episode's end.

    Example:
        >>> from detden_lite import get_task, load_victim, rollout
        >>> episodes = rollout(load_victim("hopper", "td3"), get_task("hopper"), range(3), steps=5)
        >>> episodes.obs.shape, episodes.lengths, len(episodes.select([0, 2]).seeds)
        ((5, 3, 11), array([5, 5, 5]), 2)
    """

    seeds: np.ndarray  # [N]
    mask: np.ndarray  # the episode was still going when this step began, bool
    state: np.ndarray  # qpos and qvel before the action, [steps, N, nq + nv] float32
    obs: np.ndarray  # the true observation o
    perturbed: np.ndarray  # what the attacker made of it; o itself where not attacked
    denoised: np.ndarray  # what the denoiser made of that; the perturbed observation without a defence
    shown: np.ndarray  # what the policy saw
    action: np.ndarray  # what it did, [steps, N, action_dim]
    reward: np.ndarray  # [steps, N] float64
    attacked: np.ndarray  # 1_vul, bool
    alarm: np.ndarray  # 1_anomaly, bool
    score: np.ndarray  # the detector's score; 0 without a defence

    @property
    def returns(self) -> np.ndarray:
        """Undiscounted return of each episode, ``[N]``."""
        return (self.reward * self.mask).sum(0)

    @property
    def lengths(self) -> np.ndarray:
        """Steps of each episode, ``[N]``."""
        return self.mask.sum(0)

    def select(self, index: Sequence[int] | np.ndarray) -> Episodes:
        """The episodes at these positions, or where a mask ``[N]`` is True."""
        rows = np.asarray(index)
        return Episodes(self.seeds[rows], *(getattr(self, f.name)[:, rows] for f in fields(self)[1:]))


@dataclass(frozen=True)
class World:
    """What an attack may see beside the observation, according to its ``needs``; what it does not need is None.

    Example:
        >>> World(wanted=np.array([True])).simulator is None
        True
    """

    wanted: np.ndarray  # rows whose perturbed observation will be used, [N] bool; others may hold anything
    simulator: Any = None  # a ``detden_lite.simulation.simulator.Simulator``; attacks only read it
    defense: Any = None  # a copy, with the defence's memory as it is before this observation
    action: Tensor | None = None  # what the policy did one step before, [N, action_dim]; see ``Denoiser.step``


@dataclass(frozen=True)
class Trajectories:
    """Observation sequences of whole episodes, with the actions or without; beyond an episode's length a row is 0.

    Example:
        >>> normal = Trajectories(np.zeros((2, 5, 11), np.float32), np.array([5, 3]))
        >>> len(normal), normal.mask.sum()
        (2, np.int64(8))
    """

    obs: np.ndarray  # [episodes, steps, obs_dim] float32
    lengths: np.ndarray  # [episodes]
    action: np.ndarray | None = None  # what was done there, [episodes, steps, action_dim] float32

    @property
    def mask(self) -> np.ndarray:
        """What is not padding, ``[episodes, steps]`` bool."""
        return np.arange(self.obs.shape[1]) < self.lengths[:, None]

    def __len__(self) -> int:
        return len(self.lengths)

    def select(self, index: slice | Sequence[int] | np.ndarray) -> Trajectories:
        """The trajectories at these positions (a slice or an array)."""
        return Trajectories(self.obs[index], self.lengths[index], None if self.action is None else self.action[index])


@dataclass(frozen=True)
class Verdict:
    """The defence's judgement of one observation of N episodes.

    Example:
        >>> import torch
        >>> obs = torch.zeros(2, 11)
        >>> Verdict(obs, alarm=torch.tensor([False, True]), score=torch.ones(2), denoised=obs).alarm
        tensor([False,  True])
    """

    obs: Tensor  # shown to the policy, [N, obs_dim], in raw units
    alarm: Tensor  # [N] bool
    score: Tensor  # the detector's, [N]; a GRU-VAE's is the largest error of an observation in its standard deviations
    denoised: Tensor  # what the denoiser would show, [N, obs_dim], in raw units


class Attack(Protocol):
    """Perturbs observations.

    An attack that has a ``budget`` is held to it: what it gives back must lie in the ball.

    Attributes:
        needs: what it knows beside the observation: keys of ``KNOWLEDGE``.
    """

    needs: frozenset[str]

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""

    def __call__(self, obs: Tensor, world: World) -> Tensor:
        """The perturbed observations, for true ones; both ``[N, obs_dim]`` float32 in raw units."""


class Timing(Protocol):
    """Decides when to attack."""

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""

    def __call__(self, obs: Tensor) -> Tensor:
        """1_vul for true observations ``[N, obs_dim]``: whom to attack now, ``[N]`` bool."""


class Detector(Protocol):
    """Raises the alarm.

    Attributes:
        threshold: C_anomaly; an alarm is a score above it.
    """

    threshold: float

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""

    def step(self, obs: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The score ``[N]``, the alarm ``[N]`` bool and the reconstruction o' ``[N, obs_dim]`` of one observation."""


class Denoiser(Protocol):
    """Estimates the true observation."""

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """den(o_hat) ``[N, obs_dim]``.

        Args:
            obs: what is shown, ``[N, obs_dim]``, raw units.
            action: what the policy did one step before, ``[N, action_dim]``; None at the beginning of all episodes, NaN
                in the row of one that has begun since. A denoiser may use it or not.
        """


class Defense(Protocol):
    """Stands between the sensors and the policy."""

    @property
    def needs(self) -> frozenset[str]:
        """The string "truth" for an oracle, which ``rollout`` tells by ``reveal``; otherwise nothing."""

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""

    def __call__(self, obs: Tensor, action: Tensor | None = None) -> Verdict:
        """The verdict on what is shown; the arguments are those of ``Denoiser.step``."""
