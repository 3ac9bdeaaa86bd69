import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_victim

from detden_lite.attacks.catalogue import ADAPTIVE
from detden_lite.attacks.threat import Threat
from detden_lite.core.metrics import score_auroc
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.oracles import OracleDetector
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.recipe.episode_seeds import SEEDS, seeds
from detden_lite.recipe.evaluation import run_cell
from detden_lite.results.cells import Cell
from detden_lite.victims.victim import Victim

THREAT = Threat(BUDGET, steps=3, restarts=2, c_vul=0.1, rate=0.5)


@pytest.fixture(scope="module")
def victim():
    return make_victim(seed=8)


def run(victim, cell, defense=None, n=4, clean=None):
    return run_cell(cell, HOPPER, victim, THREAT, defense, seeds("report", n), steps=26, clean=clean)


def test_a_record_has_settings_seeds_and_returns(victim):
    cell = Cell("opposite", "random", "mine")
    record, episodes = run(victim, cell, make_defense())
    assert json.loads(json.dumps(record.to_json(), allow_nan=False)) == record
    assert record["cell"] == dict(attack="opposite", timing="random", defense="mine") and record["task"] == "hopper"
    expected = dict(epsilon=0.075, norm="inf", steps=3, restarts=2, rate=0.5, c_anomaly=1.5)
    assert record["settings"] == expected
    assert record["seeds"] == [SEEDS["report"], 4] and episodes.seeds.tolist() == list(seeds("report", 4))
    assert record["returns"] == episodes.returns.tolist()
    assert 0 < record["attack_rate"] < 1
    assert cell.record_name("hopper", "td3") == "hopper-td3.opposite.random.mine"


def test_the_settings_name_each_ablation_of_a_defence(victim):
    own = make_defense()
    for defense, expected in (
        (own, {}),
        (DetectAndDenoise(own.detector, own.denoiser, always=True), dict(always=True)),
        (DetectAndDenoise(own.detector, own.denoiser, budget=BUDGET), dict(projected=True)),
        (DetectAndDenoise(own.detector), dict(detector_only=True)),
        (DetectAndDenoise(own.detector, Denoiser(own.denoiser.model, sample=False)), dict(latent_mean=True)),
        (DetectAndDenoise(OracleDetector(), own.denoiser), dict(truth=True, c_anomaly=0.5)),
    ):
        settings = run(victim, Cell("uniform", defense="mine"), defense)[0]["settings"]
        assert settings == dict(epsilon=0.075, norm="inf", c_anomaly=1.5) | expected


def test_a_record_compares_scores_with_clean_episodes(victim):
    _, clean = run(victim, Cell(defense="mine"), make_defense())
    cell = Cell("uniform", defense="mine")
    record, episodes = run(victim, cell, make_defense(), clean=clean)
    assert record["auroc_clean"] == score_auroc(episodes, clean)
    assert "auroc_clean" not in run(victim, cell, make_defense())[0]


def test_a_record_has_the_scores_of_each_episode(victim):
    record, episodes = run(victim, Cell("uniform", "random", "mine"), make_defense())
    attacked = (episodes.attacked & episodes.mask).sum(0)
    assert record.schema == 2 and record["episodes"]["attacked"] == attacked.tolist()
    scores, steps = record.episodes, sum(record.lengths)
    assert sum(scores.attacked) / steps == pytest.approx(record.attack_rate)
    misses, false = record.detector.false_negative_rate, record.detector.false_positive_rate
    assert sum(scores.alarms_attacked) / sum(scores.attacked) == pytest.approx(1 - misses)
    assert sum(scores.alarms_clean) / (steps - sum(scores.attacked)) == pytest.approx(false)
    assert np.average(scores.denoiser_mae, weights=scores.attacked) == pytest.approx(record.denoiser_mae)


@pytest.mark.parametrize(("attack", "steps"), [("none", None), ("uniform", None), ("fgsm", 1), ("opposite", 3)])
def test_the_settings_are_those_of_the_attack_that_was_made(victim, attack, steps):
    assert run(victim, Cell(attack))[0]["settings"].get("steps") == steps


def test_the_same_cell_gives_the_same_record(victim):
    cell = Cell("opposite", "vulnerable", "mine")
    first, second = (run(victim, cell, make_defense())[0].to_json() for _ in range(2))
    assert first.pop("seconds") > 0 and second.pop("seconds") > 0
    assert first == second
    assert first["settings"]["c_vul"] == 0.1


def test_a_record_states_the_setting_of_its_timing(victim):
    threat = replace(THREAT, c_third=0.2, rate_third=0.25)
    expected = {"vulnerable": dict(c_vul=0.1), "random": dict(rate=0.5), "third": dict(c_vul=0.2), "always": {}}
    for timing, setting in (expected | {"random-third": dict(rate=0.25)}).items():
        record, _ = run_cell(Cell("uniform", timing), HOPPER, victim, threat, None, seeds("report", 2), steps=3)
        assert record["settings"] == dict(epsilon=0.075, norm="inf") | setting


@pytest.mark.parametrize("attack", ["none", "uniform", "gaussian", "fgsm", "opposite"])
def test_every_attack_of_the_tables_can_be_run(victim, attack):
    record, episodes = run(victim, Cell(attack))
    assert record["attack_rate"] == (attack != "none")
    assert (episodes.perturbed != episodes.obs).any() == (attack != "none")


def test_names_that_do_not_exist_are_refused(victim):
    with pytest.raises(ValueError, match="attack must be none or one of uniform"):
        run(victim, Cell("magic"))
    with pytest.raises(ValueError, match="timing must be one of always"):
        run(victim, Cell("uniform", "never"))


def test_cell_and_defence_must_agree(victim):
    with pytest.raises(ValueError, match="defense.*give None"):
        run(victim, Cell(), make_defense())
    with pytest.raises(ValueError, match="defense.*give one"):
        run(victim, Cell(defense="mine"))


def test_no_episode_serves_two_purposes():
    """Not even with as many as the paper's 20,000 trajectories."""
    for one, other in combinations(SEEDS, 2):
        assert not set(seeds(one, 20_000)) & set(seeds(other, 20_000))


@pytest.mark.parametrize("name", ["optimal", "linear"])
def test_a_learned_adversary_must_be_given_to_attack(victim, name):
    with pytest.raises(ValueError, match=f"adversaries: the {name} one is missing"):
        run(victim, Cell(name))
    torch.manual_seed(0)
    adversary = Victim([11, 11], gaussian=True)
    cost = dict(members=6, environment_steps=5_120_000)
    threat = replace(THREAT, adversaries={name: adversary}, learned={name: cost, "other": dict(members=1)})
    record, episodes = run_cell(Cell(name), HOPPER, victim, threat, None, seeds("report", 4), steps=10)
    assert record["settings"] == dict(epsilon=0.075, norm="inf", learned=cost) and record["attack_rate"] == 1
    obs = torch.from_numpy(episodes.obs[0])
    assert torch.allclose(torch.from_numpy(episodes.perturbed[0]), obs + 0.075 * adversary(obs), atol=1e-6)


@pytest.mark.parametrize("name", ADAPTIVE)
def test_every_attack_that_knows_the_defence_can_be_run(victim, name):
    torch.manual_seed(0)
    planner = dict(horizon=2, population=4, iterations=1, elites=2)
    small = dict(steps=2, restarts=1, samples=2, fresh=2)
    adversaries = {f"adaptive-{kind}": Victim([11, 11], gaussian=True) for kind in ("optimal", "offset")}
    adversaries |= {"adaptive-director": Victim([11, 3], gaussian=True)}
    threat = replace(THREAT, planner=planner, adaptive=small, adversaries=adversaries)
    cell = Cell(name, defense="mine")
    record, episodes = run_cell(cell, HOPPER, victim, threat, make_defense(), seeds("report", 2), steps=3)
    assert json.loads(json.dumps(record.to_json(), allow_nan=False)) == record
    assert BUDGET.contains(torch.from_numpy(episodes.obs), torch.from_numpy(episodes.perturbed)).all()
    assert (episodes.perturbed != episodes.obs).any(-1).all()
    kind, unaware = name.split("-")
    own = dict(text=dict(form="text", weight=1.0), appendix=dict(form="appendix", weight=1.0), adaptive=small)
    own |= dict(coupled=small | dict(pace=0.2), free=small | dict(population=32, elites=6))
    learned = unaware in ("optimal", "offset", "director")
    assert record["settings"].get("adaptive") == (None if learned else own[kind])
    climbed = dict(optimal=None, offset=None, director=5)  # its own steps
    assert record["settings"].get("steps") == climbed.get(unaware, THREAT.steps)


def test_without_a_defence_there_is_nothing_to_adapt_to(victim):
    with pytest.raises(ValueError, match="defense to adapt to"):
        run(victim, Cell("adaptive-opposite"))
    with pytest.raises(ValueError, match="adversaries: the adaptive-optimal one is missing"):
        run(victim, Cell("adaptive-optimal", defense="mine"), make_defense())
