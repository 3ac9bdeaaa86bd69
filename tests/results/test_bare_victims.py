"""The records of undefended victims, and the paper's numbers beside them."""

import numpy as np
import pytest
from builders import BUDGET, HOPPER, make_victim, record

from detden_lite.attacks.catalogue import FOUR, TIMINGS, TITLES
from detden_lite.attacks.threat import Threat
from detden_lite.core.files import ArtifactError
from detden_lite.recipe.episode_seeds import SEEDS
from detden_lite.recipe.evaluation import run_cell
from detden_lite.results.adaptive_attacks import worst_on_record
from detden_lite.results.bare_victims import CELLS, UNATTACKED, difference, failed, fallen, load_bare, share, strikes
from detden_lite.results.cells import Cell
from detden_lite.results.paper import ATTACKED, ROWS
from detden_lite.results.paper import CLEAN as PAPER_CLEAN
from detden_lite.store import manifest


def ship(root, **returns) -> None:
    """Records of Hopper and TD3, named "attack_timing"."""
    for name, values in returns.items():
        attack, timing = name.split("_")
        path = root / "results" / f"hopper-td3.{attack}.{timing}.none.json"
        manifest.write_json(path, record(values).to_json(), root)


def test_the_paper_has_forty_numbers_all_below_its_clean_returns():
    assert set(ATTACKED) == set(ROWS)
    assert {tuple(row) for row in ATTACKED.values()} == {("opposite", "qfunction", "optimal", "enchanting")}
    assert all(number < PAPER_CLEAN[victim] for victim, row in ATTACKED.items() for number in row.values())
    assert {attack for attack, _ in CELLS} <= set(TITLES)


def test_the_four_attacks_meet_each_victim_at_every_timing_and_their_controls_at_the_same_rates():
    for attack in FOUR:
        assert {timing for name, timing in CELLS if name == attack} >= {"always", "vulnerable", "third"}
    assert {timing for _, timing in CELLS} == set(TIMINGS)


def test_only_records_that_are_there_are_loaded(tmp_path):
    assert load_bare("hopper", "td3", tmp_path) == {}
    ship(tmp_path, none_always=[10, 12], opposite_always=[3, 5], opposite_random=[1, 1], uniform_always=[8, 8])
    assert set(load_bare("hopper", "td3", tmp_path)) == {
        UNATTACKED, ("opposite", "always"), ("opposite", "random"), ("uniform", "always"),
    }  # fmt: skip
    assert load_bare("hopper", "ppo", tmp_path) == {}


def test_an_altered_record_is_refused(tmp_path):
    ship(tmp_path, none_always=[10, 12])
    path = tmp_path / "results" / "hopper-td3.none.always.none.json"
    path.write_text(path.read_text().replace("12.0", "99.0"))
    with pytest.raises(ArtifactError, match="truncated or altered"):
        load_bare("hopper", "td3", tmp_path)


def test_the_worst_is_of_the_whole_suite_noise_and_random_timings_included(tmp_path):
    ship(tmp_path, none_always=[10, 12], opposite_always=[4, 4], qfunction_vulnerable=[3, 4])
    records = load_bare("hopper", "td3", tmp_path)
    for worst, left in (("qfunction_vulnerable", 3.5), ("opposite_random", 3), ("uniform_always", 1)):
        ship(tmp_path, **{worst: [left, left]})
        cell, part = worst_on_record("hopper", "td3", "none", tmp_path)
        assert cell == tuple(worst.split("_")) and part.mean == pytest.approx(left / 11)
    assert share(records["qfunction", "vulnerable"], records[UNATTACKED]) == pytest.approx(3.5 / 11)


def test_a_difference_is_of_the_same_episodes():
    """Episodes that differ widely from each other and little from attack to attack have a narrow difference."""
    rng = np.random.default_rng(0)
    starts, gain = rng.normal(1_000, 500, 50), rng.normal(20, 1, 50)
    found = difference(record(starts + gain), record(starts))
    assert found.mean == pytest.approx(gain.mean()) and 19 < found.low < found.high < 21
    assert difference(record(starts + gain), record(starts[:30])).mean == pytest.approx(gain[:30].mean())
    with pytest.raises(ValueError, match="other episodes, from seeds 8000000 and 5000000 on"):
        difference(record(starts), record(starts, first=5_000_000))


def test_an_adaptive_attack_that_spares_the_victim_has_failed():
    """Episode by episode and beyond chance; one that is merely no better has not."""
    rng = np.random.default_rng(0)
    starts, noise = rng.normal(1_000, 500, 50), rng.normal(0, 5, 50)
    plain, spared, same, worse = (record(starts + gain + noise * bool(gain)) for gain in (0, 20, 0.1, -20))
    assert failed(spared, plain) and not failed(same, plain) and not failed(worse, plain)
    with pytest.raises(ValueError, match="other cells: their defense is mixed and both"):
        failed(spared, record(starts, cell=dict(attack="opposite", timing="always", defense="both")))


@pytest.mark.parametrize("task, algo", ROWS)
def test_shipped_records_begin_with_the_first_report_episode(task, algo):
    """Those of one victim can be compared with each other."""
    records = load_bare(task, algo)
    assert {found["seeds"][0] for found in records.values()} <= {SEEDS["report"]}
    assert all(found["cell"]["defense"] == "none" and found["task"] == task for found in records.values())


def test_an_episode_that_ends_early_has_fallen():
    assert fallen(record([1.0, 2.0, 3.0, 4.0], lengths=[1000, 999, 1000, 20])) == 0.5
    assert fallen(record([1.0], task="ant", lengths=[1000])) == 0


def test_strikes_are_the_attacked_steps_of_an_episode():
    threat = Threat(BUDGET, steps=1, rate=0.5)
    found, episodes = run_cell(
        Cell("opposite", "random"), HOPPER, make_victim(seed=8), threat, None, range(4), steps=26
    )
    counted = (episodes.attacked & episodes.mask).sum(0).mean()
    assert 0 < counted < episodes.lengths.mean() and strikes(found) == pytest.approx(counted)
