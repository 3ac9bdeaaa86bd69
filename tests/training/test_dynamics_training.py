"""Training the model of how the robot moves."""

import numpy as np
import pytest
import torch
from builders import planted

from detden_lite.core.files import ArtifactError
from detden_lite.core.types import Trajectories
from detden_lite.training import dynamics_training
from detden_lite.training.dynamics_training import DynamicsRecipe, one_step_errors, train_dynamics

SMALL = DynamicsRecipe(hidden=16, steps=30, batch=32)


def driven(n=60, steps=40, seed=0):
    """Episodes of a linear system that the action pushes, with a third number that only shows the action."""
    rng = np.random.default_rng(seed)
    action = rng.uniform(-1, 1, (n, steps, 1)).astype(np.float32)
    obs = np.zeros((n, steps, 3), np.float32)
    obs[:, 0, :2] = rng.normal(size=(n, 2))
    for t in range(steps - 1):
        obs[:, t + 1, :2] = obs[:, t, :2] @ [[0.9, 0.3], [-0.3, 0.9]] + [0.0, 0.5] * action[:, t]
        obs[:, t + 1, 2] = 2 * action[:, t, 0]
    return Trajectories(obs, rng.integers(steps // 2, steps + 1, n), action)


def test_it_learns_the_planted_system():
    normal = driven()
    model = train_dynamics(DynamicsRecipe(hidden=32, steps=1_500, batch=128), normal, seed=0, state_dim=2)
    error = one_step_errors(model, driven(seed=1)).mean(0)
    assert (error[:2] < 0.05).all() and error[2] < 0.05
    assert model.state_dim == 2 and not model.training


def test_its_standard_deviation_is_that_of_what_cannot_be_known():
    seen, *_ = planted(n=80, noise=0.3, size=(1.0, 1.0, 1.0))
    normal = Trajectories(seen.obs, seen.lengths, np.zeros((*seen.obs.shape[:2], 1), np.float32))
    model = train_dynamics(DynamicsRecipe(hidden=32, steps=1_500, batch=256), normal, seed=0)
    obs = torch.from_numpy(normal.obs[:, 0])
    _, std = model.next_state(obs, torch.zeros(len(obs), 1))
    assert 0.15 < std.mean() < 0.45, "the scale of Student's t is a little below the standard deviation of a Gaussian"


def test_padding_is_never_looked_at():
    normal = driven()
    soiled = Trajectories(
        np.where(normal.mask[..., None], normal.obs, 1e9).astype(np.float32), normal.lengths, normal.action
    )
    found, other = (train_dynamics(SMALL, data, seed=0) for data in (normal, soiled))
    assert all(torch.equal(a, b) for a, b in zip(found.parameters(), other.parameters(), strict=True))


def test_a_resumed_training_equals_one_that_never_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(dynamics_training, "SEGMENT", 10)
    whole = train_dynamics(SMALL, driven(), seed=0)

    def killed(path, identity, epochs, parts):
        save(path, identity, epochs, parts)
        if epochs == 2:
            raise KeyboardInterrupt

    save = dynamics_training.save_checkpoint
    monkeypatch.setattr(dynamics_training, "save_checkpoint", killed)
    with pytest.raises(KeyboardInterrupt):
        train_dynamics(SMALL, driven(), seed=0, checkpoint=tmp_path / "f.ckpt")
    monkeypatch.setattr(dynamics_training, "save_checkpoint", save)
    resumed = train_dynamics(SMALL, driven(), seed=0, checkpoint=tmp_path / "f.ckpt")
    assert all(torch.equal(a, b) for a, b in zip(whole.parameters(), resumed.parameters(), strict=True))
    (tmp_path / "f.ckpt").write_bytes(b"damaged")
    with pytest.raises(ArtifactError, match="damaged"):
        train_dynamics(SMALL, driven(), seed=0, checkpoint=tmp_path / "f.ckpt")


def test_trajectories_that_teach_nothing_are_refused():
    normal = driven(n=3)
    with pytest.raises(ValueError, match="no actions"):
        train_dynamics(SMALL, Trajectories(normal.obs, normal.lengths), seed=0)
    with pytest.raises(ValueError, match="two steps"):
        train_dynamics(SMALL, Trajectories(normal.obs, np.ones(3, int), normal.action), seed=0)
    broken = np.full_like(normal.action, np.nan)
    with pytest.raises(ValueError, match="NaN"):
        train_dynamics(SMALL, Trajectories(normal.obs, normal.lengths, broken), seed=0)


@pytest.mark.parametrize("wrong", [dict(steps=0), dict(hidden=1.5), dict(batch=-1), dict(learning_rate=0)])
def test_a_recipe_without_sense_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        DynamicsRecipe(**wrong)
