import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from builders import HOPPER, normal
from safetensors.torch import load_file

from detden_lite.victim_training import TD3Recipe, train_victim
from detden_lite.victims import Victim

RECIPE = TD3Recipe(steps=1_000, segment=200, net=16, batch=16, buffer=500, learning_starts=100)
TRAIN = f"""
from pathlib import Path
from detden_lite.tasks import get_task
from detden_lite.victim_training import TD3Recipe, train_victim
import sys
train_victim(get_task("hopper"), TD3Recipe(**{asdict(RECIPE)}), 0, Path(sys.argv[1]), checkpoint_seconds=0)
"""


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "snapshots").iterdir()}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("uninterrupted")
    train_victim(HOPPER, RECIPE, 0, folder)
    return folder


def test_every_segment_leaves_a_victim(uninterrupted):
    assert sorted(contents(uninterrupted)) == [f"{steps:08d}.safetensors" for steps in range(200, 1_001, 200)]
    config = dict(actor=[11, 16, 16, 3], critic=[14, 16, 16, 1])
    states = [load_file(path) for path in sorted((uninterrupted / "snapshots").iterdir())]
    actions = [Victim.from_state(config, state)(normal(5, 11)) for state in states]
    assert all(not torch.allclose(a, b) for a, b in zip(actions[:-1], actions[1:], strict=True))  # it learned on


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_a_training_that_is_killed_and_resumed_is_one_that_never_stopped(tmp_path, uninterrupted):
    process = subprocess.Popen([sys.executable, "-c", TRAIN, str(tmp_path)], stderr=subprocess.DEVNULL)
    while process.poll() is None and not (tmp_path / "checkpoint" / "segments.json").exists():
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert 1 <= len(contents(tmp_path)) < 5
    train_victim(HOPPER, RECIPE, 0, tmp_path)
    assert contents(tmp_path) == contents(uninterrupted)


def test_a_kill_between_two_checkpoints_loses_neither(tmp_path, uninterrupted):
    """The old one has been put aside, the new one is not yet in its place."""
    folder = shutil.copytree(uninterrupted, tmp_path / "copy")
    os.rename(folder / "checkpoint", folder / "checkpoint.old")
    (folder / "checkpoint.new").mkdir()
    shutil.rmtree(folder / "snapshots")
    assert train_victim(HOPPER, RECIPE, 0, folder) == []  # it goes on after the last segment, and does nothing anew
    assert (folder / "checkpoint" / "model.zip").exists()


def test_a_finished_training_is_not_repeated(uninterrupted):
    before = contents(uninterrupted), (uninterrupted / "checkpoint" / "model.zip").stat().st_mtime_ns
    train_victim(HOPPER, RECIPE, 0, uninterrupted)
    assert (contents(uninterrupted), (uninterrupted / "checkpoint" / "model.zip").stat().st_mtime_ns) == before


@pytest.mark.parametrize("change", [dict(seed=1), dict(net=8), dict(learning_rate=1.0)])
def test_a_folder_with_another_run_is_refused(uninterrupted, change):
    seed = change.pop("seed", 0)
    with pytest.raises(ValueError, match="recipe.json describes another run"):
        train_victim(HOPPER, TD3Recipe(**asdict(RECIPE) | change), seed, uninterrupted)


@pytest.mark.parametrize("change", [dict(steps=1_100), dict(segment=130)])
def test_segments_that_do_not_add_up_are_refused(change):
    with pytest.raises(ValueError, match="multiple"):
        TD3Recipe(**asdict(RECIPE) | change)
