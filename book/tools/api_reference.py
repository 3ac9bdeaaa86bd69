"""Sphinx extension with two directives that document the public face of the library, read from the library itself.

``public`` takes a room and documents its public classes and functions, and the modules that are offered whole;
``names`` lists all of them in a table. Constants have no docstring: a page describes them with ``py:data``.
"""

import dataclasses
import inspect
import re
from collections.abc import Iterator

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import detden_lite

_FIELD = re.compile(r"^    (\w+): [^#\n]+  # (.+)$", re.M)


def public(room: str) -> Iterator[tuple[str, str, object]]:
    """Name, module and object of everything that the public face offers from a room."""
    for name, module in (detden_lite._HOME | detden_lite._WHOLE).items():
        if module.startswith(f"{room}."):
            yield name, module, getattr(detden_lite, name)


def kind(value: object) -> str:
    """How autodoc calls it: class, function, module, or data."""
    if inspect.ismodule(value):
        return "module"
    return "class" if inspect.isclass(value) else "function" if callable(value) else "data"


def rooms() -> list[str]:
    """The rooms that the public face offers something from, in its order."""
    return list(dict.fromkeys(module.partition(".")[0] for module in detden_lite._FACE))


def escape(text: str, characters: str) -> str:
    """Put a backslash before each of these characters, except between double backticks."""
    parts = text.split("``")
    return "``".join(part if i % 2 else re.sub(f"([{characters}])", r"\\\1", part) for i, part in enumerate(parts))


class Public(SphinxDirective):
    """The public classes and functions of one room, each with its docstring."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        lines = []
        for name, module, value in public(self.arguments[0]):
            if (found := kind(value)) == "module":
                lines += [f".. rubric:: Module {name}", "", f".. automodule:: detden_lite.{module}", "   :members:", ""]
            elif found != "data":
                lines += [f".. auto{found}:: detden_lite.{name}", "   :members:" * (found == "class"), ""]
        return self.parse_text_to_nodes("\n".join(["```{eval-rst}", *lines, "```"]))


class Names(SphinxDirective):
    """All public names, a table for each room: where a name is documented, and the summary of its docstring."""

    def run(self) -> list[nodes.Node]:
        lines = []
        for room in rooms():
            lines += ["", f"**{room}**", "", "| name | what it is |", "|---|---|"]
            for name, module, value in public(room):
                found, target = kind(value), f"detden_lite.{name}"
                summary = "a constant" if found == "data" else (inspect.getdoc(value) or "").split("\n\n")[0]
                if found == "module":
                    summary, target = f"module: {summary}", f"detden_lite.{module}"
                text = escape(" ".join(summary.split()), "*_").replace("``", "`").replace("|", r"\|").rstrip(".")
                role = {"module": "mod", "class": "class", "function": "func", "data": "data"}[found]
                lines.append(f"| {{py:{role}}}`{name} <{target}>` | {text} |")
        return self.parse_text_to_nodes("\n".join(lines))


def describe_fields(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Add the comments behind a dataclass's fields to its docstring, if that does not tell of them itself."""
    if what != "class" or not dataclasses.is_dataclass(value) or {"Args:", "Attributes:"} & set(lines):
        return
    found = _FIELD.findall(inspect.getsource(value))
    if found:
        lines += ["", "Attributes:", *(f"    {field}: {comment}" for field, comment in found), ""]


def escape_bars(app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]) -> None:
    """Keep ``|R|``, an absolute value, from being read as a substitution; literals and examples stay as they are."""
    end = next((i for i, line in enumerate(lines) if line.strip() == "Example:"), len(lines))
    for i in range(end):
        lines[i] = escape(lines[i], "|")


def show_defaults(
    app: Sphinx, what: str, name: str, value: object, options: object, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Write defaults that are functions by their names: Sphinx reads a signature only if it is Python."""
    if signature is not None:
        signature = re.sub(r"<function (\w+)>", r"\1", signature.replace("<factory>", "..."))
    return signature, returns


def setup(app: Sphinx) -> dict:
    """Called by Sphinx."""
    app.setup_extension("sphinx.ext.autodoc")
    app.add_directive("public", Public)
    app.add_directive("names", Names)
    app.connect("autodoc-process-docstring", describe_fields, priority=400)  # before napoleon reads the sections
    app.connect("autodoc-process-docstring", escape_bars, priority=400)
    app.connect("autodoc-process-signature", show_defaults)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
