"""``judge``: the bare policy and the defended one in the same episodes, under the whole suite."""

import dataclasses

import numpy as np
import pytest
import torch
from builders import make_defense, make_victim
from safetensors.torch import load_file

from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.attacks.threat import Threat
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task
from detden_lite.defense.defended import Defended
from detden_lite.recipe import judge as module
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.judge import SUITE, judge
from detden_lite.recipe.linear_search import LinearRecipe
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim

TASK = Task("invertedpendulum", "InvertedPendulum-v5", 0.3, 4, 1)
TINY = LinearRecipe(generations=2, population=4, elites=2)
SETTINGS = dict(episodes=3, steps=6, search=TINY)


@pytest.fixture(scope="module")
def defended():
    return Defended(make_victim(TASK), TASK, make_defense(4))


@pytest.fixture(scope="module")
def judged(defended):
    return judge(defended, **SETTINGS)


def test_the_suite_is_played_in_the_episodes_of_the_report(defended, judged):
    assert [row.title for row in judged.rows] == [title for title, *_ in SUITE]
    victim, budget = defended.victim, Budget(0.3)
    for row, (_, name, size) in zip(judged.rows, SUITE, strict=True):
        if name == "linear":
            continue
        attack = Threat(dataclasses.replace(budget, epsilon=size * 0.3)).attack(name, victim, TASK)
        guarded = rollout(victim, TASK, seeds("report", 3), attack=attack, defense=defended.defense, steps=6)
        assert row.defended.mean == pytest.approx(guarded.returns.mean())
        assert row.alarms == pytest.approx(guarded.alarm[guarded.mask].mean())
        assert row.bare.n == row.defended.n == 3


def test_the_same_call_gives_the_same_judgement(defended, judged):
    assert judge(defended, **SETTINGS) == judged


def test_the_search_keeps_the_map_that_leaves_the_least_and_goes_on_from_its_folder(defended, tmp_path):
    recipe = LinearRecipe(generations=3, population=4, elites=2, spread=3.0)
    found = module._search(defended, Budget(0.3), recipe, tmp_path, 200)
    paths = sorted((tmp_path / "snapshots").glob("*.safetensors"))
    left = []
    for path in paths:
        adversary = Victim.from_state(recipe.config(TASK), load_file(path))
        attack = OptimalAttack(adversary, Budget(0.3))
        left.append(rollout(defended.victim, TASK, seeds("selection", 8), attack=attack, steps=200).returns.mean())
    best = Victim.from_state(recipe.config(TASK), load_file(paths[int(np.argmin(left))]))
    assert torch.equal(found.actor[0].weight, best.actor[0].weight)
    again = module._search(defended, Budget(0.3), recipe, tmp_path, 200)
    assert torch.equal(found.actor[0].weight, again.actor[0].weight)


def test_it_prints_a_table_and_draws_a_figure(judged, tmp_path):
    lines = str(judged).splitlines()
    assert lines[0] == "InvertedPendulum-v5, deterministic policy, epsilon 0.3 (norm inf), 3 episodes"
    assert len(lines) == 2 + len(SUITE) and len({len(line) for line in lines[1:]}) == 1
    assert judged._repr_html_().count("<tr>") == 1 + len(SUITE)
    figure = judged.figure()
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == [row.title for row in judged.rows]
    figure.savefig(tmp_path / "judged.png")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (dict(defended=make_victim(TASK)), "defended: give a detden_lite.Defended"),
        (dict(episodes=0), "episodes must be"),
        (dict(steps=0.5), "steps must be"),
    ],
)
def test_what_cannot_be_judged_is_refused(defended, changes, says):
    with pytest.raises(ValueError, match=says):
        judge(**dict(defended=defended, **SETTINGS) | changes)
