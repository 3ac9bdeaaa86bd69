"""A failed check is one message: in Jupyter instead of a traceback, under pytest an AssertionError like any other."""

import subprocess
import sys

import pytest
import torch
from IPython.core.interactiveshell import InteractiveShell

from detden_lite.checks.attacks import check_fgsm, check_project_l2
from detden_lite.checks.failure import CheckFailed, NotWritten, explained
from detden_lite.checks.stronger import check_held_corner


@pytest.fixture
def shell(capsys):
    """Runs cells as Jupyter does, and gives what is printed."""
    shell = InteractiveShell()
    shell.colors = "nocolor"

    def run(*cells):
        results = [shell.run_cell(cell) for cell in cells]
        return results[-1], capsys.readouterr().out

    yield run
    InteractiveShell.clear_instance()


SETUP = "import torch\nfrom detden_lite.checks.attacks import check_project_l2"


def test_jupyter_shows_one_message_and_neither_the_checks_code_nor_the_solution(shell):
    wrong = "def project(obs, perturbed, epsilon):\n    return perturbed"
    result, shown = shell(SETUP, wrong, "check_project_l2(project)")
    assert isinstance(result.error_in_exec, CheckFailed)
    assert shown.startswith("Not right yet.\nproject(obs, perturbed, 1.0) at [0, 0] is 4; it should be 1.6.")
    assert "move to the border" in " ".join(shown.split())
    assert "Traceback" not in shown and "mistakes" not in shown and len(shown.splitlines()) <= 4


def test_what_the_students_function_raises_is_told_with_its_line_and_its_arguments(shell):
    wrong = "def project(obs, perturbed, epsilon):\n    delta = perturbed - obs\n    return obs @ delta"
    _, shown = shell(SETUP, wrong, "check_project_l2(project)")
    shown = " ".join(shown.split())
    assert "project raises a RuntimeError at `return obs @ delta`" in shown
    assert "The shapes do not fit together" in shown and "obs = a tensor [3, 2]" in shown and "epsilon = 1" in shown


def test_a_stub_is_called_not_written_yet(shell):
    stub = 'def project(obs, perturbed, epsilon):\n    raise NotImplementedError("Exercise 2.1: the l2 projection")'
    result, shown = shell(SETUP, stub, "check_project_l2(project)")
    assert isinstance(result.error_in_exec, NotWritten)
    assert shown.startswith("Not written yet.\nExercise 2.1: the l2 projection.")


def test_a_failed_check_fails_a_program():
    program = "from detden_lite.checks.attacks import check_project_l2 as check; check(lambda o, p, e: p)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1 and "CheckFailed: project" in done.stderr


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (3, "the function project itself, not 3"),
        (lambda obs, perturbed: obs, r"project raises a TypeError.*3 were given.*Keep the first line"),
        (lambda o, p, e: unknown, "'unknown' is not defined. A name is used"),  # noqa: F821
        (lambda o, p, e: o if (p - o).norm(dim=-1) < e else p, "want a single True or False"),
        (lambda o, p, e: o.astype(float), "no attribute 'astype'. Look at what the docstring says"),
        (lambda o, p, e: p.sub_(o), "changes its argument p itself"),
        (lambda o, p, e: torch.from_numpy(o), "TypeError.*Two kinds of things"),
        (lambda o, p, e: o[:, 7], "An index goes beyond"),
        (lambda o, p, e: 1 / 0, "project raises a ZeroDivisionError: division by zero. It was given"),
        (lambda o, p, e: "near", "gives a str, not an array"),
        (lambda o, p, e: (o, p, p), r"shape \(3, 3, 2\).*An axis is left over"),
        (lambda o, p, e: o[None], r"drop keepdim"),
        (lambda o, p, e: o[:, 0], r"An axis is missing"),
        (lambda o, p, e: o.T, r"axes are swapped"),
        (lambda o, p, e: {"o": o}, "gives a dict, not an array"),
    ],
)
def test_every_way_to_fail_is_explained(wrong, says):
    with pytest.raises(CheckFailed, match=says):
        check_project_l2(wrong)


def test_the_students_own_assert_is_told_as_theirs():
    def project(obs, perturbed, epsilon):
        assert epsilon > 5, "a large ball"

    with pytest.raises(CheckFailed, match="project raises an AssertionError at `assert epsilon > 5.*a large ball"):
        check_project_l2(project)


def test_a_function_that_is_returned_is_explained_too():
    with pytest.raises(CheckFailed, match="the function that held_corner gives raises an? .*Error"):
        check_held_corner(lambda epsilon, obs_dim, rng: lambda obs: obs + rng.missing)


def test_a_result_that_the_check_cannot_use_is_told_to_be_so():
    @explained
    def check_length(length):
        assert len(length([1])) == 1

    with pytest.raises(CheckFailed, match=r"length gives 3, which .* cannot use \(.*len.*docstring of length"):
        check_length(lambda values: 3)


def test_gradients_that_were_cut_are_explained():
    def fgsm(gain, obs, start, epsilon):
        return torch.autograd.grad(((start @ gain.T) ** 2).sum(), start)[0]

    with pytest.raises(CheckFailed, match="fgsm raises a RuntimeError at `return torch.autograd.*requires_grad_"):
        check_fgsm(fgsm)
