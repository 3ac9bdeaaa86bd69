"""The Snakefile: what it plans at each scale, and a real run with two jobs at once that is killed and resumed."""

import csv
import os
import re
import signal
import subprocess
import sys
import time
from base64 import urlsafe_b64encode
from pathlib import Path

import durations
import pytest
import yaml
from conftest import ROOT
from rulegraph import rule_graph

from detden_lite.core.tasks import ALGORITHMS, ONLINE, SCALES, TASKS
from detden_lite.defense import variants
from detden_lite.defense.variants import MAIN, VARIANTS
from detden_lite.recipe.scales import get_scale
from detden_lite.recipe.stage_list import STAGES
from detden_lite.results import cells
from detden_lite.store import manifest, models

DATA = ROOT / "data"
ROWS = [f"{task}-{algo}" for algo in ALGORITHMS for task in TASKS]
JOBS = dict(  # without the policies that are trained online
    victim=13, select=11, qfunction=5, augmentation=11, detector=11, converge=10,
    converge_defended=10, timing=10, planning=10, offset=10, offset_defended=4,
    choose=10, linear=10, attacks=10, evaluation=10, table=1, look=10, portrait=10,
    epsilon=1, gallery=1, defend=1, baselines=1, threshold=1, ablation=1, all=1,
    choose_defended=4, adaptive=4, ceilings=6, barrier=1, curve=1, slip=1,
)  # fmt: skip


# What runs once for each policy, also for those that are trained online.
BARE = "select qfunction converge timing planning offset choose linear attacks portrait".split()


def recipe(folder: Path, *arguments, scale: str = "tiny") -> list[str]:
    snakemake = [
        sys.executable,
        "-m",
        "snakemake",
        *arguments,
        "--snakefile",
        DATA / "Snakefile",
        "--directory",
        folder,
    ]
    return [*map(str, snakemake), "--configfile", str(DATA / "config" / f"{scale}.yaml")]


def run(folder: Path, *arguments, scale: str = "tiny") -> str:
    """The output of Snakemake, which must succeed."""
    done = subprocess.run(recipe(folder, *arguments, scale=scale), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def refuse(folder: Path, *arguments) -> str:
    """The output of Snakemake, which must fail."""
    done = subprocess.run(recipe(folder, *arguments), capture_output=True, text=True)
    assert done.returncode != 0
    return done.stdout + done.stderr


def jobs(scale: str) -> dict[str, int]:
    """The number of jobs of each rule at a scale, for all ten rows and those that are not the paper's."""
    config = yaml.safe_load((DATA / "config" / f"{scale}.yaml").read_text())
    variants = [config["variants"].get(row, config["variants"]["default"]) for row in ROWS]
    members, adapted = config["adversaries"], len(config["adapted"])
    online = config["online"]
    trained = dict(adversary=(len(ROWS) + len(online)) * members, adversary_defended=adapted * members)
    more = {rule: JOBS[rule] + len(online) for rule in BARE}
    seeds = dict(victim=JOBS["victim"] + sum(len(config["seeds"].get(row, [0])) for row in online))
    collected = sum(len({VARIANTS[name].data for name in names}) for names in variants)
    return JOBS | dict(denoiser=sum(map(len, variants)), trajectories=collected) | trained | more | seeds


def planned(printed: str) -> dict[str, int]:
    """The number of jobs of each rule in a dry run."""
    table = printed.split("Job stats:")[1].split("total")[0]
    return {rule: int(n) for rule, n in re.findall(r"^(\w+) +(\d+)$", table, re.M)}


@pytest.mark.parametrize("scale", SCALES)
def test_every_scale_plans_the_whole_graph_for_all_ten_rows(tmp_path, scale):
    config = yaml.safe_load((DATA / "config" / f"{scale}.yaml").read_text())
    assert config["scale"] == scale and config["rows"] == ROWS and config["own"] == ["swimmer-ppo"]
    assert {*config["adapted"], *config["explained"]} <= set(ROWS)
    printed = run(tmp_path, "--dry-run", "--printshellcmds", scale=scale)
    rows = ROWS + config["online"]
    assert {row.split("-")[1] for row in config["online"]} <= set(ONLINE)
    members = [len(get_scale(scale, TASKS[row.split("-")[0]], row.split("-")[1]).adversaries) for row in rows]
    assert planned(printed) == jobs(scale) and sum(members) == jobs(scale)["adversary"]
    assert set(re.findall(r"--member (\d+)", printed)) == {str(member) for member in range(max(members))}
    for stage in ("adversary", "choose", "adapt"):  # with the defence only for the adapted rows
        told = re.findall(rf"detden_lite {stage} --task (\w+) --algo (\w+) .*", printed)
        inside = re.findall(rf"detden_lite {stage} --task (\w+) --algo (\w+) .*--defended", printed)
        assert {"-".join(row) for row in (told if stage == "adapt" else inside)} == set(config["adapted"])
    assert set(re.findall(r"--scale (\w+)", printed)) == {scale}
    named = re.findall(r"detden_lite victim --task (\w+) --algo (\w+) .*--seed (\d)", printed)
    expected = [(*row.split("-"), "0") for row in (*rows, "swimmer-ppo")] + [("hopper", "td3", s) for s in "12"]
    twice = [row for row in config["online"] if row in config["seeds"]]
    assert sorted(named) == sorted(expected + [(*row.split("-"), "1") for row in twice])
    assert scale == "tiny" or {"hopper-sappo", "halfcheetah-sappo", "hopper-atla", "halfcheetah-atla"} <= set(twice)


def test_each_rule_runs_its_stage_for_the_listed_victims(tmp_path):
    config = yaml.safe_load((DATA / "config" / "tiny.yaml").read_text())
    printed = run(tmp_path, "--dry-run", "--printshellcmds")
    for stage in STAGES.values():
        for rule, setting in stage.rules.items():
            blocks = re.findall(rf"^(?:local)?rule {rule}:\n((?:    .*\n|\n)*?.*detden_lite .*)", printed, re.M)
            assert all(f"detden_lite {stage.name} " in block for block in blocks), rule
            ran = {"-".join(row) for block in blocks for row in re.findall(r"--task (\w+) --algo (\w+)", block)}
            named = {row for name in setting.split() for row in config[name]}
            named |= set(config["own"]) if rule in ("victim", "select") else set()
            if rule == "qfunction":  # a TD3 victim has critics already
                named = {row for row in named if not row.endswith("td3")}
            assert ran == (named if stage.row and rule != "publish" else set()), rule


# The plug-ins of the clusters are not installed here, so that the executor is that of dry runs; Kubernetes' storage is
# left out with it.
@pytest.mark.parametrize(
    "settings",
    [["--profile", str(DATA / "profiles" / "slurm")], ["--jobs", "40", "--config", "root=/runs/lite"]],
    ids=["slurm", "kubernetes"],
)
def test_a_cluster_gets_the_same_jobs_with_what_each_needs(tmp_path, settings):
    printed = run(tmp_path, "--dry-run", "--printshellcmds", "--executor", "dryrun", *settings, scale="lite")
    assert planned(printed) == jobs("lite")
    resources = re.findall(r"^(?:local)?rule (\w+):(?:\n    .*)*?\n    resources: (.*)", printed, re.M)
    assert {rule for rule, _ in resources} >= set(jobs("lite")) - {"all"}
    for rule, asked in resources:
        assert rule == "all" or ("mem_mb=" in asked and "runtime=" in asked), rule
        assert ("slurm_account=my_account" in asked) == ("--profile" in settings)
    assert set(re.findall(r'--root "(.*?)"', printed)) == {"/runs/lite" if "--config" in settings else "."}


@pytest.mark.parametrize("profile", ["slurm", "kubernetes"])
def test_a_profile_is_for_the_executor_of_its_name(profile):
    settings = yaml.safe_load((DATA / "profiles" / profile / "config.yaml").read_text())
    assert settings["executor"] == profile and settings["jobs"] > 1


def test_one_row_can_be_planned_alone_without_films(tmp_path):
    rows = planned(run(tmp_path, "--dry-run", "--config", "only=hopper-td3 ant-ppo", "films=false"))
    assert rows == dict(
        victim=4, select=2, qfunction=1, trajectories=5, augmentation=3, detector=3, denoiser=11, converge=2,
        converge_defended=2, timing=2,
        adversary=8, choose=2, linear=2, offset=2, offset_defended=1, attacks=2, evaluation=2, table=1, epsilon=1,
        planning=2, baselines=1, threshold=1, ablation=1, adversary_defended=4, choose_defended=1, adaptive=1,
        barrier=1, curve=1, ceilings=1, all=1,
    )  # fmt: skip
    online = planned(run(tmp_path, "--dry-run", "--config", "only=hopper-atla", "films=false"))
    assert online == dict.fromkeys({*BARE, "victim", "table", "all"} - {"portrait"}, 1) | dict(adversary=4)
    own = planned(run(tmp_path, "--dry-run", "--config", "only=swimmer-ppo"))
    assert own == dict(victim=1, select=1, defend=1, all=1)


def test_the_tiny_scale_cannot_be_published(tmp_path):
    assert planned(run(tmp_path, "--dry-run", "publish", scale="lite"))["publish"] == 1
    assert "No rule to produce publish" in refuse(tmp_path, "--dry-run", "publish")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--config", "only=hopper-td3 chess-td3"], "unknown row chess-td3; choose from: hopper-td3 walker2d-td3"),
        (["--config", "films=maybe"], "films is 'maybe'; it must be true or false"),
    ],
)
def test_unknown_settings_are_refused(tmp_path, arguments, message):
    printed = refuse(tmp_path, "--dry-run", *arguments)
    assert message in printed and "Traceback" not in printed


def test_the_graph_for_the_book_is_that_of_the_stages():
    graph = rule_graph()
    assert set(graph) == set(jobs("tiny"))
    assert set(durations.RULES) - {"publish"} == set(graph) - {"all"}
    assert {("victim", "select"), ("select", "qfunction"), ("qfunction", "trajectories")} <= set(graph.edges)
    assert {("linear", "adversary"), ("adversary", "choose"), ("choose", "attacks"), ("offset", "attacks")} <= set(
        graph.edges
    )
    assert {("adversary_defended", "choose_defended"), ("choose_defended", "adaptive"), ("adaptive", "table")} <= set(
        graph.edges
    )
    assert {rule for rule, head in graph.edges if head == "all"} >= {"table", "look", "portrait"}


def files(folder: Path) -> dict[str, int]:
    """When each file of a run was written, without Snakemake's own files and those that are always rewritten."""
    found = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    apart = re.compile(r"^(\.|logs/|benchmarks/|manifest\.json|MUJOCO_LOG)|.+(/checkpoint/.+|\.new)$")
    return {name: path.stat().st_mtime_ns for name, path in found.items() if not apart.match(name)}


def records_of(folder: Path) -> set[str]:
    """The records that are whole, and in the manifest."""
    found = folder.glob("results/*.json")
    return {path.relative_to(folder).as_posix() for path in found if manifest.is_made(path, folder)}


@pytest.fixture(scope="module")
def killed(tmp_path_factory) -> tuple[Path, dict[str, int]]:
    """A run of one row that was killed with all its jobs after the first record, and its files at that time."""
    folder = tmp_path_factory.mktemp("recipe")
    arguments = ("--jobs", "2", "--config", "only=hopper-ppo", "films=false")
    process = subprocess.Popen(
        recipe(folder, *arguments), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    while process.poll() is None and not records_of(folder):
        time.sleep(0.02)
    assert process.poll() is None, "it ended before there was a record"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    # What a job had written when it was killed before its end is removed and made again. So is a record that was killed
    # after its file was written and before it was entered in the manifest.
    marked = {path.name for path in (folder / ".snakemake" / "incomplete").rglob("*")}
    unentered = {path.relative_to(folder).as_posix() for path in folder.glob("results/*.json")} - records_of(folder)
    again = {name for name in files(folder) if urlsafe_b64encode(name.encode()).decode() in marked} | unentered
    had = {name: written for name, written in files(folder).items() if name not in again}
    run(folder, "--unlock", *arguments[2:])
    run(folder, *arguments)
    return folder, had


def test_a_killed_run_resumes_and_makes_nothing_twice(killed):
    folder, had = killed
    now = files(folder)
    assert len([name for name in had if name.endswith(".safetensors")]) >= 8
    assert len([name for name in had if name.startswith("results/")]) >= 1
    # A training that was running resumes from its last checkpoint, and writes again what came after that.
    trainings = {name: re.match(r".+/checkpoints/(defended-)?adversary-\d+/", name) for name in had}
    under_way = {name for name, training in trainings.items() if training and f"{training.group()}done" not in had}
    kept = {name: written for name, written in had.items() if name not in under_way}
    assert {name: now.get(name) for name in kept} == kept
    assert set(had) <= set(now)


def test_a_run_makes_everything_of_its_row(killed):
    folder, _ = killed
    wanted = cells.table_cells(["none", MAIN, *variants.EXPLAINING]) + cells.adaptive_cells()
    names = {cell.record_name("hopper", "ppo") for cell in wanted}
    assert {path.stem for path in (folder / "results").glob("*.json")} == names
    assert models.load_victim("hopper", "ppo", folder).critics
    models.load_defense("hopper", "ppo", MAIN, folder)
    assert all(models.load_adversary("hopper", "ppo", kind, folder).obs_dim == 11 for kind in models.ADVERSARIES)
    with (folder / "tables" / "returns.csv").open(newline="") as file:
        assert {
            ".".join([line[key] for key in ("row", "attack", "timing", "defense")]) for line in csv.DictReader(file)
        } == names


def test_the_time_of_every_stage_is_measured(killed):
    record = durations.measure(killed[0])
    assert set(record["rows"]["hopper-ppo"]) == set(durations.RULES) - {"publish", "table"} - {
        "look", "portrait", "epsilon", "barrier", "curve", "gallery", "slip", "defend",
        "baselines", "threshold", "ablation",
    }  # fmt: skip
    spent = record["rows"]["hopper-ppo"]
    assert all(stage["wall_seconds"] > 0 for stage in spent.values())
    assert {name: stage["jobs"] for name, stage in spent.items()} == dict.fromkeys(spent, 1) | dict(
        adversary=4, adversary_defended=4
    )


def test_only_what_depends_on_a_lost_file_runs_again(killed):
    folder, _ = killed
    only = ("--dry-run", "--config", "only=hopper-ppo", "films=false")
    assert "Nothing to be done" in run(folder, *only)
    (folder / "hopper-ppo" / f"denoiser-{MAIN}.json").unlink()
    again = {
        "denoiser",
        "converge_defended",
        "adversary_defended",
        "choose_defended",
        "offset_defended",
        "evaluation",
        "ceilings",
        "adaptive",
        "table",
        "all",
    }
    assert set(planned(run(folder, *only))) == again


def test_the_files_may_lie_on_an_invisible_volume(tmp_path):
    volume, work = tmp_path / "volume", tmp_path / "work"
    run(work, "walker2d-ppo/victim.json", "--jobs", "2", "--config", f"root={volume}")
    assert models.load_victim("walker2d", "ppo", volume).obs_dim == 17
    assert (work / "walker2d-ppo" / "victim.json").read_bytes() == b""


def test_the_defended_adversaries_attack_the_main_defence(tmp_path):
    printed = run(tmp_path, "--dry-run", "--printshellcmds", "--config", "only=hopper-td3")
    parts = {f"hopper-td3/detector-{VARIANTS[MAIN].data}.json", f"hopper-td3/denoiser-{MAIN}.json"}
    for rule, others in (("adversary_defended", set()), ("adaptive", set(cells.RESIDUAL_OR_NOT))):
        needed = re.search(rf"rule {rule}:\n    input: (.+)\n", printed)[1].split(", ")
        found = {name for name in needed if re.search("detector.*json|denoiser.*json", name)}
        assert parts | {f"hopper-td3/denoiser-{name}.json" for name in others} <= found
        assert others or found == parts


def test_each_variant_is_trained_on_the_listed_data(tmp_path):
    printed = run(tmp_path, "--dry-run", "--printshellcmds", "--config", "only=hopper-td3")
    for name, variant in VARIANTS.items():
        (needed,) = re.findall(rf"input: (.+)\n    output: hopper-td3/denoiser-{name}\.safetensors", printed)
        assert needed.split(", ") == [
            f"hopper-td3/{part}-{variant.data}/done" for part in ("normal", *variant.adversarial)
        ]
