"""The largest error of a denoiser: known in closed form or by enumeration, and larger than any that is sampled."""

import itertools
import math

import pytest
import torch
from builders import BUDGET, make_gruvae, normal

from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.theory.worst_error import worst_error, worst_errors


def test_episodes_of_another_shape_are_refused():
    for obs in (normal(3, 11), normal(3, 6, 17)):
        with pytest.raises(ValueError, match="obs must be"):
            worst_errors(make_gruvae(), obs, BUDGET, RandomStreams(0))


def test_the_identity_errs_by_the_distance_to_the_corners():
    obs = normal(4, 11)
    found, error = worst_error(lambda x: x, obs, BUDGET, RandomStreams(0))
    assert torch.allclose(error, torch.full((4,), BUDGET.epsilon * math.sqrt(11)), rtol=1e-5)
    assert BUDGET.contains(obs, found).all()


def test_the_largest_error_of_a_linear_denoiser_is_found():
    """The error is convex, so that its largest value is at one of the box's 2^d corners: try them all."""
    d, budget, obs = 6, Budget(0.3), normal(3, 6, seed=1)
    matrix, offset = normal(d, d, seed=2), normal(d, seed=3)

    def denoise(x):
        return x @ matrix.T + offset

    corners = obs[:, None] + 0.3 * torch.tensor(list(itertools.product([-1.0, 1.0], repeat=d)))
    largest = (denoise(corners) - obs[:, None]).norm(dim=-1).amax(1)
    _, error = worst_error(denoise, obs, budget, RandomStreams(0), restarts=20)
    assert torch.allclose(error, largest, rtol=1e-5)


def test_along_episodes_ascent_beats_sampling_and_the_denoiser_remembers():
    model, obs = make_gruvae(residual=True), normal(3, 6, 11)

    def fresh(x):
        return model(x[:, None]).output[:, 0]

    errors, streams = worst_errors(model, obs, BUDGET, RandomStreams(0)), RandomStreams(0)
    forgetful = torch.stack([worst_error(fresh, now, BUDGET, streams)[1] for now in obs.unbind(1)], 1)
    assert torch.allclose(errors[:, 0], forgetful[:, 0])
    assert not torch.isclose(errors[:, 1:], forgetful[:, 1:]).any()  # from the same random starts
    for seed in range(50):
        sampled = BUDGET.sample(obs[:, 0], RandomStreams(seed))
        assert ((fresh(sampled) - obs[:, 0]).norm(dim=-1) <= errors[:, 0]).all()
