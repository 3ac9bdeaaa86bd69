"""Every check of an exercise handles a function that is not written yet, and one that returns nothing."""

import pkgutil
import re
from importlib import import_module
from pathlib import Path

import pytest

from detden_lite import checks

CHECKS = [
    check
    for module in pkgutil.iter_modules(checks.__path__, f"{checks.__name__}.")
    for name, check in vars(import_module(module.name)).items()
    if name.startswith("check_")
]
OTHERWISE = {  # these say what is to be given, and not that nothing was
    "check_counterexample", "check_exact_and_pinsker", "check_false_step", "check_denoiser_loss",
    "check_replace_on_alarm", "check_kl", "check_choose", "check_interval",
}  # fmt: skip


def test_every_chapter_with_exercises_has_checks():
    chapters = Path(__file__).parents[2].joinpath("book", "chapters").glob("*.md")
    used = [set(re.findall(r"detden_lite\.checks\.\w+", chapter.read_text("utf-8"))) for chapter in chapters]
    assert all(used)
    assert set().union(*used) <= {check.__module__ for check in CHECKS}


@pytest.mark.parametrize("check", CHECKS)
def test_a_stub_passes_through_with_its_own_message(check):
    def stub(*arguments, **named):
        raise NotImplementedError("Exercise 1.1: to be done")

    with pytest.raises(NotImplementedError, match="Exercise 1.1"):
        check(stub)


@pytest.mark.parametrize("check", CHECKS)
def test_a_missing_return_is_explained(check):
    with pytest.raises(AssertionError, match="give|yours|number" if check.__name__ in OTHERWISE else "return"):
        check(lambda *arguments, **named: None)
