"""Robots drawn in a figure: one pose, or poses of an episode side by side."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from detden_lite.core.types import Episodes
from detden_lite.looking.palette import BLUE
from detden_lite.looking.robot import Robot


def body(
    axes: Axes, robot: Robot, position: np.ndarray, colour: str = BLUE, alpha: float = 1.0, shift: float = 0.0
) -> None:
    """The robot in one pose, seen from its side (x to the right, z up).

    Args:
        axes: where to draw; give them an equal aspect and limits in metres (see ``stage``).
        robot: the body.
        position: generalised positions ``[nq]``, as the first entries of a row of ``Episodes.state``.
        colour: of all its limbs.
        alpha: opacity; low for a ghost.
        shift: metres added to x.
    """
    ends, turns = robot.poses(np.asarray(position)[None])
    x, y, z, w = turns[0].T
    directions = np.stack([2 * (x * z + w * y), 1 - 2 * (x * x + y * y)], axis=1)  # of the capsules' axes, x and z
    half_turn = np.linspace(0, np.pi, 12)
    for end, direction, length, radius in zip(ends[0], directions, robot.lengths, robot.radii, strict=True):
        start = end[[0, 2]] + [shift, 0]
        heading = np.arctan2(direction[1], direction[0])
        caps = [
            point + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            for point, turn in (
                (start + direction * length, heading - np.pi / 2 + half_turn),
                (start, heading + np.pi / 2 + half_turn),
            )
        ]
        axes.fill(*np.concatenate(caps).T, facecolor=colour, edgecolor="white", linewidth=1, alpha=alpha)


def stage(axes: Axes, low: float, high: float, top: float = 1.7) -> None:
    """Prepare axes for ``body``: x from ``low`` to ``high`` metres, z from the floor to ``top``, equal scales."""
    axes.set(xlim=(low, high), ylim=(-0.12, top), aspect="equal", xlabel="x (m)", yticks=[])
    axes.grid(False)
    axes.spines["left"].set_visible(False)
    axes.axhspan(-0.12, 0, color="#d9d9d9", linewidth=0)


def strip(
    axes: Axes, robot: Robot, episodes: Episodes, index: int, steps: Sequence[int], colour: str = BLUE, gap: float = 1.1
) -> None:
    """Poses of an episode at some steps, side by side, ``gap`` metres from one to the next, the step below each.

    The places of steps after the episode's end are left empty.
    """
    stage(axes, -gap / 2, gap * (len(steps) - 0.5))
    axes.set(xlabel="step", xticks=gap * np.arange(len(steps)), xticklabels=steps)
    for place, step in enumerate(steps):
        if step < len(episodes.mask) and episodes.mask[step, index]:
            position = episodes.state[step, index, : robot.model.nq]
            body(axes, robot, position, colour, shift=gap * place - position[0])
