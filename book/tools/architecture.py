"""The rooms of the library as they are: their layers from the import contract, their lines, and who imports whom."""

import ast
import io
import tokenize
import tomllib
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = ROOT / "detden_lite"
AFTERNOON = ("core", "victims", "simulation", "defense", "attacks")  # the part that is read in an afternoon
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


def layers() -> list[list[str]]:
    """The rooms from the top down, as the import contract in pyproject.toml has them; those of a layer side by side."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    (contract,) = (contract for contract in settings["contracts"] if contract["type"] == "layers")
    rooms = ([name.strip() for name in layer.split("|")] for layer in contract["layers"])
    return [layer for layer in rooms if (LIBRARY / layer[0]).is_dir()]


def modules(room: str) -> list[Path]:
    """The modules of a room."""
    return sorted((LIBRARY / room).glob("*.py"))


def code_lines(*paths: Path) -> int:
    """Lines of code of these modules, without blank lines, comments and docstrings."""
    return sum(len(_code(path.read_text("utf-8"))) for path in paths)


def _code(source: str) -> set[int]:
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            lines.difference_update(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return lines


def imports(room: str) -> list[str]:
    """The other rooms that a room imports from, in the order of the layers."""
    found = set()
    for path in modules(room):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("detden_lite."):
                found.add(node.module.split(".")[1])
    return [name for layer in layers() for name in layer if name in found - {room}]


def draw(axes: Axes) -> None:
    """The rooms as boxes, the top layer first."""
    rows = layers()
    for y, layer in zip(reversed(range(len(rows))), rows, strict=True):
        width = 1 / len(layer)
        for i, room in enumerate(layer):
            fill = "#cfe8f7" if room in AFTERNOON else "#f1f1f1"
            box = FancyBboxPatch(
                (i * width + 0.02, y + 0.14), width - 0.04, 0.72, "round,pad=0,rounding_size=0.03",
                mutation_aspect=len(rows), facecolor=fill, edgecolor="#55606b", linewidth=0.8,
            )  # fmt: skip
            axes.add_patch(box)
            middle = (i + 0.5) * width
            axes.text(middle, y + 0.63, room, ha="center", va="center", weight="bold", fontsize=11)
            lines = f"{code_lines(*modules(room)):,} lines"
            axes.text(middle, y + 0.33, lines, ha="center", va="center", color="#404850", fontsize=9.5)
    axes.annotate(
        "", (-0.04, 0.1), (-0.04, len(rows) - 0.1), arrowprops=dict(arrowstyle="-|>", color="#55606b", linewidth=1.2)
    )
    axes.text(-0.07, len(rows) / 2, "may import from", rotation=90, ha="center", va="center", fontsize=10)
    axes.set(xlim=(-0.11, 1), ylim=(0, len(rows)))
    axes.axis("off")
