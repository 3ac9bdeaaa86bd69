import csv
import shutil

import numpy as np
import pytest
from builders import record

from detden_lite.core.files import ArtifactError
from detden_lite.results import records, table
from detden_lite.store import manifest
from detden_lite.store.manifest import DATA


def test_the_table_has_a_line_for_each_record(tmp_path):
    shutil.copytree(DATA / "results", tmp_path / "results")
    shutil.copy(DATA / "manifest.json", tmp_path)
    with table.write_table(tmp_path).open(newline="") as file:
        lines = {
            ".".join(line[key] for key in ("row", "attack", "timing", "defense")): line for line in csv.DictReader(file)
        }
    assert set(lines) == {path.stem for path in (DATA / "results").glob("*.json")}
    for name, line in lines.items():
        found = records.load_record(name)
        for stronger in line["beaten_by"].split():
            assert ".".join([line["row"], stronger, line["timing"], line["defense"]]) in lines
        assert float(line["mean"]) == found["estimate"]["mean"] and int(line["n"]) == len(found["returns"])
        for column, value in (
            ("accuracy", found["detector"]["accuracy"]), ("f1", found["detector"]["f1"]),
            ("mae", found["denoiser_mae"]), ("attack_rate", found["attack_rate"]), ("auroc", found.get("auroc")),
            ("auroc_clean", found.get("auroc_clean")), ("mae_live", found.get("denoiser_mae_live")),
            ("delay", (found.get("delay") or {}).get("mean")), ("missed", (found.get("delay") or {}).get("missed")),
        ):  # fmt: skip
            assert line[column] == ("" if value is None else str(value)), (name, column)


def test_the_table_says_which_attacks_have_failed(tmp_path):
    for attack, left in (("none", 9.0), ("uniform", 4.0), ("opposite", 6.0), ("qfunction", 2.0)):
        found = record(np.linspace(left, left + 1, 30), cell=dict(attack=attack, timing="always", defense="none"))
        manifest.write_json(tmp_path / "results" / f"hopper-td3.{attack}.always.none.json", found.to_json(), tmp_path)
    beaten = {line["attack"]: line["beaten_by"] for line in table.collect_records(tmp_path)}
    assert beaten == dict(none="", uniform="", opposite="uniform", qfunction="")


def test_a_table_without_records_is_refused(tmp_path):
    with pytest.raises(ArtifactError, match="holds no record; run the evaluate stage first"):
        table.write_table(tmp_path)


@pytest.mark.parametrize(
    ("content", "problem"), [('{"cell": {}}', "truncated or altered"), ("{}", "not a result record")]
)
def test_a_table_of_damaged_records_is_refused(tmp_path, content, problem):
    path = tmp_path / "results" / "hopper-td3.none.always.none.json"
    manifest.write_bytes(path, b"{}", tmp_path)
    path.write_text(content)
    with pytest.raises(ArtifactError, match=problem):
        table.write_table(tmp_path)
    assert not (tmp_path / "tables").exists()
