"""Small real things to test with: random networks of the right shapes, real environments, nothing trained."""

import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import settings
from hypothesis import strategies as st
from torch import Tensor

from detden_lite.core.budget import Budget
from detden_lite.core.estimates import estimate
from detden_lite.core.tasks import TASKS, Task, get_task
from detden_lite.core.types import Trajectories
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.results.records import Record
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.store import models
from detden_lite.training.resumable import XLA_FLAGS
from detden_lite.victims.victim import Victim

# XLA reads this when it is first used, by whichever test: all are to compute as a training does.
os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)

HOPPER = get_task("hopper")
BUDGET = Budget(HOPPER.epsilon)

# The same examples at every run, however slow the machine is.
steady = settings(deadline=None, derandomize=True)


def make_victim(task: Task = HOPPER, seed: int = 0, gaussian: bool = False, hidden: int = 16) -> Victim:
    """An untrained policy with an untrained critic (a value network for a Gaussian one)."""
    torch.manual_seed(seed)
    actor = [task.obs_dim, hidden, task.action_dim]
    if gaussian:
        return Victim(actor, value=[task.obs_dim, hidden, 1], gaussian=True)
    return Victim(actor, critic=[task.obs_dim + task.action_dim, hidden, 1])


def make_gruvae(obs_dim: int = 11, seed: int = 0, residual: bool = False, layers: int = 1) -> GRUVAE:
    """An untrained GRU-VAE whose z-scoring is not the identity."""
    torch.manual_seed(seed)
    model = GRUVAE(obs_dim, hidden=8, layers=layers, latent=4, residual=residual).requires_grad_(False).eval()
    model.set_statistics(torch.linspace(1, -1, obs_dim), torch.linspace(0.5, 2, obs_dim))
    return model


def make_defense(obs_dim: int = 11, threshold: float = 1.5) -> DetectAndDenoise:
    """An untrained defence, whose alarm goes off now and then."""
    return DetectAndDenoise(Detector(make_gruvae(obs_dim), threshold), Denoiser(make_gruvae(obs_dim, 1, residual=True)))


def run_with_gl(script: str, *arguments) -> None:
    """Run a Python script with the first GL driver that there is; skip the test where there is none."""
    for driver in ("egl", "osmesa"):  # read when Python starts
        environment = os.environ | dict(MUJOCO_GL=driver)
        command = [sys.executable, "-c", script, *map(str, arguments)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        if done.returncode == 0:
            return
        if not any(word in done.stderr for word in ("GL", "libOSMesa")):
            pytest.fail(done.stderr)
    pytest.skip("no GL driver: Debian has libegl1 libgl1-mesa-dri")


def normal(*shape: int, seed: int = 0) -> Tensor:
    """Standard normal numbers."""
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def planted(n=40, steps=60, seed=0, noise=0.1, size=(1.0, 10.0, 0.1)):
    """Episodes of a rotating, damped linear system of three dimensions; and its A, b and Q."""
    rng, size = np.random.default_rng(seed), np.array(size)
    a = np.array([[0.9, -0.4, 0.0], [0.4, 0.9, 0.1], [0.0, 0.0, 0.8]]) * 0.98 * size[:, None] / size
    b, root = np.array([0.3, 0.0, -0.2]) * size, noise * np.diag(size)
    lengths = rng.integers(steps // 2, steps + 1, n)
    obs = np.zeros((n, steps, 3))
    obs[:, 0] = size * (1 + 0.1 * rng.normal(size=(n, 3)))
    for t in range(steps - 1):
        obs[:, t + 1] = obs[:, t] @ a.T + b + rng.normal(size=(n, 3)) @ root.T
    obs[np.arange(steps) >= lengths[:, None]] = 1e9  # nobody may look at the padding
    return Trajectories(obs.astype(np.float32), lengths), a, b, root @ root.T


NORMS = [float("inf"), 2, 1]


def excess(budget, obs, perturbed) -> float:
    """How far out of the ball the worst row is, measured in float64, less what rounding to float32 can do."""
    obs, perturbed, scale = obs.double(), perturbed.double(), torch.as_tensor(budget.scale).double()
    size = torch.linalg.vector_norm((perturbed - obs) / scale, ord=budget.norm, dim=-1)
    rounding = 4e-7 * ((obs.abs() + perturbed.abs()) / scale).sum(-1) + 1e-6 * budget.epsilon
    return float((size - budget.epsilon - rounding).max())


class Quadratic(Victim):
    """One linear action, w.o + b, and Q(o, a) = -(a - o_0)^2."""

    def __init__(self):
        torch.manual_seed(0)
        super().__init__([6, 1], gaussian=True)
        self.actor[0].weight[0, 0] = 0.2  # raising o_0 raises the action, but the best action more
        self.action_low.fill_(-100)
        self.action_high.fill_(100)

    def qs(self, obs, action):
        return -(action - obs[:, :1]).square().T


class FixedPlan(CEMPlanner):
    """A planner whose answer is known."""

    def __init__(self, env_id, plan=0.3):
        super().__init__(env_id)
        self.answer = np.asarray(plan)

    def plan(self, envs, wanted):
        return self.answer if self.answer.ndim else np.full((len(envs), 1), self.answer)


def record(returns, first=8_000_000, **changes) -> Record:
    """A record with these returns, of episodes from seed ``first`` on."""
    scores = dict(accuracy=1.0, f1=None, false_negative_rate=None, false_positive_rate=0.0)
    content = dict(
        task="hopper", cell=dict(attack="opposite", timing="always", defense="mixed"), settings=dict(epsilon=0.075),
        seeds=[first, len(returns)], returns=[float(number) for number in returns], lengths=[1] * len(returns),
        estimate=asdict(estimate(returns)), attack_rate=1.0, detector=scores, denoiser_mae=None, seconds=1.0,
        versions={},
    )  # fmt: skip
    return Record.from_json({**content, **changes})


def ship_victim(root: Path, task: str = "hopper", algo: str = "td3", **changes) -> None:
    """An untrained victim with a card like those that ``select`` writes."""
    returns = np.arange(10.0)
    about = dict(
        recipe=dict(task=task, seed=1, net=16), step=2_000, selection_mean=5.0, returns=returns.tolist(),
        estimate=asdict(estimate(returns)),
        learning_curves=[
            dict(seed=0, steps=[1_000, 2_000], mean=[1.0, 9.0]),
            dict(seed=1, steps=[1_000, 2_000, 3_000], mean=[2.0, 8.0, 4.0]),
        ],
    )  # fmt: skip
    victim = make_victim(TASKS[task], gaussian=algo != "td3")
    models.save_victim(task, algo, victim, {**about, **changes}, root)


@st.composite
def cases(draw):
    """A budget, true observations, and points that may be far outside the ball."""
    n, dim = draw(st.integers(1, 4)), draw(st.integers(1, 12))
    numbers = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = draw(st.sampled_from([1.0, 0.3, torch.from_numpy(np.exp(numbers.normal(size=dim)).astype(np.float32))]))
    budget = Budget(draw(st.just(0.0) | st.floats(1e-6, 100)), draw(st.sampled_from(NORMS)), scale)
    obs = numbers.normal(size=(n, dim)) * draw(st.sampled_from([0.0, 1.0, 100.0]))
    far = obs + numbers.standard_cauchy(size=(n, dim)) * draw(st.sampled_from([0.0, 0.01, 1.0, 1e3]))
    return budget, torch.from_numpy(obs.astype(np.float32)), torch.from_numpy(far.astype(np.float32))
