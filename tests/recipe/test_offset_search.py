from dataclasses import replace
from itertools import product
from math import inf, nan

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import load_file

from detden_lite.core.tasks import Task
from detden_lite.recipe.offset_search import OffsetRecipe, refine, search
from detden_lite.victims.victim import Victim

TOY = Task("toy", "none", 0.1, obs_dim=9, action_dim=1)
RECIPE = OffsetRecipe(candidates=16, episodes=2, finalists=4, rounds=3)
TARGET = torch.tensor([1.0, -1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 1.0])


def measure(offsets: torch.Tensor, numbers: range) -> torch.Tensor:
    """The return falls with every coordinate that has the target's sign."""
    return -offsets @ TARGET


def stored(folder) -> list[Victim]:
    return [Victim.from_state(RECIPE.config(TOY), load_file(path)) for path in sorted((folder / "snapshots").iterdir())]


@given(st.lists(st.sampled_from([-1.0, 1.0]), min_size=9, max_size=9))
def test_refinement_never_ends_higher_than_it_began(start):
    offset, left = torch.tensor(start), lambda offsets: -offsets @ TARGET
    refined = refine(offset, left, left)
    assert left(refined) <= left(offset) and (refined.abs() == 1).all()


def test_the_planted_corner_is_found(tmp_path):
    search(RECIPE, TOY, 0, tmp_path, measure)
    found = [adversary(torch.zeros(1, 9))[0] for adversary in stored(tmp_path)]
    assert len(found) == 4 and (found[0] != TARGET).any() and torch.equal(found[-1], TARGET)


@pytest.mark.parametrize("norm", [2, 1])
def test_the_offset_stays_on_the_border_of_another_ball(tmp_path, norm):
    search(RECIPE, TOY, 0, tmp_path, measure, norm)
    (found,) = stored(tmp_path)[-1](torch.zeros(1, 9))
    assert torch.linalg.vector_norm(found, ord=norm) == pytest.approx(1, rel=1e-5)


def test_no_two_rounds_share_an_episode(tmp_path):
    asked = []

    def recorded(offsets, numbers):
        asked.append((len(offsets), numbers))
        return measure(offsets, numbers)

    search(RECIPE, TOY, 0, tmp_path, recorded)
    played = [number for _, numbers in asked for number in numbers]
    assert len(set(played)) == len(played)
    assert [n for n, _ in asked[:3]] == [16, 4, 9]


def test_a_resumed_search_equals_an_uninterrupted_one(tmp_path):
    calls = []

    def failing(offsets, numbers):
        calls.append(numbers)
        if len(calls) == 5:
            raise KeyboardInterrupt
        return measure(offsets, numbers)

    search(RECIPE, TOY, 0, tmp_path / "whole", measure)
    with pytest.raises(KeyboardInterrupt):
        search(RECIPE, TOY, 0, tmp_path / "killed", failing)
    assert len(stored(tmp_path / "killed")) == 2
    search(RECIPE, TOY, 0, tmp_path / "killed", failing)
    pairs = zip(stored(tmp_path / "whole"), stored(tmp_path / "killed"), strict=True)
    assert all(torch.equal(a(torch.zeros(1, 9)), b(torch.zeros(1, 9))) for a, b in pairs)


def test_a_folder_with_another_search_is_refused(tmp_path):
    search(RECIPE, TOY, 0, tmp_path, measure)
    with pytest.raises(ValueError, match="recipe.json describes another run"):
        search(replace(RECIPE, rounds=4), TOY, 0, tmp_path, measure)


@pytest.mark.parametrize(
    ("argument", "value"),
    [*product(("candidates", "episodes", "finalists", "rounds"), (0, -1, 1.5, nan, inf)), ("finalists", 257)],
)
def test_senseless_sizes_are_named(argument, value):
    with pytest.raises(ValueError, match=argument):
        OffsetRecipe(**{argument: value})
