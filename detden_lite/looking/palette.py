"""The colours and the style of the book's figures.

A colour means the same in every chapter (Okabe and Ito's palette, told apart with any colour vision).
"""

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib_inline.backend_inline import set_matplotlib_formats

from detden_lite.attacks.catalogue import CATALOGUE

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, GREY, BLACK = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#767676", "#1a1a1a",
)  # fmt: skip

PALETTE = dict(clean=BLUE, attacked=VERMILLION, defended=GREEN, perturbed=PURPLE, noise=ORANGE, paper=GREY)

ATTACK_COLOURS: Mapping[str, str] = {name: entry.colour for name, entry in CATALOGUE.items() if entry.colour}
TRACES = dict(obs=BLUE, perturbed=PURPLE, denoised=GREEN)  # the signals of an episode, in the order they arise

STYLE: dict[str, Any] = {
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
    "axes.prop_cycle": cycler(color=[BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY]),
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "svg.hashsalt": "detden",
}


def use_style() -> None:
    """Draw every following figure of the notebook in the book's style, as SVG."""
    mpl.rcParams.update(STYLE)  # type: ignore[arg-type]  # the stubs want literal keys, STYLE is a plain dictionary
    set_matplotlib_formats("svg")


def cell_colour(cell: Mapping[str, str]) -> str:
    """The colour of a result record's cell: defended, attacked, noise or clean."""
    if cell["defense"] != "none":
        return PALETTE["defended"]
    return {"none": PALETTE["clean"], "uniform": PALETTE["noise"], "gaussian": PALETTE["noise"]}.get(
        cell["attack"], PALETTE["attacked"]
    )
