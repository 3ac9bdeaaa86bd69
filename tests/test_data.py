"""The files of data/ are those of its manifest, and the records agree with themselves."""

import json

import numpy as np
import pytest

from detden_lite import artifacts

RECORDS = sorted((artifacts.DATA / "results").glob("*.json"))


def test_the_manifest_lists_every_file_and_every_file_is_as_listed():
    files = {p.relative_to(artifacts.DATA).as_posix() for p in artifacts.DATA.rglob("*") if p.is_file()}
    listed = set(json.loads((artifacts.DATA / "manifest.json").read_text()))
    assert files - {"manifest.json", "README.md", ".manifest.lock"} == listed
    for name in listed:
        artifacts.read_bytes(artifacts.DATA / name)


def test_data_is_small_and_holds_no_pickle():
    files = [p for p in artifacts.DATA.rglob("*") if p.is_file()]
    assert sum(p.stat().st_size for p in files) < 20e6
    assert not [p for p in files if p.suffix in {".pkl", ".pickle", ".pt", ".pth", ".npz", ".npy", ".zip"}]


def test_victim_and_defences_load():
    assert artifacts.load_victim("hopper", "td3").obs_dim == 11
    for variant in ("printed", "diverse", "residual"):
        assert artifacts.load_defense("hopper", "td3", variant).detector.threshold > 0


@pytest.mark.parametrize("path", RECORDS, ids=lambda p: p.stem)
def test_a_records_estimate_is_that_of_its_returns(path):
    record = artifacts.load_record(path.stem)
    returns = np.array(record["returns"])
    assert len(returns) == record["seeds"][1] == record["estimate"]["n"] >= 100
    assert record["estimate"]["mean"] == pytest.approx(returns.mean())
    assert record["estimate"]["low"] <= returns.mean() <= record["estimate"]["high"]
