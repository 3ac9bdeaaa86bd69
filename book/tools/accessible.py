"""Sphinx extension: names for folds, and the roles and table heads that a screen reader expects.

What only exists in the browser, such as sliders, is named by ``_static/book.js``.
"""

import re

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.transforms.post_transforms import SphinxPostTransform

_EMPTY_HEAD = re.compile(r"<th\b[^>]*>\s*(?:<p>\s*</p>\s*)?</th>")
_SIGNATURE = re.compile(r'<dl>\s*((?:<dd><em class="sig-param">.*?</em>,?</dd>\s*)+)</dl>')


class NameFolds(SphinxPostTransform):
    """A folded cell says of which figure it is the code."""

    default_priority = 197  # before the extension of exercises, and before myst-nb folds what has a hide_mode
    formats = ("html",)

    def run(self, **kwargs: object) -> None:
        numbers = self.env.toc_fignumbers.get(self.env.docname, {}).get("figure", {})
        for cell in self.document.findall(nodes.container):
            if not cell.get("hide_mode"):
                continue
            drawn = [
                numbers[name] for figure in cell.findall(nodes.figure) for name in figure["ids"] if name in numbers
            ]
            if drawn:
                name = f"Code of figure {'.'.join(map(str, drawn[0]))}"
            elif any(isinstance(child, nodes.table) for child in cell.findall()) or "<table" in cell.astext():
                name = "Code of the table below"
            else:
                name = "Code of what is shown below" if cell["hide_mode"] == "input" else "Folded cell"
            cell["prompt_show"] = cell["prompt_hide"] = name


def repair(app: Sphinx, page: str, template: str, context: dict, doctree: nodes.document | None) -> None:
    """What other extensions write into a page, with the names and roles that are meant."""
    body = context.get("body", "")
    body = body.replace('<summary aria-label="Toggle hidden content">', "<summary>")  # its text says more
    body = body.replace('role="doc-biblioentry"', 'role="listitem"')  # its parent is a list
    body = _SIGNATURE.sub(_as_lines, body)
    context["body"] = _EMPTY_HEAD.sub("<td></td>", body)


def _as_lines(found: re.Match[str]) -> str:
    """The arguments of a long signature, which Sphinx writes as a list of definitions without their terms."""
    lines = found[1].replace("<dd>", '<span class="sig-line">').replace("</dd>", "</span>")
    return f'<span class="sig-lines">{lines}</span>'


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.add_post_transform(NameFolds)
    app.connect("html-page-context", repair)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
