import csv
import shutil

import pytest

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
        record = records.load_record(name)
        assert float(line["mean"]) == record["estimate"]["mean"] and int(line["n"]) == len(record["returns"])
        for column, value in (
            ("accuracy", record["detector"]["accuracy"]), ("f1", record["detector"]["f1"]),
            ("mae", record["denoiser_mae"]), ("attack_rate", record["attack_rate"]), ("auroc", record.get("auroc")),
            ("auroc_clean", record.get("auroc_clean")), ("mae_live", record.get("denoiser_mae_live")),
            ("delay", (record.get("delay") or {}).get("mean")), ("missed", (record.get("delay") or {}).get("missed")),
        ):  # fmt: skip
            assert line[column] == ("" if value is None else str(value)), (name, column)


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
