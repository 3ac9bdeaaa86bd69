"""The walks of CONTRIBUTING.md work as they are printed: in a copy of the project, files written and commands run."""

import ast
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT

PAGE = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
BLOCK = re.compile(
    r"(?:^\*\*`(?P<path>[^`]+)`\*\*(?:, (?P<where>at the end of|before|after) `(?P<name>[^`]+)`)?:\n\n)?"
    r"^(?P<fence>`{3,})(?P<language>\w+)\n(?P<text>.*?)^(?P=fence)$",
    re.M | re.S,
)


def walk(title: str) -> list[re.Match]:
    """The fenced blocks below a heading, up to the next one of the page itself."""
    begin = re.search(rf"(?m)^#+ {re.escape(title)}$", PAGE).end()
    found = [block for block in BLOCK.finditer(PAGE) if block.start() > begin]
    # Headings inside a block, those of the printed chapter, end nothing.
    prose = BLOCK.sub(lambda block: " " * len(block[0]), PAGE)
    end = re.compile(r"(?m)^##+ ").search(prose, begin)
    return [block for block in found if block.start() < (end.start() if end else len(PAGE))]


def insert(source: str, where: str, name: str, text: str) -> str:
    """The source with a text put before an assignment, at the end of the list it assigns, or after a line."""
    lines = source.splitlines(keepends=True)
    if where == "after":
        (row,) = (i for i, line in enumerate(lines) if name in line)
        return "".join([*lines[: row + 1], text, *lines[row + 1 :]])
    (node,) = (
        node
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        and name in [getattr(target, "id", "") for target in getattr(node, "targets", None) or [node.target]]
    )
    if where == "before":
        return "".join([*lines[: node.lineno - 1], text, "\n\n", *lines[node.lineno - 1 :]])
    row, column = node.value.end_lineno - 1, node.value.end_col_offset - 1
    last = lines[row]
    return "".join(
        [*lines[:row], last[:column], "\n" * bool(last[:column].strip()), text, last[column:], *lines[row + 1 :]]
    )


@pytest.fixture
def project(tmp_path) -> Path:
    """A copy of the project without what is built; the data are the shipped ones."""
    ignore = shutil.ignore_patterns("__pycache__", "images", "benchmarks")
    for folder in ("detden_lite", "tests", "book"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "data").symlink_to(ROOT / "data")
    return tmp_path


@pytest.mark.parametrize(
    "title", ["Add an attack", "A variant", "Another detector or denoiser", "Add a task", "Add a chapter"]
)
def test_the_walk_works_as_it_is_printed(title, project):
    blocks = walk(title)
    commands = [line[2:] for block in blocks if block["language"] == "console" for line in block["text"].splitlines()]
    files = [block for block in blocks if block["path"]]
    assert files and commands and len(files) == sum(block["language"] != "console" for block in blocks)
    for block in files:
        path = project / block["path"]
        if block["where"]:
            text = insert(path.read_text("utf-8"), block["where"], block["name"], block["text"])
        else:
            assert not path.exists(), f"{block['path']} is in the project already"
            text = block["text"]
        path.write_text(text, encoding="utf-8")
    environment = os.environ | dict(PYTHONPATH=str(project), OMP_NUM_THREADS="1")
    for command in commands:
        program, *arguments = re.findall(r'"[^"]*"|\S+', command)
        start = [sys.executable, *(["-m", "detden_lite"] if program == ".venv/bin/detden" else [])]
        done = subprocess.run(
            [*start, *(argument.strip('"') for argument in arguments)],
            cwd=project, env=environment, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"


def test_new_code_of_the_walks_keeps_the_style(project):
    """Whole modules, as ruff formats and checks them."""
    modules = [block for block in BLOCK.finditer(PAGE) if block["path"] and not block["where"]]
    for block in modules:
        if block["path"].endswith(".py"):
            (project / block["path"]).write_text(block["text"], encoding="utf-8")
    written = [block["path"] for block in modules if block["path"].endswith(".py")]
    for command in (["check"], ["format", "--check"]):
        done = subprocess.run(
            [sys.executable, "-m", "ruff", *command, *written], cwd=project, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout
