"""Appendix A: every inequality under its correct conditions, and every false step with its counterexample."""

import itertools
import math

import numpy as np
import pytest
import torch
from builders import HOPPER, make_victim, normal, steady
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm
from torch.distributions import MultivariateNormal, kl_divergence

from detden_lite.core.distances import mahalanobis
from detden_lite.theory import bound
from detden_lite.theory.finite_mdp import FiniteMDP, largest_tv, leaving
from detden_lite.victims.victim import Victim

SEEDS = st.integers(0, 2**32 - 1)
GAMMAS = st.sampled_from([0.0, 0.3, 0.5, 0.9, 0.99])


def distance(mean_1, mean_2, cov):
    """The Mahalanobis distance of two means, not squared."""
    return mahalanobis(mean_1, mean_2, factor=torch.linalg.cholesky(cov)).sqrt()


def positive_definite(rng, d):
    factor = rng.normal(size=(d, d))
    return torch.from_numpy(factor @ factor.T + np.diag(np.exp(rng.uniform(-2, 2, d))))


@st.composite
def gaussians(draw):
    """Two means and two covariances, which may be correlated, in float64."""
    rng, d = np.random.default_rng(draw(SEEDS)), draw(st.integers(1, 5))
    size = draw(st.sampled_from([0.0, 1e-3, 1.0, 10.0]))
    means = torch.from_numpy(rng.normal(size=(2, d)) * size)
    return *means, positive_definite(rng, d), positive_definite(rng, d)


@st.composite
def mdps(draw):
    """A random MDP, a policy, and what may be shown in each state. Sparse ones have absorbing states."""
    rng = np.random.default_rng(draw(SEEDS))
    states, actions = draw(st.integers(2, 4)), draw(st.integers(2, 3))
    concentration = draw(st.sampled_from([0.05, 1.0]))
    transition = rng.dirichlet(np.full(states, concentration), (states, actions))
    policy = rng.dirichlet(np.full(actions, draw(st.sampled_from([0.05, 1.0, 30.0]))), states)
    reward = rng.normal(size=transition.shape)
    allowed = rng.random((states, states)) < 0.6
    return FiniteMDP(transition, reward, draw(GAMMAS)), policy, allowed


def attacked_value(mdp, policy, allowed):
    return mdp.value(policy[mdp.worst_attack(policy, allowed)])


# From total variation to the distance of the means


@steady
@given(gaussians())
def test_the_two_kl_terms_sum_to_that_of_torch(case):
    mean_1, mean_2, cov_1, cov_2 = case
    of_covariances, of_means = bound.kl_parts(mean_1, cov_1, mean_2, cov_2)
    first, second = MultivariateNormal(mean_1, cov_1), MultivariateNormal(mean_2, cov_2)
    assert torch.isclose(of_covariances + of_means, kl_divergence(first, second), rtol=1e-6, atol=1e-9)
    assert of_covariances >= -1e-9 and of_means >= 0


@pytest.mark.parametrize("distance", [0.0, 0.01, 1.0, 3.0, 8.0])
def test_total_variation_is_half_the_integral_of_the_difference(distance):
    half, _ = quad(lambda x: abs(norm.pdf(x) - norm.pdf(x - distance)), -12, 12 + distance, points=[distance / 2])
    assert bound.total_variation(torch.tensor(distance, dtype=torch.double)) == pytest.approx(half / 2, abs=1e-8)


def test_total_variation_in_several_dimensions_is_what_sampling_finds():
    """TV is the difference of both Gaussians' probabilities of the region in which the first is denser."""
    rng = np.random.default_rng(0)
    cov, mean = positive_definite(rng, 3), torch.tensor([0.5, -0.3, 0.8], dtype=torch.double)
    first, second = MultivariateNormal(torch.zeros(3, dtype=torch.double), cov), MultivariateNormal(mean, cov)
    torch.manual_seed(0)
    found = [
        (first.log_prob(x) > second.log_prob(x)).double().mean()
        for x in (d.sample((200_000,)) for d in (first, second))
    ]
    expected = bound.total_variation(distance(first.mean, mean, cov))
    assert expected > 0.1 and abs(found[0] - found[1] - expected) < 0.006  # four standard errors


@steady
@given(gaussians())
def test_pinsker_holds_and_costs_a_quarter_at_small_distances(case):
    mean_1, mean_2, cov, _ = case
    exact = bound.total_variation(distance(mean_1, mean_2, cov))
    above = bound.pinsker(sum(bound.kl_parts(mean_1, cov, mean_2, cov)).clamp_min(0))
    assert exact <= above + 1e-7
    # The covariances' term is 0 only up to rounding, and its root is larger: from the means' term alone.
    closest = bound.pinsker(bound.kl_parts(mean_1, cov, mean_2, cov)[1])
    assert closest >= exact * math.sqrt(math.pi / 2) * (1 - 1e-9)


def test_pinsker_fails_for_the_whole_l1_distance():
    distance = torch.tensor(0.1)
    assert 2 * bound.total_variation(distance) > bound.pinsker(0.5 * distance.square())


@steady
@given(gaussians())
def test_equal_covariances_need_a_c_1_of_exactly_one_half(case):
    mean_1, mean_2, cov, _ = case
    kl = kl_divergence(MultivariateNormal(mean_1, cov), MultivariateNormal(mean_2, cov))
    squared = distance(mean_1, mean_2, cov).square()
    assert bound.c_1(cov, cov.clone()) == 0.5
    assert torch.isclose(kl, 0.5 * squared, rtol=1e-6, atol=1e-9)


def test_with_unequal_covariances_no_c_1_exists():
    """The appendix's step: a constant plus half of x is to be at most C_1 x, for all x. At x = 0 it is not."""
    mean, one, two = torch.zeros(1), torch.ones(1, 1), 2 * torch.ones(1, 1)
    of_covariances, of_means = bound.kl_parts(mean, one, mean, two)
    assert of_covariances == pytest.approx(0.5 * (math.log(2) - 0.5)) and round(float(of_covariances), 4) == 0.0966
    assert of_means == 0  # the right side, whatever it is multiplied by
    assert bound.c_1(one, two) == math.inf


@steady
@given(gaussians())
def test_c_2_is_large_enough_and_reached(case):
    x, _, cov, _ = case
    zero, c_2 = torch.zeros_like(x), bound.c_2(cov)
    assert distance(zero, x, cov).square() <= c_2 * x.square().sum() * (1 + 1e-9)
    steepest = torch.linalg.eigh(cov).eigenvectors[:, 0]
    assert distance(zero, steepest, cov).square() == pytest.approx(c_2)


def test_the_elements_of_an_inverse_covariance_need_not_be_positive():
    """The reason that the appendix gives for C_2. Its covariances are diagonal: zeros. Correlation gives negatives."""
    assert (torch.linalg.inv(torch.diag(torch.tensor([1.0, 4.0]))) == 0).any()
    assert (torch.linalg.inv(torch.tensor([[1.0, 0.5], [0.5, 1.0]])) < 0).any()


def test_the_largest_element_of_an_inverse_is_no_c_2():
    cov = torch.linalg.inv(torch.tensor([[1.0, 0.9], [0.9, 1.0]]))
    assert torch.linalg.inv(cov).max() == pytest.approx(1.0, abs=1e-5)
    assert bound.c_2(cov) == pytest.approx(1.9, abs=1e-5)
    assert distance(torch.zeros(2), torch.ones(2), cov).square() > 1.5 * torch.ones(2).square().sum()


def test_shrinking_noise_makes_c_2_grow_without_limit():
    sizes = [1.0, 0.1, 0.01]
    assert [bound.c_2(size**2 * torch.eye(3)) for size in sizes] == pytest.approx([1, 100, 10_000])


# The policy


@settings(steady, max_examples=40)
@given(SEEDS, st.booleans(), st.sampled_from([1e-3, 1.0, 100.0]))
def test_no_two_observations_are_stretched_more_than_the_certificate_says(seed, gaussian, far):
    victim = uneven_victim(seed % 1000, gaussian)
    rng = torch.Generator().manual_seed(seed)
    obs = 3 * torch.randn(64, victim.obs_dim, generator=rng)
    other = obs + far * torch.randn(obs.shape, generator=rng)
    moved = (victim.double().mean(other.double()) - victim.mean(obs.double())).norm(dim=-1)
    assert (moved <= bound.lipschitz_certified(victim) * (other.double() - obs.double()).norm(dim=-1) + 1e-9).all()
    assert bound.stretches(victim, obs.double()).max() <= bound.lipschitz_certified(victim) * (1 + 1e-9)


def uneven_victim(seed, gaussian):
    """A policy whose normaliser, clipping and action bounds all matter."""
    victim = make_victim(seed=seed, gaussian=gaussian)
    victim.obs_mean.copy_(torch.linspace(-1, 1, victim.obs_dim))
    victim.obs_std.copy_(torch.linspace(0.1, 3, victim.obs_dim))
    victim.obs_clip.fill_(2.0)
    victim.action_low.copy_(torch.tensor([-1.0, -3.0, 0.0]))
    victim.action_high.copy_(torch.tensor([1.0, 3.0, 0.5]))
    return victim


@pytest.mark.parametrize("gaussian", [False, True])
def test_certificate_and_jacobian_of_a_linear_policy_agree(gaussian):
    """Far inside the tanh and the clipping the policy of one layer is linear: both must be its matrix's norm."""
    torch.manual_seed(0)
    victim = Victim([HOPPER.obs_dim, HOPPER.action_dim], gaussian=gaussian)
    victim.obs_std.copy_(torch.linspace(0.1, 3, HOPPER.obs_dim))
    victim.action_high.copy_(torch.tensor([1.0, 5.0, 0.0]))
    victim.actor[0].bias.zero_()
    matrix = victim.actor[0].weight / victim.obs_std
    if not gaussian:
        matrix = matrix * torch.tensor([[1.0], [3.0], [0.5]])
    expected = torch.linalg.matrix_norm(matrix, ord=2).item()
    assert bound.lipschitz_certified(victim) == pytest.approx(expected, rel=1e-5)
    assert bound.stretches(victim, torch.zeros(2, HOPPER.obs_dim)).tolist() == pytest.approx([expected] * 2, rel=1e-5)


def test_stretches_are_what_small_steps_find():
    victim, obs = uneven_victim(0, True).double(), 0.5 * normal(5, HOPPER.obs_dim).double()
    step = 1e-6
    columns = [(victim.mean(obs + step * e) - victim.mean(obs - step * e)) / (2 * step) for e in torch.eye(11).double()]
    expected = torch.linalg.matrix_norm(torch.stack(columns, -1), ord=2)
    assert torch.allclose(bound.stretches(victim, obs), expected, rtol=1e-5)


def test_beta_depends_on_the_policy():
    """The theorem says that it does not. The same policy with twice the output stretches twice as much."""
    victim = make_victim(gaussian=True)
    before = bound.beta(1.0, bound.lipschitz_certified(victim), bound.c_2(torch.eye(3)))
    victim.actor[-1].weight.mul_(2)
    assert bound.beta(1.0, bound.lipschitz_certified(victim), bound.c_2(torch.eye(3))) == pytest.approx(2 * before)
    assert bound.beta(1.0, 1.0, bound.c_2(0.01 * torch.eye(3))) == pytest.approx(10 * bound.beta(1.0, 1.0, 1.0))


@steady
@given(SEEDS)
def test_the_links_hold_together(seed):
    """From two observations to the total variation of the actions, along the whole chain."""
    victim = uneven_victim(seed % 1000, True).double()
    victim.action_std.copy_(torch.tensor([0.2, 1.0, 3.0]))
    rng = torch.Generator().manual_seed(seed)
    obs = torch.randn(16, victim.obs_dim, generator=rng).double()
    other = obs + 0.05 * torch.randn(obs.shape, generator=rng).double()
    cov = torch.diag(victim.action_std.square())
    tv = bound.total_variation(distance(victim.mean(obs), victim.mean(other), cov))
    factor = bound.beta(1.0, bound.lipschitz_certified(victim), bound.c_2(cov))
    assert (tv <= factor * (other - obs).norm(dim=-1)).all()


# The value


@settings(steady, max_examples=20)
@given(mdps())
def test_values_are_those_of_iterating_bellmans_equation(case):
    mdp, policy, _ = case
    value = np.zeros(len(policy))
    for _ in range(4000):
        value = (policy * mdp.action_values(value)).sum(-1)
    assert np.allclose(mdp.value(policy), value, atol=1e-6)


@steady
@given(mdps())
def test_the_worst_attack_is_the_worst_of_all(case):
    mdp, policy, allowed = case
    found = attacked_value(mdp, policy, allowed)
    choices = [np.flatnonzero(row | (np.arange(len(row)) == s)) for s, row in enumerate(allowed)]
    everyone = [mdp.value(policy[list(shown)]) for shown in itertools.product(*choices)]
    assert np.allclose(found, np.min(everyone, axis=0), atol=1e-8)  # in every state at once


@steady
@given(mdps())
def test_the_value_lost_is_bounded_by_the_total_variation(case):
    """Zhang's theorem with the right constant, and the sharper one by coupling."""
    mdp, policy, allowed = case
    lost = (mdp.value(policy) - attacked_value(mdp, policy, allowed)).max()
    tv = largest_tv(policy, allowed)
    sharp = bound.coupled(tv, mdp.gamma, mdp.reward_range)
    rounding = 1e-9 / (1 - mdp.gamma) ** 2
    assert lost <= sharp + rounding
    assert sharp <= bound.alpha(mdp.gamma, mdp.reward_range) * tv * (1 + 1e-12)
    assert sharp <= bound.most_that_can_be_lost(mdp.gamma, mdp.reward_range) * (1 + 1e-12)


@steady
@given(GAMMAS, st.floats(1e-6, 1))
def test_no_sharper_bound_is_true(gamma, tv):
    mdp, policy = leaving(gamma, tv)
    allowed = np.ones((2, 2), dtype=bool)
    lost = (mdp.value(policy) - attacked_value(mdp, policy, allowed))[0]
    assert largest_tv(policy, allowed) == pytest.approx(tv)
    assert lost == pytest.approx(bound.coupled(tv, gamma, 2.0), rel=1e-6)


def test_the_coupled_bound_equals_the_sum_of_its_proof():
    gamma, tv = 0.9, 0.07
    terms = [gamma**t * (1 - (1 - tv) ** (t + 1)) for t in range(2000)]
    assert bound.coupled(tv, gamma, 3.0) == pytest.approx(3 * sum(terms))


@pytest.mark.parametrize("gamma", [0.2, 0.5, 0.9, 0.99])
def test_the_printed_alpha_is_too_small(gamma):
    tv = 1e-3 * (1 - gamma) ** 2
    mdp, policy = leaving(gamma, tv)
    lost = (mdp.value(policy) - mdp.value(policy[[1, 1]]))[0]
    assert bound.alpha_printed(gamma, 2.0) * tv < lost < bound.alpha(gamma, 2.0) * tv
    assert lost < 2 * bound.alpha_printed(gamma, 2.0) * tv  # with the whole l1 distance it would hold


def test_the_printed_alpha_is_short_by_a_third_at_most():
    gammas = np.linspace(0, 0.999, 1000)
    short = np.array([bound.alpha(g, 2.0) / bound.alpha_printed(g, 2.0) for g in gammas])
    assert short.max() == pytest.approx(4 / 3, rel=1e-4) and gammas[short.argmax()] == pytest.approx(0.5, abs=2e-3)


def test_the_printed_inequality_fails_for_a_constant_policy():
    """V(o) against V(o'): the total variation is 0, the values are not the same. Nobody attacks here."""
    mdp, _ = leaving(0.9, 0.0)
    constant = np.array([[1.0, 0.0], [1.0, 0.0]])
    allowed = np.ones((2, 2), dtype=bool)
    value = mdp.value(constant)
    assert largest_tv(constant, allowed) == 0
    assert value[0] - value[1] == pytest.approx(20)
    assert np.array_equal(attacked_value(mdp, constant, allowed), value)  # what Zhang's theorem compares


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9, 0.99])
def test_the_bound_is_vacuous_from_1_minus_gamma_on(gamma):
    def vacuous(alpha, tv):
        return alpha(gamma, 3.0) * tv >= bound.most_that_can_be_lost(gamma, 3.0)

    assert vacuous(bound.alpha, (1 - gamma) * (1 + 1e-9)) and not vacuous(bound.alpha, (1 - gamma) * (1 - 1e-9))
    assert bound.largest_gamma(1 - gamma) == pytest.approx(gamma)


def test_the_printed_alpha_is_vacuous_from_0_0101_on():
    threshold = bound.most_that_can_be_lost(0.99, 1.0) / bound.alpha_printed(0.99, 1.0)
    assert round(threshold, 4) == 0.0101


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: bound.alpha(1.0, 1.0), "gamma"),
        (lambda: bound.alpha_printed(-0.1, 1.0), "gamma"),
        (lambda: bound.coupled(0.1, 2.0, 1.0), "gamma"),
        (lambda: bound.coupled(1.1, 0.9, 1.0), "tv"),
        (lambda: bound.largest_gamma(-0.1), "tv"),
        (lambda: bound.beta(1.0, -1.0, 1.0), "lipschitz"),
        (lambda: bound.c_2(torch.diag(torch.tensor([1.0, 0.0]))), "cov"),
        (lambda: bound.most_that_can_be_lost(0.9, -1.0), "reward_range"),
        (lambda: bound.most_that_can_be_lost(0.9, math.nan), "reward_range"),
        (lambda: FiniteMDP(np.ones((2, 2)), np.ones((2, 2)), 0.9), "transition"),
        (lambda: FiniteMDP(np.full((2, 2, 2), 0.5), np.full((2, 2, 2), np.nan), 0.9), "reward"),
        (lambda: leaving(0.9, 1.5), "tv"),
        (lambda: leaving(0.9, 0.5)[0].value(np.ones((2, 2))), "policy"),
        (lambda: leaving(0.9, 0.5)[0].value(np.full((3, 2), 0.5)), "policy"),
        (lambda: leaving(0.9, 0.5)[0].worst_attack(np.full((2, 2), 0.5), np.ones((3, 3), bool)), "allowed"),
        (lambda: largest_tv(np.full((2, 2), 0.5), np.ones((2, 2))), "allowed"),
        (lambda: FiniteMDP(np.ones((2, 2, 2)), np.ones((2, 2, 2)), 0.9), "transition"),
        (lambda: FiniteMDP(np.full((2, 2, 2), 0.5), np.ones((2, 2)), 0.9), "reward"),
        (lambda: FiniteMDP(np.full((2, 2, 2), 0.5), np.ones((2, 2, 2)), 1.0), "gamma"),
    ],
)
def test_arguments_that_make_no_sense_are_refused_by_name(call, name):
    with pytest.raises(ValueError, match=name):
        call()
