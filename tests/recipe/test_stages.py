import inspect
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import HOPPER, normal
from safetensors.torch import load_file, save_file

from detden_lite.attacks.catalogue import ATTACKS
from detden_lite.core.budget import Budget
from detden_lite.core.files import ArtifactError
from detden_lite.core.tasks import ALGORITHMS, SCALES, TASK_NAMES
from detden_lite.core.types import Trajectories
from detden_lite.defense import variants
from detden_lite.defense.detector import Detector
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import defense_stages, trajectories
from detden_lite.recipe.cli import main
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import ADVERSARIAL, Run
from detden_lite.recipe.stage_list import GROUPS, STAGES
from detden_lite.recipe.trajectories import load_shard, load_trajectories
from detden_lite.results import cells, records
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models, tensors
from detden_lite.training.thresholds import calibrate, clean_scores
from detden_lite.victims.victim import Victim

ORDER = ["victim", "select", "collect", "augment", "detector", "denoiser"]
ORDER += [
    "converge",
    "converge --defended",
    "timing",
    "linear",
    "offset",
    "adversary",
    "adversary --member 3",
    "choose",
]
ORDER += ["evaluate"]
ADVERSARIES = ["adversary", "adversary-linear", "adversary-offset", "director"]
PPO_ORDER = [*ORDER[:2], "qfunction", *ORDER[2:]]


def run_stage(root: Path, *stage: str, algo: str = "td3") -> None:
    main([*stage, "--task", "hopper", "--algo", algo, "--scale", "tiny", "--root", str(root)])


def contents(root: Path) -> dict[str, bytes]:
    """Every file of a run except the checkpoints of trainings, whose zip files hold the time of day."""
    files = (path for path in root.rglob("*") if path.is_file() and "checkpoint" not in path.parts)
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in files}


def run_recipe(root: Path, order: list[str], algo: str) -> Path:
    """Run every stage in order, and each a second time, which changes nothing."""
    for stage in order:
        run_stage(root, *stage.split(), algo=algo)
        before = contents(root)
        run_stage(root, *stage.split(), algo=algo)
        assert contents(root) == before, stage
    return root


@pytest.fixture(scope="module")
def tiny(tmp_path_factory) -> Path:
    """The whole recipe of a TD3 victim at the tiny scale."""
    return run_recipe(tmp_path_factory.mktemp("tiny"), ORDER, "td3")


@pytest.fixture(scope="module")
def tiny_ppo(tmp_path_factory) -> Path:
    """The whole recipe of a PPO victim, whose Q-function is learned, at the tiny scale."""
    return run_recipe(tmp_path_factory.mktemp("tiny-ppo"), PPO_ORDER, "ppo")


@pytest.fixture
def copy(tiny, tmp_path) -> Path:
    return shutil.copytree(tiny, tmp_path / "copy")


def the_run(root: Path) -> Run:
    return Run.of(root, "hopper", "td3", "tiny")


@pytest.mark.parametrize("algo", ["td3", "ppo"])
def test_the_recipe_makes_everything_that_the_library_loads(request, algo):
    tiny = request.getfixturevalue("tiny" if algo == "td3" else "tiny_ppo")
    victim = models.load_victim("hopper", algo, tiny)
    defense = models.load_defense("hopper", algo, MAIN, tiny)
    assert victim.obs_dim == defense.detector.model.obs_dim == 11 and defense.denoiser.model.config["residual"]
    for cell in cells.table_cells(["none", MAIN]):
        record = records.load_record(cell.record_name("hopper", algo), tiny)
        assert len(record["returns"]) == (2 if cell.attack == "enchanting" else 4)
        assert record["estimate"]["mean"] == pytest.approx(np.mean(record["returns"]))
    assert set(json.loads((tiny / "manifest.json").read_text())) | {"manifest.json"} >= {
        name for name in contents(tiny) if "checkpoints" not in name and not name.startswith(".")
    }


def test_a_ppo_victim_is_stored_with_normaliser_and_q_function(tiny_ppo):
    victim, obs = models.load_victim("hopper", "ppo", tiny_ppo), normal(5, 11)
    assert victim.action_std is not None and (victim.obs_std != 1).all()
    assert victim.q(obs, victim(obs)).shape == (5,) and not torch.equal(victim.q(obs, victim(obs)), victim.value(obs))
    card = manifest.read_json(tiny_ppo / "hopper-ppo" / "critic.json", tiny_ppo)
    assert card["fit"]["actions"] == 4 * card["fit"]["episodes"] > 0
    assert card["critic"] == [14, 32, 32, 1] and card["recipe"]["episodes"] == 16
    assert manifest.read_json(tiny_ppo / "hopper-ppo" / "victim.json", tiny_ppo)["recipe"]["gae_lambda"] == 0.95


def test_the_timing_is_tuned_on_the_value_network(tiny_ppo, tmp_path):
    """The timing is the same whether a Q-function was learned or not."""
    copy = shutil.copytree(tiny_ppo, tmp_path / "copy")
    before = (copy / "hopper-ppo" / "timing.json").read_bytes()
    for name in ("timing.json", "critic.json", "critic.safetensors"):
        (copy / "hopper-ppo" / name).unlink()
    run_stage(copy, "timing", algo="ppo")
    assert (copy / "hopper-ppo" / "timing.json").read_bytes() == before


def test_a_lost_q_function_is_learned_again_the_same(tiny_ppo, tmp_path):
    copy = shutil.copytree(tiny_ppo, tmp_path / "copy")
    (copy / "hopper-ppo" / "critic.safetensors").unlink()
    run_stage(copy, "qfunction", algo="ppo")
    assert contents(copy) == contents(tiny_ppo)


def test_a_td3_victim_needs_no_q_function(tiny):
    before = contents(tiny)
    with pytest.raises(SystemExit, match="error: a TD3 victim has critics of its own; the qfunction stage is for PPO"):
        run_stage(tiny, "qfunction")
    assert contents(tiny) == before


def test_the_shipped_victim_is_the_best_in_selection(tiny):
    card = manifest.read_json(tiny / "hopper-td3" / "victim.json", tiny)
    assert [curve["seed"] for curve in card["learning_curves"]] == [0]
    assert card["learning_curves"][0]["steps"] == [500, 1_000] and card["step"] in (500, 1_000)
    clean = records.load_record("hopper-td3.none.always.none", tiny)
    assert clean["returns"] == pytest.approx(card["returns"])


def test_the_victim_is_chosen_by_screening_and_then_by_selection(copy):
    """Among another seed's twelve snapshots and the two that were trained."""
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
    card = manifest.read_json(copy / "hopper-td3" / "victim.json", copy)
    best = max(selection, key=selection.get)
    assert card["step"] == int(best.stem) and card["selection_mean"] == pytest.approx(selection[best])
    curves = {curve["seed"]: curve for curve in card["learning_curves"]}
    assert curves[1]["steps"] == list(range(12)) and len(curves[0]["steps"]) == 2
    assert curves[1]["mean"] == pytest.approx([screening[path] for path in snapshots if "victim-1" in str(path)])


@pytest.fixture(scope="module", params=["td3", "ppo"])
def attacked(request, tmp_path_factory) -> Run:
    """The trajectories of an untrained victim, clean and attacked."""
    run = Run.of(tmp_path_factory.mktemp("attacked"), "hopper", request.param, "tiny")
    critic, value = [14, 16, 1], [11, 16, 1]
    torch.manual_seed(0)
    victim = Victim([11, 16, 3], critic, value, gaussian=True) if run.algo == "ppo" else Victim([11, 16, 3], critic)
    models.save_victim("hopper", run.algo, victim, {}, run.root)
    defense_stages.collect(run, "diverse")
    defense_stages.augment(run, "diverse")
    return run


def test_trajectories_are_attacked_within_the_ball(attacked):
    parts = ("normal", *ADVERSARIAL)
    normal, opposite, qfunction = (load_trajectories(attacked, f"{part}-diverse") for part in parts)
    assert len(normal) == 8 and len(load_trajectories(attacked, "calibration")) == 4
    for adversarial in (opposite, qfunction):
        assert np.array_equal(adversarial.lengths, normal.lengths)
        difference = np.abs(adversarial.obs - normal.obs)[normal.mask]
        assert 0 < difference.max() <= Budget(0.075).epsilon + 1e-5
    victim, true = attacked.victim(), torch.from_numpy(normal.obs[normal.mask])
    moved, worse = (victim(torch.from_numpy(part.obs[normal.mask])) for part in (opposite, qfunction))
    assert (moved - victim(true)).square().sum() > (worse - victim(true)).square().sum()
    assert victim.qs(true, worse).mean() < victim.qs(true, moved).mean()


def test_every_variant_that_learns_from_both_attacks_is_trained(attacked):
    before, weights = contents(attacked.root), {}
    for name in ("residual", "both", "mixed", "regularized", "standard-prior"):
        defense_stages.train_denoiser(attacked, name)
        model, card = models.load_model("hopper", attacked.algo, f"denoiser-{name}", attacked.root)
        assert card["adversarial"] == (["adversarial"] if name == "residual" else ["adversarial", "qfunction"])
        assert card["recipe"].items() >= variants.VARIANTS[name].recipe.items() and model.config["residual"]
        assert (card["regularizer"] or {}).get("epsilon") == (HOPPER.epsilon if name == "regularized" else None)
        weights[name] = model.to_output.weight
    assert not any(torch.equal(weights[name], weights["both"]) for name in weights if name != "both")
    after = contents(attacked.root)
    assert {name: after[name] for name in before if name != "manifest.json"} == {
        name: content for name, content in before.items() if name != "manifest.json"
    }


def test_the_threshold_is_calibrated_on_held_out_episodes(tiny):
    model, card = models.load_model("hopper", "td3", "detector-diverse", tiny)
    scores = clean_scores(Detector(model, np.inf), load_trajectories(the_run(tiny), "calibration"))
    assert not card["conformal"]  # four episodes cannot guarantee one false alarm in twenty steps
    assert card["threshold"] == pytest.approx(calibrate(scores, card["false_alarms"]))
    assert card["calibration_quantiles"]["0.5"] == pytest.approx(np.median(scores))


def test_a_lost_or_damaged_file_is_made_again_the_same(tiny, copy):
    shard = "hopper-td3/normal-diverse/00000"
    harms = {
        "collect": [f"{shard}.json", "hopper-td3/calibration/00000.safetensors"],
        "augment": ["hopper-td3/adversarial-diverse/00000.json", "hopper-td3/qfunction-diverse/00000.safetensors"],
        "detector": ["hopper-td3/detector-diverse.safetensors"],
        "denoiser": [f"hopper-td3/denoiser-{MAIN}.json"],
        "timing": ["hopper-td3/timing.json"],
        "evaluate": [f"results/hopper-td3.opposite.always.{MAIN}.json"],
    }
    for harmed in (f"{shard}.safetensors",):
        (copy / harmed).write_bytes((copy / harmed).read_bytes()[:100])
    manifest = json.loads((copy / "manifest.json").read_text())
    del manifest["results/hopper-td3.fgsm.always.none.json"]  # written, but killed before the manifest was
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
        (
            "denoiser --variant both",
            ["victim.*", "normal-diverse", "adversarial-diverse"],
            "qfunction-diverse is empty; run the augment stage first",
        ),
        ("converge", [], "victim.safetensors is missing"),
        ("converge --defended", ["victim.*"], f"denoiser-{MAIN}.safetensors is missing"),
        ("timing", [], "victim.safetensors is missing"),
        ("adversary", [], "victim.safetensors is missing"),
        ("choose", ["victim.*"], "no snapshot of an adversary; run the adversary stage first"),
        ("linear", [], "victim.safetensors is missing"),
        ("offset", [], "victim.safetensors is missing"),
        ("evaluate", ["victim.*"], "timing.json is missing"),
        ("evaluate", ["victim.*", "timing.json"], "adversaries: the linear one is missing; run its stage first"),
        (
            "evaluate",
            ["victim.*", "timing.json", "adversary*", "director.*"],
            f"denoiser-{MAIN}.safetensors is missing",
        ),
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
        run_stage(tmp_path, *stage.split())


def harm_alter(path: Path, run: Run) -> None:
    path.write_bytes(path.read_bytes()[:-1] + b"?")


def harm_truncate(path: Path, run: Run) -> None:
    path.write_bytes(path.read_bytes()[:100])


def harm_sidecar(path: Path, run: Run) -> None:
    path.with_suffix(".json").unlink()


def harm_other_content(path: Path, run: Run) -> None:
    tensors.save_tensors(path, dict(weights=torch.zeros(3)), {}, run.root)


def harm_other_task(path: Path, run: Run) -> None:
    shard = load_shard(run, path)
    trajectories.save_shard(run, path, Trajectories(shard.obs[..., :5].copy(), shard.lengths))


def harm_first_lost(path: Path, run: Run) -> None:
    tensors.save_tensors(path.with_stem("00128"), load_file(path), {}, run.root)
    path.unlink()


@pytest.mark.parametrize(
    "harm", [harm_alter, harm_truncate, harm_sidecar, harm_other_content, harm_other_task, harm_first_lost]
)
def test_damaged_trajectories_are_refused_with_their_file(attacked, tmp_path, harm):
    run = replace(attacked, root=shutil.copytree(attacked.root, tmp_path / "copy"))
    path = run.folder / "normal-diverse" / "00000.safetensors"
    harm(path, run)
    with pytest.raises(ArtifactError, match=r"normal-diverse/00000\."):
        load_trajectories(run, "normal-diverse")


def test_publishing_an_empty_root_is_an_error(tmp_path):
    data = tmp_path / "data"
    result = command_line("publish", "--scale", "tiny", "--root", str(tmp_path / "nothing"), data=data)
    assert result.returncode == 1 and not data.exists()
    assert re.fullmatch(r"error: .*nothing has nothing of hopper-td3 to publish; make it first.*\n", result.stderr)


INTERRUPTED = """
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from detden_lite.results import cells
from detden_lite.recipe import trajectories, defense_stages
from detden_lite.recipe.run import Run
from detden_lite.core.types import Trajectories
from detden_lite.defense import variants

trajectories.SHARD = 2
run = Run.of(Path(sys.argv[1]), "hopper", "td3", "tiny")
defense_stages.collect(replace(run, scale=replace(run.scale, trajectories=60)), "diverse")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_kill_while_trajectories_are_collected_loses_no_whole_file(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(trajectories, "SHARD", 2)
    killed, uninterrupted = (Run.of(tmp_path / name, "hopper", "td3", "tiny") for name in ("killed", "whole"))
    for run in (killed, uninterrupted):
        victim = models.load_victim("hopper", "td3", tiny)
        models.save_victim("hopper", "td3", victim, {}, run.root)
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, str(killed.root)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    while process.poll() is None and "/00004.json" not in (killed.root / "manifest.json").read_text():
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    made = sorted((killed.folder / "normal-diverse").glob("*.safetensors"))
    whole = [path for path in made if manifest.is_made(path, killed.root)]
    assert 3 <= len(whole) < 30 and len(made) - len(whole) <= 1  # at most one was being written
    assert all(len(load_shard(killed, path)) == 2 for path in whole)
    before = {path: path.stat().st_mtime_ns for path in whole}
    for run in (killed, uninterrupted):
        defense_stages.collect(replace(run, scale=replace(run.scale, trajectories=60)), "diverse")
    assert {path: path.stat().st_mtime_ns for path in whole} == before  # these were not made again
    assert contents(killed.root) == contents(uninterrupted.root)


FULL_DISK = """
import resource, signal, sys
from detden_lite.recipe.cli import main

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (900, resource.RLIM_INFINITY))  # bytes: no file may be larger
for stage in sys.argv[2:]:
    try:
        main([stage, "--root", sys.argv[1]])
    except SystemExit as stop:
        print(stage, stop.code)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such quota")
def test_a_full_disk_stops_every_stage_and_changes_nothing(tiny, copy):
    """For each stage a file is missing, except for ``select``, which would replace one."""
    folder = copy / "hopper-td3"
    lost = dict(
        collect=folder / "calibration" / "00000.safetensors",
        detector=folder / "checkpoints" / "detector-diverse.ckpt",
        denoiser=folder / "checkpoints" / f"denoiser-{MAIN}.ckpt",
        evaluate=copy / "results" / "hopper-td3.none.always.none.json",
    )
    for path in lost.values():
        path.unlink()
    before = contents(copy)
    order = ["select", *lost]
    result = subprocess.run([sys.executable, "-c", FULL_DISK, str(copy), *order], capture_output=True, text=True)
    assert result.returncode == 0 and "Traceback" not in result.stderr and "ignored" not in result.stderr
    lines = dict(line.split(" ", 1) for line in result.stdout.splitlines())
    files = dict(select="victim.safetensors") | {stage: path.name for stage, path in lost.items()}
    assert list(lines) == order
    for stage, line in lines.items():
        assert re.fullmatch(rf"error: .*{files[stage]}.* could not be written \(.+\); free some space.*", line)
    assert contents(copy) == before
    for stage in lost:
        run_stage(copy, stage)
    assert set(contents(copy)) == set(contents(tiny))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such quota")
def test_an_error_of_the_disk_is_one_line(tmp_path):
    """A folder cannot be made where a file is."""
    (tmp_path / "hopper-td3").write_text("in the way")
    result = command_line("victim", "--root", str(tmp_path))
    assert result.returncode == 1 and result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: ") and "hopper-td3" in result.stderr


def command_line(*arguments: str, data: Path | None = None) -> subprocess.CompletedProcess:
    environment = dict(os.environ) | (dict(DETDEN_DATA=str(data)) if data else {})
    return subprocess.run(
        [sys.executable, "-m", "detden_lite", *arguments], capture_output=True, text=True, env=environment
    )


def test_the_command_line_publishes_models_and_records_but_no_trajectories(tiny, tmp_path):
    assert command_line("publish", "--scale", "tiny", "--root", str(tiny), data=tmp_path).returncode == 0
    published = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    shipped = {f"hopper-td3/{name}" for name in ("victim", "detector-diverse", f"denoiser-{MAIN}", *ADVERSARIES)}
    records = {f"results/{cell.record_name('hopper', 'td3')}.json" for cell in cells.table_cells(["none", MAIN])}
    expected = {f"{name}.{ending}" for name in shipped for ending in ("json", "safetensors")} | records
    tuned = {f"hopper-td3/{name}.json" for name in ("timing", "convergence", "convergence-defended")}
    assert published - {".manifest.lock"} == expected | tuned | {"manifest.json"}
    models.load_defense("hopper", "td3", MAIN, tmp_path)


def test_an_error_is_one_line_and_no_traceback(tmp_path):
    result = command_line("detector", "--root", str(tmp_path))
    assert result.returncode == 1
    assert result.stderr.startswith("error: ") and result.stderr.count("\n") == 1


def test_help_lists_every_stage_under_its_group(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    listed, group = {}, None
    for line in printed.splitlines():
        group = next((name for name, title in GROUPS.items() if line == f"{title}:"), group)
        if group and (stage := re.match(r"  (\w+)  +\S", line)):
            listed[stage[1]] = group
    assert listed == {stage.name: stage.group for stage in STAGES.values()}


@pytest.mark.parametrize("stage", STAGES.values(), ids=list(STAGES))
def test_a_stage_runs_a_function_that_takes_its_options(stage):
    module, name = stage.function.split(":")
    parameters = inspect.signature(getattr(import_module(f"detden_lite.{module}"), name)).parameters
    assert list(parameters)[0] == ("run" if stage.row else "root")
    assert {option.flag.removeprefix("--") for option in stage.options} <= set(parameters)


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        ([], ["STAGE"]),
        (["fly"], list(STAGES)),
        (["select", "--task", "chess"], list(TASK_NAMES)),
        (["select", "--algo", "sac"], list(ALGORITHMS)),
        (["select", "--scale", "huge"], list(SCALES)),
        (["denoiser", "--variant", "prayer"], list(variants.VARIANTS)),
        (["evaluate", "--attacks", "prayer"], list(ATTACKS)),
        (["victim", "--seed", "1.5"], ["--seed", "'1.5' is no whole number of at least 0"]),
        (["adversary", "--member", "-1"], ["--member", "'-1' is no whole number of at least 0"]),
        (["select", "--seed", "1"], ["--seed"]),
    ],
)
def test_an_unknown_argument_exits_2_and_lists_the_choices(arguments, names, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    printed = capsys.readouterr().err
    assert stop.value.code == 2 and printed.startswith("usage: detden")
    assert all(name in printed.splitlines()[-1] for name in names)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("chess", "td3", "tiny"), "unknown task 'chess'; choose one of: hopper"),
        (("hopper", "sac", "tiny"), "unknown algorithm 'sac'; choose one of: td3, ppo"),
        (("hopper", "td3", "huge"), "unknown scale 'huge'; choose one of: tiny, lite, paper"),
        (("swimmer", "td3", "lite"), "no recipe for swimmer with td3; choose one of: ppo"),
    ],
)
def test_a_run_of_an_unknown_name_lists_the_names(names, message):
    with pytest.raises(ValueError, match=message):
        Run.of("runs", *names)
