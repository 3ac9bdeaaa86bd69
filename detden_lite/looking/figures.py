"""The book's figures: one style, one palette, and drawings of episodes and result records that chapters share.

A colour means the same in every chapter (Okabe and Ito's palette, told apart with any colour vision). Every function
draws on axes that it is given, so that a cell decides how its figure is laid out.
"""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from IPython.display import HTML
from matplotlib.axes import Axes
from matplotlib_inline.backend_inline import set_matplotlib_formats

from detden_lite.attacks.catalogue import CATALOGUE
from detden_lite.core.estimates import Estimate
from detden_lite.core.types import Episodes
from detden_lite.looking.robot import Robot
from detden_lite.results.paper import CLEAN
from detden_lite.results.victim_cards import VictimCard

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, GREY, BLACK = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#767676", "#1a1a1a",
)  # fmt: skip

PALETTE = dict(clean=BLUE, attacked=VERMILLION, defended=GREEN, perturbed=PURPLE, noise=ORANGE, paper=GREY)

ATTACK_COLOURS = {name: entry.colour for name, entry in CATALOGUE.items() if entry.colour}
TRACES = dict(obs=BLUE, perturbed=PURPLE, denoised=GREEN)  # the signals of an episode, in the order they arise

STYLE = {
    "figure.figsize": (7.2, 3.2),
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "font.size": 10.5,
    "axes.titlesize": 11,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": plt.cycler(color=[BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY]),
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "svg.hashsalt": "detden",
}


def use_style() -> None:
    """Give every following figure of the notebook the book's look, drawn as SVG."""
    plt.rcParams.update(STYLE)
    set_matplotlib_formats("svg")


def table(columns: Sequence[str], rows: Sequence[Sequence]) -> HTML:
    """A table for the end of a cell; what looks like HTML is not escaped.

    Entries are shown as ``str`` gives them; those that are no text, as an ``Estimate``, broken as ``whole`` does it.
    """

    def line(cells: Sequence, tag: str) -> str:
        shown = (cell if isinstance(cell, str) else whole(cell) for cell in cells)
        return "<tr>" + "".join(f"<{tag}>{cell}</{tag}>" for cell in shown) + "</tr>"

    body = "".join(line(row, "td") for row in rows)
    # The class tells themes that the output needs no light ground when the page is dark.
    return HTML(f'<table class="table dataframe"><thead>{line(columns, "th")}</thead><tbody>{body}</tbody></table>')


def whole(text: object) -> str:
    """Text of a table's entry that breaks into lines before an interval at most: "3,376", then "[3,375, 3,376]"."""
    return str(text).replace(" ", "\N{NO-BREAK SPACE}").replace("\N{NO-BREAK SPACE}[", " [")


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


def body(
    axes: Axes, robot: Robot, position: np.ndarray, colour: str = BLUE, alpha: float = 1.0, shift: float = 0.0
) -> None:
    """The robot in one pose, seen from its side (x to the right, z up).

    Args:
        axes: where to draw; give them an equal aspect and limits in metres (see ``stage``).
        robot: whose body.
        position: generalised positions ``[nq]``, as the first entries of a row of ``Episodes.state``.
        colour: of all its limbs.
        alpha: opacity; a ghost has little.
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
    """Make ready for ``body``: x from ``low`` to ``high`` metres, z from the floor to ``top``, equal scales."""
    axes.set(xlim=(low, high), ylim=(-0.12, top), aspect="equal", xlabel="x (m)", yticks=[])
    axes.grid(False)
    axes.spines["left"].set_visible(False)
    axes.axhspan(-0.12, 0, color="#d9d9d9", linewidth=0)


def strip(
    axes: Axes, robot: Robot, episodes: Episodes, index: int, steps: Sequence[int], colour: str = BLUE, gap: float = 1.1
) -> None:
    """Poses of an episode at some steps, side by side, ``gap`` metres from one to the next, the step below each.

    Steps that the episode did not live to are left empty.
    """
    stage(axes, -gap / 2, gap * (len(steps) - 0.5))
    axes.set(xlabel="step", xticks=gap * np.arange(len(steps)), xticklabels=steps)
    for place, step in enumerate(steps):
        if step < len(episodes.mask) and episodes.mask[step, index]:
            position = episodes.state[step, index, : robot.model.nq]
            body(axes, robot, position, colour, shift=gap * place - position[0])


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


def cell_colour(cell: Mapping[str, str]) -> str:
    """The colour of a result record's cell: defended, attacked, noise or clean."""
    if cell["defense"] != "none":
        return PALETTE["defended"]
    return {"none": PALETTE["clean"], "uniform": PALETTE["noise"], "gaussian": PALETTE["noise"]}.get(
        cell["attack"], PALETTE["attacked"]
    )


def returns(axes: Axes, records: Mapping[str, Mapping], paper: Mapping[str, float] | None = None) -> None:
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
        look = dict(color=PALETTE["clean"], linewidth=1.8) if chosen else dict(color="#9a9a9a", linewidth=1.1)
        axes.plot(curve.steps / 1e6, curve.mean, **look)
        if chosen:
            shown = curve.mean[curve.steps == card.step]
            axes.plot(card.step / 1e6, shown, "o", markersize=9, markerfacecolor="none", markeredgecolor=BLACK)
    axes.axhline(CLEAN[card.task.name, card.algo], color=BLACK, linewidth=1, linestyle=(0, (4, 3)))
    axes.set_title(card.title, loc="left")
    axes.set_xlim(0, card.steps / 1e6 * 1.03)
    axes.set_ylim(bottom=min(0, axes.get_ylim()[0]))
