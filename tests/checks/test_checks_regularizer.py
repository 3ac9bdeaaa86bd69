"""Every check passes on a solution and fails on plausible mistakes."""

import pytest
import torch

from detden_lite.checks import regularizer as checks
from detden_lite.defense.gruvae import kl_divergence, reconstruction_loss

CHECKS = [checks.check_r_ppo, checks.check_training_loss, checks.check_survives]


def r_ppo(action, reference, std):
    return ((action - reference) / std).square().sum(-1)


def training_loss(
    model, regularizer, true, perturbed, mask, noise, beta, lam, elbo=1.0, sign=1.0, shown=None, wanted=None,
    attacked=None, where=None, counted=None, z="noise", over=None,
):  # fmt: skip
    """The solution, and with other arguments every mistake."""
    result = model(perturbed if shown is None else shown, noise)
    loss = reconstruction_loss(model, result.output, true if wanted is None else wanted)
    loss = loss + beta * kl_divergence(result.mean, result.log_variance)
    where, counted = (mask if m is None else m for m in (where, counted))
    r = regularizer(model, true if attacked is None else attacked, counted, noise if z == "noise" else z)
    return elbo * (loss * where).sum() / (over or where.sum()) + sign * lam * r


def survives(action, denoised):
    return 1 - (denoised - action).square().sum() / (action - action.mean(0)).square().sum()


def test_the_solutions_pass(capsys):
    for check, solution in zip(CHECKS, (r_ppo, training_loss, survives), strict=True):
        check(solution)
    assert capsys.readouterr().out.count("Right") == 3


def test_other_ways_to_say_the_same_pass():
    checks.check_r_ppo(lambda a, b, s: torch.einsum("nti,ij,ntj->nt", a - b, torch.diag(s**-2), a - b))
    checks.check_survives(lambda a, d: 1 - ((d - a) ** 2).mean() / a.var(0, unbiased=False).mean())


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda a, b, s: (a - b).square().sum(-1), "Sigma is missing"),
        (lambda a, b, s: ((a - b).square() / s).sum(-1), "VARIANCES"),
        (lambda a, b, s: ((a - b) / s**2).square().sum(-1), "variance once"),
        (lambda a, b, s: ((a - b) * s).square().sum(-1), "Sigma\\^-1"),
        (lambda a, b, s: ((a - b) / s).norm(dim=-1), "without a root"),
        (lambda a, b, s: ((a - b) / s).square().mean(-1), "that is their mean"),
        (lambda a, b, s: r_ppo(a, b, s) / 2, "KL divergence"),
        (lambda a, b, s: ((a - b) / s).sum(-1).square(), "cancel"),
        (lambda a, b, s: r_ppo(a, b, s).mean(), "each has its own"),
        (lambda a, b, s: ((a - b) / s).square(), "shape"),
    ],
)
def test_a_wrong_r_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_r_ppo(mistake)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (lambda m, true, seen: dict(sign=-1), "R is subtracted"),
        (lambda m, true, seen: dict(elbo=-1), "printed sign"),
        (lambda m, true, seen: dict(elbo=-1, sign=-1), "minus what should be"),
        (lambda m, true, seen: dict(lam=1), "lam is missing"),
        (lambda m, true, seen: dict(lam=0), "R is missing"),
        (lambda m, true, seen: dict(elbo=0.5, lam=1), "lam weighs the ELBO"),
        (lambda m, true, seen: dict(attacked=seen), "attacked already"),
        (lambda m, true, seen: dict(z=None), "latent's mean"),
        (lambda m, true, seen: dict(counted=torch.ones_like(m)), "counted in R"),
        (lambda m, true, seen: dict(where=torch.ones_like(m)), "counted in the error"),
        (lambda m, true, seen: dict(shown=true, wanted=seen), "swap them"),
        (lambda m, true, seen: dict(shown=true), "must be perturbed"),
        (lambda m, true, seen: dict(beta=1), "beta is missing"),
        (lambda m, true, seen: dict(beta=0), "KL is missing"),
        (lambda m, true, seen: dict(beta=-0.1), "KL is subtracted"),
        (lambda m, true, seen: dict(elbo=0.1, beta=1), "has beta in it already"),
        (lambda m, true, seen: dict(over=m.numel()), "number of steps that count"),
        (lambda m, true, seen: dict(elbo=2), "should be"),
    ],
)
def test_a_wrong_loss_is_explained(changed, says):
    names = ("model", "regularizer", "true", "perturbed", "mask", "noise", "beta", "lam")

    def mistake(*arguments):
        given = dict(zip(names, arguments, strict=True))
        return training_loss(**given | changed(given["mask"], given["true"], given["perturbed"]))

    with pytest.raises(AssertionError, match=says):
        checks.check_training_loss(mistake)


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda *given: training_loss(*given).detach(), "no gradient"),
        (lambda *given: training_loss(*given[:-1], 0.5), "with lam = 0"),
        (lambda *given: training_loss(*given).expand(2), "shape"),
    ],
)
def test_a_loss_without_a_gradient_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_training_loss(mistake)


def columns(a, b):
    return zip(a.T[..., None], b.T[..., None], strict=True)


def correlation(a, b):
    a, b = a.flatten(), b.flatten()
    return torch.nn.functional.cosine_similarity(a - a.mean(), b - b.mean(), dim=0)


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda a, d: 1 - survives(a, d), "LOST"),
        (lambda a, d: 1 - (d - a).square().sum() / a.square().sum(), "not from 0"),
        (lambda a, d: 1 - (d - a).square().sum() / (a - a.mean()).square().sum(), "its own mean"),
        (lambda a, d: (d - d.mean(0)).square().sum() / (a - a.mean(0)).square().sum(), "Compare denoised"),
        (lambda a, d: 1 - (d - a).square().sum() / (d - d.mean(0)).square().sum(), "TRUE actions vary"),
        (lambda a, d: 1 - (d - a).square().mean(0).sum() / a.var(0).sum(), "n - 1"),
        (lambda a, d: 1 - (d - a).abs().sum() / (a - a.mean(0)).abs().sum(), "Square"),
        (lambda a, d: survives(a, d).clamp_min(0), "do not clip"),
        (lambda a, d: correlation(a, d) ** 2, "squared correlation"),
        (lambda a, d: correlation(a, d), "the correlation of the actions"),
        (lambda a, d: torch.stack([correlation(*p) ** 2 for p in columns(a, d)]).mean(), "mean of the"),
        (lambda a, d: torch.stack([survives(*p) for p in columns(a, d)]).mean(), "own shares"),
    ],
)
def test_a_wrong_share_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_survives(mistake)
