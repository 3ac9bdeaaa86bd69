"""The page for teachers: its exercises are the course's, and their mistakes those of the checks."""

import re

import pytest
import teaching
from conftest import ROOT


def test_each_exercise_has_a_purpose_and_known_mistakes():
    assert list(teaching.PURPOSE) == [exercise.number for exercise in teaching.exercises()]
    for exercise in teaching.exercises():
        assert len(teaching.misconceptions(exercise)) >= 3, exercise.number


def test_the_page_lists_a_mistake_that_is_made_up_of_nothing_but_the_checks_text():
    shown = teaching.purposes()
    assert "- A point that is inside the ball stays where it is.\n" in shown
    assert "{" not in shown.replace(":::{dropdown}", "") and shown.count(":::{dropdown}") == len(teaching.PURPOSE)


@pytest.mark.parametrize("name", teaching.PATHS)
def test_paths_name_exercises_that_exist_and_add_up(name):
    sessions = teaching.PATHS[name]
    named = re.findall(r"\d+\.\d+", " ".join(session.exercises for session in sessions))
    assert set(named) <= set(teaching.PURPOSE)
    total = sum(session.minutes for session in sessions)
    assert f"**{total}**" in teaching.paths()
    if name == "Four hours":
        assert total == 240


def test_there_are_six_open_problems_each_with_what_a_good_answer_shows():
    text = (ROOT / "book" / "teaching.md").read_text("utf-8").split("## Six open problems")[1]
    assert len(re.findall(r"^\d\. \*\*", text, re.M)) == text.count("*A good answer*") == 6
