import numpy as np
import pytest
import torch
from builders import planted, steady
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from detden_lite.core.types import Trajectories
from detden_lite.defense.linear_models import Gaussian, LinearModel, steady_gain

RIDGE = 1e-9  # so small that textbooks' formulas hold to many digits


def test_a_linear_system_is_found_again():
    normal, a, b, q = planted(noise=1e-3)
    model = LinearModel.fit(normal, RIDGE)
    assert np.allclose(model.transition, a, rtol=0.02, atol=2e-3 * np.abs(a).max())
    assert np.allclose(model.offset, b, atol=5e-3 * np.abs(b).max())
    noisy, a, b, q = planted(n=400)
    found = LinearModel.fit(noisy, RIDGE).noise.numpy()
    scale = np.sqrt(np.outer(q.diagonal(), q.diagonal()))
    assert np.allclose(found / scale, np.eye(3), atol=0.05)


def test_the_linear_model_equals_numpys_least_squares():
    normal, *_ = planted()
    model = LinearModel.fit(normal, 1e-12)
    episodes = [obs[:length].astype(float) for obs, length in zip(normal.obs, normal.lengths, strict=True)]
    before, after = np.vstack([o[:-1] for o in episodes]), np.vstack([o[1:] for o in episodes])
    solution, *_ = np.linalg.lstsq(np.hstack([before, np.ones((len(before), 1))]), after, rcond=None)
    assert np.allclose(model.transition, solution[:-1].T, rtol=1e-6, atol=1e-8)
    assert np.allclose(model.offset, solution[-1], rtol=1e-6)
    left = after - model.predict(torch.from_numpy(before)).numpy()
    assert np.allclose(model.noise, np.cov(left.T, bias=True), rtol=1e-6, atol=1e-12)
    assert np.allclose(model.start, np.mean([o[0] for o in episodes], 0))


def test_the_gaussian_covers_all_observations_and_no_padding():
    normal, *_ = planted()
    seen = normal.obs[normal.mask].astype(float)
    gaussian = Gaussian.fit(normal, 1e-12)
    assert np.allclose(gaussian.mean, seen.mean(0)) and np.allclose(gaussian.covariance, np.cov(seen.T, bias=True))


@pytest.mark.parametrize("fit", [Gaussian.fit, LinearModel.fit])
def test_constant_and_doubled_observations_are_no_trouble(fit):
    normal, *_ = planted()
    wide = np.concatenate([normal.obs, normal.obs[..., :1], np.full_like(normal.obs[..., :1], 3)], -1)
    fitted = fit(Trajectories(wide, normal.lengths))
    matrix = fitted.covariance if fit == Gaussian.fit else fitted.noise
    assert torch.linalg.eigvalsh(matrix)[0] > 0
    if fit == LinearModel.fit:  # what it predicts does not suffer
        obs = torch.from_numpy(wide[:, 0])
        narrow = LinearModel.fit(normal).predict(obs[:, :3])
        assert torch.allclose(fitted.predict(obs)[:, :3], narrow, rtol=1e-3, atol=1e-4)
        assert torch.allclose(fitted.predict(obs)[:, 4], torch.tensor(3.0).double(), atol=1e-5)


@pytest.mark.parametrize("ridge", [0, -1.0, float("nan")])
@pytest.mark.parametrize("fit", [Gaussian.fit, LinearModel.fit])
def test_a_ridge_that_is_not_positive_is_refused(fit, ridge):
    with pytest.raises(ValueError, match="ridge"):
        fit(planted(n=2)[0], ridge)


def test_episodes_of_one_observation_say_nothing_of_what_follows():
    with pytest.raises(ValueError, match="normal: no trajectory has two"):
        LinearModel.fit(Trajectories(np.zeros((3, 5, 2), np.float32), np.array([1, 1, 1])))


@steady
@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.floats(0.3, 1.05))
def test_the_gain_solves_the_riccati_equation(seed, d, radius):
    """Even of an unstable system: every dimension is measured."""
    rng = np.random.default_rng(seed)
    a, root = rng.normal(size=(d, d)), rng.normal(size=(d, d))
    a *= radius / np.abs(np.linalg.eigvals(a)).max()
    q, r = root @ root.T + 0.1 * np.eye(d), np.diag(rng.uniform(0.01, 2, d))
    zeros = torch.zeros(d).double()
    model = LinearModel(torch.from_numpy(a), zeros, torch.from_numpy(q), zeros)
    predicted = solve_discrete_are(a.T, np.eye(d), q, r)
    expected = predicted @ np.linalg.inv(predicted + r)
    assert np.allclose(steady_gain(model, torch.from_numpy(r)), expected, atol=1e-6)
