"""Episodes prepared for films and recordings: one of each kind, side by side."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from detden_lite.core.types import Episodes
from detden_lite.looking.robot import Robot

# Okabe and Ito's colours, a little lighter for a dark background: distinct with any colour vision. They are those of a
# clean robot, of an attacked one, of a defended one, and of the robot that the perturbed observation describes.
TAKE_COLOURS = ((86, 180, 233), (236, 122, 32), (0, 190, 135), (214, 134, 180))

GREY = (112, 114, 118)


@dataclass(frozen=True)
class Take:
    """One episode, cut to the T steps that it lasted. Arrays are ``[T, ...]``, in the units of ``Episodes``.

    Args:
        name: of the kind of episode.
        colour: of the robot.
        fell: whether it ended before the longest of the episodes beside it could end.
        positions: ``[T, nq]`` before each action, and one row more where the state after the last is known.
        obs: true observations.
        perturbed: observations after the attack.
        denoised: outputs of the denoiser.
        reward: of each step.
        attacked: whether the step was attacked.
        alarm: of the detector.
        score: of the detector.

    Example:
        >>> from detden_lite import Robot, get_task, load_victim, rollout, takes
        >>> task = get_task("hopper")
        >>> clean = rollout(load_victim("hopper", "td3"), task, [0], steps=5)
        >>> [(take.name, len(take)) for take in takes(Robot.of(task), dict(clean=clean), index=0)]
        [('clean', 5)]
    """

    name: str
    colour: tuple[int, int, int]
    fell: bool
    positions: np.ndarray
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
    """One episode of each of several kinds, to be shown side by side.

    Args:
        robot: the body.
        episodes: kinds of episodes by name.
        index: which episode of each kind.

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
