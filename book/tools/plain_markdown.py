"""MyST to the Markdown that JupyterLab shows: directives, roles and labels become plain text, images and links.

Figures and labelled equations get the numbers that the built book gives them: chapter, dot, position.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from posixpath import normpath
from typing import TypeVar

from pybtex.database import parse_file

Found = TypeVar("Found")

_FENCE = re.compile(r"(?P<fence>`{3,}|:{3,})(?:\{(?P<name>[\w-]+)\})?[ \t]*(?P<argument>.*)")
_OPTION = re.compile(r":([\w-]+):[ \t]*(.*)")
_ROLE = re.compile(r"(?<!`)\{([\w:]+)\}`([^`]+)`")
_TARGET = re.compile(r"\(([\w:-]+)\)=")
_EQUATION = re.compile(r"\$\$[ \t]*\(([\w:-]+)\)[ \t]*$", re.M)
_LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")
_ADMONITIONS = {"note", "tip", "hint", "warning", "important", "seealso", "admonition"}


@dataclass(frozen=True)
class Directive:
    """A fenced directive: its name, the text behind the name, its ``:key: value`` options and the lines of its body."""

    name: str
    argument: str
    options: dict[str, str]
    body: list[str]


@dataclass
class Labels:
    """What references point to, over all chapters: the shown text of figures, equations, headings and citations."""

    figures: dict[str, str] = field(default_factory=dict)
    equations: dict[str, str] = field(default_factory=dict)
    headings: dict[str, str] = field(default_factory=dict)
    citations: dict[str, tuple[str, str]] = field(default_factory=dict)  # key: (authors, year)

    def add_figure(self, name: str | None, number: str) -> None:
        """Raises ValueError if there is no name, or another figure has it."""
        if not name or name in self.figures:
            raise ValueError(f"figure {number} needs a name of its own, not {name!r}")
        self.figures[name] = number


def read_citations(bibliography: Path) -> dict[str, tuple[str, str]]:
    """Authors and year of every entry: ``{"xiong2022": ("Xiong et al.", "2022")}``."""
    citations = {}
    for key, entry in parse_file(str(bibliography)).entries.items():
        names = [" ".join(person.prelast_names + person.last_names) for person in entry.persons.get("author", [])]
        authors = " and ".join(names) if len(names) <= 2 else f"{names[0]} et al."
        citations[key] = (authors.replace("{", "").replace("}", ""), entry.fields["year"])
    return citations


def blocks(lines: list[str]) -> Iterator[str | list[str] | Directive]:
    """Yield the lines outside fences one by one, fenced code as a list of lines, directives as `Directive`.

    Raises:
        ValueError: if a fence is never closed.
    """
    position = 0
    while position < len(lines):
        line = lines[position]
        position += 1
        opening = _FENCE.fullmatch(line)
        if not opening:
            yield line
            continue
        start, fence = position, opening["fence"]
        closing = re.compile(rf"{fence[0]}{{{len(fence)},}}\s*")
        while position < len(lines) and not closing.fullmatch(lines[position]):
            position += 1
        if position == len(lines):
            raise ValueError(f"this fence is never closed: {line}")
        body = lines[start:position]
        position += 1
        if not opening["name"]:
            yield [line, *body, fence]
            continue
        options = {}
        while body and (option := _OPTION.fullmatch(body[0])):
            options[option[1]] = option[2]
            body = body[1:]
        yield Directive(opening["name"], opening["argument"].strip(), options, body)


def collect(lines: list[str], labels: Labels, number: Callable[[str], str]) -> None:
    """Put the labels of some Markdown into ``labels``; ``number("figure")`` is the next free number of that kind."""
    target = None
    for block in blocks(lines):
        if isinstance(block, Directive):
            if block.name == "figure":
                labels.add_figure(block.options.get("name"), number("figure"))
            elif block.name == "math" and "label" in block.options:
                labels.equations[block.options["label"]] = number("equation")
            else:
                collect(block.body, labels, number)
        elif isinstance(block, str):
            if equation := _EQUATION.search(block):
                labels.equations[equation[1]] = number("equation")
            elif found := _TARGET.fullmatch(block.strip()):
                target = found[1]
            elif target and block.strip():
                labels.headings[target] = block.lstrip("# ").strip()
                target = None


def plain(lines: list[str], labels: Labels) -> list[str]:
    """The same text without MyST's directives, roles and labels.

    Raises:
        ValueError: at a directive, role or reference that has no plain form; it names it and says what there is.
    """
    out: list[str] = []
    for is_text, run in groupby(blocks(lines), key=lambda block: isinstance(block, str)):
        if is_text:  # together, because a role may go on in the next line
            kept = [line for line in run if not _TARGET.fullmatch(line.strip())]
            out += inline("\n".join(kept), labels).split("\n") if kept else []
            continue
        for block in run:
            out += _directive(block, labels) if isinstance(block, Directive) else block
    return out


def inline(text: str, labels: Labels) -> str:
    """Text without roles and labels."""
    text = _EQUATION.sub(lambda match: rf"\tag{{{_find(labels.equations, match[1], 'equation')}}} $$", text)
    # Links first: a role becomes a link of the notebook's own, which is not to be converted again.
    text = _LINK.sub(lambda match: f"[{match[1]}]({_notebook(match[2])})" if _is_local(match[2]) else match[0], text)
    return _ROLE.sub(lambda match: _role(match[1], match[2], labels), text)


def caption(name: str, text: str, labels: Labels) -> str:
    """The line below a figure."""
    return f"**Figure {labels.figures[name]}.** {inline(' '.join(text.split()), labels)}"


def _directive(block: Directive, labels: Labels) -> list[str]:
    name, body = block.name, block.body
    if name in _ADMONITIONS:
        heading = block.argument or {"seealso": "See also"}.get(name, name.capitalize())
        inner = plain(body, labels)
        return [f"> **{inline(heading, labels)}**", ">", *(f"> {line}".rstrip() for line in inner), ""]
    if name == "dropdown":
        heading = inline(block.argument, labels)
        return ["<details>", f"<summary>{heading}</summary>", "", *plain(body, labels), "", "</details>", ""]
    if name == "figure":
        image = f"![{block.options.get('alt', '')}]({_image(block.argument)})"
        return [image, "", caption(block.options["name"], " ".join(body), labels), ""]
    if name in ("film", "recording", "playground"):
        return [f"![{block.options['alt']}]({_image(block.options['still'])})", "", *plain(body, labels), ""]
    if name == "image":
        return [f"![{block.options.get('alt', '')}]({_image(block.argument)})", ""]
    if name == "math":
        label = block.options.get("label")
        tag = [rf"\tag{{{labels.equations[label]}}}"] if label else []
        return ["$$", *body, *tag, "$$"]
    if name == "code-block":
        return [f"```{block.argument}", *body, "```"]
    if name == "raw":
        return []
    raise ValueError(f"the directive {{{name}}} has no plain form for notebooks: AUTHORING.md lists those that do")


def _role(name: str, argument: str, labels: Labels) -> str:
    argument = " ".join(argument.split())
    shown, target = re.fullmatch(r"(?:(.*?)\s*<)?([^<>]+)>?", argument).groups()
    if name == "numref":
        return shown or f"Figure {_find(labels.figures, target, 'figure')}"
    if name == "eq":
        return f"({_find(labels.equations, target, 'equation')})"
    if name == "ref":
        return shown or f"*{inline(_find(labels.headings, target, 'section'), labels)}*"
    if name == "doc":
        return f"[{shown or target}]({_notebook(target + '.md')})"
    if name == "scene":
        return shown or "the playground"
    if name in ("cite", "cite:p"):
        found = [_find(labels.citations, key.strip(), "citation") for key in argument.split(",")]
        return "(" + "; ".join(f"{authors}, {year}" for authors, year in found) + ")"
    if name == "cite:t":
        return "{} ({})".format(*_find(labels.citations, target, "citation"))
    raise ValueError(f"the role {{{name}}} has no plain form for notebooks: AUTHORING.md lists those that do")


def _find(labels: Mapping[str, Found], name: str, kind: str) -> Found:
    if name not in labels:
        raise ValueError(f"no {kind} is called {name!r}")
    return labels[name]


def _is_local(target: str) -> bool:
    return target.split("#")[0].endswith(".md")


def _notebook(target: str) -> str:
    """Where a link from one chapter to another page leads from the folder of notebooks."""
    path = target.split("#")[0]
    return path.removesuffix(".md") + ".ipynb" if "/" not in path else "../book/chapters/" + path


def _image(path: str) -> str:
    """Where an image of a chapter is, seen from the folder of notebooks."""
    return normpath(f"../book/chapters/{path}")
