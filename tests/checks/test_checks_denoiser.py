"""Every check passes on a solution and fails on plausible mistakes."""

import numpy as np
import pytest
import torch

from detden_lite.checks import denoiser as checks
from detden_lite.defense.gruvae import kl_divergence, reconstruction_loss


def augment(obs, attack):
    return attack(obs.reshape(-1, obs.shape[-1])).reshape(obs.shape), obs


def denoiser_loss(model, true, perturbed, noise, beta):
    result = model(perturbed, noise)
    kl = kl_divergence(result.mean, result.log_variance)
    return (reconstruction_loss(model, result.output, true) + beta * kl).mean()


def replace_on_alarm(obs, denoised, alarm):
    return torch.where(alarm[:, None], denoised, obs)


def mae(denoised, obs, attacked, mask):
    return np.abs(denoised - obs)[attacked & mask].mean()


def test_the_solutions_pass(capsys):
    checks.check_augment(augment)
    checks.check_denoiser_loss(denoiser_loss)
    checks.check_replace_on_alarm(replace_on_alarm)
    checks.check_mae_attacked(mae)
    assert capsys.readouterr().out.count("Right") == 4


@pytest.mark.parametrize("give", [list, lambda pair: [part.numpy() for part in pair], torch.stack])
def test_augment_may_give_a_list_arrays_or_one_tensor(give):
    checks.check_augment(lambda obs, attack: give(augment(obs, attack)))


def _only_the_last(obs, attack):
    inputs = obs.clone()
    inputs[:, -1] = attack(obs[:, -1])
    return inputs, obs


def _in_place(obs, attack):
    for steps in obs:
        steps[:] = attack(steps)
    return obs, obs


def _shuffled(obs, attack):
    rows = attack(obs.swapaxes(0, 1).reshape(-1, obs.shape[-1]))
    return rows.reshape(obs.shape), obs


def _replaced_in_place(obs, denoised, alarm):
    obs[alarm] = denoised[alarm]
    return obs


@pytest.mark.parametrize(
    ("check", "mistake", "says"),
    [
        (checks.check_augment, lambda obs, attack: (attack(obs), obs), "takes rows"),
        (checks.check_augment, lambda obs, attack: augment(obs, attack)[::-1], "are swapped"),
        (checks.check_augment, lambda obs, attack: (augment(obs, attack)[0],) * 2, "targets are attacked too"),
        (checks.check_augment, lambda obs, attack: (obs, obs), "is never called"),
        (checks.check_augment, lambda obs, attack: augment(obs, attack)[0], "two things"),
        (checks.check_augment, _only_the_last, "not attacked"),
        (checks.check_augment, _in_place, "its argument obs"),
        (checks.check_augment, lambda obs, attack: attack(obs.numpy().reshape(-1, 2)), "has no attribute|Two kinds"),
        (checks.check_augment, _shuffled, "order has changed"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, p, t, n, b), "swap them"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, p, p, n, b), "not a denoiser"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, t, t, n, b), "that is a detector.$"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, t, p, n, -b), "subtracted"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, t, p, n, 1), "beta is missing"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, t, p, n, 0), "KL is missing"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, t, p, 2 * n, b), "should be"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, t, p, None, b), "noise is not used"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: -denoiser_loss(m, t, p, n, b), "change the sign"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: b * denoiser_loss(m, t, p, n, 1), "not the error"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: 12 * denoiser_loss(m, t, p, n, b), "that is the sum"),
        (checks.check_denoiser_loss, lambda m, t, p, n, b: denoiser_loss(m, t, p, n, b).expand(2), "one number"),
        (checks.check_replace_on_alarm, lambda obs, den, alarm: torch.where(alarm, den, obs), "DIMENSION"),
        (checks.check_replace_on_alarm, lambda obs, den, alarm: replace_on_alarm(den, obs, alarm), "wrong way round"),
        (checks.check_replace_on_alarm, lambda obs, den, alarm: den, "bit for bit"),
        (checks.check_replace_on_alarm, lambda obs, den, alarm: den[alarm], "shape"),
        (checks.check_replace_on_alarm, _replaced_in_place, "its argument obs"),
        (checks.check_mae_attacked, lambda d, o, a, m: mae(d, o, a, a), "after an episode's end"),
        (checks.check_mae_attacked, lambda d, o, a, m: mae(d, o, m, m), "not attacked are counted"),
        (checks.check_mae_attacked, lambda d, o, a, m: np.abs(d - o).mean(), "All steps"),
        (checks.check_mae_attacked, lambda d, o, a, m: (d - o)[a & m].mean(), "cancel"),
        (checks.check_mae_attacked, lambda d, o, a, m: ((d - o) ** 2)[a & m].mean(), "SQUARED"),
        (checks.check_mae_attacked, lambda d, o, a, m: np.abs(d - o)[a & m], "one number"),
        (checks.check_mae_attacked, lambda d, o, a, m: (np.abs(d - o) * (a & m)[..., None]).mean(), "divided"),
    ],
)
def test_a_mistake_is_explained(check, mistake, says):
    with pytest.raises(AssertionError, match=says):
        check(mistake)
