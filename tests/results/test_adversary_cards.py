"""The data cards of adversaries: what they were chosen from, and what it cost."""

import pytest
from builders import make_victim

from detden_lite.core.files import ArtifactError
from detden_lite.core.tasks import get_task
from detden_lite.recipe import offset_search
from detden_lite.recipe.offset_search import OffsetRecipe
from detden_lite.results.adversary_cards import Member, load_adversary_card, load_adversary_cards
from detden_lite.store import models

HOPPER = get_task("hopper")
TRAINED = dict(steps=1_024_000, learning_rate=1e-3, timing="always")
SEARCHED = dict(generations=3, population=8, episodes=2)


def ship(root, curves, kind="optimal", **about):
    sidecar = dict(recipe=curves[0]["recipe"], selection_mean=5.0, clean_mean=100.0, learning_curves=curves)
    models.save_adversary("hopper", "td3", kind, make_victim(HOPPER), sidecar | about, root)


def member(**recipe):
    return Member(recipe, steps=(1, 2), mean=(2.0, 1.0), selection=None, chosen=False, obs_dim=11)


def test_a_card_lists_every_member_and_sums_their_budgets(tmp_path):
    curves = [
        dict(recipe=TRAINED | dict(seed=0), steps=[1, 2], mean=[9.0, 4.0], selection=5.0),
        dict(recipe=TRAINED | dict(seed=1, history=3), steps=[1, 2], mean=[9.0, 6.0], selection=None),
        dict(recipe=SEARCHED, steps=[1], mean=[7.0], selection=7.5),
    ]
    ship(tmp_path, curves)
    card = load_adversary_card("hopper", "td3", "optimal", tmp_path)
    assert [(m.chosen, m.mean, m.selection, m.cost) for m in card.members] == [
        (True, (9.0, 4.0), 5.0, "1,024,000 steps"),
        (False, (9.0, 6.0), None, "1,024,000 steps"),
        (False, (7.0,), 7.5, "48 episodes"),
    ]
    assert card.members[0].steps == (1, 2)
    assert load_adversary_cards("hopper", "td3", tmp_path) == {"optimal": card}
    assert card.budget == dict(members=3, environment_steps=2_048_000, episodes=48) and card.with_search
    assert (card.selection_mean, card.clean_mean) == (5.0, 100.0)


def test_titles_tell_members_apart():
    recipes = [
        TRAINED,
        TRAINED | dict(learning_rate=3e-3),
        TRAINED | dict(timing="vulnerable"),
        TRAINED | dict(history=3),
        TRAINED | dict(warm=True),
        TRAINED | dict(director=True),
        SEARCHED,
        dict(candidates=8, finalists=2, episodes=1, rounds=1),
    ]
    assert len({member(**recipe).title for recipe in recipes}) == len(recipes)


@pytest.mark.parametrize("recipe", [OffsetRecipe(8, 1, 2, 1), OffsetRecipe(16, 3, 5, 2)])
def test_the_episodes_of_an_offset_search_are_those_that_it_plays(recipe, tmp_path):
    played = 0

    def measure(offsets, numbers):
        nonlocal played
        played += len(offsets) * len(numbers)
        return offsets.sum(-1)

    offset_search.search(recipe, HOPPER, 0, tmp_path / "offset", measure)
    assert member(**vars(recipe)).episodes == played


def test_trainings_alone_are_no_search(tmp_path):
    ship(tmp_path, [dict(recipe=TRAINED, steps=[1], mean=[9.0])])
    card = load_adversary_card("hopper", "td3", "optimal", tmp_path)
    assert not card.with_search and card.budget == dict(members=1, environment_steps=1_024_000)


def test_a_card_without_its_curves_is_refused(tmp_path):
    ship(tmp_path, [dict(recipe=TRAINED, steps=[1], mean=[])])
    with pytest.raises(ArtifactError, match="adversary.json is no adversary's card"):
        load_adversary_card("hopper", "td3", "optimal", tmp_path)
