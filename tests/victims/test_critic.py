from dataclasses import replace
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch
from builders import HOPPER, make_victim, steady
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.critic import QRecipe, fit, lambda_returns, learn_q, policy_noise
from detden_lite.victims.victim import Victim

DRAG, PUSH, GAIN, STD, GAMMA = 0.9, 0.5, 0.8, 0.5, 0.8
RECIPE = QRecipe(net=64, epochs=40, batch=128, learning_rate=3e-3, gamma=GAMMA)


class Cart(gymnasium.Env):
    """x' = 0.9 x + 0.5 a, with reward -x^2 - a^2: so simple that Q of a linear policy is known."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))
    action_space = gymnasium.spaces.Box(-3, 3, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.at(self.np_random.uniform(-2, 2, 1)), {}

    def at(self, x):
        self.data = SimpleNamespace(qpos=x, qvel=x[:0])  # as MuJoCo keeps it
        return x

    def step(self, action):
        x = self.data.qpos
        return self.at(DRAG * x + PUSH * action), float(-(x**2 + action**2)[0]), False, False, {}


gymnasium.register("Cart-v0", Cart)
CART = Task("cart", "Cart-v0", epsilon=0.1, obs_dim=1, action_dim=1, horizon=20)


class TrueQ(nn.Module):
    """Q of the policy N(-GAIN x, STD^2): V(x) = -slope x^2 - offset, from one Bellman equation for each of the two."""

    def forward(self, inputs):
        x, action = inputs[..., :1], 3 * inputs[..., 1:]  # what a critic sees: the action is scaled
        slope = (1 + GAIN**2) / (1 - GAMMA * (DRAG - PUSH * GAIN) ** 2)
        offset = STD**2 * (1 + GAMMA * slope * PUSH**2) / (1 - GAMMA)
        return -(x**2) - action**2 - GAMMA * (slope * (DRAG * x + PUSH * action) ** 2 + offset)


def one_by_one(reward, q, cut_off: bool, gamma: float, lam: float) -> list[float]:
    """The targets of a single episode, each as the weighted sum of its n-step returns (Sutton and Barto, 12.3)."""
    length, targets = len(reward), []
    for t in range(length):
        n_step = []
        for n in range(1, length - t + 1):
            rest = q[t + n] if t + n < length else (q[-1] if cut_off else 0.0)
            n_step.append(sum(gamma**k * reward[t + k] for k in range(n)) + gamma**n * rest)
        weights = [(1 - lam) * lam ** (n - 1) for n in range(1, len(n_step))] + [lam ** (len(n_step) - 1)]
        targets.append(sum(w * g for w, g in zip(weights, n_step, strict=True)))
    return targets


@given(
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=4),
    horizon=st.integers(5, 8),
    gamma=st.floats(0, 1),
    lam=st.floats(0, 1),
    seed=st.integers(0, 99),
)
@steady
def test_targets_are_those_of_a_loop_over_single_episodes(lengths, horizon, gamma, lam, seed):
    lengths = [min(length, horizon) for length in lengths]
    steps = max(lengths)
    rng = np.random.default_rng(seed)
    reward, q = rng.normal(size=(2, steps, len(lengths)))
    mask = np.arange(steps)[:, None] < lengths
    found = lambda_returns(reward, q, mask, horizon, QRecipe(gamma=gamma, lam=lam))
    for i, length in enumerate(lengths):
        expected = one_by_one(reward[:length, i], q[:length, i], length == horizon, gamma, lam)
        assert found[:length, i] == pytest.approx(expected, abs=1e-9)
    assert not found[~mask].any()


def test_with_lambda_one_a_target_is_the_discounted_return():
    rng = np.random.default_rng(0)
    reward, q = rng.normal(size=(2, 7, 3))
    lengths = np.array([7, 4, 1])
    found = lambda_returns(reward, q, np.arange(7)[:, None] < lengths, 100, QRecipe(gamma=0.9, lam=1.0))
    for i, length in enumerate(lengths):
        assert found[0, i] == pytest.approx(sum(0.9**t * reward[t, i] for t in range(length)))


@pytest.fixture(scope="module")
def driver() -> Victim:
    """The linear policy on the cart."""
    victim = Victim([1, 1], value=[1, 1], gaussian=True)
    victim.load_state_dict(
        victim.state_dict()
        | {"actor.0.weight": torch.tensor([[-GAIN]]), "actor.0.bias": torch.zeros(1)}
        | dict(action_low=torch.tensor([-3.0]), action_high=torch.tensor([3.0]), action_std=torch.tensor([STD]))
    )
    return victim


@pytest.fixture(scope="module")
def drives(driver) -> Episodes:
    return rollout(driver, CART, range(500, 600), action_noise=STD / 3)


class Constant(nn.Module):
    def __init__(self, value: float):
        super().__init__()
        self.value = value

    def forward(self, inputs):
        return torch.full((*inputs.shape[:-1], 1), self.value)


def test_the_fit_is_one_for_the_truth_zero_for_constants(driver, drives):
    true = fit(TrueQ(), driver, drives, CART.horizon, RECIPE)
    assert 0.75 < true.explained_variance < 1  # the rest is what later actions will do by chance
    assert true.action_correlation > 0.5
    assert true.episodes == 100 and true.steps == 100 * 10  # the first half, after which a return is half unknown
    for value in (0.0, -5.0):
        flat = fit(Constant(value), driver, drives, CART.horizon, RECIPE)
        assert (flat.explained_variance, flat.action_correlation) == (pytest.approx(0, abs=1e-9), 0)


def test_the_fit_of_a_reward_is_exact_where_nothing_follows(driver, drives):
    now = replace(RECIPE, gamma=0.0)
    reward = nn.Linear(2, 1).requires_grad_(False)
    reward.weight.copy_(torch.tensor([[1.0, 2.0]]))
    inputs = driver.critic_input(torch.from_numpy(drives.obs), torch.from_numpy(drives.action))
    episodes = replace(drives, reward=reward(inputs)[..., 0].numpy().astype(float))
    perfect = fit(reward, driver, episodes, CART.horizon, now)
    assert (perfect.explained_variance, perfect.action_correlation) == pytest.approx((1, 1), abs=1e-4)
    reward.weight[0, 1] *= -1  # the worth of an action the wrong way round
    assert fit(reward, driver, episodes, CART.horizon, now).action_correlation < -0.2


def test_equal_returns_leave_nothing_to_explain(driver, drives):
    same = fit(Constant(5.0), driver, replace(drives, reward=np.ones_like(drives.reward)), CART.horizon, RECIPE)
    assert (same.explained_variance, same.action_correlation) == (pytest.approx(0, abs=1e-9), 0)


def test_returns_of_an_ended_episode_are_all_known(driver, drives):
    lengths = np.where(np.arange(100) < 50, 20, 7)
    found = fit(TrueQ(), driver, replace(drives, mask=np.arange(20)[:, None] < lengths), CART.horizon, RECIPE)
    assert found.steps == 50 * 10 + 50 * 7


def learn(driver: Victim, recipe: QRecipe, seeds, seed: int = 0):
    return learn_q(driver, CART, recipe, rollout(driver, CART, seeds, action_noise=policy_noise(driver)), seed=seed)


@pytest.fixture(scope="module")
def learned(driver):
    net, found = learn(driver, RECIPE, range(300))
    return driver.with_critic([2, 64, 64, 1], net.state_dict()), found


def test_regression_finds_the_q_that_is_known(driver, drives, learned):
    victim, found = learned
    obs, action = torch.from_numpy(drives.obs), torch.from_numpy(drives.action)
    true = TrueQ()(driver.critic_input(obs, action))[..., 0]
    assert (victim.q(obs, action) - true).abs().mean() < 0.1 * true.std()
    best = fit(TrueQ(), driver, drives, CART.horizon, RECIPE)
    assert found.explained_variance > best.explained_variance - 0.1
    assert found.action_correlation > best.action_correlation - 0.1
    assert found.episodes == 38  # one in eight was held out
    for x, better, worse in ((1.0, -0.5, 0.5), (-1.0, 0.5, -0.5)):  # towards the middle, or away from it
        values = victim.q(torch.full((2, 1), x), torch.tensor([[better], [worse]]))
        assert values[0] > values[1]


def test_a_learned_q_has_the_true_gradient_with_respect_to_actions(driver, learned):
    obs, action = torch.tensor([[1.0], [-1.0]]), torch.tensor([[0.5], [-0.5]], requires_grad=True)
    (found,) = torch.autograd.grad(learned[0].q(obs, action).sum(), action)
    (true,) = torch.autograd.grad(TrueQ()(driver.critic_input(obs, action)).sum(), action)
    assert torch.allclose(found, true, rtol=0.6)  # and so of the same sign


def test_the_same_seeds_learn_the_same(driver):
    short = replace(RECIPE, epochs=1)
    nets = [learn(driver, short, range(8), seed=seed)[0] for seed in (0, 0, 1)]
    assert torch.equal(nets[0][0].weight, nets[1][0].weight) and not torch.equal(nets[0][0].weight, nets[2][0].weight)
    assert not any(parameter.requires_grad for parameter in nets[0].parameters())


def test_a_deterministic_victim_is_refused(drives):
    with pytest.raises(ValueError, match="victim: its policy is deterministic"):
        learn_q(make_victim(), HOPPER, RECIPE, drives)


def test_one_episode_is_too_few(driver):
    with pytest.raises(ValueError, match="episodes: at least two"):
        learn(driver, RECIPE, [3])


@pytest.mark.parametrize(
    "change",
    [
        dict(episodes=1), dict(net=0), dict(epochs=0), dict(epochs=1.5), dict(batch=0), dict(learning_rate=0.0),
        dict(learning_rate=-1.0), dict(gamma=1.5), dict(gamma=np.nan), dict(lam=-0.1), dict(lam=1.1),
    ],
    ids=str,
)  # fmt: skip
def test_a_recipe_with_a_bad_number_is_refused_by_name(change):
    with pytest.raises(ValueError, match=f"{next(iter(change))} must be"):
        replace(RECIPE, **change)
