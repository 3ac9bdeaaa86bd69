"""Which attacks have failed: planted returns, and laws that hold for any."""

import numpy as np
import pytest
from builders import record, steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.attacks.catalogue import CATALOGUE, CONTROLS
from detden_lite.results.strength import beaten_by, chance_of_excess, holm, knowledge, verdict

RNG = np.random.default_rng(0)
STARTS, NOISE = RNG.normal(1_000, 300, 60), RNG.normal(0, 20, 60)
CHANCES = st.lists(st.floats(0, 1), max_size=12)


def planted(**left):
    """Records of episodes that differ widely; of each attack what it leaves, by "attack_timing"."""
    return {tuple(name.rsplit("_", 1)): record(STARTS - 1_000 + mean + NOISE) for name, mean in left.items()}


def test_an_attack_that_is_weaker_than_noise_has_failed():
    found = beaten_by(planted(none_always=1_000, uniform_always=500, opposite_always=700, qfunction_always=300))
    assert found == {("opposite", "always"): ("uniform",), ("qfunction", "always"): ()}


def test_only_an_attack_that_knows_no_more_counts():
    """The critic is known to one of the two; of another pair each knows what the other does not."""
    assert beaten_by(planted(opposite_always=700, qfunction_always=300))["opposite", "always"] == ()
    assert beaten_by(planted(opposite_always=300, qfunction_always=700))["qfunction", "always"] == ("opposite",)
    assert not any(beaten_by(planted(optimal_always=700, opposite_always=300)).values())


def test_an_adversary_that_learned_against_the_defence_knows_it():
    found = beaten_by({("optimal", "always"): record(STARTS), ("adaptive-optimal", "always"): record(STARTS - 200)})
    assert not any(found.values())
    found = beaten_by({("optimal", "always"): record(STARTS - 200), ("adaptive-optimal", "always"): record(STARTS)})
    assert found["adaptive-optimal", "always"] == ("optimal",)


def test_only_attacks_at_the_same_timing_are_compared():
    assert not any(beaten_by(planted(uniform_always=100, opposite_vulnerable=700)).values())
    found = beaten_by(planted(opposite_vulnerable=300, qfunction_vulnerable=700, opposite_always=900))
    assert found["qfunction", "vulnerable"] == ("opposite",)


def test_the_strongest_of_those_that_beat_it_stands_first():
    found = beaten_by(planted(uniform_always=600, gaussian_always=500, opposite_always=550, qfunction_always=900))
    assert found["qfunction", "always"] == ("gaussian", "opposite", "uniform")
    assert found["opposite", "always"] == ("gaussian",)
    assert verdict(found["qfunction", "always"]) == "failed: Gaussian noise leaves less"
    assert verdict(()) == ""


def test_controls_are_beaten_by_nobody_and_every_other_attack_is_judged():
    found = beaten_by({(name, "always"): record(STARTS + i) for i, name in enumerate(CATALOGUE)})
    assert set(found) == {(name, "always") for name in CATALOGUE if name not in CONTROLS}


def test_what_chance_gives_is_no_failure():
    """Attacks that are equally strong, on two hundred victims: a wrong flag on at most one in twenty, and a few."""
    rng, wrong = np.random.default_rng(1), 0
    for _ in range(200):
        names = ("uniform", "gaussian", "opposite", "qfunction")
        wrong += any(beaten_by({(name, "always"): record(rng.normal(size=20)) for name in names}).values())
    assert wrong <= 22  # the chance of more is below 0.1 % at 5 %


def test_fewer_episodes_are_compared_with_the_first_ones_of_more():
    long = np.concatenate([STARTS, np.full(40, -1e6)])
    found = beaten_by({("opposite", "always"): record(long), ("enchanting", "always"): record(STARTS + 5)})
    assert found["enchanting", "always"] == ("opposite",)


def test_records_of_other_episodes_are_refused():
    with pytest.raises(ValueError, match="other episodes, from seeds 8000000 and 5000000 on"):
        beaten_by({("uniform", "always"): record(STARTS, first=5_000_000), ("opposite", "always"): record(STARTS)})


def test_everybody_knows_at_least_what_their_attack_asks_for():
    for name, entry in CATALOGUE.items():
        assert knowledge(name) >= entry.needs
        assert ("defense" in knowledge(name)) == (entry.group == "aware")


@steady
@given(st.lists(st.integers(-50, 50), min_size=1, max_size=12), st.integers(-50, 50))
def test_the_chance_of_an_excess_is_a_p(gaps, shift):
    """Between 0 and 1, 1 if there is no excess, and the same if all episodes are harder."""
    one, other = record(gaps), record([0] * len(gaps))
    chance = chance_of_excess(one, other, draws=199)
    assert 1 / 200 <= chance <= 1
    assert chance == 1 or sum(gaps) > 0
    moved = chance_of_excess(record([gap + shift for gap in gaps]), record([shift] * len(gaps)), draws=199)
    assert moved == chance


def test_the_chance_is_that_of_all_signs():
    """Five gaps alike: only one of the 32 signs gives as much."""
    assert chance_of_excess(record([1] * 5), record([0] * 5)) == pytest.approx(1 / 32, abs=0.006)


def test_two_episodes_prove_nothing():
    for seed in range(20):
        one, other = np.random.default_rng(seed).normal(size=(2, 2))
        assert chance_of_excess(record(one), record(other)) > 0.2


@steady
@given(CHANCES, st.floats(0.001, 0.999))
def test_holm_rejects_as_bonferroni_does_or_more_and_the_smallest_first(chances, level):
    rejected = holm(chances, level)
    assert len(rejected) == len(chances)
    for p, found in zip(chances, rejected, strict=True):
        assert found or p > level / len(chances)
        assert not found or p <= level
        assert not found or all(other for q, other in zip(chances, rejected, strict=True) if q < p)


@pytest.mark.parametrize(("chances", "level"), [([1.5], 0.05), ([-0.1], 0.05), ([float("nan")], 0.05), ([0.1], 0.0)])
def test_holm_refuses_what_is_no_chance(chances, level):
    with pytest.raises(ValueError, match="between 0 and 1"):
        holm(chances, level)
