import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import HOPPER
from safetensors.torch import load_file, save_file

from detden_lite import artifacts, stages
from detden_lite.__main__ import main
from detden_lite.budget import Budget
from detden_lite.defense import Detector
from detden_lite.defense.detector import calibrate, clean_scores
from detden_lite.rollout import rollout
from detden_lite.study import seeds
from detden_lite.victims import Victim

ORDER = ["victim", "select", "collect", "augment", "detector", "denoiser", "adversary", "evaluate"]


def run_stage(root: Path, *stage: str) -> None:
    main([*stage, "--task", "hopper", "--algo", "td3", "--scale", "tiny", "--root", str(root)])


def contents(root: Path) -> dict[str, bytes]:
    """Every file of a run but the checkpoints of training, whose zip files hold the time of day."""
    files = (path for path in root.rglob("*") if path.is_file() and "checkpoint" not in path.parts)
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in files}


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> Path:
    """The whole recipe at the tiny scale, every stage in its order; and each once more, which changes nothing."""
    root = tmp_path_factory.mktemp("tiny")
    for stage in ORDER:
        run_stage(root, stage)
        before = contents(root)
        run_stage(root, stage)
        assert contents(root) == before, stage
    return root


@pytest.fixture
def copy(tiny, tmp_path) -> Path:
    return shutil.copytree(tiny, tmp_path / "copy")


def the_run(root: Path) -> stages.Run:
    return stages.Run.of(root, "hopper", "td3", "tiny")


def test_the_recipe_makes_everything_that_the_library_loads(tiny):
    victim = artifacts.load_victim("hopper", "td3", tiny)
    defense = artifacts.load_defense("hopper", "td3", "residual", tiny)
    assert victim.obs_dim == defense.detector.model.obs_dim == 11 and defense.denoiser.model.config["residual"]
    for cell in stages.cells(["residual"]):
        record = artifacts.load_record(cell.record_name("hopper", "td3"), tiny)
        assert len(record["returns"]) == 4 and record["estimate"]["mean"] == pytest.approx(np.mean(record["returns"]))
    assert set(json.loads((tiny / "manifest.json").read_text())) | {"manifest.json"} >= {
        name for name in contents(tiny) if "checkpoints" not in name and not name.startswith(".")
    }


def test_the_shipped_victim_is_the_best_in_selection(tiny):
    card = artifacts.read_json(tiny / "hopper-td3" / "victim.json", tiny)
    assert [curve["seed"] for curve in card["learning_curves"]] == [0]
    assert card["learning_curves"][0]["steps"] == [500, 1_000] and card["step"] in (500, 1_000)
    clean = artifacts.load_record("hopper-td3.none.always.none", tiny)
    assert clean["returns"] == pytest.approx(card["returns"])


def test_the_victim_is_chosen_by_screening_and_then_by_selection(copy):
    """Of another seed's twelve snapshots and the two that were trained."""
    other = copy / "hopper-td3" / "checkpoints" / "victim-1"
    (other / "snapshots").mkdir(parents=True)
    (other / "recipe.json").write_text(json.dumps(dict(net=16, seed=1)))
    for i in range(12):
        torch.manual_seed(i)
        victim = Victim([11, 16, 16, 3], [14, 16, 16, 1])
        save_file(victim.state_dict(), other / "snapshots" / f"{i:08d}.safetensors")

    def mean(path: Path, purpose: str, n: int) -> float:
        net = [16 if "victim-1" in str(path) else 32] * 2
        victim = Victim.from_state(dict(actor=[11, *net, 3], critic=[14, *net, 1]), load_file(path))
        return float(rollout(victim, HOPPER, seeds(purpose, n), steps=50).returns.mean())

    snapshots = sorted(copy.rglob("victim-*/snapshots/*"))
    screening = {path: mean(path, "screening", 5) for path in snapshots}
    selection = {path: mean(path, "selection", 4) for path in sorted(snapshots, key=screening.get)[-10:]}
    run_stage(copy, "select")
    card = artifacts.read_json(copy / "hopper-td3" / "victim.json", copy)
    best = max(selection, key=selection.get)
    assert card["step"] == int(best.stem) and card["selection_mean"] == pytest.approx(selection[best])
    curves = {curve["seed"]: curve for curve in card["learning_curves"]}
    assert curves[1]["steps"] == list(range(12)) and len(curves[0]["steps"]) == 2
    assert curves[1]["mean"] == pytest.approx([screening[path] for path in snapshots if "victim-1" in str(path)])


def test_trajectories_are_attacked_within_the_ball(tiny):
    run = the_run(tiny)
    normal, adversarial = (stages.load_trajectories(run, f"{kind}-diverse") for kind in ("normal", "adversarial"))
    assert len(normal) == len(adversarial) == 8 and len(stages.load_trajectories(run, "calibration")) == 4
    difference = np.abs(adversarial.obs - normal.obs)[normal.mask]
    assert 0 < difference.max() <= Budget(0.075).epsilon + 1e-5


def test_the_threshold_is_calibrated_on_held_out_episodes(tiny):
    model, card = artifacts.load_model("hopper", "td3", "detector-diverse", tiny)
    scores = clean_scores(Detector(model, np.inf), stages.load_trajectories(the_run(tiny), "calibration"))
    assert card["threshold"] == pytest.approx(calibrate(scores))
    assert card["calibration_quantiles"]["0.5"] == pytest.approx(np.median(scores))


def test_what_is_lost_or_harmed_is_made_anew_and_the_same(tiny, copy):
    shard = "hopper-td3/normal-diverse/00000"
    harms = {
        "collect": [f"{shard}.json", "hopper-td3/calibration/00000.safetensors"],
        "augment": ["hopper-td3/adversarial-diverse/00000.json"],
        "detector": ["hopper-td3/detector-diverse.safetensors"],
        "denoiser": ["hopper-td3/denoiser-residual.json"],
        "adversary": ["hopper-td3/timing.json"],
        "evaluate": ["results/hopper-td3.opposite.always.residual.json"],
    }
    for harmed in (f"{shard}.safetensors",):
        (copy / harmed).write_bytes((copy / harmed).read_bytes()[:100])
    manifest = json.loads((copy / "manifest.json").read_text())
    del manifest["results/hopper-td3.fgsm.always.none.json"]  # written, but the kill came before it was noted
    (copy / "manifest.json").write_text(json.dumps(manifest))
    for stage, names in harms.items():
        for name in names:
            (copy / name).unlink()
        run_stage(copy, stage)

    def timeless(name: str, content: bytes):
        """Records without the time that they took; the manifest has the sums of records."""
        if name.startswith("results/"):
            return {key: value for key, value in json.loads(content).items() if key != "seconds"}
        return name if name == "manifest.json" else content

    expected, found = ({n: timeless(n, c) for n, c in contents(root).items()} for root in (tiny, copy))
    assert found == expected


def test_without_a_snapshot_there_is_nothing_to_select(copy):
    shutil.rmtree(copy / "hopper-td3" / "checkpoints" / "victim-0" / "snapshots")
    with pytest.raises(SystemExit, match="no snapshot of a victim; run the victim stage first"):
        run_stage(copy, "select")


@pytest.mark.parametrize(
    ("stage", "made", "message"),
    [
        ("select", [], "run the victim stage first"),
        ("collect", [], "victim.safetensors is missing"),
        ("augment", ["victim.*"], "normal-diverse.*00000.safetensors is missing"),
        ("detector", ["victim.*"], "normal-diverse is empty; run the collect stage first"),
        ("denoiser", ["victim.*", "normal-diverse"], "adversarial-diverse is empty; run the augment stage first"),
        ("adversary", [], "victim.safetensors is missing"),
        ("evaluate", ["victim.*"], "timing.json is missing"),
        ("evaluate", ["victim.*", "timing.json"], "denoiser-residual.safetensors is missing"),
    ],
)
def test_a_stage_out_of_order_says_what_is_missing(tiny, tmp_path, stage, made, message):
    shutil.copy(tiny / "manifest.json", tmp_path)
    for pattern in made:
        for path in (tiny / "hopper-td3").glob(pattern):
            target = tmp_path / "hopper-td3" / path.name
            target.parent.mkdir(exist_ok=True)
            (shutil.copytree if path.is_dir() else shutil.copy)(path, target)
    with pytest.raises(SystemExit, match=f"error: .*{message}"):
        run_stage(tmp_path, stage)


def command_line(*arguments: str, data: Path | None = None) -> subprocess.CompletedProcess:
    environment = dict(os.environ) | (dict(DETDEN_DATA=str(data)) if data else {})
    return subprocess.run(
        [sys.executable, "-m", "detden_lite", *arguments], capture_output=True, text=True, env=environment
    )


def test_the_command_line_publishes_models_and_records_but_no_trajectories(tiny, tmp_path):
    assert command_line("publish", "--scale", "tiny", "--root", str(tiny), data=tmp_path).returncode == 0
    published = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    models = {f"hopper-td3/{name}" for name in ("victim", "detector-diverse", "denoiser-residual")}
    records = {f"results/{cell.record_name('hopper', 'td3')}.json" for cell in stages.cells(["residual"])}
    expected = {f"{name}.{ending}" for name in models for ending in ("json", "safetensors")} | records
    assert published - {".manifest.lock"} == expected | {"hopper-td3/timing.json", "manifest.json"}
    artifacts.load_defense("hopper", "td3", "residual", tmp_path)


def test_an_error_is_one_line_and_no_traceback(tmp_path):
    result = command_line("detector", "--root", str(tmp_path))
    assert result.returncode == 1
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1


def test_help_lists_the_stages_in_their_order(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    places = [re.search(rf"\n    {stage}\s", printed).start() for stage in ORDER]
    assert places == sorted(places)


@pytest.mark.parametrize("arguments", [[], ["fly"], ["select", "--task", "chess"], ["select", "--scale", "huge"]])
def test_what_the_command_line_does_not_know_it_refuses(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2 and "usage" in capsys.readouterr().err


def test_only_what_is_built_can_be_run():
    with pytest.raises(ValueError, match="'sac'; choose one of: td3, ppo"):
        stages.Run.of(Path("runs"), "hopper", "sac", "tiny")
