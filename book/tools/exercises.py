"""Exercises: the stub that a student gets, and the Sphinx extension that shows it above the folded solution."""

import json
import re

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform

_TITLE = re.compile(r"# (Exercise \d+\.\d+: .+)")
_SOLUTION = re.compile(r"^( *)### BEGIN SOLUTION\n.*?^\1### END SOLUTION$", re.M | re.S)


def title(source: str) -> str:
    """The title of an exercise: the comment in its first line, as in ``# Exercise 2.1: project into the ball``.

    Raises:
        ValueError: if the first line is no such comment.
    """
    match = _TITLE.fullmatch(source.split("\n", 1)[0].rstrip())
    if not match:
        raise ValueError(f"an exercise begins with a line '# Exercise 2.1: what to do', not with:\n{source[:80]}")
    return match[1]


def stub(source: str) -> str:
    """The code of an exercise with ``raise NotImplementedError(title)`` instead of its solution.

    Raises:
        ValueError: if there is not exactly one solution between the markers, inside a function.
    """
    error = f"raise NotImplementedError({json.dumps(title(source), ensure_ascii=False)})"
    solutions = _SOLUTION.findall(source)
    if len(solutions) != 1 or not solutions[0]:
        raise ValueError(
            f"{title(source)}: write one solution, indented in a function, between the lines "
            "'### BEGIN SOLUTION' and '### END SOLUTION' of the same indentation"
        )
    return _SOLUTION.sub(lambda match: match[1] + error, source)


class ShowStubFoldSolution(SphinxPostTransform):
    """A cell tagged ``exercise`` shows its stub, and its code folded under "Solution of 2.1"."""

    default_priority = 198  # just before myst-nb folds what has a hide_mode
    formats = ("html",)

    def run(self, **kwargs: object) -> None:
        for cell in list(self.document.findall(nodes.container)):
            if "tag_exercise" in cell["classes"]:
                code = next(cell.findall(nodes.literal_block))
                shown = code.deepcopy()
                shown.rawsource = stub(code.astext())
                shown.children = [nodes.Text(shown.rawsource)]
                box = nodes.container("", shown, classes=["cell", "cell_input", "exercise-stub"])
                cell.parent.insert(cell.parent.index(cell), box)
                cell["hide_mode"] = "input"
                number = title(code.astext()).split(":")[0].removeprefix("Exercise ")
                cell["prompt_show"] = cell["prompt_hide"] = f"Solution of {number}"


def setup(app: Sphinx) -> dict:
    app.add_post_transform(ShowStubFoldSolution)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
