from types import SimpleNamespace

import numpy as np
import pytest
from builders import BUDGET, HOPPER, make_defense, make_victim
from scipy.stats import bootstrap, trim_mean

from detden_lite.attacks import Random, UniformNoise
from detden_lite.metrics import detector_scores, estimate, iqm, mean_absolute_error, summarize
from detden_lite.rollout import rollout


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 50, 101])
def test_the_interquartile_mean_is_scipys_trimmed_mean(n):
    values = np.random.default_rng(n).exponential(size=(3, n))
    assert np.allclose(iqm(values), trim_mean(values, 0.25, axis=-1))
    assert np.allclose(iqm(values.T, axis=0), iqm(values))


def test_the_intervals_are_scipys_bootstrap():
    values = np.random.default_rng(0).exponential(1_000, size=60)
    found = estimate(values, resamples=20_000)
    for statistic, low, high in ((np.mean, found.low, found.high), (iqm, found.iqm_low, found.iqm_high)):
        expected = bootstrap((values,), statistic, method="percentile", n_resamples=20_000, rng=1).confidence_interval
        assert np.allclose([low, high], expected, rtol=0.02)
    assert found.mean == pytest.approx(values.mean()) and found.iqm == pytest.approx(trim_mean(values, 0.25))
    assert found.n == 60


def test_the_same_values_give_the_same_interval_and_equal_values_a_point():
    values = np.arange(10.0)
    assert estimate(values) == estimate(values)
    assert estimate(values**3) == estimate(values**3) != estimate(values**3, seed=1)
    found = estimate([5.0, 5.0, 5.0])
    assert (found.low, found.high, found.iqm_low, found.iqm_high) == (5, 5, 5, 5)
    assert str(estimate([1234.4])) == "1,234 [1,234, 1,234]"


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf], np.ones((2, 3))])
def test_what_has_no_mean_is_refused(values):
    with pytest.raises(ValueError, match="values"):
        estimate(values)


def test_detector_scores_by_hand():
    attacked = np.array([1, 1, 1, 1, 0, 0, 0, 0, 0, 0], bool)
    alarm = np.array([1, 1, 1, 0, 1, 1, 0, 0, 0, 0], bool)  # 3 hits, 1 miss, 2 false alarms, 4 rightly silent
    scores = detector_scores(attacked, alarm)
    assert scores.accuracy == pytest.approx(0.7)
    assert scores.f1 == pytest.approx(2 * (3 / 5) * (3 / 4) / (3 / 5 + 3 / 4))
    assert scores.false_negative_rate == pytest.approx(1 / 4)
    assert scores.false_positive_rate == pytest.approx(2 / 6)


def test_a_rate_of_nothing_is_none():
    never, always = np.zeros(4, bool), np.ones(4, bool)
    quiet = detector_scores(never, never)
    assert (quiet.accuracy, quiet.f1, quiet.false_negative_rate, quiet.false_positive_rate) == (1, None, None, 0)
    assert detector_scores(always, always).false_positive_rate is None
    missed = detector_scores(always, never)
    assert (missed.accuracy, missed.f1, missed.false_negative_rate) == (0, 0, 1)


def test_alarms_that_do_not_fit_the_attacks_are_refused():
    with pytest.raises(ValueError, match="alarm"):
        detector_scores(np.ones((5, 3), bool), np.ones(3, bool))


def test_the_error_of_the_denoiser_counts_attacked_steps_of_living_episodes():
    obs = np.zeros((2, 2, 2))
    denoised = np.array([[[1.0, 3.0], [7.0, 7.0]], [[0.0, 2.0], [9.0, 9.0]]])
    attacked = np.array([[True, False], [True, True]])
    mask = np.array([[True, True], [True, False]])
    assert mean_absolute_error(SimpleNamespace(obs=obs, denoised=denoised, attacked=attacked, mask=mask)) == 1.5
    assert (
        mean_absolute_error(SimpleNamespace(obs=obs, denoised=denoised, attacked=attacked & ~mask, mask=mask)) is None
    )


def test_a_summary_says_what_happened_and_ignores_what_came_after_the_end():
    victim = make_victim(seed=8)
    parts = dict(attack=UniformNoise(BUDGET), timing=Random(0.5), defense=make_defense(threshold=1.5))
    episodes = rollout(victim, HOPPER, range(6), **parts, steps=40)
    summary = summarize(episodes)
    assert summary["returns"] == episodes.returns.tolist() and summary["lengths"] == episodes.lengths.tolist()
    assert summary["estimate"]["mean"] == pytest.approx(np.mean(summary["returns"]))
    living = [(t, i) for i, length in enumerate(episodes.lengths) for t in range(length)]
    attacked, alarm = ([bool(rows[at]) for at in living] for rows in (episodes.attacked, episodes.alarm))
    assert summary["attack_rate"] == pytest.approx(np.mean(attacked))
    assert summary["detector"]["accuracy"] == pytest.approx(np.mean(np.equal(attacked, alarm)))
    errors = [
        np.abs(episodes.denoised[at] - episodes.obs[at]).mean() for at, a in zip(living, attacked, strict=True) if a
    ]
    assert summary["denoiser_mae"] == pytest.approx(np.mean(errors), rel=1e-4)
