import hashlib
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import HOPPER, normal
from safetensors.torch import load_file

from detden_lite.core.files import ArtifactError, replace_file
from detden_lite.core.tasks import get_task
from detden_lite.training import checkpoints, resumable
from detden_lite.training.adversary_recipe import AdversaryRecipe
from detden_lite.training.progress import load_progress
from detden_lite.training.recipes import PPORecipe, TD3Recipe
from detden_lite.training.worlds import task_worlds, train_victim
from detden_lite.victims.victim import Victim

pytestmark = pytest.mark.slow  # each test trains

RECIPES = dict(
    td3=TD3Recipe(steps=1_000, segment=200, net=16, batch=16, buffer=500, learning_starts=100),
    ppo=PPORecipe(steps=1_280, segment=256, net=16, envs=4, rollout=32, batch=32, epochs=2),
)
WORLDS = partial(task_worlds, HOPPER)
TRAIN = """
import sys
from pathlib import Path
from detden_lite.core.tasks import get_task
from detden_lite.training.recipes import PPORecipe, TD3Recipe
from detden_lite.training.worlds import train_victim
train_victim(get_task("hopper"), {recipe}, 0, Path(sys.argv[1]), checkpoint_seconds=0)
"""


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "snapshots").iterdir()}


def states(folder: Path) -> list[dict]:
    return [load_file(path) for path in sorted((folder / "snapshots").iterdir())]


@pytest.fixture(scope="module", params=RECIPES)
def algo(request):
    return request.param


@pytest.fixture(scope="module")
def recipe(algo):
    return RECIPES[algo]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory, recipe) -> Path:
    folder = tmp_path_factory.mktemp("uninterrupted")
    train_victim(HOPPER, recipe, 0, folder)
    return folder


def test_every_segment_leaves_a_victim(uninterrupted, recipe):
    ends = range(recipe.segment, recipe.steps + 1, recipe.segment)
    assert sorted(contents(uninterrupted)) == [f"{steps:08d}.safetensors" for steps in ends]
    victims = [Victim.from_state(recipe.config(HOPPER), state) for state in states(uninterrupted)]
    actions, values = [v(normal(5, 11)) for v in victims], [v.value(normal(5, 11)) for v in victims]
    for outputs in (actions, values):  # it learned on
        assert all(not torch.allclose(a, b) for a, b in zip(outputs[:-1], outputs[1:], strict=True))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_killed_and_resumed_training_equals_an_uninterrupted_one(tmp_path, uninterrupted, recipe):
    code = TRAIN.format(recipe=recipe)
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stderr=subprocess.DEVNULL)
    while process.poll() is None and not recorded_segments(tmp_path):
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    done = recorded_segments(tmp_path)
    assert 1 <= done <= len(contents(tmp_path)) < 5
    before = times(tmp_path / "snapshots")[:done]
    train_victim(HOPPER, recipe, 0, tmp_path)
    assert contents(tmp_path) == contents(uninterrupted)
    assert times(tmp_path / "snapshots")[:done] == before  # they were not made again


def recorded_segments(folder: Path) -> int:
    record = folder / "checkpoint" / "segments.json"
    return json.loads(record.read_text())["segments"] if record.exists() else 0


def times(folder: Path) -> list[int]:
    return [path.stat().st_mtime_ns for path in sorted(folder.iterdir())]


def saved_model(folder: Path, recipe):
    model = recipe.start(HOPPER, WORLDS, 9)
    assert checkpoints.load(model, folder / "checkpoint") > 0
    return model


def test_a_checkpoint_remembers_the_returns_of_the_last_episodes(uninterrupted, recipe):
    """The progress bar shows their mean; a resumed run would begin with none."""
    model = saved_model(uninterrupted, recipe)
    assert model.num_timesteps == recipe.steps
    assert len(model.ep_info_buffer) > 5 and all(np.isfinite(episode["r"]) for episode in model.ep_info_buffer)


def test_ppo_keeps_its_normalisers_statistics_over_segments():
    """They count every observation and become the victim's first layer; rewards have statistics of their own."""
    recipe = RECIPES["ppo"]
    model = recipe.start(HOPPER, WORLDS, 0)
    for segment in range(2):
        recipe.begin_segment(model, WORLDS, segment / 2)
        model.set_random_seed(segment)
        model.learn(recipe.segment, reset_num_timesteps=False)
    statistics = model.get_vec_normalize_env()
    assert statistics.obs_rms.count == pytest.approx(2 * (recipe.segment + recipe.envs), abs=1)
    assert statistics.ret_rms.count == pytest.approx(2 * recipe.segment, abs=1)
    victim = Victim.from_sb3(model, statistics)
    assert np.allclose(victim.obs_mean, statistics.obs_rms.mean, atol=1e-6) and (victim.obs_std != 1).all()


def test_td3_normalises_by_its_buffer_as_a_segment_begins(tmp_path):
    """Nothing before the first; and a run that is resumed normalises as one that never stopped."""
    recipe = replace(RECIPES["td3"], envs=2, updates=10, normalize=True, learning_starts=200, buffer=2_000, steps=600)
    train_victim(HOPPER, recipe, 0, tmp_path / "whole")
    train_victim(HOPPER, replace(recipe, steps=400), 0, tmp_path / "resumed")
    train_victim(HOPPER, recipe, 0, tmp_path / "resumed")
    assert contents(tmp_path / "whole") == contents(tmp_path / "resumed")
    model, (first, _, last) = saved_model(tmp_path / "whole", recipe), states(tmp_path / "whole")
    before = model.replay_buffer.observations[:200].reshape(400, 11)  # of 600, in two environments
    assert (first["obs_mean"] == 0).all() and torch.allclose(first["obs_std"], torch.ones(11))
    assert np.allclose(last["obs_mean"], before.mean(0), atol=1e-5)
    assert np.allclose(last["obs_std"], before.std(0), rtol=1e-3)


def test_td3_cannot_normalise_by_a_buffer_that_is_empty():
    with pytest.raises(ValueError, match="learning_starts: there is nothing to normalise by"):
        replace(RECIPES["td3"], normalize=True)


def test_a_checkpoint_of_ppo_holds_its_normaliser(tmp_path):
    recipe = replace(RECIPES["ppo"], steps=256)
    train_victim(HOPPER, recipe, 0, tmp_path)
    loaded = saved_model(tmp_path, recipe).get_vec_normalize_env()
    (state,) = states(tmp_path)
    assert np.allclose(loaded.obs_rms.mean, state["obs_mean"], atol=1e-6)
    assert loaded.ret_rms.var > 0 and loaded.ret_rms.count > 256


def test_the_learning_rate_of_ppo_falls_with_every_segment():
    recipe = RECIPES["ppo"]
    model, rates = recipe.start(HOPPER, WORLDS, 0), []
    for done in (0, 0.4, 0.8):
        recipe.begin_segment(model, WORLDS, done)
        model.learn(recipe.envs * recipe.rollout, reset_num_timesteps=False)
        for state in (model.policy.actor_state, model.policy.vf_state):
            rates.append(float(state.opt_state[1].hyperparams["learning_rate"]))
    assert rates == pytest.approx([share * recipe.learning_rate for share in (1, 1, 0.6, 0.6, 0.2, 0.2)])


def test_a_kill_between_model_and_record_keeps_the_last_checkpoint(tmp_path, begun, uninterrupted, recipe):
    """The next model is written whole, and one more half; the record still names the one before."""
    folder = shutil.copytree(begun, tmp_path / "copy")
    (folder / "checkpoint" / "model-2.npz").write_bytes(b"whole")
    (folder / "checkpoint" / "model-3.npz.0.new.npz").write_bytes(b"ha")
    train_victim(HOPPER, recipe, 0, folder)
    assert contents(folder) == contents(uninterrupted)
    assert sorted(path.name for path in (folder / "checkpoint").iterdir()) == ["model-5.npz", "segments.json"]


def test_a_kill_during_the_first_checkpoint_starts_anew(tmp_path, uninterrupted, recipe):
    """The model is written whole, and the record does not name it yet; again with another model as the first one."""
    for first, segments in (("model-5.npz", 5), ("model-1.npz", 1)):
        with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
            patch.setattr(checkpoints, "replace_file", interrupted_at_a_finished_model)
            train_victim(HOPPER, recipe, 0, tmp_path, checkpoint_seconds=600 if segments == 5 else 0)
        assert sorted(path.name for path in (tmp_path / "checkpoint").iterdir()) == [first, "segments.json"]
    (tmp_path / "checkpoint" / "model-1.npz.0.new.npz").write_bytes(b"ha")
    train_victim(HOPPER, recipe, 0, tmp_path)
    assert contents(tmp_path) == contents(uninterrupted)
    assert recorded_segments(tmp_path) == 5


def interrupted_at_a_finished_model(path: Path, content: bytes) -> None:
    if json.loads(content)["segments"]:
        raise KeyboardInterrupt
    replace_file(path, content)


def test_a_finished_training_is_not_repeated(uninterrupted, recipe):
    before = contents(uninterrupted), times(uninterrupted / "checkpoint")
    train_victim(HOPPER, recipe, 0, uninterrupted)
    assert (contents(uninterrupted), times(uninterrupted / "checkpoint")) == before


class Trap:
    """A pickle that leaves a trace when it is loaded."""

    def __init__(self, trace: Path):
        self.trace = trace

    def __reduce__(self):
        return (Path.touch, (self.trace,))


def trapped(folder: Path) -> None:
    """A model of pickles, and the record's SHA-256 with it: hashes alone do not make a pickle safe."""
    path = folder / "checkpoint" / "model-1.npz"
    np.savez(path, segments=np.array(1), key=np.array([Trap(folder / "trace")], dtype=object))
    rewritten(folder, sha256={path.name: hashlib.sha256(path.read_bytes()).hexdigest()})


def rewritten(folder: Path, **changes) -> None:
    record = folder / "checkpoint" / "segments.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | changes))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def altered(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def replaced_by_a_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


DAMAGES = dict(
    record_is_a_number=(lambda f: (f / "checkpoint" / "segments.json").write_text("99"), "segments.json"),
    record_cut=(lambda f: cut(f / "checkpoint" / "segments.json"), "segments.json"),
    record_is_no_text=(lambda f: (f / "checkpoint" / "segments.json").write_bytes(b"\xff\xfe"), "segments.json"),
    record_is_a_list=(lambda f: (f / "checkpoint" / "segments.json").write_text("[1]"), "segments.json"),
    record_without_sums=(lambda f: (f / "checkpoint" / "segments.json").write_text('{"segments": 1}'), "segments.json"),
    record_of_more_segments=(lambda f: rewritten(f, segments=5), "segments.json"),
    record_of_no_segments=(lambda f: rewritten(f, segments=0), "segments.json"),
    record_of_another_first_model=(lambda f: rewritten(f, segments=0, first="model-5.npz"), "segments.json"),
    record_deeply_nested=(lambda f: (f / "checkpoint" / "segments.json").write_text("[" * 99_999), "segments.json"),
    record_missing=(lambda f: (f / "checkpoint" / "segments.json").unlink(), "segments.json"),
    sum_of_another_file=(lambda f: rewritten(f, sha256={"../model-1.npz": "0"}), "segments.json"),
    model_missing=(lambda f: (f / "checkpoint" / "model-1.npz").unlink(), "model-1.npz"),
    model_is_a_folder=(lambda f: replaced_by_a_folder(f / "checkpoint" / "model-1.npz"), "model-1.npz"),
    model_cut=(lambda f: cut(f / "checkpoint" / "model-1.npz"), "model-1.npz"),
    model_altered=(lambda f: altered(f / "checkpoint" / "model-1.npz"), "model-1.npz"),
    model_pickled=(trapped, "model-1.npz"),
    recipe_cut=(lambda f: cut(f / "recipe.json"), "recipe.json"),
    recipe_deeply_nested=(lambda f: (f / "recipe.json").write_text("[" * 99_999), "recipe.json"),
)


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_checkpoint_is_refused_by_name(tmp_path, begun, recipe, damage):
    do, name = DAMAGES[damage]
    folder = shutil.copytree(begun, tmp_path / "copy")
    do(folder)
    with pytest.raises(ArtifactError, match=f"{name}.*(train anew|run again)"):
        train_victim(HOPPER, recipe, 0, folder)
    assert not (folder / "trace").exists() and contents(folder) == contents(begun)


def test_a_checkpoint_of_another_network_is_refused(begun, recipe):
    with pytest.raises(ArtifactError, match="model-1.npz does not fit this recipe"):
        checkpoints.load(replace(recipe, net=8).start(HOPPER, WORLDS, 0), begun / "checkpoint")


def test_a_finished_td3_can_be_prolonged_a_ppo_cannot(tmp_path, uninterrupted, recipe, algo):
    folder = shutil.copytree(uninterrupted, tmp_path / "copy")
    longer = replace(recipe, steps=recipe.steps + recipe.segment)
    if algo == "td3":
        assert len(train_victim(HOPPER, longer, 0, folder)) == 6
    else:
        with pytest.raises(ValueError, match="recipe.json describes another run"):
            train_victim(HOPPER, longer, 0, folder)


@pytest.mark.parametrize("change", [dict(seed=1), dict(net=8), dict(learning_rate=1.0), dict(task="walker2d")])
def test_a_folder_with_another_run_is_refused(uninterrupted, recipe, change):
    before = (uninterrupted / "recipe.json").read_text()
    seed, task = change.get("seed", 0), get_task(change.get("task", "hopper"))
    other = replace(recipe, **{key: value for key, value in change.items() if key not in ("seed", "task")})
    with pytest.raises(ValueError, match="recipe.json describes another run"):
        train_victim(task, other, seed, uninterrupted)
    assert (uninterrupted / "recipe.json").read_text() == before


def test_a_folder_with_another_algorithms_run_is_refused(uninterrupted, algo):
    other = RECIPES["ppo" if algo == "td3" else "td3"]
    with pytest.raises(ValueError, match="recipe.json describes another run"):
        train_victim(HOPPER, other, 0, uninterrupted)


@pytest.mark.parametrize(
    ("algo", "change"),
    [
        ("td3", dict(steps=1_100)),
        ("td3", dict(segment=130)),
        ("td3", dict(envs=3)),
        ("ppo", dict(steps=1_300)),
        ("ppo", dict(segment=200)),
        ("ppo", dict(envs=3)),
    ],
)
def test_segments_that_do_not_add_up_are_refused(algo, change):
    with pytest.raises(ValueError, match="multiple"):
        replace(RECIPES[algo], **change)


@pytest.fixture(scope="module")
def begun(tmp_path_factory, recipe) -> Path:
    """A run that was interrupted after its first checkpoint."""

    class Interrupting(resumable.tqdm):
        def update(self, n=1):
            raise KeyboardInterrupt

    folder = tmp_path_factory.mktemp("begun")
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(resumable, "tqdm", Interrupting)
        train_victim(HOPPER, recipe, 0, folder, checkpoint_seconds=0)
    assert len(contents(folder)) == 1
    return folder


QUOTAS = {100: "recipe.json", 1_000: "safetensors", 12_000: "npz"}  # bytes, and what is too large for them
FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from detden_lite.core.files import ArtifactError
from detden_lite.core.tasks import get_task
from detden_lite.training.recipes import PPORecipe, TD3Recipe
from detden_lite.training.worlds import train_victim

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for quota in sys.argv[2:]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(quota), resource.RLIM_INFINITY))
    try:
        train_victim(get_task("hopper"), {recipe}, 0, Path(sys.argv[1]) / quota)
    except ArtifactError as error:
        print(error)
"""


def everything(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such quota")
def test_a_full_disk_leaves_the_last_checkpoint_whole(tmp_path, begun, uninterrupted, recipe):
    for quota in QUOTAS:
        shutil.copytree(begun, tmp_path / str(quota))
    code = FULL_DISK.format(recipe=recipe)
    stopped = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path), *map(str, QUOTAS)], capture_output=True, text=True
    )
    assert stopped.returncode == 0 and "Exception" not in stopped.stderr
    messages, before = stopped.stdout.splitlines(), everything(begun)
    del before["progress.json"]  # may tell of the segment that could not be kept, which replaces its entry
    assert len(messages) == len(QUOTAS)
    for message, (quota, refused) in zip(messages, QUOTAS.items(), strict=True):
        assert re.search(rf"{refused} could not be written \(.+\); free some space and run again$", message)
        after = everything(tmp_path / str(quota))
        assert before.items() <= after.items() and not [name for name in after if ".new" in name or ".old" in name]
        assert load_progress(begun).items() <= load_progress(tmp_path / str(quota)).items()
        assert len(contents(tmp_path / str(quota))) == (5 if refused == "npz" else 1)
    train_victim(HOPPER, recipe, 0, tmp_path / str(quota))  # there is room again
    assert contents(tmp_path / str(quota)) == contents(uninterrupted)


@pytest.mark.parametrize(
    ("recipe", "change"),
    [
        *((TD3Recipe(), {name: value}) for name in ("steps", "segment", "net", "batch") for value in (0, -1, 1.5)),
        *((TD3Recipe(), {name: 0}) for name in ("buffer", "envs", "updates")),
        (TD3Recipe(), dict(learning_starts=-1)),
        (TD3Recipe(), dict(action_noise=-0.1)),
        *((PPORecipe(), {name: value}) for name in ("steps", "segment", "net", "rollout") for value in (0, -1, 1.5)),
        *((PPORecipe(), {name: 0}) for name in ("envs", "epochs", "batch")),
        *((PPORecipe(), {name: value}) for name in ("gamma", "gae_lambda") for value in (-0.1, 1.1, np.nan)),
        (PPORecipe(), dict(clip=0.0)),
        (PPORecipe(), dict(log_std=np.inf)),
        (PPORecipe(), dict(activation="elu")),
        *(
            (kind(), dict(learning_rate=rate))
            for kind in (TD3Recipe, PPORecipe, AdversaryRecipe)
            for rate in (0, np.nan)
        ),
        (AdversaryRecipe(), dict(timing="random")),
        (AdversaryRecipe(), dict(entropy=-1.0)),
        (AdversaryRecipe(), dict(steps=0)),
    ],
    ids=str,
)
def test_a_recipe_with_a_bad_number_is_refused_by_name(recipe, change):
    with pytest.raises(ValueError, match=f"{next(iter(change))} must be"):
        replace(recipe, **change)
