from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_victim, normal

from detden_lite.attacks.noise import UniformNoise
from detden_lite.core.types import Trajectories
from detden_lite.defense.autoencoder import DenoisingAutoencoder, train_autoencoder
from detden_lite.defense.gruvae import LEAST_STD
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.simulation.rollout import rollout


def lines(n: int = 30, steps: int = 40, seed: int = 0) -> Trajectories:
    """Points of a curve in four dimensions, of several sizes, the last of them constant; garbage behind the ends."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(5, steps + 1, n)
    phase = rng.uniform(0, 6.28, (n, steps, 1))
    obs = np.concatenate([np.sin(phase), 10 * np.cos(phase) + 5, 0.1 * np.sin(2 * phase), 0 * phase + 2], -1)
    obs[np.arange(steps) >= lengths[:, None]] = 1e6
    return Trajectories(obs.astype(np.float32), lengths)


SIZE = np.array([0.3, 3, 0.03, 0], np.float32)


def noisy(trajectories: Trajectories, seed: int) -> Trajectories:
    noise = np.random.default_rng(seed).normal(size=trajectories.obs.shape).astype(np.float32)
    return replace(trajectories, obs=trajectories.obs + SIZE * noise)


NORMAL = lines()
INPUTS = [NORMAL, noisy(NORMAL, 1)]
SMALL = dict(hidden=32, latent=16, epochs=40, batch=64, learning_rate=5e-3)


def same(model, other) -> bool:
    return all(torch.equal(value, other.state_dict()[name]) for name, value in model.state_dict().items())


@pytest.mark.slow
@pytest.mark.parametrize("residual", [False, True])
def test_noisy_observations_are_brought_back_to_the_data(residual):
    model = train_autoencoder(NORMAL, INPUTS, 0, residual=residual, **SMALL)
    truth = lines(seed=7)
    seen = noisy(truth, 8)
    true, perturbed = (torch.from_numpy(t.obs[t.mask]) for t in (truth, seen))

    def error(estimate):
        return float(((estimate - true) / torch.tensor([1, 10, 0.1, 1])).square()[:, :3].mean())

    assert error(model.step(perturbed)) < 0.6 * error(perturbed)
    assert error(model.step(true)) < 0.1 * error(perturbed)
    assert torch.allclose(model.step(perturbed)[:, 3], torch.tensor(2.0), atol=0.15)


def test_it_is_residual_or_not_and_z_scores():
    torch.manual_seed(0)
    plain = DenoisingAutoencoder(11)
    residual = DenoisingAutoencoder(11, residual=True)
    residual.load_state_dict(plain.state_dict())
    obs = normal(3, 7, 11)
    assert torch.allclose(residual(obs), plain(obs) + obs, atol=1e-6) and plain(obs).shape == obs.shape
    for model in (plain, residual):
        expected = 3 * model(obs) + 5
        model.obs_mean.fill_(5), model.obs_std.fill_(3)
        assert torch.allclose(model(3 * obs + 5), expected, atol=1e-4)


def test_statistics_come_from_normal_data_with_a_least_deviation():
    model = train_autoencoder(NORMAL, INPUTS, 0, epochs=1)
    seen = NORMAL.obs[NORMAL.mask]
    assert np.allclose(model.obs_mean, seen.mean(0), rtol=1e-4)
    assert np.allclose(model.obs_std[:3], seen.std(0)[:3], rtol=1e-2) and np.isclose(model.obs_std[3], LEAST_STD)
    assert not any(p.requires_grad for p in model.parameters()) and not model.training


def test_the_seed_decides_and_the_padding_does_not():
    one = train_autoencoder(NORMAL, INPUTS, 0, epochs=2)
    assert same(one, train_autoencoder(NORMAL, INPUTS, 0, epochs=2))
    assert not same(one, train_autoencoder(NORMAL, INPUTS, 1, epochs=2))
    clean = [replace(t, obs=np.where(t.mask[..., None], t.obs, 0)) for t in (NORMAL, *INPUTS)]
    assert same(one, train_autoencoder(clean[0], clean[1:], 0, epochs=2))


def test_it_is_without_memory_and_a_denoiser_as_it_stands():
    model = train_autoencoder(Trajectories(normal(4, 9, 11).numpy(), np.full(4, 9)),
                              [Trajectories(normal(4, 9, 11, seed=1).numpy(), np.full(4, 9))], 0, epochs=1)  # fmt: skip
    obs = normal(3, 5, 11)
    model.reset(range(3))
    steps = torch.stack([model.step(o) for o in obs.unbind(1)], 1)
    assert torch.allclose(steps, model(obs), atol=1e-6)
    defense = DetectAndDenoise(make_defense().detector, model, always=True)
    episodes = rollout(make_victim(seed=8), HOPPER, range(3), attack=UniformNoise(BUDGET), defense=defense, steps=5)
    assert np.allclose(episodes.shown, model(torch.from_numpy(episodes.perturbed)), atol=1e-5)


@pytest.mark.parametrize(
    "inputs", [[], [lines(n=29)], [NORMAL, lines(steps=41)], [replace(NORMAL, lengths=NORMAL.lengths - 1)]]
)
def test_versions_of_other_trajectories_are_refused(inputs):
    with pytest.raises(ValueError, match="inputs"):
        train_autoencoder(NORMAL, inputs, 0)
