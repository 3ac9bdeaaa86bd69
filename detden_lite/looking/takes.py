"""Episodes made ready to be looked at: one of each kind side by side."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from detden_lite.core.types import Episodes
from detden_lite.looking.robot import Robot

# Okabe and Ito's colours, a little lightened for a dark ground: told apart with any colour vision. They are those of a
# clean robot, of an attacked one, of a defended one, and of what the perturbed observation describes.
TAKE_COLOURS = ((86, 180, 233), (236, 122, 32), (0, 190, 135), (214, 134, 180))

GREY = (112, 114, 118)


@dataclass(frozen=True)
class Take:
    """One episode, cut to the T steps that it lived. Arrays are ``[T, ...]``, in the units of ``Episodes``."""

    name: str
    colour: tuple[int, int, int]
    fell: bool  # it ended before its time, which is that of the longest episode beside it
    positions: np.ndarray  # [T, nq] before each action, and one row more where the state after the last is known
    obs: np.ndarray
    perturbed: np.ndarray
    denoised: np.ndarray
    reward: np.ndarray
    attacked: np.ndarray
    alarm: np.ndarray
    score: np.ndarray

    def __len__(self) -> int:
        return len(self.reward)


def takes(robot: Robot, episodes: Mapping[str, Episodes], index: int) -> list[Take]:
    """Episode ``index`` of each of several kinds of episodes, by name, to be shown side by side.

    Raises:
        ValueError: if there is none, if an index is out of range, or if episodes are not of this robot's task.
    """
    if not episodes:
        raise ValueError("episodes: give at least one kind of episodes, by name")
    horizon = max(len(kind.mask) for kind in episodes.values())
    return [_take(robot, name, kind, index, horizon) for name, kind in episodes.items()]


def _take(robot: Robot, name: str, kind: Episodes, index: int, horizon: int) -> Take:
    n, obs_dim, numbers = kind.mask.shape[1], kind.obs.shape[-1], kind.state.shape[-1]
    if not 0 <= index < n:
        raise ValueError(f"index: {name!r} has episodes 0 to {n - 1}, not {index}")
    if (obs_dim, numbers) != (len(robot.names), robot.model.nq + robot.model.nv):
        raise ValueError(
            f"episodes: {name!r} has {obs_dim} observations and {numbers} positions and velocities, the task "
            f"{len(robot.names)} and {robot.model.nq + robot.model.nv}; give episodes and task that belong together"
        )
    length = int(kind.mask[:, index].sum())
    defended, attacked = not np.array_equal(kind.denoised, kind.perturbed), kind.attacked.any()
    rows = ("obs", "perturbed", "denoised", "reward", "attacked", "alarm", "score")
    return Take(
        name,
        TAKE_COLOURS[2 if defended else int(attacked)],
        length < horizon,
        kind.state[: length + 1, index, : robot.model.nq],
        **{row: getattr(kind, row)[:length, index] for row in rows},
    )
