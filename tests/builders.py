"""Small real things to test with: random networks of the right shapes, real environments, nothing trained."""

import os
import subprocess
import sys

import pytest
import torch
from hypothesis import settings
from torch import Tensor

from detden_lite.budget import Budget
from detden_lite.defense import GRUVAE, Denoiser, DetectAndDenoise, Detector
from detden_lite.tasks import Task, get_task
from detden_lite.victim_training import XLA_FLAGS
from detden_lite.victims import Victim

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
