import numpy as np
import pytest
import scipy.spatial.distance
import torch
from builders import normal, steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.core.distances import euclidean, mahalanobis


def test_the_two_distances_are_the_papers():
    action, reference = torch.tensor([[3.0, 4.0]]), torch.tensor([[0.0, 0.0]])
    assert euclidean(action, reference).tolist() == [5.0]
    sigma = torch.diag(torch.tensor([0.25, 4.0]))
    expected = action @ sigma.inverse() @ action.T
    assert mahalanobis(action, reference, torch.tensor([0.5, 2.0])).tolist() == [expected.item()]


@steady
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_a_full_covariance_gives_the_distance_of_scipy(seed, d):
    rng = np.random.default_rng(seed)
    root, x, y = rng.normal(size=(d, d)), rng.normal(size=(4, 3, d)), rng.normal(size=d)
    covariance = root @ root.T + 0.1 * np.eye(d)
    factor = torch.linalg.cholesky(torch.from_numpy(covariance))
    found = mahalanobis(torch.from_numpy(x), torch.from_numpy(y), factor=factor)
    inverse = np.linalg.inv(covariance)
    expected = [[scipy.spatial.distance.mahalanobis(a, y, inverse) ** 2 for a in row] for row in x]
    assert np.allclose(found, expected, rtol=1e-6)


@steady
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_the_three_descriptions_of_sigma_agree(seed, d):
    std = torch.from_numpy(np.exp(np.random.default_rng(seed).normal(size=d)))
    x, y = normal(2, 5, d, seed=seed % 1000).double(), normal(d).double()
    expected = mahalanobis(x, y, std)
    assert torch.allclose(mahalanobis(x, y, precision=std**-2), expected)
    assert torch.allclose(mahalanobis(x, y, factor=torch.diag(std)), expected)
    assert torch.allclose(mahalanobis(x, y, precision=1.0), euclidean(x, y).square())


@pytest.mark.parametrize("sigma", [{}, dict(std=torch.ones(2), precision=1.0)])
def test_no_sigma_or_two_are_refused(sigma):
    with pytest.raises(ValueError, match="std, precision and factor"):
        mahalanobis(torch.ones(1, 2), torch.zeros(1, 2), **sigma)
