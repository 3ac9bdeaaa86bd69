"""The denoiser that predicts, on a small system that it has learned."""

import numpy as np
import pytest
import torch
from builders import steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.core.budget import Budget
from detden_lite.core.types import Trajectories
from detden_lite.defense.dynamics import Dynamics
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.predict_correct import PredictCorrect, Surprise
from detden_lite.training.dynamics_training import DynamicsRecipe, train_dynamics

BALL = Budget(0.3)


def swings(n, steps, seed):
    """A pendulum that is pushed at random, and a third number that shows the push."""
    rng = np.random.default_rng(seed)
    action = rng.uniform(-1, 1, (n, steps, 1)).astype(np.float32)
    obs = np.zeros((n, steps, 3), np.float32)
    obs[:, 0, :2] = rng.normal(0, 0.05, (n, 2))
    for t in range(steps - 1):
        angle, speed = obs[:, t, 0], obs[:, t, 1]
        obs[:, t + 1, 0] = angle + 0.2 * speed
        obs[:, t + 1, 1] = 0.97 * speed - 0.2 * np.sin(angle) + 0.2 * action[:, t, 0]
        obs[:, t + 1, 2] = action[:, t, 0]
    return Trajectories(obs, np.full(n, steps), action)


@pytest.fixture(scope="module")
def dynamics():
    return train_dynamics(DynamicsRecipe(hidden=32, steps=3_000, batch=256), swings(100, 60, 0), seed=0, state_dim=2)


def run(dynamics, true, perturbed, budget=BALL):
    """Denoised observations ``[n, steps, 3]`` and the probability of a perturbation ``[n, steps]``."""
    found = PredictCorrect(dynamics, budget)
    found.reset(range(len(true)))
    denoised, odds = [], []
    for t in range(perturbed.shape[1]):
        last = torch.from_numpy(true.action[:, t - 1]) if t else None
        denoised.append(found.step(torch.from_numpy(perturbed[:, t]), last))
        odds.append(found.perturbed)
    return torch.stack(denoised, 1).numpy(), torch.stack(odds, 1).numpy()


def error(denoised, true):
    """Mean error of the state, in balls, after the first ten steps."""
    return np.abs(denoised - true.obs)[:, 10:, :2].mean() / BALL.epsilon


def test_clean_observations_pass_and_raise_no_alarm(dynamics):
    true = swings(20, 60, 1)
    denoised, perturbed = run(dynamics, true, true.obs)
    assert error(denoised, true) < 0.01
    assert (perturbed > 0.5).mean() < 0.02


def corners(rng, n, steps, every):
    """Corners of the ball, drawn anew every so many steps."""
    drawn = rng.choice([-1.0, 1.0], (n, -(-steps // every), 3))
    return drawn.repeat(every, 1)[:, :steps]


KINDS = {
    "noise": lambda rng, n, steps: rng.uniform(-1, 1, (n, steps, 3)),
    "corners": lambda rng, n, steps: corners(rng, n, steps, 1),
    "held for ten steps": lambda rng, n, steps: corners(rng, n, steps, 10),
    "held for ever": lambda rng, n, steps: corners(rng, n, steps, steps),
    "a drift": lambda rng, n, steps: np.sin(np.arange(steps)[None, :, None] / 15 + rng.uniform(0, 6, (n, 1, 3))),
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_perturbation_is_seen_and_undone(dynamics, kind):
    true = swings(20, 80, 2)
    delta = KINDS[kind](np.random.default_rng(3), 20, 80)
    perturbed = (true.obs + BALL.epsilon * delta).astype(np.float32)
    denoised, odds = run(dynamics, true, perturbed)
    assert error(denoised, true) < 0.3 * error(perturbed, true)
    assert (odds[:, 1:] > 0.5).mean() > 0.9


@steady
@given(seed=st.integers(0, 99), size=st.floats(0, 50), norm=st.sampled_from([float("inf"), 2]))
def test_the_answer_lies_in_the_ball_around_what_is_shown(dynamics, seed, size, norm):
    rng, budget = np.random.default_rng(seed), Budget(0.3, norm)
    true = swings(3, 8, seed)
    shown = (true.obs + size * rng.normal(size=true.obs.shape)).astype(np.float32)
    denoised, odds = run(dynamics, true, shown, budget)
    flat = (torch.from_numpy(part).flatten(0, 1) for part in (shown, denoised))
    assert budget.contains(*flat, atol=1e-4).all()
    assert ((odds >= 0) & (odds <= 1)).all()


def test_batched_equals_one_by_one_and_a_restart_is_a_new_episode(dynamics):
    true = swings(4, 12, 5)
    shown = (true.obs + 0.3 * np.random.default_rng(0).uniform(-1, 1, true.obs.shape)).astype(np.float32)
    together, _ = run(dynamics, true, shown)
    for i in range(4):
        alone, _ = run(dynamics, true.select([i]), shown[i : i + 1])
        assert np.allclose(alone[0], together[i], atol=1e-4)
    found = PredictCorrect(dynamics, BALL)
    found.reset([0, 1])
    obs, action = torch.from_numpy(shown), torch.from_numpy(true.action)
    for t in range(4):
        found.step(obs[:2, t], action[:2, t - 1] if t else None)
    found.restart(1, 7)
    unknown = torch.tensor([[0.0], [float("nan")]])  # there is no action before the first
    for t in range(4):
        last = torch.where(unknown.isnan(), unknown, action[:2, 3]) if t == 0 else action[[0, 2], t - 1]
        answer = found.step(obs[[0, 2], t], last)
    assert np.allclose(answer[1], together[2, 3], atol=1e-4)


def test_to_correct_or_to_select_rows_leaves_the_memory_as_it_is(dynamics):
    true = swings(3, 6, 6)
    found = PredictCorrect(dynamics, BALL)
    found.reset(range(3))
    obs, action = torch.from_numpy(true.obs), torch.from_numpy(true.action)
    for t in range(3):
        found.step(obs[:, t] + 0.2, action[:, t - 1] if t else None)
    rows = torch.tensor([True, False, True])
    part = found.select(rows)
    prediction = part.predict(action[rows, 2])
    seen = (obs[rows, 3] + 0.2).requires_grad_()
    corrected = part.correct(seen, prediction)
    assert torch.autograd.grad(corrected.denoised.sum() + corrected.perturbed.sum(), seen)[0].isfinite().all()
    assert torch.allclose(found.step(obs[:, 3] + 0.2, action[:, 2])[rows], corrected.denoised.detach(), atol=1e-5)


def test_it_gates_as_detector_and_denoiser_of_one_defence(dynamics):
    found = PredictCorrect(dynamics, BALL)
    defense = DetectAndDenoise(Surprise(found), found)
    true = swings(2, 5, 8)
    defense.reset([0, 1])
    obs = torch.from_numpy(true.obs[:, 0])
    verdict = defense(torch.stack([obs[0], obs[1] + 0.29]))
    assert verdict.alarm.tolist() == [False, True]
    assert torch.equal(verdict.obs[0], obs[0]) and torch.equal(verdict.obs[1], verdict.denoised[1])


def test_a_missing_action_is_refused_and_a_ball_without_radius(dynamics):
    found = PredictCorrect(dynamics, BALL)
    found.reset([0])
    found.step(torch.zeros(1, 3))
    with pytest.raises(ValueError, match="action"):
        found.step(torch.zeros(1, 3))
    with pytest.raises(ValueError, match="epsilon"):
        PredictCorrect(Dynamics(3, 1, hidden=4), Budget(0.0))
