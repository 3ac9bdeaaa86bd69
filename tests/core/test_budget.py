import numpy as np
import pytest
import torch
from builders import NORMS, cases, excess, normal, steady
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams


@steady
@given(cases())
def test_projection_lands_in_the_ball(case):
    budget, obs, far = case
    assert excess(budget, obs, budget.project(obs, far)) <= 0


@steady
@given(cases(), st.integers(0, 1000))
def test_samples_lie_in_the_ball(case, seed):
    budget, obs, _ = case
    assert excess(budget, obs, budget.sample(obs, RandomStreams(seed))) <= 0


@steady
@given(cases())
def test_projection_keeps_points_inside_the_ball(case):
    budget, obs, far = case
    inside = budget.project(obs, far)
    again = budget.project(obs, inside)
    assert torch.allclose(again, inside, rtol=1e-5, atol=1e-5 * float(inside.abs().max() + budget.epsilon))


@pytest.mark.parametrize("norm", NORMS)
def test_epsilon_zero_gives_back_the_observation_itself(norm):
    budget, obs = Budget(0.0, norm), normal(5, 7)
    assert torch.equal(budget.project(obs, obs + 3), obs)
    assert torch.equal(budget.sample(obs, RandomStreams(0)), obs)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("seed", range(4))
def test_projection_is_the_nearest_point_that_scipy_finds(norm, seed):
    rng = np.random.default_rng(seed)
    dim, epsilon = 5, 0.7
    scale = np.exp(rng.normal(size=dim)) if seed % 2 else np.ones(dim)
    obs, point = rng.normal(size=dim), rng.normal(size=dim) * 3
    target = (point - obs) / scale
    # |d| is split into two non-negative parts, so that every ball has smooth constraints.
    constraint = {
        float("inf"): lambda d: epsilon - d[:dim] - d[dim:],
        2: lambda d: epsilon**2 - ((d[:dim] - d[dim:]) ** 2).sum(),
        1: lambda d: epsilon - d.sum(),
    }[norm]
    found = minimize(
        lambda d: ((d[:dim] - d[dim:] - target) ** 2).sum(),
        np.full(2 * dim, 1e-3),
        method="SLSQP",
        bounds=[(0, None)] * 2 * dim,
        constraints=dict(type="ineq", fun=constraint),
        options=dict(maxiter=500, ftol=1e-13),
    ).x
    expected = obs + (found[:dim] - found[dim:]) * scale
    budget = Budget(epsilon, norm, torch.tensor(scale))
    assert np.allclose(budget.project(torch.tensor(obs), torch.tensor(point)), expected, atol=1e-4)


@pytest.mark.parametrize("norm", NORMS)
def test_no_random_step_climbs_faster_than_the_steepest(norm):
    budget = Budget(1.0, norm, torch.tensor([0.5, 1.0, 2.0, 3.0]))
    gradient, origin = normal(6, 4, seed=1), torch.zeros(6, 4)
    steepest = budget.steepest(gradient)
    assert torch.allclose(budget.size(origin, steepest), torch.ones(6))
    climbed = (steepest * gradient).sum(-1)
    for seed in range(200):
        other = budget.sample(origin, RandomStreams(seed))
        other = other / budget.size(origin, other)[:, None]
        assert ((other * gradient).sum(-1) <= climbed + 1e-5).all()


@pytest.mark.parametrize("norm", NORMS)
def test_samples_are_uniform_in_the_ball(norm):
    """A uniform point's size has the distribution r^dim, and every orthant is as likely."""
    dim, n = 3, 20_000
    origin, budget = torch.zeros(n, dim), Budget(2.0, norm)
    points = budget.sample(origin, RandomStreams(0))
    ordered = (budget.size(origin, points) / 2.0).sort().values.numpy()
    assert np.abs(ordered**dim - np.linspace(0, 1, n)).max() < 0.02  # Kolmogorov-Smirnov, p of about 1e-7
    assert (points > 0).double().mean(0).sub(0.5).abs().max() < 0.02
    # Archimedes: each coordinate of a uniform point on the sphere is uniform itself; on the octahedron Beta(1, 2).
    coordinate = (points / torch.linalg.vector_norm(points, ord=norm, dim=-1, keepdim=True))[:, 0].abs().double()
    if norm != float("inf"):
        cumulated = (coordinate if norm == 2 else 1 - (1 - coordinate) ** 2).sort().values.numpy()
        assert np.abs(cumulated - np.linspace(0, 1, n)).max() < 0.012
    # In the l2 and l1 balls a smaller box is filled as densely as its volume says.
    volume = {float("inf"): 1.0, 2: np.pi / 6, 1: 1 / 6}[norm]  # of the unit ball, in units of its enclosing box
    small_box = (points.abs() < 2 / 3).all(-1).double().mean()  # inside every ball: its corner has an l1 norm of 2
    assert abs(small_box - (1 / 27) / volume) < 0.02


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((-0.1,), "epsilon"),
        ((float("nan"),), "epsilon"),
        ((float("inf"),), "epsilon"),
        (("0.1",), "epsilon"),
        ((0.1, 3), "norm"),
        ((0.1, float("nan")), "norm"),
        ((0.1, "inf"), "norm"),
        ((0.1, 2, 0.0), "scale"),
        ((0.1, 2, torch.tensor([1.0, -1.0])), "scale"),
        ((0.1, 2, torch.tensor([1.0, float("inf")])), "scale"),
        ((0.1, 2, float("nan")), "scale"),
        ((0.1, 2, "wide"), "scale"),
        ((0.1, 2, []), "scale"),
        ((0.1, 2, np.ones((2, 3))), "scale"),
    ],
)
def test_a_ball_that_is_none_is_refused_by_name(arguments, name):
    with pytest.raises(ValueError, match=name):
        Budget(*arguments)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("make", [np.array, list, lambda scale: torch.tensor(scale, dtype=torch.float64)])
def test_every_kind_of_scale_is_the_same_float32_scale(norm, make):
    numbers, obs, far = [0.5, 1.0, 2.0], normal(4, 3), normal(4, 3, seed=1) * 9
    budget, expected = Budget(0.3, norm, make(numbers)), Budget(0.3, norm, torch.tensor(numbers))
    for found, same in (
        (budget.project(obs, far), expected.project(obs, far)),
        (budget.sample(obs, RandomStreams(0)), expected.sample(obs, RandomStreams(0))),
        (budget.steepest(far), expected.steepest(far)),
        (budget.size(obs, far), expected.size(obs, far)),
    ):
        assert found.dtype == torch.float32 and torch.equal(found, same)


def test_a_scale_that_is_one_number_stays_a_plain_number():
    assert [type(Budget(0.1, scale=scale).scale) for scale in (1, 1.0, np.float64(2.0))] == [float] * 3


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("length", [2, 4])
def test_a_scale_of_another_length_is_refused_at_first_use(norm, length):
    budget, obs = Budget(0.1, norm, [1.0] * length), normal(5, 3)
    for use in (
        lambda: budget.project(obs, obs), lambda: budget.projection(obs), lambda: budget.contains(obs, obs),
        lambda: budget.sample(obs, RandomStreams(0)),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=f"scale: it has {length} numbers, and an observation 3"):
            use()
