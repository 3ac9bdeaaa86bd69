"""The graph of the recipe's rules, as Snakemake itself prints it, drawn without Graphviz."""

import re
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import networkx as nx
import numpy as np
from matplotlib.axes import Axes

from detden_lite.looking import figures

DATA = Path(__file__).resolve().parents[2] / "data"


def rule_graph(scale: str = "lite") -> nx.DiGraph:
    """The rules that lead to rule ``all``, an edge from each to the rules that wait for it next."""
    with tempfile.TemporaryDirectory() as folder:
        printed = subprocess.run(
            [
                *(sys.executable, "-m", "snakemake", "--rulegraph", "--directory", folder),
                *("--snakefile", DATA / "Snakefile", "--configfile", DATA / "config" / f"{scale}.yaml"),
            ],
            check=True, capture_output=True, text=True,
        ).stdout  # fmt: skip
    names = dict(re.findall(r'^\s*(\d+)\[label = "(\w+)"', printed, re.M))
    edges = re.findall(r"^\s*(\d+) -> (\d+)", printed, re.M)
    # Dependence is transitive: an edge that others imply adds nothing.
    return nx.transitive_reduction(nx.DiGraph([(names[tail], names[head]) for tail, head in edges]))


def draw(axes: Axes, graph: nx.DiGraph) -> None:
    """Draw the graph from top to bottom, each rule just above the first that waits for it."""
    levels = [list(rules) for rules in nx.topological_generations(graph.reverse())]
    level = {rule: height for height, rules in enumerate(levels) for rule in rules}
    routes = []
    for tail, head in graph.edges:  # a long edge has a place on each level that it passes
        between = [(tail, head, height) for height in range(level[head] + 1, level[tail])]
        for height, via in zip(range(level[head] + 1, level[tail]), between, strict=True):
            levels[height].append(via)
        routes.append([head, *between, tail])
    places = _places(levels, nx.Graph(pair for route in routes for pair in pairwise(route)))
    for route in routes:
        x, y = zip(*(places[stop] for stop in route), strict=True)
        axes.plot(x, y, color=figures.GREY, linewidth=1.3, zorder=1)
        arrow = dict(arrowstyle="-|>", color=figures.GREY, shrinkA=0, shrinkB=13, linewidth=1.3)
        axes.annotate("", places[route[0]], places[route[1]], arrowprops=arrow)
    for rule in graph:
        box = dict(boxstyle="round,pad=0.45", facecolor="white", edgecolor=figures.BLUE, linewidth=1.4)
        axes.text(*places[rule], rule, ha="center", va="center", bbox=box, fontsize=8)
    half = max(abs(x) + _width(stop) / 2 for stop, (x, _) in places.items())
    axes.set(xlim=(-half, half), ylim=(-0.5, len(levels) - 0.5))
    axes.axis("off")


def _width(stop: str | tuple) -> float:
    """Width in characters: of a rule's name with its box, or of an edge that passes."""
    return len(stop) + 4.0 if isinstance(stop, str) else 2.0


def _places(levels: list[list], neighbours: nx.Graph) -> dict:
    """Places with few crossings: each level is ordered by the mean place of its neighbours, below and above in turn."""
    places: dict = {}
    for sweep in range(9):
        for height, stops in enumerate(levels) if sweep % 2 == 0 else reversed(list(enumerate(levels))):
            middle = {stop: np.mean([places[n][0] for n in neighbours[stop] if n in places] or [0]) for stop in stops}
            stops.sort(key=lambda stop: (middle[stop], str(stop)))
            widths = np.array([_width(stop) for stop in stops])
            for stop, x in zip(stops, widths.cumsum() - widths / 2 - widths.sum() / 2, strict=True):
                places[stop] = (float(x), height)
    return places
