import json

import numpy as np
import pytest
from builders import BUDGET, HOPPER, make_victim, ship_victim

from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.threat import Threat
from detden_lite.attacks.timing import After
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import SCALES, get_task
from detden_lite.recipe.cli import main
from detden_lite.recipe.episode_seeds import SEEDS, seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import get_scale
from detden_lite.recipe.sweeps import SIZES, _chosen, over_planners, over_sizes
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest

EPISODES = seeds("tuning", 4)


def test_each_size_gives_the_returns_of_its_own_attack():
    victim = make_victim(seed=8)
    found = over_sizes(HOPPER, victim, Threat(BUDGET, 3), EPISODES, ("uniform", "opposite"), (0.0, 2.0), steps=20)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["seeds"] == [SEEDS["tuning"], 4] and list(found["attacks"]) == ["uniform", "opposite"]
    for name, attack in (("uniform", None), ("opposite", OppositeAttack(victim, Budget(0.15), 3))):
        nothing, double = found["attacks"][name]
        assert (nothing["epsilon"], double["epsilon"]) == (0.0, 0.15)
        assert nothing["returns"] == rollout(victim, HOPPER, EPISODES, steps=20).returns.tolist()
        if attack:
            assert double["returns"] == rollout(victim, HOPPER, EPISODES, attack=attack, steps=20).returns.tolist()
        assert double["returns"] != nothing["returns"]
        assert double["estimate"]["mean"] == pytest.approx(np.mean(double["returns"]))


def test_every_planner_attacks_robots_that_already_walk():
    victim, settings = make_victim(seed=8), dict(horizon=2, population=4, iterations=1, elites=2)
    found = over_planners(HOPPER, victim, BUDGET, EPISODES, [settings, settings | dict(horizon=4)], begin=5, steps=12)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    first, second = found["rows"]
    assert first | settings == first and second["horizon"] == 4 and found["begin"] == 5
    attack = EnchantingAttack(victim, BUDGET, CEMPlanner(HOPPER.env_id, **settings))
    episodes = rollout(victim, HOPPER, EPISODES, attack=attack, timing=After(5), steps=12)
    assert first["returns"] == episodes.returns.tolist()
    assert first["lived"] == (episodes.lengths - 5).clip(0).tolist() and max(first["lived"]) <= 7
    assert first["plans_per_second"] > 0
    assert found["clean_return"] == rollout(victim, HOPPER, EPISODES, steps=12).returns.mean()
    ended = np.array(first["lived"]) < 7
    assert first["seconds"] == pytest.approx(np.where(ended, first["lived"], 1000).mean() / first["plans_per_second"])


def test_an_episode_that_ends_is_not_charged_for_what_would_follow():
    victim, settings = make_victim(seed=8), dict(horizon=2, population=4, iterations=1, elites=2)
    (row,) = over_planners(HOPPER, victim, BUDGET, EPISODES, [settings], begin=0, steps=500)["rows"]
    assert max(row["lived"]) < 500
    assert row["seconds"] * row["plans_per_second"] == pytest.approx(np.mean(row["lived"]))


def test_planners_that_never_plan_cost_nothing():
    settings = dict(horizon=1, population=4, iterations=1, elites=2)
    found = over_planners(HOPPER, make_victim(seed=8), BUDGET, EPISODES, [settings], begin=5, steps=5)
    (row,) = json.loads(json.dumps(found, allow_nan=False))["rows"]
    assert row["lived"] == [0] * 4 and row["plans_per_second"] == row["seconds"] == 0


def test_a_planner_is_chosen_even_if_clean_episodes_lose_reward():
    task, settings = get_task("halfcheetah"), dict(horizon=1, population=4, iterations=1, elites=2)
    found = over_planners(task, make_victim(task), BUDGET, EPISODES, [settings], begin=1, steps=20)
    assert found["clean_return"] < 0 and found["chosen"] == settings


@pytest.mark.parametrize(
    ("means", "affordable", "chosen"),
    [
        ([50, 30, 10], 99, 2),
        ([50, 12, 10], 99, 1),  # two per cent of the clean return are no difference
        ([11.5, 30, 10], 99, 0),
        ([50, 30, 10], 5, 1),
        ([50, 49, 10], 5, 0),  # the lowest of those that can be afforded
        ([50, 30, 10], 0, 0),  # if none can, the cheapest
    ],
)
def test_the_chosen_planner_is_the_cheapest_of_the_best(means, affordable, chosen):
    rows = [
        dict(horizon=h, population=8, iterations=1, seconds=h, estimate=dict(mean=mean))
        for h, mean in zip((1, 3, 10), means, strict=True)
    ]
    assert _chosen(rows, tie=2, affordable=affordable) == chosen
    assert _chosen(rows[::-1], tie=2, affordable=affordable) == 2 - chosen


def test_the_sweeps_have_no_duplicates_and_contain_the_defaults():
    assert 1.0 in SIZES and len(set(SIZES)) == len(SIZES)
    for scale in SCALES:
        found = get_scale(scale, HOPPER)
        assert found.planner in found.planners and len({tuple(row.items()) for row in found.planners}) == len(
            found.planners
        )
        assert all(row.keys() == found.planner.keys() for row in found.planners)


def test_the_stages_store_their_sweeps_once(tmp_path):
    ship_victim(tmp_path)
    for stage, purpose in (("epsilon", "report"), ("planning", "tuning")):
        path = tmp_path / "hopper-td3" / f"{stage}.json"
        main([stage, "--root", str(tmp_path)])
        assert manifest.read_json(path, tmp_path)["seeds"] == [SEEDS[purpose], 4]
        made = path.stat().st_mtime_ns
        main([stage, "--root", str(tmp_path)])
        assert path.stat().st_mtime_ns == made


def test_the_attacker_plans_as_the_sweep_chose(tmp_path):
    ship_victim(tmp_path)
    run, chosen = Run.of(tmp_path, "hopper", "td3", "tiny"), dict(horizon=7, population=6, iterations=2, elites=3)
    manifest.write_json(run.folder / "timing.json", dict(c_vul=0.0, attack_rate=0.5), tmp_path)
    for sweep in (None, dict(rows=[]), dict(chosen=chosen)):  # an older sweep chose none
        if sweep is not None:
            manifest.write_json(run.folder / "planning.json", sweep, tmp_path)
        planner = run.threat().attack("enchanting", run.victim(), HOPPER).planner
        expected = sweep["chosen"] if sweep and "chosen" in sweep else run.scale.planner
        assert {name: getattr(planner, name) for name in expected} == expected
