"""`make grade`: what is handed in runs by itself, and only right answers pass, whatever it does to the check."""

import csv
import json
import os
import sys

import grade
import nbformat
import pytest
from conftest import ROOT
from grade import needed, read_course
from student import make_notebooks

STUDENTS, SOLUTIONS = make_notebooks(), make_notebooks(solved=True)
PROJECT = "# Exercise 2.1: the l2 projection\ndef project(obs, perturbed, epsilon):\n"
SOLVED = """\
    delta = perturbed - obs
    length = delta.norm(dim=-1, keepdim=True)
    return obs + delta * (epsilon / length.clamp_min(1e-12)).clamp(max=1)
"""
FORGES = f"""{PROJECT}    return perturbed
import detden_lite.checks.attacks as c, detden_lite.checks.compare as d, numpy, torch, answers, builtins
c.check_project_l2 = d.compare = c.compare = answers.record = lambda *arguments, **named: print("Right.")
check_project_l2 = print
numpy.isclose = lambda a, b, **named: numpy.ones(numpy.shape(a), bool)
numpy.allclose = lambda *arguments, **named: True
builtins.AssertionError = KeyError
print("Right. Points inside the ball stay, points outside move straight to its border.")
"""
PLANTS = f"""{PROJECT}    import glob, json, pathlib
    for frame in [__import__("sys")._getframe(i) for i in range(3)]:
        if "path" in frame.f_locals: planted = frame.f_locals["path"]
    return perturbed
import answers, json, pathlib
def record(path, *rest):
    pathlib.Path(path).write_text(json.dumps({{"answers": [[]], "said": None}}))
answers.record = record
"""
WRITES = f"""{PROJECT}{SOLVED}
import detden_lite, os, pathlib
for folder in (pathlib.Path(detden_lite.__file__).parent, pathlib.Path.cwd(), pathlib.Path.home()):
    (folder / "written-by-a-student.txt").write_text("here I was")
pathlib.Path(detden_lite.__file__).write_text("raise SystemExit")
"""
OPPOSITE, FGSM, VULNERABLE = (
    f"# Exercise 2.{number}: as it was\ndef {name}(*arguments):\n"
    for number, name in ((2, "opposite"), (3, "fgsm"), (4, "vulnerable"))
)
HOSTILE = {  # the cells that are not as in the solution, and what comes of all four
    "forges": ({"2.1": FORGES}, ["wrong"]),
    "plants": ({"2.1": PLANTS}, ["wrong"]),
    "writes": ({"2.1": WRITES}, ["passed"]),
    "breaks": (
        {
            "2.1": f"{PROJECT}    import sys; sys.exit(0)\n",
            "2.2": f"{OPPOSITE}    import os, signal; os.kill(os.getpid(), signal.SIGKILL)\n",
            "2.3": f"{FGSM}    while True:\n        print('Right. ' * 1000)\n",
        },
        ["wrong", "killed", "time limit", "passed"],
    ),
    "=1+1 <b>bold": (
        {
            "2.1": f"{PROJECT}    raise ValueError('<script>alert(1)</script>')\n",
            "2.2": f"{OPPOSITE}    return (\n",
            "2.3": f"{FGSM}    return __import__('threading').Lock()\n",
            "2.4": f"{VULNERABLE}    import os; os._exit(0)\n",
        },
        ["wrong", "error", "wrong", "killed"],
    ),
}


def hand_in(folder, name, cells, solved=False):
    """The notebook of chapter 2 with these cells in the place of its own."""
    notebook = nbformat.reads((SOLUTIONS if solved else STUDENTS)["02-attacks.ipynb"], as_version=4)
    for cell in notebook.cells:
        for number, source in cells.items():
            if cell.source.startswith(f"# Exercise {number}"):
                cell.source = source
    (folder / name / "work").mkdir(parents=True)
    nbformat.write(notebook, folder / name / "work" / "my chapter 2.ipynb")


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """What `make grade` writes for a class in which somebody does each of these things."""
    folder = tmp_path_factory.mktemp("handed-in")
    hand_in(folder, "right", {}, solved=True)
    hand_in(folder, "stub", {})
    hand_in(folder, "wrong", {"2.1": f"{PROJECT}    return obs + (perturbed - obs).clamp(-epsilon, epsilon)"})
    for name, (cells, _) in HOSTILE.items():
        hand_in(folder, name, cells, solved=True)
    (folder / "unreadable").mkdir()
    (folder / "unreadable" / "02-attacks.ipynb").write_text('{"cells": 3}')
    before = {path: path.stat().st_mtime_ns for path in (ROOT / "detden_lite").rglob("*.py")}
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.setattr(sys, "argv", ["grade", str(folder), str(folder / "grades"), "--limit", "20"])
    monkeypatch.setattr(grade, "make_notebooks", lambda: {"02-attacks.ipynb": STUDENTS["02-attacks.ipynb"]})
    grade.main()
    monkeypatch.undo()
    assert {path: path.stat().st_mtime_ns for path in (ROOT / "detden_lite").rglob("*.py")} == before
    assert not list(ROOT.glob("detden_lite/**/written-by-a-student.txt"))
    with (folder / "grades" / "grades.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["student"].lstrip("'"): row for row in csv.DictReader(file)}
    return rows, (folder / "grades" / "grades.html").read_text(encoding="utf-8")


pytestmark = pytest.mark.skipif(os.name == "nt", reason="the hostile cells are written for POSIX")


@pytest.mark.slow
def test_right_wrong_and_stub(graded):
    rows, page = graded
    assert [rows["right"][n] for n in ("2.1", "2.2", "2.3", "2.4")] == ["passed"] * 4 and rows["right"]["passed"] == "4"
    assert [rows["stub"][n] for n in ("2.1", "2.2", "2.3", "2.4")] == ["not written"] * 4
    assert rows["wrong"]["2.1"] == "wrong" and rows["wrong"]["2.2"] == "not written"
    assert "projection on the l-infinity ball" in page
    assert rows["unreadable"]["2.1"] == "missing"


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_cells_do_not_pass_and_a_kernel_that_they_end_is_replaced(graded, name):
    expected = HOSTILE[name][1]
    assert [graded[0][name][number] for number in ("2.1", "2.2", "2.3", "2.4")][: len(expected)] == expected


@pytest.mark.slow
def test_the_tables_hold_no_code_of_students(graded):
    rows, page = graded
    assert "<script>" not in page and "<b>bold" not in page and "=1+1 <b>bold" in rows
    assert "&lt;script&gt;alert(1)" in page


@pytest.mark.slow
@pytest.mark.parametrize("chapter", STUDENTS)
def test_all_solutions_of_the_course_pass(chapter, tmp_path):
    solved = nbformat.reads(SOLUTIONS[chapter], as_version=4).cells
    exercises = [exercise for exercise in read_course() if f"{exercise.chapter}.ipynb" == chapter]
    cells = [cell.source for cell in solved if "exercise" in cell.metadata.get("tags", [])]
    by_number = {exercise.number: cell for exercise, cell in zip(exercises, cells, strict=True)}
    grades = grade.Desk(tmp_path, limit=120).grade(exercises, by_number)
    assert {number: tuple(vars(found).values()) for number, found in grades.items()} == {
        exercise.number: ("passed", "") for exercise in exercises
    }


def test_only_what_a_cell_needs_runs_before_it():
    cells = ["import numpy as np", "a = np.ones(3)", "b = a.sum()", "%matplotlib inline", "for i in range(3):\n  c = i"]
    assert needed(cells, "def f(x):\n    a = x\n    return a") == []
    assert needed(cells, "def f(x):\n    return lambda: a") == cells[:2]
    assert needed(cells, "print(b, c)") == [*cells[:3], cells[4]]


def test_of_a_notebook_only_the_cells_of_exercises_are_taken(tmp_path):
    hand_in(tmp_path, "somebody", {"2.1": PROJECT + SOLVED})
    found = grade.find_answers(tmp_path / "somebody")
    assert list(found) == ["2.1", "2.2", "2.3", "2.4"] and found["2.1"] == PROJECT + SOLVED


def test_an_empty_or_missing_folder_is_named(tmp_path, monkeypatch):
    for folder, says in ((tmp_path, "has no folders"), (tmp_path / "none", "is no folder")):
        monkeypatch.setattr(sys, "argv", ["grade", str(folder), str(tmp_path)])
        with pytest.raises(SystemExit, match=says):
            grade.main()


@pytest.mark.parametrize(
    "planted",
    [
        "", "[]", "{}", '{"answers": [], "said": null}', '{"answers": [[{"plain": {}}]], "said": null}',
        '{"answers": [[{"tensor": "####", "slopes": null}]], "said": null}', "[" * 100_000,
        json.dumps({"answers": [[{"other": "x"}]], "said": None}),
    ],
)  # fmt: skip
def test_planted_answers_are_refused(tmp_path, planted):
    from answers import replay

    (tmp_path / "a.json").write_text(planted)
    assert replay(tmp_path / "a.json", "detden_lite.checks.attacks", "check_project_l2")[0] == "wrong"
    (tmp_path / "b.json").symlink_to("/dev/zero")
    assert replay(tmp_path / "b.json", "detden_lite.checks.attacks", "check_project_l2")[0] == "wrong"
