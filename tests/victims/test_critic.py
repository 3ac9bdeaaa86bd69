from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import steady
from cart import CART, GAMMA, TrueQ, make_driver
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.core.types import Episodes
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.critic import QRecipe, explored_returns, learn_q
from detden_lite.victims.victim import Victim

RECIPE = QRecipe(noise=0.3, noise_rate=0.2, net=64, epochs=20, batch=128, learning_rate=3e-3, gamma=GAMMA)


def one_by_one(reward, value, explored, cut_off: bool, gamma: float) -> list[float]:
    """The targets of a single episode: rewards one after the other, up to the next explored step or the end."""
    length, targets = len(reward), []
    for t in range(length):
        end = next((k for k in range(t + 1, length) if explored[k]), length)
        rest = value[end] if end < length else (value[-1] if cut_off else 0.0)
        targets.append(sum(gamma ** (k - t) * reward[k] for k in range(t, end)) + gamma ** (end - t) * rest)
    return targets


@given(
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=4),
    rate=st.floats(0, 1),
    gamma=st.floats(0, 1),
    seed=st.integers(0, 99),
)
@steady
def test_targets_are_those_of_a_loop_over_single_episodes(lengths, rate, gamma, seed):
    steps = max(lengths)
    rng = np.random.default_rng(seed)
    reward, value = rng.normal(size=(2, steps, len(lengths)))
    explored = rng.random((steps, len(lengths))) < rate
    mask = np.arange(steps)[:, None] < lengths
    cut_off = (mask.sum(0) == steps) & (seed % 2 == 0)
    found = explored_returns(reward, value, explored, mask, cut_off, gamma)
    for i, n in enumerate(lengths):
        expected = one_by_one(reward[:n, i], value[:n, i], explored[:n, i], cut_off[i], gamma)
        assert found[:n, i] == pytest.approx(expected, abs=1e-9)
    assert not found[~mask].any()


@pytest.fixture(scope="module")
def driver() -> Victim:
    """The linear policy on the cart."""
    return make_driver()


def explore(driver: Victim, seeds) -> Episodes:
    return rollout(driver, CART, seeds, action_noise=RECIPE.noise, noise_rate=RECIPE.noise_rate)


@pytest.fixture(scope="module")
def learned(driver):
    net = learn_q(driver, CART, RECIPE, explore(driver, range(300)))
    return driver.with_critic(RECIPE.sizes(CART), net.state_dict())


def test_regression_finds_the_q_that_is_known(driver, learned):
    drives = explore(driver, range(500, 600))
    obs, action = torch.from_numpy(drives.obs), torch.from_numpy(drives.action)
    true = TrueQ()(driver.critic_input(obs, action))[..., 0]
    assert (learned.q(obs, action) - true).abs().mean() < 0.1 * true.std()
    for x, better, worse in ((1.0, -0.5, 0.5), (-1.0, 0.5, -0.5)):  # towards the middle, or away from it
        values = learned.q(torch.full((2, 1), x), torch.tensor([[better], [worse]]))
        assert values[0] > values[1]


def test_a_learned_q_has_the_true_gradient_with_respect_to_actions(driver, learned):
    obs, action = torch.tensor([[1.0], [-1.0]]), torch.tensor([[0.5], [-0.5]], requires_grad=True)
    (found,) = torch.autograd.grad(learned.q(obs, action).sum(), action)
    (true,) = torch.autograd.grad(TrueQ()(driver.critic_input(obs, action)).sum(), action)
    assert torch.allclose(found, true, rtol=0.6)  # and so of the same sign


def test_the_same_seeds_learn_the_same(driver):
    short, episodes = replace(RECIPE, epochs=1), explore(driver, range(8))
    nets = [learn_q(driver, CART, short, episodes, seed=seed) for seed in (0, 0, 1)]
    assert torch.equal(nets[0][0].weight, nets[1][0].weight) and not torch.equal(nets[0][0].weight, nets[2][0].weight)
    assert not any(parameter.requires_grad for parameter in nets[0].parameters())


def test_episodes_without_exploration_are_refused(driver):
    with pytest.raises(ValueError, match="episodes: no action was explored"):
        learn_q(driver, CART, RECIPE, rollout(driver, CART, [3]))


@pytest.mark.parametrize(
    "change",
    [
        dict(episodes=0), dict(net=0), dict(epochs=0), dict(epochs=1.5), dict(batch=0), dict(learning_rate=0.0),
        dict(learning_rate=-1.0), dict(gamma=1.5), dict(gamma=np.nan), dict(noise=0.0), dict(noise_rate=0.0),
        dict(noise_rate=1.1), dict(weight=0.0), dict(judged=0),
    ],
    ids=str,
)  # fmt: skip
def test_a_recipe_with_a_bad_number_is_refused_by_name(change):
    with pytest.raises(ValueError, match=f"{next(iter(change))} must be"):
        replace(RECIPE, **change)
