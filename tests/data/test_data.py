"""The shipped files: whole, small, no pickles, and every number in them can be computed again.

A test over many files checks them all, and reports all failures together.
"""

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import fisher_exact

from detden_lite.attacks.threat import Threat
from detden_lite.core.budget import Budget
from detden_lite.core.estimates import estimate
from detden_lite.core.files import ArtifactError
from detden_lite.core.tasks import ONLINE, SWIMMER, TASKS, get_task
from detden_lite.defense.baselines import Identity
from detden_lite.defense.detector import Detector
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import MAIN, VARIANTS
from detden_lite.recipe import ablations
from detden_lite.recipe.bound_along_training import both_sides, play
from detden_lite.recipe.defend import defend
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.evaluation import run_cell
from detden_lite.recipe.run import Run
from detden_lite.results import cells, paper, records
from detden_lite.results.cells import Cell
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models

DATA = Path(__file__).resolve().parents[2] / "data"
if not (DATA / "manifest.json").exists():
    pytest.skip("data/ is not made yet", allow_module_level=True)

MANIFEST = json.loads((DATA / "manifest.json").read_text())
RECORDS = sorted(path.stem for path in (DATA / "results").glob("*.json"))
VICTIMS = sorted(path.parent.name for path in DATA.glob("*/victim.safetensors"))
DEFENSES = [
    (folder, variant)
    for folder in VICTIMS
    for variant in VARIANTS
    if (DATA / folder / f"denoiser-{variant}.safetensors").exists()
]
PAPERS = {"-".join(row) for row in paper.ROWS}
TABLES = sorted({folder for folder, _ in DEFENSES} & PAPERS)
SUITE = PAPERS | {f"{task}-{algo}" for task in TASKS for algo in ONLINE}  # judged by the whole suite of attacks
ATTACKED = sorted({name.split(".")[0] for name in RECORDS} & SUITE)
MODELS = sorted(path.relative_to(DATA).as_posix() for path in DATA.glob("*/de*.safetensors"))


def check_each(items: Iterable, check: Callable[..., None]) -> None:
    """Check all items, and fail once with the problems of all."""
    problems = []
    for item in items:
        try:
            check(*item) if isinstance(item, tuple) else check(item)
        except (AssertionError, ArtifactError) as error:
            problems.append(f"{item}: {error}")
    assert not problems, "\n".join([f"{len(problems)} failed", *problems])


@cache
def record(name: str) -> records.Record:
    return records.load_record(name, DATA)


@cache
def threshold(folder: str, variant: str) -> float:
    return ablations.build_defense(Run.of(DATA, *folder.split("-"), "lite"), variant).detector.threshold


def assert_as_often(lengths, recorded, steps: int) -> None:
    """As many episodes end before ``steps`` as in the record, up to chance.

    Processors round differently, and a walking robot magnifies that: an episode of the same seed is another episode on
    another machine. So this is a two-sample test, at a level of 1e-8: one in a million for all of its uses together.
    """
    ended = [int((np.asarray(sample) < steps).sum()) for sample in (lengths, recorded)]
    table = [[ended[0], len(lengths) - ended[0]], [ended[1], len(recorded) - ended[1]]]
    assert fisher_exact(table).pvalue > 1e-8, f"ended before step {steps}: {ended}, of {len(lengths)}, {len(recorded)}"


def median_alarm_share(task: str, victim, defense) -> float:
    """The share of alarms in the first 100 clean steps of the middle one of 16 episodes: one may fall, not half."""
    episodes = rollout(victim, get_task(task), seeds("report", 16), defense=defense, steps=100)
    return float(np.median((episodes.alarm & episodes.mask).sum(0) / episodes.lengths))


def test_the_manifest_lists_every_file_and_no_other():
    files = {path.relative_to(DATA).as_posix() for path in DATA.rglob("*") if path.is_file()}
    recipe = {name for name in files if name.endswith((".md", ".yaml", ".lock", "Snakefile", "manifest.json"))}
    assert files - recipe == set(MANIFEST)


def test_every_file_has_the_sum_in_the_manifest():
    def check(name):
        assert hashlib.sha256((DATA / name).read_bytes()).hexdigest() == MANIFEST[name]

    check_each(MANIFEST, check)


def test_nothing_is_a_pickle():
    pickles = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05", b"PK\x03\x04", b"\x93NUMPY")

    def check(name):
        assert Path(name).suffix in {".safetensors", ".json", ".rrd", ".mp4", ".png"}
        assert not (DATA / name).read_bytes().startswith(pickles)

    check_each(MANIFEST, check)


def test_shipped_files_are_small():
    assert sum((DATA / name).stat().st_size for name in MANIFEST) < 60e6


@pytest.mark.parametrize("folder", VICTIMS)
def test_every_victim_walks_as_its_card_says(folder):
    """The card's numbers are those of its returns, and episodes end early as often as in its record."""
    task, algo = folder.split("-")
    victim, card = models.load_victim(task, algo, DATA), manifest.read_json(DATA / folder / "victim.json", DATA)
    assert card["estimate"] == asdict(estimate(card["returns"]))
    episodes = rollout(victim, get_task(task), seeds("report", 16), steps=125)
    assert_as_often(episodes.lengths, record(f"{folder}.none.always.none").lengths, 125)
    obs = torch.from_numpy(episodes.obs[0])
    assert victim.value(obs).isfinite().all()
    assert folder not in SUITE or victim.q(obs, victim(obs)).isfinite().all()


def test_every_model_loads_and_answers():
    def check(name):
        folder, stem = name.removesuffix(".safetensors").split("/")
        model, _ = models.load_model(*folder.split("-"), stem, DATA)
        assert model.obs_dim == get_task(folder.split("-")[0]).obs_dim
        assert model(torch.zeros(2, 3, model.obs_dim)).output.isfinite().all()

    check_each(MODELS, check)


@pytest.mark.parametrize(("folder", "data"), sorted({(folder, VARIANTS[name].data) for folder, name in DEFENSES}))
def test_every_detector_is_silent_for_most_of_a_clean_episode(folder, data):
    task, algo = folder.split("-")
    model, sidecar = models.load_model(task, algo, f"detector-{data}", DATA)
    watched = DetectAndDenoise(Detector(model, sidecar["threshold"]), Identity())
    assert median_alarm_share(task, models.load_victim(task, algo, DATA), watched) < 0.5


@pytest.mark.parametrize(("folder", "variant"), DEFENSES)
def test_every_defence_but_the_printed_is_silent_on_clean_episodes(folder, variant):
    """After its first false alarm the printed denoiser leads the robot astray, and the alarm goes on: chapter 4."""
    task, algo = folder.split("-")
    defense = models.load_defense(task, algo, variant, DATA)
    share = median_alarm_share(task, models.load_victim(task, algo, DATA), defense)
    assert (share < 0.5) == (variant != "printed")


def test_every_summary_is_that_of_the_records_own_returns():
    def check(name):
        found = record(name)
        n = found.seeds[1]
        assert n >= 50 and len(found.returns) == len(found.lengths) == n
        assert found.seeds[0] == seeds("report", 1)[0]
        assert asdict(found.estimate) == pytest.approx(asdict(estimate(found.returns)))
        assert max(found.lengths) <= get_task(found.task).horizon
        assert name == found.cell.record_name(*name.split(".")[0].split("-"))

    check_each(RECORDS, check)


def test_every_record_is_of_the_models_that_are_shipped():
    def check(name):
        folder, found = name.split(".")[0], record(name)
        timing = manifest.read_json(DATA / folder / "timing.json", DATA) if folder in SUITE else {}
        if found.cell.defense != "none":
            assert found.settings["c_anomaly"] == threshold(folder, found.cell.defense)
        if found.cell.timing == "vulnerable":
            assert found.settings["c_vul"] == timing["c_vul"]
        if found.cell.timing == "random":
            assert found.settings["rate"] == timing["attack_rate"]
        if found.cell.timing == "third":
            assert found.settings["c_vul"] == timing["third"]["c_vul"]
        if found.cell.timing == "random-third":
            assert found.settings["rate"] == timing["third"]["attack_rate"]
        assert found.settings["epsilon"] == get_task(found.task).epsilon

    check_each(RECORDS, check)


NEW = ("corner", "offset", "director")  # attacks that came after the first tables


def due(folder: str, defenses: list[str]) -> list[cells.Cell]:
    """The cells of the tables; those that are made in two rounds, if one with the same defence has been made."""
    made = [cells.Cell(*name.split(".")[1:]) for name in RECORDS if name.startswith(f"{folder}.")]
    timed = {(cell.timing, cell.defense) for cell in made}
    held = {cell.defense for cell in made if cell.attack in NEW}
    return [
        cell
        for cell in cells.table_cells(defenses)
        if ("third" not in cell.timing or (cell.timing, cell.defense) in timed)
        and (cell.attack not in NEW or cell.defense in held)
    ]


def test_the_table_of_a_defended_victim_is_complete():
    def check(folder):
        variants = [variant for name, variant in DEFENSES if name == folder]
        missing = {cell.record_name(*folder.split("-")) for cell in due(folder, variants)} - set(RECORDS)
        assert not missing

    check_each(TABLES, check)


def test_the_training_curve_ends_at_the_shipped_denoiser():
    run, known = Run.of(DATA, "hopper", "td3", "lite"), manifest.read_json(DATA / "hopper-td3" / "curve.json")
    defense = run.defense(known["variant"])
    found = both_sides(run, defense.denoiser.model, defense.detector, play(run, run.victim(), known["seeds"][1]))
    assert known["epochs"][-1]["mae"] == pytest.approx(found["mae"], rel=0.2)
    assert known["epochs"][-1]["error"] == pytest.approx(found["error"], rel=0.2)


def test_no_attack_on_a_victim_is_half_recorded():
    """All timings of an attack or none; and the clean episodes are those of the victim's card.

    HalfCheetah magnifies rounding until an episode on another machine is another episode: its mean must agree.
    """

    def check(folder):
        recorded = {name.split(".")[1] for name in RECORDS if name.startswith(f"{folder}.")}
        wanted = [cell for cell in due(folder, ["none"]) if cell.attack in recorded]
        assert {cell.record_name(*folder.split("-")) for cell in wanted} <= set(RECORDS)
        card = manifest.read_json(DATA / folder / "victim.json", DATA)["estimate"]
        clean = record(f"{folder}.none.always.none").estimate
        assert abs(clean.mean - card["mean"]) <= max(card["high"] - card["low"], 1e-6 * card["mean"])

    check_each(ATTACKED, check)


def test_defend_finds_swimmers_defence_and_repeats_its_records():
    """Swimmer never falls, and does not magnify rounding: the returns of two report episodes."""
    before = {path: path.stat().st_mtime_ns for path in DATA.rglob("*")}
    victim = models.load_victim("swimmer", "ppo", DATA)
    defended = defend(victim, "Swimmer-v5", Budget(SWIMMER.epsilon), "lite", DATA)
    assert {path: path.stat().st_mtime_ns for path in DATA.rglob("*")} == before
    threat = Threat(Budget(SWIMMER.epsilon), steps=20)
    for attack, name in (("none", MAIN), ("uniform", "none"), ("opposite", "none"), ("opposite", MAIN)):
        defense = defended.defense if name == MAIN else None
        _, episodes = run_cell(Cell(attack, defense=name), SWIMMER, victim, threat, defense, seeds("report", 2))
        told = record(f"swimmer-ppo.{attack}.always.{name}")
        assert episodes.returns == pytest.approx(told.returns[:2], abs=0.2 * told.estimate.mean)


@pytest.mark.parametrize("name", ["none", MAIN])
def test_swimmers_sweep_over_sizes_agrees_with_its_records(name):
    sweep = manifest.read_json(DATA / "swimmer-ppo" / "sizes.json", DATA)[name]
    assert sweep["seeds"] == [seeds("report", 1)[0], 100]
    for attack, rows in sweep["attacks"].items():
        assert all(row["estimate"] == pytest.approx(asdict(estimate(row["returns"]))) for row in rows)
        for epsilon, told in ((0.0, "none"), (SWIMMER.epsilon, attack)):
            (found,) = [row["returns"] for row in rows if row["epsilon"] == epsilon]
            assert found == pytest.approx(list(record(f"swimmer-ppo.{told}.always.{name}").returns))


@pytest.mark.parametrize("folder", TABLES)
def test_shipped_models_fall_as_often_as_their_records(folder):
    """As many of 16 report episodes end within 200 steps as of the record's, in each cell of the opposite attack."""
    run = Run.of(DATA, *folder.split("-"), "lite")
    threat, victim = run.threat(), run.victim()

    def check(cell):
        defense = None if cell.defense == "none" else run.defense(cell.defense)
        _, episodes = run_cell(cell, run.task, victim, threat, defense, seeds("report", 16), steps=200)
        assert_as_often(episodes.lengths, record(cell.record_name(run.task.name, run.algo)).lengths, 200)

    check_each([cell for cell in due(folder, ["none", MAIN]) if cell.attack == "opposite"], check)
