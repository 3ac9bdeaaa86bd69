"""The book's figures: drawings of episodes and result records that chapters share.

Every function draws on axes that it is given, so that a cell decides how its figure is laid out. The palette, the
style, the tables and the robots have modules of their own; their names are here, too.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from detden_lite.core.estimates import Estimate
from detden_lite.core.types import Episodes
from detden_lite.looking.bodies import body, stage, strip
from detden_lite.looking.palette import (
    ATTACK_COLOURS,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALETTE,
    PURPLE,
    SKY,
    STYLE,
    TRACES,
    VERMILLION,
    cell_colour,
    use_style,
)  # fmt: skip
from detden_lite.looking.tables import folded_table, table, whole
from detden_lite.results.paper import CLEAN
from detden_lite.results.victim_cards import VictimCard

__all__ = [
    "ATTACK_COLOURS", "BLACK", "BLUE", "GREEN", "GREY", "ORANGE", "PALETTE", "PURPLE", "SKY", "STYLE", "TRACES",
    "VERMILLION", "body", "cell_colour", "flags", "folded_table", "label", "learning_curves", "returns", "stage",
    "strip", "table", "trace", "units", "use_style", "whole",
]  # fmt: skip


def units(names: Sequence[str]) -> list[str]:
    """Units of the observations that ``Robot.names`` lists, in ASCII: "m", "rad", "m/s" or "rad/s"."""
    found = []
    for name in names:
        unit = "m" if name.removeprefix("velocity_") in ("x", "y", "z") else "rad"
        found.append(unit + "/s" if name.startswith("velocity_") else unit)
    return found


def label(name: str) -> str:
    """An observation's name as a figure shows it: "velocity of thigh" for "velocity_thigh"."""
    return name.replace("velocity_", "velocity of ")


def trace(axes: Axes, episodes: Episodes, index: int, dim: int, kinds: Sequence[str] = ("obs", "perturbed")) -> None:
    """One observation of one episode over time, true, perturbed or denoised; only while the episode lasts.

    Args:
        axes: where to draw.
        episodes: a rollout.
        index: which episode.
        dim: which observation.
        kinds: some of "obs", "perturbed", "denoised".
    """
    length = episodes.lengths[index]
    names = dict(obs="true", perturbed="perturbed", denoised="denoised")
    for kind in kinds:
        width = 2.4 if kind == "obs" else 1.2
        values = getattr(episodes, kind)[:length, index, dim]
        axes.plot(values, color=TRACES[kind], linewidth=width, label=names[kind])
    axes.set(xlabel="step")


def flags(axes: Axes, on: np.ndarray, colour: str, height: tuple[float, float] = (0.0, 0.05)) -> None:
    """Mark the steps where ``on`` ``[steps]`` is true as a band; ``height`` is its bottom and top, 0 to 1."""
    edges = np.diff(np.concatenate([[0], np.asarray(on, dtype=int), [0]]))
    for start, end in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True):
        axes.axvspan(start - 0.5, end - 0.5, *height, color=colour, linewidth=0)


def returns(axes: Axes, records: Mapping[str, Mapping[str, Any]], paper: Mapping[str, float] | None = None) -> None:
    """Returns of result records, a row each: episodes as dots, the mean with its 95 % interval, the paper's number.

    Args:
        axes: where to draw.
        records: what ``load_record`` gives, by the name that the row gets; the first is on top.
        paper: the paper's mean return for some of the rows, drawn as a diamond.
    """
    scatter = np.random.default_rng(0)
    for row, (name, record) in enumerate(records.items()):
        colour, estimate = cell_colour(record["cell"]), Estimate(**record["estimate"])
        height = row + scatter.uniform(-0.18, 0.18, len(record["returns"]))
        axes.plot(record["returns"], height, ".", color=colour, alpha=0.45, markersize=6, markeredgewidth=0)
        axes.plot([estimate.low, estimate.high], [row, row], color=BLACK, linewidth=5, solid_capstyle="butt")
        axes.plot(estimate.mean, row, "o", color=colour, markeredgecolor=BLACK, markersize=7)
        if paper and name in paper:
            axes.plot(paper[name], row, "D", markersize=7, markerfacecolor="white", markeredgecolor=PALETTE["paper"])
    axes.set(yticks=range(len(records)), yticklabels=records, ylim=(len(records) - 0.5, -0.5), xlabel="return")
    axes.set_xlim(left=min(0, axes.get_xlim()[0]))
    axes.grid(False, axis="y")


def learning_curves(axes: Axes, card: VictimCard) -> None:
    """A victim's learning curves: the chosen seed's in blue with a ring at its snapshot, other seeds' in grey.

    The dashed line is the paper's policy.
    """
    for curve in sorted(card.curves, key=lambda curve: curve.seed == card.seed):  # the chosen one on top
        chosen = curve.seed == card.seed
        colour, width = (PALETTE["clean"], 1.8) if chosen else ("#9a9a9a", 1.1)
        axes.plot(curve.steps / 1e6, curve.mean, color=colour, linewidth=width)
        if chosen:
            shown = curve.mean[curve.steps == card.step]
            axes.plot(card.step / 1e6, shown, "o", markersize=9, markerfacecolor="none", markeredgecolor=BLACK)
    axes.axhline(CLEAN[card.task.name, card.algo], color=BLACK, linewidth=1, linestyle=(0, (4, 3)))
    axes.set_title(card.title, loc="left")
    axes.set_xlim(0, card.steps / 1e6 * 1.03)
    axes.set_ylim(bottom=min(0, axes.get_ylim()[0]))
