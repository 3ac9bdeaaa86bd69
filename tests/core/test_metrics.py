import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from builders import BUDGET, HOPPER, make_defense, make_victim, steady
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import bootstrap, mannwhitneyu, trim_mean

from detden_lite.attacks.noise import UniformNoise
from detden_lite.attacks.timing import Random
from detden_lite.core.estimates import estimate, iqm
from detden_lite.core.metrics import (
    auroc,
    detection_delay,
    detection_delays,
    detector_scores,
    f1_at,
    live_dimensions,
    mean_absolute_error,
    score_auroc,
    summarize,
)
from detden_lite.simulation.rollout import rollout


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


def test_same_values_same_interval_and_equal_values_a_point():
    values = np.arange(10.0)
    assert estimate(values) == estimate(values)
    assert estimate(values**3) == estimate(values**3) != estimate(values**3, seed=1)
    found = estimate([5.0, 5.0, 5.0])
    assert (found.low, found.high, found.iqm_low, found.iqm_high) == (5, 5, 5, 5)
    assert str(estimate([1234.4])) == "1,234 [1,234, 1,234]"


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf], np.ones((2, 3))])
def test_values_without_a_mean_are_refused(values):
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


@given(hit=st.integers(0, 50), miss=st.integers(0, 50), false=st.integers(0, 50), right=st.integers(1, 50))
def test_f1_at_a_rate_is_that_of_counted_steps(hit, miss, false, right):
    attacked = np.repeat([True, True, False, False], [hit, miss, false, right])
    alarm = np.repeat([True, False, True, False], [hit, miss, false, right])
    scores = detector_scores(attacked, alarm)
    if hit + miss:
        found = f1_at(attacked.mean(), scores.false_negative_rate, scores.false_positive_rate)
        assert found == pytest.approx(scores.f1)


@pytest.mark.parametrize("rates", [(0, 0.1, 0.1), (1.1, 0.1, 0.1), (0.5, -0.1, 0.1), (0.5, 0.1, 2), (np.nan, 0, 0)])
def test_an_f1_at_an_invalid_rate_is_refused(rates):
    with pytest.raises(ValueError, match="rate"):
        f1_at(*rates)


def test_a_rate_without_cases_is_none():
    never, always = np.zeros(4, bool), np.ones(4, bool)
    quiet = detector_scores(never, never)
    assert (quiet.accuracy, quiet.f1, quiet.false_negative_rate, quiet.false_positive_rate) == (1, None, None, 0)
    assert detector_scores(always, always).false_positive_rate is None
    missed = detector_scores(always, never)
    assert (missed.accuracy, missed.f1, missed.false_negative_rate) == (0, 0, 1)


def test_alarms_that_do_not_fit_the_attacks_are_refused():
    with pytest.raises(ValueError, match="alarm"):
        detector_scores(np.ones((5, 3), bool), np.ones(3, bool))


def test_the_denoisers_error_is_over_attacked_steps_before_the_end():
    obs = np.zeros((2, 2, 2))
    denoised = np.array([[[1.0, 3.0], [7.0, 7.0]], [[0.0, 2.0], [9.0, 9.0]]])
    attacked = np.array([[True, False], [True, True]])
    mask = np.array([[True, True], [True, False]])
    assert mean_absolute_error(SimpleNamespace(obs=obs, denoised=denoised, attacked=attacked, mask=mask)) == 1.5
    assert (
        mean_absolute_error(SimpleNamespace(obs=obs, denoised=denoised, attacked=attacked & ~mask, mask=mask)) is None
    )


few = st.lists(st.integers(-3, 3).map(float), min_size=1, max_size=30)  # with many ties


@steady
@given(few, few)
def test_auroc_is_the_share_of_pairs_that_are_in_order(positive, negative):
    pairs = [(p > n) + (p == n) / 2 for p in positive for n in negative]
    found = auroc(positive, negative)
    assert found == pytest.approx(np.mean(pairs))
    assert found == pytest.approx(mannwhitneyu(positive, negative).statistic / len(pairs))
    assert auroc(negative, positive) == pytest.approx(1 - found)
    assert auroc(np.exp(positive), np.exp(negative)) == found  # only the order counts


def test_auroc_needs_both_kinds_and_numbers():
    assert auroc([1.0], []) is None and auroc([], [1.0]) is None
    assert auroc([2.0, 3.0], [1.0]) == 1 and auroc([1.0], [1.0]) == 0.5
    with pytest.raises(ValueError, match="positive"):
        auroc([np.nan], [1.0])


@st.composite
def many_episodes(draw):
    """Episodes of several lengths, now and then attacked, alarmed and scored; beyond an end it goes on."""
    steps, n = draw(st.integers(1, 12)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    attacked = rng.random((steps, n)) < draw(st.sampled_from([0.0, 0.3, 0.8, 1.0]))
    alarm = rng.random((steps, n)) < draw(st.sampled_from([0.0, 0.1, 0.5]))
    mask = np.arange(steps)[:, None] < rng.integers(1, steps + 1, n)
    return SimpleNamespace(
        mask=mask, attacked=attacked, alarm=alarm, score=rng.integers(0, 9, (steps, n)).astype(float)
    )


@steady
@given(many_episodes())
def test_delays_are_counted_from_each_attacks_beginning(episodes):
    expected = []
    for i in range(episodes.mask.shape[1]):
        before = False
        for t in range(episodes.mask[:, i].sum()):
            now = episodes.attacked[t, i]
            if now and not before:
                expected.append(np.inf)
                end = t
                while end < episodes.mask[:, i].sum() and episodes.attacked[end, i]:
                    if episodes.alarm[end, i]:
                        expected[-1] = end - t
                        break
                    end += 1
            before = now
    assert sorted(detection_delays(episodes)) == sorted(expected)
    found, noticed = detection_delay(episodes), [delay for delay in expected if delay < np.inf]
    assert (found.attacks, found.missed) == (len(expected), len(expected) - len(noticed))
    assert found.longest == (max(noticed) if noticed else None)
    assert found.mean == (pytest.approx(np.mean(noticed)) if noticed else None)


def test_delays_are_in_the_order_of_the_attacks():
    columns = [
        ("alarm", "..!..!", ".....!"),
        ("attacked", "xxx.x.", ".xxxxx"),  # 2, never (the alarm comes after the end); 4
    ]
    rows = {name: np.array([[c in "x!" for c in text] for text in texts]).T for name, *texts in columns}
    episodes = SimpleNamespace(mask=np.ones((6, 2), bool), **rows)
    assert detection_delays(episodes).tolist() == [2, 4, np.inf]
    short = SimpleNamespace(mask=np.arange(6)[:, None] < [6, 5], **rows)
    assert detection_delays(short).tolist() == [2, np.inf, np.inf]


@steady
@given(many_episodes(), many_episodes())
def test_the_scores_auroc_is_that_of_living_steps(episodes, clean):
    living = [(t, i) for t, i in np.ndindex(episodes.mask.shape) if episodes.mask[t, i]]
    positive = [episodes.score[at] for at in living if episodes.attacked[at]]
    others = [episodes.score[at] for at in living if not episodes.attacked[at]]
    assert score_auroc(episodes) == auroc(positive, others)
    assert score_auroc(episodes, clean) == auroc(positive, clean.score[clean.mask])


def test_a_live_dimension_varies_within_clean_episodes():
    obs = np.zeros((3, 2, 4), np.float32)
    obs[..., 0] = 1e3  # constant
    obs[..., 1] = [[0, 1], [2, 3], [4, 5]]
    obs[2, 1, 2] = 7  # after the end
    obs[0, 0, 3] = 1e-6  # hardly
    clean = SimpleNamespace(obs=obs, mask=np.array([[1, 1], [1, 1], [1, 0]], bool))
    assert live_dimensions(clean).tolist() == [False, True, False, False]
    attacked = SimpleNamespace(obs=obs, denoised=obs + [9, 2, 5, 8], attacked=clean.mask, mask=clean.mask)
    assert mean_absolute_error(attacked, live_dimensions(clean)) == 2 and mean_absolute_error(attacked) == 6
    assert mean_absolute_error(attacked, np.zeros(4, bool)) is None


def test_clean_episodes_only_add_to_a_summary():
    victim, defense = make_victim(seed=8), make_defense(threshold=1.5)
    clean = rollout(victim, HOPPER, range(6), defense=defense, steps=40)
    attacked = rollout(victim, HOPPER, range(6), attack=UniformNoise(BUDGET), defense=defense, steps=40)
    without, summary = summarize(attacked), summarize(attacked, clean)
    more = {name: summary[name] for name in summary if name not in without}
    assert {name: summary[name] for name in without} == without
    assert without["auroc"] is None and without["delay"]["attacks"] == 6  # attacked always
    assert more["auroc_clean"] == score_auroc(attacked, clean) > 0
    assert more["live_dimensions"] == 11
    assert more["denoiser_mae_live"] == pytest.approx(summary["denoiser_mae"], rel=1e-5)
    frozen = replace(clean, obs=np.where(np.arange(11) < 4, clean.obs, 0))
    assert summarize(attacked, frozen)["live_dimensions"] == 4
    error = np.abs(attacked.denoised - attacked.obs)[attacked.mask][:, :4].mean()
    assert summarize(attacked, frozen)["denoiser_mae_live"] == pytest.approx(error, rel=1e-5)
    quiet = summarize(clean, clean)
    assert quiet["auroc"] is quiet["auroc_clean"] is quiet["denoiser_mae_live"] is None
    assert quiet["delay"] == dict(attacks=0, missed=0, mean=None, longest=None)
    for found in (summary, quiet):
        assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_a_summary_ignores_the_steps_after_an_episodes_end():
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
