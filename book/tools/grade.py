"""Grades what students handed in: ``python grade.py SUBMISSIONS FOLDER [--limit SECONDS]``.

SUBMISSIONS has a folder for each student, with their notebooks somewhere in it. Of a notebook only the cells of
exercises are taken, by their title; everything else is the course's own. They run in a kernel of their own, in a copy
of the library, with an empty home and a time limit. What counts is what the check says about their answers in this
process, in which no student's code runs (see answers.py). FOLDER gets grades.csv and grades.html.

It is no prison: code that is handed in can read what you can read, and use the network. Grade strangers in a container.
"""

import argparse
import csv
import html
import os
import re
import shutil
import symtable
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import answers
import nbformat
from exercises import title
from IPython.core.inputtransformer2 import TransformerManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError, DeadKernelError
from nbformat.v4 import new_code_cell, new_notebook
from student import make_notebooks

ROOT = Path(__file__).resolve().parents[2]
COURSE_LIMIT = 300  # seconds for a cell of the course's own: a machine may be slow
LARGEST_NOTEBOOK = 50_000_000  # bytes
MARKS = {
    "passed": "✓",
    "wrong": "✗",
    "not written": "○",
    "missing": "–",
    "error": "!",
    "time limit": "⏱",
    "killed": "†",
}


@dataclass(frozen=True)
class Exercise:
    """An exercise of the course, with the cells that come before it and what checks it."""

    number: str  # "2.1"
    title: str
    chapter: str
    before: tuple[str, ...]  # the course's code cells
    module: str
    check: str
    function: str


@dataclass(frozen=True)
class Grade:
    """What came of an exercise: one of MARKS, and a sentence about it."""

    mark: str
    said: str = ""


def read_course() -> list[Exercise]:
    """The exercises of all chapters, in their order."""
    found = []
    for name, text in make_notebooks().items():
        before: list[str] = []
        heading = ""
        for cell in nbformat.reads(text, as_version=4).cells:
            tags = cell.metadata.get("tags", [])
            if "exercise" in tags:
                heading = title(cell.source)
            elif "check" in tags:
                module, check = re.search(r"from (detden_lite\.checks\.\w+) import (check_\w+)", cell.source).groups()
                function = re.search(rf"{check}\((\w+)\)", cell.source)[1]
                number = re.search(r"\d+\.\d+", heading)[0]
                found.append(Exercise(number, heading, Path(name).stem, tuple(before), module, check, function))
            elif cell.cell_type == "code":
                before.append(cell.source)
    return found


def needed(before: Iterable[str], source: str) -> list[str]:
    """The cells that define what ``source`` uses, what those use, and so on, in their order.

    Example:
        >>> needed(["import math", "x = math.pi", "y = 1"], "def f():\\n    return 2 * x")
        ['import math', 'x = math.pi']
    """
    wanted, kept = _names(source)[1], []
    for cell in reversed(list(before)):
        defined, used = _names(cell)
        if defined & wanted:
            kept.append(cell)
            wanted |= used
    return kept[::-1]


def _names(source: str) -> tuple[set[str], set[str]]:
    """The names that a cell defines, and those that it takes from elsewhere."""
    plain = TransformerManager().transform_cell(source)
    tables = [symtable.symtable(plain, "cell", "exec")]
    defined = {s.get_name() for s in tables[0].get_symbols() if s.is_assigned() or s.is_imported()}
    used = set()
    while tables:
        table = tables.pop()
        tables += table.get_children()
        used |= {s.get_name() for s in table.get_symbols() if s.is_referenced() and s.is_global()}
        if table.get_type() == "module":
            used |= {s.get_name() for s in table.get_symbols() if s.is_referenced()}
    return defined, used


def find_answers(folder: Path) -> dict[str, str]:
    """The cells of exercises in a student's notebooks, by their number; of several with one title the last."""
    cells = {}
    for path in sorted(folder.rglob("*.ipynb")):
        if ".ipynb_checkpoints" in path.parts or path.is_symlink() or path.stat().st_size > LARGEST_NOTEBOOK:
            continue
        try:
            notebook = nbformat.read(path, as_version=4)
            for cell in notebook.cells:
                if cell.cell_type == "code" and (found := re.match(r"\s*# Exercise (\d+\.\d+)\b", cell.source)):
                    cells[found[1]] = cell.source
        except Exception as error:  # nbformat raises many kinds
            print(f"{path} cannot be read: {type(error).__name__}", file=sys.stderr)
    return cells


class Quiet(NotebookClient):
    """Keeps nothing of what cells print, which may be without end."""

    def output(self, *arguments: object) -> None:
        """Called for each output."""


class Desk:
    """Where one student's code runs: a folder with a copy of the library and data, and kernels in it.

    Args:
        limit: seconds that the student's cell may take, and its check.
    """

    def __init__(self, folder: Path, limit: int):
        self.folder, self.limit = folder, limit
        self.course, self.home = folder / "course", folder / "home"
        heavy = shutil.ignore_patterns("__pycache__", "*.mp4", "*.rrd", "*.png")
        for part in ("detden_lite", "data"):
            shutil.copytree(ROOT / part, self.course / part, ignore=heavy)
        shutil.copy(Path(answers.__file__), self.course)
        self.home.mkdir()

    def environment(self) -> dict[str, str]:
        """Nothing of the teacher's environment but the way to Python."""
        kept = {name: os.environ[name] for name in ("PATH", "SYSTEMROOT", "LANG") if name in os.environ}
        home = str(self.home)
        return kept | dict(
            HOME=home, USERPROFILE=home, IPYTHONDIR=home, MPLCONFIGDIR=home, TMPDIR=home, PYTHONPATH=str(self.course),
            DETDEN_DATA=str(self.course / "data"), OMP_NUM_THREADS="1", PYTHONDONTWRITEBYTECODE="1",
        )  # fmt: skip

    def grade(self, exercises: list[Exercise], cells: dict[str, str]) -> dict[str, Grade]:
        """The grades of one chapter's exercises. A kernel that hangs or dies is replaced for those that follow."""
        grades = {e.number: Grade("missing", "there is no such cell") for e in exercises if e.number not in cells}
        rest = [exercise for exercise in exercises if exercise.number in cells]
        while rest:
            for number, grade in self._grade_in_one_kernel(rest, cells):
                grades[number] = grade
            rest = [exercise for exercise in rest if exercise.number not in grades]
        return grades

    def _grade_in_one_kernel(self, exercises: list[Exercise], cells: dict[str, str]) -> Iterator[tuple[str, Grade]]:
        notebook = new_notebook()
        client = Quiet(notebook, timeout=COURSE_LIMIT, kernel_name="python3", shutdown_kernel="immediate")
        done: set[str] = set()

        def run(source: str, seconds: int) -> None:
            client.timeout = seconds
            notebook.cells.append(new_code_cell(source))
            client.execute_cell(notebook.cells[-1], len(notebook.cells) - 1)

        with client.setup_kernel(cwd=str(self.home), env=self.environment()):
            run("import answers", COURSE_LIMIT)  # and torch, which would take from the student's time
            for exercise in exercises:
                source, path = cells[exercise.number], self.folder / f"{exercise.number}.json"
                given = f"{str(path)!r}, {exercise.module!r}, {exercise.check!r}, globals().get({exercise.function!r})"
                try:
                    for cell in needed(exercise.before, source):
                        if cell not in done:
                            run(cell, COURSE_LIMIT)
                            done.add(cell)
                    run(source, self.limit)
                    run(f"import answers\nanswers.record({given})", self.limit)
                    yield exercise.number, Grade(*answers.replay(path, exercise.module, exercise.check))
                except SyntaxError as error:
                    yield exercise.number, Grade("error", f"SyntaxError: {error}")
                except CellExecutionError as error:
                    yield exercise.number, Grade("error", f"{error.ename}: {error.evalue}"[:500])
                except CellTimeoutError:
                    yield exercise.number, Grade("time limit", f"it took more than {self.limit} seconds")
                    return
                except DeadKernelError:
                    yield exercise.number, Grade("killed", "it ended the kernel")
                    return


def grade(submissions: Path, limit: int) -> dict[str, dict[str, Grade]]:
    """The grades of all students, by their folder's name and the exercise's number."""
    students = sorted(path for path in submissions.iterdir() if path.is_dir() and not path.name.startswith("."))
    if not students:
        sys.exit(f"{submissions} has no folders: give each student one, with their notebooks in it")
    course = read_course()
    chapters = {exercise.chapter: [e for e in course if e.chapter == exercise.chapter] for exercise in course}
    grades: dict[str, dict[str, Grade]] = {}
    for student in students:
        cells, grades[student.name] = find_answers(student), {}
        with tempfile.TemporaryDirectory(prefix="grade-", ignore_cleanup_errors=True) as folder:
            desk = Desk(Path(folder), limit)
            for exercises in chapters.values():
                grades[student.name] |= desk.grade(exercises, cells)
        passed = sum(grade.mark == "passed" for grade in grades[student.name].values())
        print(f"{student.name}: {passed} of {len(course)} passed", flush=True)
    return grades


def write_csv(grades: dict[str, dict[str, Grade]], path: Path) -> None:
    """A row for each student: how many passed, and the mark of each exercise."""
    numbers = list(next(iter(grades.values())))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["student", "passed", *numbers])
        for student, row in grades.items():
            safe = f"'{student}" if student[0] in "=+-@" else student  # a spreadsheet would calculate it
            writer.writerow([safe, _passed(row), *(row[number].mark for number in numbers)])


def _passed(row: dict[str, Grade]) -> int:
    return sum(grade.mark == "passed" for grade in row.values())


def write_html(grades: dict[str, dict[str, Grade]], path: Path) -> None:
    """The same table to look at; what was said of an exercise is below, and shows when a mark is pointed at."""
    numbers = list(next(iter(grades.values())))
    escape = html.escape
    head = "".join(f'<th scope="col">{number}</th>' for number in numbers)
    rows, notes = [], []
    for student, row in grades.items():
        marks = "".join(
            f'<td class="{row[n].mark.replace(" ", "-")}" title="{escape(row[n].said)}">{MARKS[row[n].mark]}'
            f'<span class="read">{row[n].mark}</span></td>'
            for n in numbers
        )
        rows.append(f'<tr><th scope="row">{escape(student)}</th><td>{_passed(row)} of {len(numbers)}</td>{marks}</tr>')
        said = [f"<dt>{n}: {row[n].mark}</dt><dd>{escape(row[n].said)}</dd>" for n in numbers if row[n].said]
        notes.append(f"<details><summary>{escape(student)}</summary><dl>{''.join(said)}</dl></details>")
    legend = ", ".join(f"{sign} {mark}" for mark, sign in MARKS.items())
    path.write_text(_PAGE.format(head=head, rows="\n".join(rows), notes="\n".join(notes), legend=legend), "utf-8")


_PAGE = """<!DOCTYPE html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Grades</title>
<style>
body {{ font: 1rem/1.4 system-ui, sans-serif; margin: 1.5rem; color: #1b1f23; background: #fff }}
.wide {{ overflow-x: auto }} table {{ border-collapse: collapse }} caption {{ text-align: left; padding: .5rem 0 }}
th, td {{ border: 1px solid #d5dbe1; padding: .25rem .5rem; text-align: center }} th[scope=row] {{ text-align: left }}
.passed {{ background: #d7ecfa }} .wrong, .error, .time-limit, .killed {{ background: #fbe3d3 }}
.read {{ position: absolute; clip-path: inset(50%) }} dt {{ font-weight: 600 }} dd {{ margin: 0 0 .5rem 1rem }}
</style>
<main><h1>Grades</h1>
<div class="wide" tabindex="0" role="region" aria-label="Exercises passed"><table>
<caption>Exercises passed. {legend}</caption>
<thead><tr><th scope="col">student</th><th scope="col">passed</th>{head}</tr></thead><tbody>
{rows}
</tbody></table></div>
<h2>What the checks said</h2>
{notes}
</main></html>
"""


def main() -> None:
    """Called by ``make grade``."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("submissions", type=Path, help="has a folder with notebooks for each student")
    parser.add_argument("folder", type=Path, help="where grades.csv and grades.html are written")
    parser.add_argument("--limit", type=int, default=60, help="seconds for a student's cell, and for its check")
    arguments = parser.parse_args()
    if not arguments.submissions.is_dir():
        sys.exit(f"SUBMISSIONS={arguments.submissions} is no folder: name one that has a folder for each student")
    grades = grade(arguments.submissions, arguments.limit)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    write_csv(grades, arguments.folder / "grades.csv")
    write_html(grades, arguments.folder / "grades.html")
    print(f"written: {arguments.folder / 'grades.csv'} and grades.html")


if __name__ == "__main__":
    main()
