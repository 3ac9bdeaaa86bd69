"""Bayes' rule for a perturbation in a ball, against numerical integration and random samples."""

import math

import numpy as np
import pytest
import torch
from builders import steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.defense.bounded_noise import condition, log_student, truncated_moments


def double(*numbers):
    return torch.tensor(numbers, dtype=torch.float64)


@steady
@given(mean=st.floats(-3, 3), std=st.floats(0.02, 5))
def test_truncated_moments_are_those_of_numerical_integration(mean, std):
    grid = np.linspace(-1, 1, 200_001)
    log = -0.5 * ((grid - mean) / std) ** 2
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    expected = (grid * weight).sum()
    found, variance = truncated_moments(double(mean), double(std**2))
    assert found.item() == pytest.approx(expected, abs=2e-4)
    least = 1e-4 * std**2  # what the variance is kept above
    assert variance.item() == pytest.approx(max(((grid - expected) ** 2 * weight).sum(), least), rel=0.05, abs=1e-6)


@steady
@given(mean=st.floats(-1e3, 1e3), std=st.floats(1e-5, 1e3))
def test_truncated_moments_stay_in_the_ball_and_never_grow(mean, std):
    found, variance = truncated_moments(double(mean), double(std**2))
    assert -1 <= found.item() <= 1
    assert 0 < variance.item() <= std**2 * (1 + 1e-9)


def test_truncated_moments_are_mirrored_with_the_mean():
    mean, variance = double(0.3, 1.5, 40.0), double(0.1, 0.5, 0.01)
    right, left = truncated_moments(mean, variance), truncated_moments(-mean, variance)
    assert torch.equal(right[0], -left[0]) and torch.equal(right[1], left[1])


def test_log_student_is_that_of_torch():
    residual, variance = torch.randn(50).double(), torch.rand(50).double() + 0.1
    expected = torch.distributions.StudentT(4.0, 0.0, variance.sqrt()).log_prob(residual)
    assert torch.allclose(log_student(residual, variance), expected)


def gaussian(n, d, seed=0):
    generator = torch.Generator().manual_seed(seed)
    root = torch.randn(n, d, d, generator=generator, dtype=torch.float64)
    return torch.randn(n, d, generator=generator, dtype=torch.float64), root @ root.mT + 0.1 * torch.eye(d).double()


def test_conditioning_on_gaussian_measurements_is_a_kalman_update():
    mean, covariance = gaussian(5, 4)
    rows = torch.randn(3, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    shown, noise = double(0.5, -1.0, 2.0), double(0.3, 0.1, 1.0)

    def seen(cavity):
        variance = 1 / (1 / cavity[1] + 1 / noise)
        return variance * (cavity[0] / cavity[1] + shown / noise), variance

    found, left = condition(mean, covariance, rows, seen)
    gain = covariance @ rows.T @ torch.linalg.inv(rows @ covariance @ rows.T + torch.diag(noise))
    assert torch.allclose(found, mean + (gain @ (shown - mean @ rows.T)[..., None])[..., 0])
    assert torch.allclose(left, covariance - gain @ rows @ covariance)


def test_conditioning_on_a_box_is_near_what_samples_say():
    covariance = torch.tensor([[[0.5, 0.45], [0.45, 0.5]]]).double()
    mean = double(1.4, 0.2)[None]
    found, left = condition(mean, covariance, torch.eye(2).double(), lambda m: truncated_moments(*m), rounds=8)
    samples = np.random.default_rng(0).multivariate_normal(mean[0].numpy(), covariance[0].numpy(), 400_000)
    inside = samples[(np.abs(samples) <= 1).all(1)]
    assert np.allclose(found[0], inside.mean(0), atol=0.02)
    assert np.allclose(left[0], np.cov(inside.T), atol=0.02)
    assert found[0, 1] < mean[0, 1], "what is known of the first number moves the second, which is inside already"


def test_batched_equals_one_by_one():
    mean, covariance = gaussian(6, 3)
    rows = torch.eye(3).double()
    found, left = condition(mean, covariance, rows, lambda m: truncated_moments(*m))
    for i in range(6):
        alone = condition(mean[i : i + 1], covariance[i : i + 1], rows, lambda m: truncated_moments(*m))
        assert torch.allclose(alone[0][0], found[i]) and torch.allclose(alone[1][0], left[i])


def test_gradients_pass_through():
    mean, covariance = gaussian(2, 3)
    mean.requires_grad_()
    found, _ = condition(mean, covariance, torch.eye(3).double(), lambda m: truncated_moments(*m))
    (gradient,) = torch.autograd.grad(found.sum(), mean)
    assert torch.isfinite(gradient).all() and gradient.abs().sum() > 0
    assert math.isfinite(found.sum().item())
