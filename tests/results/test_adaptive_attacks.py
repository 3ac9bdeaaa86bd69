"""The records of attackers who know the defence, beside those of attackers who do not."""

import numpy as np
import pytest
import yaml
from builders import record
from conftest import ROOT

from detden_lite.attacks import catalogue
from detden_lite.core.files import ArtifactError
from detden_lite.defense.variants import MAIN
from detden_lite.results import defended_victims
from detden_lite.results.adaptive_attacks import ADAPTED_ROWS, change, compare, load_adaptive, worst_on_record
from detden_lite.results.bare_victims import UNATTACKED
from detden_lite.store import manifest

RNG = np.random.default_rng(0)


def ship(root, attack: str, returns) -> None:
    path = root / "results" / f"hopper-td3.{attack}.always.{MAIN}.json"
    manifest.write_json(path, record(returns).to_json(), root)


def test_the_rows_are_those_that_the_recipe_adapts_to():
    for path in (ROOT / "data" / "config").glob("*.yaml"):
        assert yaml.safe_load(path.read_text())["adapted"] == ["-".join(row) for row in ADAPTED_ROWS]


def test_every_adaptive_attack_has_an_unaware_one_and_a_title():
    unaware = {catalogue.CATALOGUE[attack].unaware for attack in catalogue.ADAPTIVE}
    assert unaware == {*catalogue.FOUR, "offset", "director"}
    assert len({catalogue.TITLES[attack] for attack in catalogue.ADAPTIVE}) == len(catalogue.ADAPTIVE)
    assert catalogue.TITLES["adaptive-qfunction"] == "Q-function, adaptive"


def test_only_adaptive_records_of_this_defence_are_loaded(tmp_path):
    assert load_adaptive("hopper", "td3", root=tmp_path) == {}
    for attack in ("none", "opposite", "text-opposite", "adaptive-optimal"):
        ship(tmp_path, attack, [10.0, 12.0])
    assert set(load_adaptive("hopper", "td3", root=tmp_path)) == {
        ("text-opposite", "always"),
        ("adaptive-optimal", "always"),
    }
    assert load_adaptive("hopper", "td3", "printed", tmp_path) == {}


def test_an_altered_adaptive_record_is_refused(tmp_path):
    ship(tmp_path, "text-opposite", [10.0, 12.0])
    path = tmp_path / "results" / f"hopper-td3.text-opposite.always.{MAIN}.json"
    path.write_text(path.read_text().replace("12.0", "99.0"))
    with pytest.raises(ArtifactError, match="truncated or altered"):
        load_adaptive("hopper", "td3", root=tmp_path)


def ship_clean(root, returns) -> None:
    manifest.write_json(root / "results" / "hopper-td3.none.always.none.json", record(returns).to_json(), root)


@pytest.mark.parametrize(("aware", "worst"), [(30.0, "adaptive-optimal"), (60.0, "opposite")])
def test_the_worst_on_record_is_the_lowest_of_both_kinds_of_attacks(tmp_path, aware, worst):
    assert worst_on_record("hopper", "td3", root=tmp_path) is None
    ship_clean(tmp_path, [100.0, 100.0])
    assert worst_on_record("hopper", "td3", root=tmp_path) is None
    for attack, left in (("none", 10.0), ("opposite", 40.0), ("adaptive-optimal", aware)):
        ship(tmp_path, attack, [left, left])
    cell, share = worst_on_record("hopper", "td3", root=tmp_path)
    assert cell == (worst, "always")
    assert share.mean == pytest.approx(min(aware, 40.0) / 100)


def test_without_the_clean_record_no_worst_part_is_told(tmp_path):
    ship(tmp_path, "opposite", [40.0, 40.0])
    assert worst_on_record("hopper", "td3", root=tmp_path) is None


def test_a_change_compares_the_means_of_the_same_episodes():
    """Returns that differ widely, and of which all lose the same part: the part is known exactly."""
    plain = RNG.normal(1_000, 300, 60)
    lost = change(record(0.8 * plain[:40]), record(plain))
    assert (lost.mean, lost.low, lost.high) == pytest.approx((-0.2, -0.2, -0.2))
    noisy = change(record(1.1 * plain + RNG.normal(0, 50, 60)), record(plain))
    assert 0 < noisy.low < noisy.mean < noisy.high < 0.2
    assert change(record(plain), record(-plain)) is None  # per cent of what?


def test_an_adaptive_attack_that_does_worse_has_failed(tmp_path):
    returns = RNG.normal(1_000, 300, 60)
    for attack, part in (("none", 2.0), ("opposite", 1.0), ("text-opposite", 1.5), ("adaptive-opposite", 0.5)):
        ship(tmp_path, attack, part * returns)
    ship(tmp_path, "text-qfunction", returns)  # whose unaware one has no record
    adaptive, plain = (
        load_adaptive("hopper", "td3", root=tmp_path),
        defended_victims.load_defended("hopper", "td3", root=tmp_path),
    )
    printed, proper = compare(adaptive, plain)
    assert (printed.attack, printed.unaware, proper.attack) == ("text-opposite", "opposite", "adaptive-opposite")
    assert printed.failed and not proper.failed
    assert printed.change.mean == pytest.approx(0.5) and proper.change.mean == pytest.approx(-0.5)
    assert proper.record is adaptive["adaptive-opposite", "always"]


def test_the_worst_attack_is_found_among_all_records(tmp_path):
    assert defended_victims.worst({UNATTACKED: record([1, 2])}) is None
    adaptive, plain = {("text-opposite", "always"): record([5, 6])}, {("optimal", "vulnerable"): record([4, 5])}
    assert defended_victims.worst(plain | adaptive) == ("optimal", "vulnerable")
    assert defended_victims.worst(adaptive) == ("text-opposite", "always")
