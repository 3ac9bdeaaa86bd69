"""The student notebooks: made from the chapters, run to their end, and no check passes on a stub."""

import json

import nbformat
import pytest
from conftest import ROOT
from exercises import stub, title
from nbclient import NotebookClient
from student import find_chapters, make_notebooks, write_notebooks

NAMES = [path.stem for path in find_chapters()]


def tagged(cell, tag: str) -> bool:
    return tag in cell.metadata.get("tags", [])


def test_the_committed_notebooks_are_those_of_the_chapters(tmp_path):
    write_notebooks(tmp_path)
    committed = {path.name: path.read_bytes() for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert committed == {path.name: path.read_bytes() for path in tmp_path.iterdir()}, "run: make notebooks"


def test_notebooks_of_chapters_that_are_no_more_are_removed(tmp_path):
    (tmp_path / "99-gone.ipynb").write_text("{}")
    write_notebooks(tmp_path)
    assert sorted(path.stem for path in tmp_path.iterdir()) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_notebooks_are_valid_and_without_outputs_and_solutions(name):
    notebook = json.loads(make_notebooks()[f"{name}.ipynb"])
    nbformat.validate(notebook)
    for cell in notebook["cells"]:
        assert not cell.get("outputs") and cell.get("execution_count") is None
        assert "SOLUTION" not in "".join(cell["source"])


@pytest.mark.parametrize("name", NAMES)
def test_student_notebook_runs_to_its_end_and_every_check_fails(name, tmp_path):
    """No cell but a check needs what a student has not yet written, and no check passes without it."""
    notebook = nbformat.reads(make_notebooks()[f"{name}.ipynb"], as_version=4)
    NotebookClient(notebook, timeout=90, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    todo = None
    for cell in notebook.cells:
        if tagged(cell, "exercise"):
            todo = title(cell.source)
        errors = [output for output in cell.get("outputs", []) if output.output_type == "error"]
        if tagged(cell, "check"):
            assert [(error.ename, error.evalue.split(". Replace")[0]) for error in errors] == [("NotWritten", todo)]
            assert errors[0].traceback[0] == "Not written yet." and len(errors[0].traceback) <= 5, "one message"
        else:
            assert errors == []


def test_stub_keeps_the_code_around_the_solution_and_its_indentation():
    before = '# Exercise 2.1: say "hello"\ndef hello(name):\n    if name:\n'
    solution = "        ### BEGIN SOLUTION\n        text = name\n        print(text)\n        ### END SOLUTION\n"
    error = '        raise NotImplementedError("Exercise 2.1: say \\"hello\\"")\n'
    assert stub(f"{before}{solution}    return text") == f"{before}{error}    return text"


@pytest.mark.parametrize(
    "source",
    [
        "def f():\n    ### BEGIN SOLUTION\n    return 1\n    ### END SOLUTION",
        "# Exercise 1.1: none\ndef f():\n    return 1",
        "# Exercise 1.1: not in a function\n### BEGIN SOLUTION\nx = 1\n### END SOLUTION",
        "# Exercise 1.1: never ends\ndef f():\n    ### BEGIN SOLUTION\n    return 1",
        "# Exercise 1.1: two\ndef f():\n" + 2 * "    ### BEGIN SOLUTION\n    return 1\n    ### END SOLUTION\n",
    ],
)
def test_an_exercise_that_breaks_the_rules_is_refused(source):
    with pytest.raises(ValueError, match="[Ee]xercise"):
        stub(source)
