"""Checks of the chapter on the detector."""

from collections.abc import Callable
from statistics import NormalDist

import numpy as np
import torch
from torch import Tensor
from torch.distributions import Independent, Normal, kl_divergence

from detden_lite.checks.compare import array, compare, parts
from detden_lite.checks.failure import explained


@explained
def check_sample_latent(sample_latent: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``sample_latent(mean, log_variance, noise)`` makes z ~ N(mean, exp(log_variance)) of standard normal noise."""
    mean = torch.tensor([[1.0, -2.0, 0.5], [0.0, 3.0, -1.0]], requires_grad=True)
    log_variance = torch.tensor([[4.0, 0.25, 1.0], [0.25, 9.0, 4.0]]).log().requires_grad_()
    sigma, still = (log_variance / 2).exp().detach(), mean.detach()
    call = "sample_latent(mean, log_variance, noise)"
    calm = sample_latent(mean, log_variance, torch.zeros(2, 3))
    compare(
        f"Where the noise is 0 the sample is the mean, and {call}",
        calm,
        still,
        {
            "mean is missing: add it to sigma times noise": torch.zeros(2, 3),
            "sigma is added and should be multiplied by noise": still + sigma,
        },
    )
    got = sample_latent(mean, log_variance, torch.ones(2, 3))
    mistakes = {
        "It is 1 away from the mean for a noise of 1: log_variance is not used": still + 1,
        "It is sigma^2 away from the mean for a noise of 1, and should be sigma: log_variance is log sigma^2": (
            still + sigma**2
        ),
        "log_variance is a logarithm: exponentiate it": still + 2 * sigma.log(),
        "Halve log_variance before exp, not after: sigma is the root of the variance, not half of it": (
            still + sigma**2 / 2
        ),
        "Divide by nothing: z = mean + sigma * noise": still + 1 / sigma,
        "That is the mean itself: noise is not used": still,
    }
    compare(f"Where the noise is 1, {call}", got, still + sigma, mistakes)
    assert getattr(got, "requires_grad", False), (
        f"{call} has no gradient: use plain arithmetic of torch on mean and log_variance, without detach or no_grad"
    )
    slopes = torch.autograd.grad(got.sum(), [mean, log_variance], allow_unused=True)
    for name, slope, expected in zip(("mean", "log_variance"), slopes, (torch.ones(2, 3), sigma / 2), strict=True):
        assert slope is not None, (
            f"the gradient of {call} does not reach {name}: it is cut off by detach, no_grad or .data. The encoder "
            "learns sigma through log_variance as it learns the mean"
        )
        compare(f"the gradient of {call} with respect to {name}", slope, expected)
    print("Right. The noise is an argument, so gradients flow through mean and log_variance.")


@explained
def check_kl(kl: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``kl(mean, log_variance, prior_mean)`` is D_KL(N(mean, exp(log_variance)) || N(prior_mean, I)), ``[N]``."""
    draw = torch.Generator().manual_seed(0)
    mean, log_variance, prior_mean = torch.randn(3, 5, 4, generator=draw)

    def divergence(mean: Tensor, log_variance: Tensor, prior_mean: Tensor) -> Tensor:
        prior = Independent(Normal(prior_mean, torch.ones_like(mean)), 1)
        return kl_divergence(Independent(Normal(mean, (log_variance / 2).exp()), 1), prior)

    right = divergence(mean, log_variance, prior_mean)
    apart, spread = (mean - prior_mean).square().sum(-1), (log_variance.exp() - 1 - log_variance).sum(-1)
    mistakes = {
        "The factor 1/2 is missing": 2 * right,
        "Only a part is halved: 1/2 stands before all terms": apart + spread / 2,
        "Only a part is halved: 1/2 stands before the squared distance too": apart / 2 + spread,
        "Sum over the latent's dimensions; that is their mean": right / 4,
        "prior_mean is not used: the distance is that of mean from prior_mean": divergence(
            mean, log_variance, torch.zeros(5, 4)
        ),
        "The distance of mean from prior_mean is missing": spread / 2,
        "The spread is missing: log_variance is not used": apart / 2,
        "The means should be squared: their differences may have either sign": (
            ((mean - prior_mean).sum(-1) + spread) / 2
        ),
        "log_variance is log sigma^2: do not square or double it again": divergence(mean, 2 * log_variance, prior_mean),
        "log_variance is log sigma^2, not log sigma: do not halve it": divergence(mean, log_variance / 2, prior_mean),
        "The 1 is missing: the divergence of a Gaussian from itself is 0": right + 2,
        "Subtract log_variance: with its sign turned, a small sigma would cost nothing": (right + log_variance.sum(-1)),
        "The distance is subtracted: the KL must GROW with the distance of mean from prior_mean": (spread - apart) / 2,
        "Minus the KL: a divergence is never negative": -right,
        "That is the KL in the other direction: the prior's variance, 1, divides": (
            ((1 + (mean - prior_mean).square()) / log_variance.exp() - 1 + log_variance).sum(-1) / 2
        ),
    }
    got = kl(mean.clone(), log_variance.clone(), prior_mean.clone())
    call = "kl(mean, log_variance, prior_mean)"
    assert array(call, got).shape != (), f"{call} gives one number for 5 latents; there are 5 numbers, one a row"
    compare(call, got, right, mistakes, atol=1e-4)
    zeros = torch.zeros(2, 4)
    compare("kl of a Gaussian from itself", kl(zeros + 1, zeros, zeros + 1), [0.0, 0.0])
    print("Right. With prior_mean = mean, the paper's free prior, the means add nothing to the KL.")


@explained
def check_calibrate(clean_threshold: Callable[[np.ndarray, float], float]) -> None:
    """``clean_threshold(clean_scores, rate)`` is the threshold that this fraction of clean scores exceeds."""
    scores = np.random.default_rng(0).permutation(np.linspace(0, 1, 2_001) ** 4)
    for rate in (0.01, 0.1):
        call = f"clean_threshold(clean_scores, {rate})"
        threshold = array(call, clean_threshold(scores.copy(), rate))
        assert threshold.ndim == 0, f"{call} has the shape {threshold.shape}; the threshold is one number"
        above = float((scores > threshold).mean())
        if abs(above - rate) <= 0.1 * rate:
            continue
        gaussian = NormalDist(float(scores.mean()), float(scores.std())).inv_cdf(1 - rate)
        mistakes = {
            "The largest score depends on a single step: take a quantile of them": scores.max(),
            "Take the quantile at 1 - rate, and not in per cent: the scores ABOVE it raise the alarm": (
                np.quantile(scores, rate)
            ),
            "That leaves half of the rate on either side; only scores above the threshold raise the alarm": (
                np.quantile(scores, 1 - rate / 2)
            ),
            "Take a quantile of the scores themselves, without assuming that they are Gaussian": gaussian,
            "Three standard deviations assume a distribution: take a quantile of the scores": (
                scores.mean() + 3 * scores.std()
            ),
            "That is a share of the largest score; take a quantile": (1 - rate) * scores.max(),
        }
        compare(f"{above:.2%} of the clean scores exceed the threshold, and {rate:.0%} should: {call}",
                threshold, np.quantile(scores, 1 - rate), mistakes, atol=2e-3)  # fmt: skip
        raise AssertionError(f"{call}: {above:.2%} of the clean scores exceed the threshold, and {rate:.0%} should")
    print("Right. The threshold needs clean scores alone.")


@explained
def check_scores(scores: Callable[[np.ndarray, np.ndarray], tuple[float, float, float]]) -> None:
    """``scores(attacked, alarm)`` gives accuracy, F1 and false-negative rate of boolean arrays."""
    attacked = np.array([1, 1, 1, 1, 0, 0, 0, 0, 0, 0], dtype=bool)  # 3 hits, 1 miss, 2 false alarms, 4 rightly silent
    alarm = np.array([1, 1, 1, 0, 1, 1, 0, 0, 0, 0], dtype=bool)
    call, names = "scores(attacked, alarm)", ("accuracy", "f1", "false_negative_rate")
    result = parts(call, scores(attacked.copy(), alarm.copy()), *names)
    case = f"With 3 hits, 1 miss, 2 false alarms and 4 silent steps, the {{}} of {call}"
    mistakes = (
        {
            "That is the share of the wrong steps, or of the hits; the rightly silent steps count as right too": 3 / 10,
            "That is the share of the alarms; compare alarm with attacked": 5 / 10,
        },
        {
            "That is the recall; false alarms must count against F1 too": 3 / 4,
            "That is the precision; misses must count against F1 too": 3 / 5,
            "That is the accuracy; F1 ignores the steps that are rightly silent": 7 / 10,
            "The hits count twice, in the numerator and in the denominator": 3 / 6,
            "That is the mean of precision and recall; F1 is their harmonic mean": (3 / 4 + 3 / 5) / 2,
            "That is the product of precision and recall; F1 is their harmonic mean": 3 / 4 * 3 / 5,
        },
        {
            "That is 1 miss of all 10 steps; only the 4 attacked steps can be missed": 1 / 10,
            "That is the false POSITIVE rate, 2 of 6 clean steps": 2 / 6,
            "That is the recall: the rate is 1 minus it": 3 / 4,
            "That is 1 miss of the 5 steps without an alarm; take the share of the attacked steps": 1 / 5,
        },
    )
    for name, got, right, hints in zip(names, result, (7 / 10, 6 / 9, 1 / 4), mistakes, strict=True):
        assert array(f"the {name} of {call}", got).ndim == 0, (
            f"the {name} of {call} is one number, for all steps together"
        )
        compare(case.format(name), got, right, hints)
    grid = parts(call, scores(attacked.reshape(5, 2), alarm.reshape(5, 2)), *names)
    assert all(
        array(call, a).ndim == 0 and np.isclose(float(a), float(b)) for a, b in zip(grid, result, strict=True)
    ), f"{call} gives something else when the arrays are [steps, N], as a rollout's are: count over all entries"
    print("Right. Each score ignores one kind of error, so three of them are reported.")
