"""Every check passes on a solution and fails on plausible mistakes."""

import numpy as np
import pytest
import torch

from detden_lite.checks import detector as checks


def sample_latent(mean, log_variance, noise):
    return mean + (0.5 * log_variance).exp() * noise


def kl(mean, log_variance, prior_mean):
    return 0.5 * (log_variance.exp() + (mean - prior_mean) ** 2 - 1 - log_variance).sum(-1)


def calibrate(clean_scores, false_alarm_rate):
    return np.quantile(clean_scores, 1 - false_alarm_rate)


def scores(attacked, alarm):
    hit, miss, false = (attacked & alarm).sum(), (attacked & ~alarm).sum(), (~attacked & alarm).sum()
    return (attacked == alarm).mean(), 2 * hit / (2 * hit + miss + false), miss / (hit + miss)


def test_the_solutions_pass(capsys):
    checks.check_sample_latent(sample_latent)
    checks.check_kl(kl)
    checks.check_calibrate(calibrate)
    checks.check_scores(scores)
    assert capsys.readouterr().out.count("Right") == 4


@pytest.mark.parametrize("give", [list, np.array, torch.tensor])
def test_scores_may_be_a_list_or_an_array(give):
    checks.check_scores(lambda attacked, alarm: give([float(number) for number in scores(attacked, alarm)]))


def _with_recall_for_f1(attacked, alarm):
    accuracy, _, misses = scores(attacked, alarm)
    return accuracy, 1 - misses, misses


def _with_misses_of_all_steps(attacked, alarm):
    accuracy, f1, _ = scores(attacked, alarm)
    return accuracy, f1, (attacked & ~alarm).mean()


def _with_false_positives(attacked, alarm):
    accuracy, f1, _ = scores(attacked, alarm)
    return accuracy, f1, (~attacked & alarm).sum() / (~attacked).sum()


def _by_columns(attacked, alarm):
    hit, miss, false = (attacked & alarm).sum(0), (attacked & ~alarm).sum(0), (~attacked & alarm).sum(0)
    return (attacked == alarm).mean(), 2 * hit / (2 * hit + miss + false), miss / (hit + miss)


@pytest.mark.parametrize(
    ("check", "mistake", "says"),
    [
        (checks.check_sample_latent, lambda m, v, e: m + v.exp() * e, "log_variance is log sigma"),
        (checks.check_sample_latent, lambda m, v, e: m + v * e, "exponentiate"),
        (checks.check_sample_latent, lambda m, v, e: m + e, "log_variance is not used"),
        (checks.check_sample_latent, lambda m, v, e: (0.5 * v).exp() * e, "is the mean"),
        (checks.check_sample_latent, lambda m, v, e: torch.normal(m, (0.5 * v).exp()), "is the mean"),
        (checks.check_sample_latent, lambda m, v, e: m.detach() + (0.5 * v).exp() * e, "gradient"),
        (checks.check_sample_latent, lambda m, v, e: m + (0.5 * v).exp().detach() * e, "does not reach log_variance"),
        (checks.check_sample_latent, lambda m, v, e: m + (0.5 * v.detach()).exp() * e, "does not reach log_variance"),
        (checks.check_sample_latent, lambda m, v, e: (m + (0.5 * v).exp() * e).detach(), "no gradient"),
        (checks.check_sample_latent, lambda m, v, e: m + v.exp() / 2 * e, "not after"),
        (checks.check_sample_latent, lambda m, v, e: m.numpy(), "stay with torch"),
        (checks.check_kl, lambda m, v, p: kl(m, v / 2, p), "do not halve"),
        (checks.check_kl, lambda m, v, p: -kl(m, v, p), "never negative"),
        (checks.check_kl, lambda m, v, p: kl(m, v, p) - (m - p).square().sum(-1), "must GROW"),
        (checks.check_kl, lambda m, v, p: kl(m, v, p) + 2, "1 is missing"),
        (checks.check_kl, lambda m, v, p: (((m - p) ** 2 + 1) / v.exp() - 1 + v).sum(-1) / 2, "other direction"),
        (checks.check_kl, lambda m, v, p: 2 * kl(m, v, p), "1/2 is missing"),
        (checks.check_kl, lambda m, v, p: kl(m, v, torch.zeros_like(p)), "prior_mean is not used"),
        (checks.check_kl, lambda m, v, p: kl(m, v, m), "from prior_mean is missing"),
        (checks.check_kl, lambda m, v, p: kl(m, 2 * v, p), "double it"),
        (checks.check_kl, lambda m, v, p: kl(m, v, p).mean(), "5 numbers"),
        (checks.check_kl, lambda m, v, p: kl(m, v, p) / 4, "that is their mean"),
        (checks.check_calibrate, lambda s, r: np.quantile(s, r), "quantile at 1 - rate"),
        (checks.check_calibrate, lambda s, r: s.max(), "largest"),
        (checks.check_calibrate, lambda s, r: s.mean() + 2.33 * s.std(), "without assuming"),
        (checks.check_calibrate, lambda s, r: np.percentile(s, 1 - r), "per cent"),
        (checks.check_calibrate, lambda s, r: np.quantile(s, 1 - r / 2), "either side"),
        (checks.check_calibrate, lambda s, r: s.mean(), "exceed the threshold, and 1% should"),
        (checks.check_calibrate, lambda s, r: np.quantile(s, [1 - r]), "one number"),
        (checks.check_scores, _with_recall_for_f1, "recall"),
        (checks.check_scores, _with_misses_of_all_steps, "only the 4 attacked"),
        (checks.check_scores, _with_false_positives, "POSITIVE"),
        (checks.check_scores, _by_columns, "all entries"),
        (checks.check_scores, lambda attacked, alarm: 0.7, "three things"),
    ],
)
def test_a_mistake_is_explained(check, mistake, says):
    with pytest.raises(AssertionError, match=says):
        check(mistake)
