"""Writes notebooks from the chapters: ``python student.py [--solved] FOLDER``.

The student's notebook has stubs instead of solutions, no outputs, and the chapter's MyST as plain Markdown. The same
chapters always give the same bytes.
"""

import argparse
from collections import Counter
from functools import partial
from pathlib import Path

import jupytext
import nbformat
import yaml
from exercises import stub
from nbformat.v4 import new_code_cell, new_markdown_cell
from plain_markdown import Labels, caption, collect, plain, read_citations
from project import PYPROJECT, install, source

BOOK = Path(__file__).resolve().parents[1]
_HOW_TO = (
    "*A chapter of the book, to work in. Run the cells from top to bottom. In an exercise, replace the line "
    "`raise NotImplementedError(...)` by your code, run the cell, then run the check below it.*"
)
_METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def find_chapters(book: Path = BOOK) -> list[Path]:
    """The sources of the chapters, in the order of the table of contents."""
    contents = yaml.safe_load((book / "_toc.yml").read_text(encoding="utf-8"))
    files = [entry["file"] for part in contents["parts"] for entry in part["chapters"]]
    return [book / f"{file}.md" for file in files if file.startswith("chapters/")]


def make_notebooks(book: Path = BOOK, solved: bool = False) -> dict[str, str]:
    """The notebooks of all chapters, as text: ``{"01-the-ball.ipynb": "{...}"}``.

    Args:
        book: the folder with ``chapters/*.md`` and ``references.bib``.
        solved: keep the solutions, and let checks fail: for testing them.

    Raises:
        ValueError: if a chapter breaks a rule of AUTHORING.md; it names the chapter.
    """
    chapters = {path.stem: jupytext.read(path, fmt="md:myst") for path in find_chapters(book)}
    labels = Labels(citations=read_citations(book / "references.bib"))
    for step in (_collect_labels, partial(_convert, solved=solved)):
        for name, notebook in chapters.items():
            try:
                step(name, notebook, labels)
            except ValueError as error:
                raise ValueError(f"{name}.md: {error}") from error
    return {f"{name}.ipynb": nbformat.writes(notebook) + "\n" for name, notebook in chapters.items()}


def _collect_labels(name: str, notebook: nbformat.NotebookNode, labels: Labels) -> None:
    """Number figures and equations in reading order, as Sphinx does."""
    chapter = int(name.split("-")[0])
    counts: Counter[str] = Counter()

    def number(kind: str) -> str:
        counts[kind] += 1
        return f"{chapter}.{counts[kind]}"

    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            collect(cell.source.split("\n"), labels, number)
        elif drawn := cell.metadata.get("mystnb", {}).get("figure"):
            labels.add_figure(drawn.get("name"), number("figure"))


def _convert(name: str, notebook: nbformat.NotebookNode, labels: Labels, solved: bool) -> None:
    cells = [new_markdown_cell(_HOW_TO)]
    if first := install(source(PYPROJECT.read_text("utf-8"))):
        cells.append(new_code_cell(first))
    for cell in notebook.cells:
        cells.append(cell)
        if cell.cell_type == "markdown":
            cell.source = "\n".join(plain(cell.source.split("\n"), labels)).strip()
            continue
        tags = cell.metadata.get("tags", [])
        if "exercise" in tags and not solved:
            cell.source = stub(cell.source)
        if "check" in tags and not solved:
            tags = [*tags, "raises-exception"]
        drawn = cell.metadata.get("mystnb", {}).get("figure")
        cell.metadata = nbformat.from_dict({"tags": tags} if tags else {})
        if {"hide-input", "remove-input", "hide-cell", "remove-cell"} & set(tags):
            cell.metadata["jupyter"] = {"source_hidden": True}
        if drawn:
            cells.append(new_markdown_cell(caption(drawn["name"], drawn["caption"], labels)))
    for position, cell in enumerate(cells):
        cell.id = f"{name}-{position:03d}"[:64]
    notebook.cells = cells
    notebook.metadata = nbformat.from_dict(_METADATA)
    notebook.nbformat, notebook.nbformat_minor = 4, 5


def write_notebooks(folder: Path, solved: bool = False) -> None:
    """Write the notebooks of all chapters into ``folder``, and remove those of chapters that do not exist any more."""
    folder.mkdir(parents=True, exist_ok=True)
    made = make_notebooks(solved=solved)
    for path in folder.glob("*.ipynb"):
        if path.name not in made:
            path.unlink()
    for name, text in made.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--solved", action="store_true", help="with the solutions")
    arguments = parser.parse_args()
    write_notebooks(arguments.folder, arguments.solved)
