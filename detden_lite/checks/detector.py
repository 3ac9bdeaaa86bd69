"""Checks of the chapter on the detector."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.distributions import Independent, Normal, kl_divergence

from detden_lite.checks.compare import array


def check_sample_latent(sample_latent: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``sample_latent(mean, log_variance, noise)`` makes z ~ N(mean, exp(log_variance)) of standard normal noise."""
    mean = torch.tensor([[1.0, -2.0, 0.5], [0.0, 3.0, -1.0]], requires_grad=True)
    log_variance = torch.tensor([[4.0, 0.25, 1.0], [0.25, 9.0, 4.0]]).log()
    still = sample_latent(mean, log_variance, torch.zeros(2, 3))
    assert isinstance(still, Tensor), f"return the sample z as a tensor; yours is {type(still).__name__}"
    assert still.shape == mean.shape, f"z has the mean's shape {list(mean.shape)}; yours has {list(still.shape)}"
    assert torch.allclose(still, mean), "where the noise is 0 the sample is the mean; yours is not"

    away = (sample_latent(mean, log_variance, torch.ones(2, 3)) - mean).detach()
    assert not torch.allclose(away, torch.ones(2, 3)), (
        "your sample is 1 away from the mean for a noise of 1, whatever the variance: log_variance is not used"
    )
    assert not torch.allclose(away, log_variance.exp()), (
        "your sample is sigma^2 away from the mean for a noise of 1; it should be sigma: log_variance is log sigma^2"
    )
    assert not torch.allclose(away, log_variance), "log_variance is a logarithm: exponentiate it"
    assert torch.allclose(away, (log_variance / 2).exp()), (
        f"for a noise of 1 and sigma^2 = {log_variance[0].exp().tolist()} the sample should be sigma away from the "
        f"mean; yours is {away[0].tolist()} away"
    )

    gradient = torch.autograd.grad(still.sum(), mean)[0] if still.requires_grad else torch.zeros(2, 3)
    assert torch.allclose(gradient, torch.ones(2, 3)), (
        f"the gradient of z with respect to the mean should be 1, and yours is {gradient[0, 0]:.0f}: "
        "use plain arithmetic on mean, without detach or no_grad"
    )
    print("Right. The noise is an argument, so gradients flow through mean and log_variance.")


def check_kl(kl: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``kl(mean, log_variance, prior_mean)`` is D_KL(N(mean, exp(log_variance)) || N(prior_mean, I)), ``[N]``."""
    draw = torch.Generator().manual_seed(0)
    mean, log_variance, prior_mean = torch.randn(3, 5, 4, generator=draw)
    result = kl(mean, log_variance, prior_mean)
    assert isinstance(result, Tensor) and result.shape == (5,), (
        f"for 5 latents of 4 dimensions kl gives 5 numbers, one a row; yours gives {_shape(result)}"
    )
    zeros = torch.zeros(2, 4)
    same = kl(zeros + 1, zeros, zeros + 1)
    assert torch.allclose(same, torch.zeros(2), atol=1e-6), (
        f"the divergence of a Gaussian from itself is 0; yours gives {same[0]:.3f} for sigma = 1 and equal means"
    )
    moved = kl(zeros + 3, zeros, zeros + 1)[0]
    assert torch.isclose(moved, torch.tensor(8.0)), (
        "with sigma = 1, and 4 dimensions whose mean is 2 away from the prior's, the divergence is 8; "
        f"yours is {moved:.3f}"
    )
    wide = kl(zeros, zeros + np.log(4.0), zeros)[0]
    expected = 4 * 0.5 * (4 - 1 - np.log(4.0))
    assert abs(wide - expected) < 1e-4, (
        f"with equal means and sigma^2 = 4 in 4 dimensions the divergence is {expected:.3f}; yours is {wide:.3f}"
    )
    true = kl_divergence(
        Independent(Normal(mean, (log_variance / 2).exp()), 1), Independent(Normal(prior_mean, torch.ones(5, 4)), 1)
    )
    assert torch.allclose(result, true, atol=1e-4), (
        f"for random means and variances it should be {_numbers(true)}; yours gives {_numbers(result)}"
    )
    free = kl(mean, log_variance, mean)
    assert (free <= result + 1e-6).all(), (
        "the KL is smallest where prior_mean is mean; check the sign of the part with the means"
    )
    print("Right. With prior_mean = mean, the paper's free prior, the means add nothing to the KL.")


def check_calibrate(calibrate: Callable[[np.ndarray, float], float]) -> None:
    """``calibrate(clean_scores, false_alarm_rate)`` is the threshold that this fraction of clean scores exceeds."""
    scores = np.random.default_rng(0).permutation(np.linspace(0, 1, 2_001) ** 4)
    for rate in (0.01, 0.1):
        threshold = array("calibrate(clean_scores, rate)", calibrate(scores, rate))
        assert np.ndim(threshold) == 0, f"the threshold is one number; yours has the shape {np.shape(threshold)}"
        above = float((scores > threshold).mean())
        assert not np.isclose(above, 1 - rate, atol=0.005), (
            f"{above:.1%} of the clean scores exceed your threshold, where {rate:.0%} should; "
            "take the quantile at 1 - rate"
        )
        assert above > 0, (
            "no clean score exceeds your threshold: the largest one depends on a single step; take a quantile"
        )
        assert abs(above - rate) <= 0.1 * rate, (
            f"{above:.2%} of the clean scores exceed your threshold for a rate of {rate:.0%}; "
            "take a quantile of the scores themselves, without assuming a distribution"
        )
    print("Right. The threshold needs clean scores alone.")


def check_scores(scores: Callable[[np.ndarray, np.ndarray], tuple[float, float, float]]) -> None:
    """``scores(attacked, alarm)`` gives accuracy, F1 and false-negative rate of boolean arrays."""
    attacked = np.array([1, 1, 1, 1, 0, 0, 0, 0, 0, 0], dtype=bool)  # 3 hits, 1 miss, 2 false alarms, 4 rightly silent
    alarm = np.array([1, 1, 1, 0, 1, 1, 0, 0, 0, 0], dtype=bool)
    result = scores(attacked, alarm)
    assert isinstance(result, tuple) and len(result) == 3, "return three numbers: accuracy, f1, false_negative_rate"
    accuracy, f1, misses = (float(number) for number in result)
    case = "with 3 hits, 1 miss, 2 false alarms and 4 steps rightly silent"
    assert np.isclose(accuracy, 7 / 10), f"{case} the accuracy is 7/10; yours is {accuracy:.3f}"
    assert not np.isclose(f1, 3 / 4), f"{case} your F1 is the recall, 3/4; false alarms must count against it too"
    assert not np.isclose(f1, 3 / 5), f"{case} your F1 is the precision, 3/5; misses must count against it too"
    assert np.isclose(f1, 6 / 9), f"{case} F1 is {6 / 9:.3f}; yours is {f1:.3f}"
    assert not np.isclose(misses, 1 / 10), (
        f"{case} your rate is 1 miss of 10 steps; only the 4 attacked steps can be missed"
    )
    assert not np.isclose(misses, 2 / 6), f"{case} your rate is the false POSITIVE rate, 2 of 6 clean steps"
    assert np.isclose(misses, 1 / 4), f"{case} the false-negative rate is 1 of 4 attacked steps; yours is {misses:.3f}"
    grid = scores(attacked.reshape(5, 2), alarm.reshape(5, 2))
    assert all(np.size(a) == 1 and np.isclose(a, b) for a, b in zip(grid, result, strict=True)), (
        "the arrays of a rollout are [steps, N]: the counts must run over all entries"
    )
    print("Right. Each score ignores one kind of error, so three of them are reported.")


def _shape(result: object) -> str:
    return f"the shape {list(result.shape)}" if isinstance(result, Tensor) else f"a {type(result).__name__}"


def _numbers(values: Tensor) -> list[float]:
    return [round(float(value), 3) for value in values]
