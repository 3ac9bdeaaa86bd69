import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_victim, normal, ship_victim
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.attacks.opposite import OppositeAttack, opposite_objective
from detden_lite.attacks.qfunction import QFunctionAttack, q_objective
from detden_lite.attacks.threat import Threat
from detden_lite.recipe.cli import main
from detden_lite.recipe.convergence import choose, measure_objectives, returns_left, sample_observations
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest

SETTINGS = [(2, 1), (2, 3), (10, 3)]


def row(steps, restarts, opposite=1.0, qfunction=1.0):
    return dict(steps=steps, restarts=restarts, opposite=opposite, qfunction=qfunction)


def test_the_cheapest_setting_that_is_close_in_both_objectives_is_chosen():
    rows = [row(20, 1), row(20, 5, opposite=0.97), row(50, 5, qfunction=0.985), row(100, 10)]
    assert choose(rows, restarts=5) == dict(steps=50, restarts=5)
    assert choose(rows, restarts=1) == dict(steps=20, restarts=1)
    assert choose([row(20, 5, 0.9), row(50, 5, 1.0, 0.9), row(100, 10, 0.97)], 5) == dict(steps=100, restarts=10)


@given(st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9), st.floats(0, 1), st.floats(0, 1)), min_size=1))
def test_nothing_as_good_is_cheaper_than_what_is_chosen(found):
    rows = [row(*one) for one in found] + [row(10, 10)]
    chosen = choose(rows, restarts=5)
    assert chosen["restarts"] >= 5
    cheaper = [r for r in rows if r["steps"] * r["restarts"] < chosen["steps"] * chosen["restarts"]]
    assert all(r["restarts"] < 5 or r["opposite"] < 0.98 or r["qfunction"] < 0.98 for r in cheaper)


def test_objectives_are_told_in_parts_of_the_largest():
    victim, obs = make_victim(seed=8), normal(30, 11)
    rows = measure_objectives(HOPPER, victim, Threat(BUDGET), SETTINGS, obs)
    for name, kind, simple in (
        ("opposite", OppositeAttack, opposite_objective),
        ("qfunction", QFunctionAttack, q_objective),
    ):
        rises = []
        for steps, restarts in SETTINGS:
            attack, objective = kind(victim, BUDGET, steps, restarts), simple(victim, obs)
            attack.reset()
            rises.append(float((objective(attack(obs)) - objective(obs)).mean()))
        assert [row[name] for row in rows] == pytest.approx([rise / max(rises) for rise in rises], rel=1e-3)
        assert rises[0] < rises[1] <= rises[2]
    assert [(row["steps"], row["restarts"]) for row in rows] == SETTINGS


def test_returns_are_those_of_tuning_episodes_with_the_defence_and_without():
    victim, chosen = make_victim(seed=8), seeds("tuning", 3)
    for defense in (None, make_defense()):
        found = returns_left(HOPPER, victim, Threat(BUDGET), SETTINGS[:2], defense, episodes=3, steps=15)
        played = [
            rollout(victim, HOPPER, chosen, attack=attack, defense=defense, steps=15).returns.mean()
            for attack in (None, *(OppositeAttack(victim, BUDGET, *setting) for setting in SETTINGS[:2]))
        ]
        assert [found["clean"], *found["left"]] == pytest.approx(played)
        assert found["seeds"] == [chosen[0], 3]


def test_observations_are_sampled_from_clean_tuning_episodes():
    victim = make_victim(seed=8)
    some, everything = (sample_observations(HOPPER, victim, n, episodes=2, steps=9) for n in (5, 1_000))
    clean = rollout(victim, HOPPER, seeds("tuning", 2), steps=9)
    assert torch.equal(everything[:5], some) and len(some) == 5
    assert torch.equal(everything.sort(0).values, torch.from_numpy(clean.obs[clean.mask]).sort(0).values)


def test_attackers_use_what_the_stage_chose(tmp_path):
    run = Run.of(tmp_path, "hopper", "td3", "tiny")
    ship_victim(tmp_path)
    assert (run.untimed_threat.steps, run.untimed_threat.restarts) == (3, 2)
    path = run.folder / "convergence.json"
    main(["converge", "--scale", "tiny", "--root", str(tmp_path)])
    found = manifest.read_json(path, tmp_path)
    assert found["settings"] == [[3, 1], [3, 2], [3, 4], [7, 2], [15, 4]] and len(found["returns"]["left"]) == 5
    assert found["chosen"] == choose(found["rows"], restarts=2)
    for chosen in (found["chosen"], dict(steps=6, restarts=4)):
        manifest.write_json(path, found | dict(chosen=chosen), tmp_path)
        assert dict(steps=run.untimed_threat.steps, restarts=run.untimed_threat.restarts) == chosen
