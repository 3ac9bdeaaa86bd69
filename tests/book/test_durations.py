import json
import os
import subprocess
import sys
import time
from dataclasses import replace

import durations
import pytest

from detden_lite.core.files import ArtifactError
from detden_lite.recipe.scales import TINY_VICTIMS
from detden_lite.store import manifest

HEADER = "s\th:m:s\tmax_rss\tmax_vms\tmax_uss\tmax_pss\tio_in\tio_out\tmean_load\tcpu_time\n"


def benchmark(root, name: str, seconds: str, memory: str, cpu: str) -> None:
    path = root / "benchmarks" / f"{name}.tsv"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(HEADER + "\t".join([seconds, "0:00:00", memory, *"12345", "6", cpu]) + "\n")


@pytest.fixture
def run(tmp_path):
    root = tmp_path / "lite"
    benchmark(root, "victim/hopper-td3.0", "4000", "900.5", "3600")
    benchmark(root, "victim/hopper-td3.1", "8000", "800", "7200")
    benchmark(root, "select/hopper-td3", "90", "700", "60")
    benchmark(root, "qfunction/ant-ppo", "0.1", "NA", "NA")
    return root


def test_the_jobs_of_a_stage_are_summed_up(run):
    record = durations.measure(run)
    assert record["run"] == "lite" and record["machine"]["cores"] >= 1
    hopper = record["rows"]["hopper-td3"]
    assert hopper["victim"] == dict(jobs=2, cpu_seconds=10_800, wall_seconds=12_000, memory_mb=900.5)
    assert hopper["select"]["jobs"] == 1 and "qfunction" not in hopper
    assert record["rows"]["ant-ppo"] == {"qfunction": dict(jobs=1, cpu_seconds=0, wall_seconds=0.1, memory_mb=0)}
    json.dumps(record, allow_nan=False)


def test_the_table_names_only_stages_that_were_measured(run):
    names, *lines = durations.table(durations.measure(run))
    assert names == ["row", "victim", "select", "qfunction", "all"]
    assert ["hopper-td3", "3.0 h", "1 min", "–", "3.0 h"] in lines and ["ant-ppo", "–", "–", "0 s", "0 s"] in lines


def command_line(data, *arguments) -> subprocess.CompletedProcess:
    """Run the tool with another folder for data/."""
    program = [sys.executable, durations.__file__, *map(str, arguments)]
    return subprocess.run(program, capture_output=True, text=True, env=os.environ | dict(DETDEN_DATA=str(data)))


def test_what_was_measured_is_stored_and_printed(run, tmp_path):
    stored = command_line(tmp_path / "data", "--root", run, "--store")
    assert stored.returncode == 0 and "hopper-td3" in stored.stdout and "3.0 h" in stored.stdout
    found = manifest.read_json(tmp_path / "data" / durations.RECORD, tmp_path / "data")
    assert found == durations.measure(run) and "trainings" not in found
    assert command_line(tmp_path / "data").stdout == stored.stdout


def test_measurements_of_another_run_are_kept(run, tmp_path):
    durations.show(run, store=True, data=tmp_path / "data")
    before = durations.measure(run)["rows"]
    other = tmp_path / "other"
    benchmark(other, "select/hopper-td3", "30", "700", "20")
    benchmark(other, "detector/walker2d-ppo", "30", "700", "20")
    durations.show(other, store=True, data=tmp_path / "data")
    rows = manifest.read_json(tmp_path / "data" / durations.RECORD, tmp_path / "data")["rows"]
    assert rows["ant-ppo"] == before["ant-ppo"] and rows["hopper-td3"]["victim"] == before["hopper-td3"]["victim"]
    assert rows["hopper-td3"]["select"]["cpu_seconds"] == 20 and "detector" in rows["walker2d-ppo"]


def test_missing_measurements_are_an_error(run, tmp_path):
    with pytest.raises(ArtifactError, match="durations.json is missing"):
        durations.show(run, data=tmp_path)
    with pytest.raises(ArtifactError, match="holds no measurement; run `make data` first"):
        durations.show(tmp_path / "empty", store=True, data=tmp_path)


def test_the_speed_of_trainings_is_stored_beside_the_rest(run, tmp_path, monkeypatch):
    recipe = replace(TINY_VICTIMS["ppo"], steps=512, segment=512)
    durations.show(run, store=True, data=tmp_path)
    monkeypatch.setattr(durations.measure_trainings, "__defaults__", ({("hopper", "ppo"): recipe},))
    start = time.perf_counter()
    durations.show(run, trainings=True, data=tmp_path)
    spent = time.perf_counter() - start
    record = manifest.read_json(tmp_path / durations.RECORD, tmp_path)
    speed = record["trainings"]["hopper-ppo"]["steps_per_second"]
    # A segment, one of three, cannot have taken longer than all of it.
    assert 4 * recipe.envs * recipe.rollout / speed < spent
    assert record.pop("trainings").keys() == {"hopper-ppo"} and record == durations.measure(run)


def test_the_time_of_a_training_is_steps_by_speed():
    record = dict(trainings={"hopper-td3": dict(steps=500_000, steps_per_second=250.0)})
    assert durations.trainings_table(record)[1] == ["hopper-td3", "500,000", "250", "33 min"]
    assert durations.table(record) == [["row", "all"]]
