"""The records of defended victims, and the paper's numbers beside them."""

import numpy as np
import pytest
from builders import record

from detden_lite.attacks import catalogue
from detden_lite.core.files import ArtifactError
from detden_lite.defense.variants import MAIN
from detden_lite.results.bare_victims import UNATTACKED
from detden_lite.results.defended_victims import at_worst, load_defended, of_clean, on_average, worst
from detden_lite.store import manifest

RNG = np.random.default_rng(0)


def ship(root, **returns) -> None:
    for name, values in returns.items():
        path = root / "results" / f"hopper-td3.{name.replace('_', '.')}.{MAIN}.json"
        manifest.write_json(path, record(values).to_json(), root)


def test_only_records_of_this_defence_are_loaded(tmp_path):
    assert load_defended("hopper", "td3", root=tmp_path) == {}
    ship(tmp_path, none_always=[10, 12], enchanting_vulnerable=[3, 5])
    assert set(load_defended("hopper", "td3", root=tmp_path)) == {UNATTACKED, ("enchanting", "vulnerable")}
    assert load_defended("hopper", "td3", "printed", tmp_path) == {}


def test_an_altered_record_of_a_defence_is_refused(tmp_path):
    ship(tmp_path, none_always=[10, 12])
    path = tmp_path / "results" / f"hopper-td3.none.always.{MAIN}.json"
    path.write_text(path.read_text().replace("12.0", "99.0"))
    with pytest.raises(ArtifactError, match="truncated or altered"):
        load_defended("hopper", "td3", root=tmp_path)


def test_the_worst_cell_is_attacked():
    records = {UNATTACKED: record([0, 0])}
    assert worst(records) is None and at_worst(records, record([10, 10])) is None
    records |= {("opposite", "always"): record([5, 6]), ("optimal", "vulnerable"): record([5, 5])}
    assert worst(records) == ("optimal", "vulnerable")
    cell, part = at_worst(records, record([10, 10]))
    assert cell == ("optimal", "vulnerable") and part == of_clean(record([5, 5]), record([10, 10]))


def test_the_kept_share_is_a_ratio_of_paired_means():
    """Episodes that differ widely, of all of which the same part is kept: the part is known better than the returns."""
    bare = RNG.normal(1_000, 300, 60)
    part = of_clean(record(0.8 * bare), record(bare))
    assert (part.mean, part.low, part.high) == pytest.approx((0.8, 0.8, 0.8)) and str(part) == "80% [80%, 80%]"
    noisy = of_clean(record(0.8 * bare + RNG.normal(0, 50, 60)), record(bare))
    assert noisy.low < 0.8 < noisy.high and noisy.high - noisy.low < 0.1
    assert of_clean(record(0.5 * bare[:30]), record(bare)).mean == pytest.approx(0.5)  # of the episodes that both have
    with pytest.raises(ValueError, match="other episodes, from 5 and 8000000"):
        of_clean(record(bare, first=5), record(bare))


def test_the_average_over_the_attacks_needs_all_four():
    bare = RNG.normal(1_000, 300, 60)
    records = {
        (attack, "always"): record(share * bare)
        for attack, share in zip(catalogue.FOUR, (1, 0.5, 0.9, 0.8), strict=True)
    }
    assert on_average(records, record(bare)).mean == pytest.approx(0.8)
    assert on_average(records, record(bare), "vulnerable") is None
    del records["optimal", "always"]
    assert on_average(records, record(bare)) is None
