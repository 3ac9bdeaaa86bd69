"""Every check passes on a solution and fails on plausible mistakes."""

import numpy as np
import pytest
import torch

from detden_lite.checks import results as checks


def kept_share(defended, clean, drawn):
    ratios = defended[drawn].mean(1) / clean[drawn].mean(1)
    return defended.mean() / clean.mean(), *np.quantile(ratios, [0.025, 0.975])


def worst_elsewhere(chosen_on, reported_on):
    return reported_on[chosen_on.mean(1).argmin()].mean()


def f1(rate, misses, false_alarms):
    hit = rate * (1 - misses)
    return 2 * hit / (2 * hit + rate * misses + (1 - rate) * false_alarms)


def felt(policy, obs, denoised):
    found = []
    for i in range(obs.shape[1]):
        mixed = obs.clone()
        mixed[:, i] = denoised[:, i]
        found.append((policy(mixed) - policy(obs)).norm(dim=-1).mean())
    return torch.stack(found)


CHECKS = {
    checks.check_kept_share: kept_share,
    checks.check_worst_elsewhere: worst_elsewhere,
    checks.check_f1: f1,
    checks.check_felt: felt,
}


def test_the_solutions_pass(capsys):
    for check, solution in CHECKS.items():
        check(solution)
    assert capsys.readouterr().out.count("Right") == len(CHECKS)


def _ends(ratios, tail=0.025):
    return np.quantile(ratios, [tail, 1 - tail])


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda d, c, i: None, "gives None"),
        (lambda d, c, i: kept_share(d, c, i)[0], "three things"),
        (lambda d, c, i: (kept_share(d, c, i)[0], np.array(kept_share(d, c, i)[1:])), "three things"),
        (lambda d, c, i: ((d / c).mean(), *_ends((d / c)[i].mean(1))), "ratio of the two means"),
        (lambda d, c, i: (d.mean() / c.mean(), *_ends((d / c)[i].mean(1))), "two resampled means"),
        (lambda d, c, i: (d.mean() / c.mean(), *_ends(d[i].mean(1) / c.mean())), "drawn episodes of clean"),
        (lambda d, c, i: (d.mean() / c.mean(), *_ends(d[i].mean(1) / c[i].mean(1), 0.05)), "90 %"),
        (lambda d, c, i: (d.mean() / c.mean(), *_ends(d[i].mean(1) / c[i].mean(1), 0)), "largest resample"),
        (lambda d, c, i: ((d[i].mean(1) / c[i].mean(1)).mean(), *kept_share(d, c, i)[1:]), "mean of the resamples"),
        (lambda d, c, i: (d.mean() / c.mean(), *_ends(d[i].mean(0) / c[i].mean(0))), "last axis"),
        (lambda d, c, i: (d.mean() / c.mean(), *_ends(d[i].mean(1) / c[i[::-1]].mean(1))), "it should be"),
        (lambda d, c, i: (d.mean() / c.mean(), *(_ends(d[i].mean(1)) / _ends(c[i].mean(1)))), "resampled by itself"),
        (lambda d, c, i: (d.mean() / c.mean(), *(_ends(d[i].mean(1)) / _ends(c[i].mean(1))[::-1])), "the worst"),
        (lambda d, c, i: (d.mean() / c.mean(), *_ends(d[i].mean(1) / c[np.roll(i, 1, 0)].mean(1))), "in pairs"),
    ],
)
def test_a_wrong_share_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_kept_share(mistake)


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda chosen, shown: shown.mean(1).min(), "chosen on the episodes that it is reported on"),
        (lambda chosen, shown: chosen.mean(1).min(), "reported on the episodes that it was chosen on"),
        (lambda chosen, shown: shown.min(0).mean(), "every episode"),
        (lambda chosen, shown: shown[chosen.min(1).argmin()].mean(), "its worst episode"),
        (lambda chosen, shown: shown[np.median(chosen, 1).argmin()].mean(), "chosen by its median"),
        (lambda chosen, shown: np.median(shown[chosen.mean(1).argmin()]), "report its mean"),
        (lambda chosen, shown: np.median(shown, 1)[np.median(chosen, 1).argmin()], "twice"),
        (lambda chosen, shown: shown[chosen.mean(1).argmin()].min(), "worst episode of the right"),
        (lambda chosen, shown: shown[chosen.mean(1).argmax()].mean(), "leaves the most"),
        (lambda chosen, shown: shown.mean(), "all attacks"),
        (lambda chosen, shown: chosen.mean(1).argmin(), "which attack is the worst"),
        (lambda chosen, shown: shown[chosen.mean(0).argmin()].mean(), r"is mean\(1\)"),
        (lambda chosen, shown: shown[chosen.mean(1).argmin()], "shape"),
    ],
)
def test_a_wrong_worst_case_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_worst_elsewhere(mistake)


def _precision(r, m, f):
    return r * (1 - m) / (r * (1 - m) + (1 - r) * f)


def test_the_chapters_own_definition_of_f1_passes():
    checks.check_f1(lambda r, m, f: 2 / (1 / _precision(r, m, f) + 1 / (1 - m)))


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda r, m, f: 2 * r * (1 - m) / (2 * r * (1 - m) + r * m + f), "CLEAN"),
        (lambda r, m, f: 2 * r * (1 - m) / (2 * r * (1 - m) + m + (1 - r) * f), "ATTACKED"),
        (lambda r, m, f: 2 * (1 - m) / (2 * (1 - m) + m + f), "rate is missing"),
        (lambda r, m, f: r * (1 - m) / (r * (1 - m) + (1 - r) * f), "precision"),
        (lambda r, m, f: 1 - m, "recall"),
        (lambda r, m, f: r * (1 - m) + (1 - r) * (1 - f), "accuracy"),
        (lambda r, m, f: r * (1 - m) / (r + (1 - r) * f), "twice"),
        (lambda r, m, f: (_precision(r, m, f) + 1 - m) / 2, "mean of precision and recall"),
        (lambda r, m, f: _precision(r, m, f) * (1 - m), "product"),
        (lambda r, m, f: f1(r, m, f) + 0.01, "it should be"),
    ],
)
def test_a_wrong_f1_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_f1(mistake)


def _accumulated(policy, obs, denoised):
    mixed, found = obs.clone(), []
    for i in range(obs.shape[1]):
        mixed[:, i] = denoised[:, i]
        found.append((policy(mixed) - policy(obs)).norm(dim=-1).mean())
    return torch.stack(found)


def _in_place(policy, obs, denoised):
    truth = policy(obs)
    found = []
    for i in range(obs.shape[1]):
        obs[:, i] = denoised[:, i]
        found.append((policy(obs) - truth).norm(dim=-1).mean())
    return torch.stack(found)


def _with(distance):
    def mistake(policy, obs, denoised):
        moved = []
        for i in range(obs.shape[1]):
            mixed = torch.where(torch.arange(obs.shape[1]) == i, denoised, obs)
            moved.append(distance(policy(mixed) - policy(obs)))
        return torch.stack(moved)

    return mistake


def _others_wrong(policy, obs, denoised):
    mixed = [torch.where(torch.arange(obs.shape[1]) == i, obs, denoised) for i in range(obs.shape[1])]
    return torch.stack([(policy(m) - policy(obs)).norm(dim=-1).mean() for m in mixed])


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (_accumulated, "fresh copy"),
        (_in_place, "its argument obs"),
        (_others_wrong, "the other way round"),
        (lambda policy, obs, denoised: (denoised - obs).abs().mean(0), "ACTION"),
        (lambda policy, obs, denoised: policy(obs[:, 0]), "whole observations"),
        (_with(lambda moved: moved.abs().mean()), "take the norm"),
        (_with(lambda moved: moved.norm(dim=-1).sum()), "mean over the rows"),
        (_with(lambda moved: moved.mean(0).norm()), "cancel"),
        (_with(lambda moved: moved.norm(dim=-1)), "shape"),
    ],
)
def test_a_wrong_sensitivity_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_felt(mistake)
