from math import inf, sqrt

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_gruvae, make_victim, normal, planted, steady
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import mahalanobis

from detden_lite.attacks.noise import UniformNoise
from detden_lite.core.budget import Budget
from detden_lite.core.metrics import mean_absolute_error
from detden_lite.core.types import Trajectories
from detden_lite.defense.baselines import Identity, KalmanFilter, MahalanobisDetector, PredictionDetector
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.linear_models import Gaussian, LinearModel
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.simulation.collection import collect_normal
from detden_lite.simulation.rollout import rollout
from detden_lite.training.thresholds import calibrate, clean_scores

NORMAL = Trajectories(normal(20, 30, 11).cumsum(1).numpy(), np.full(20, 30))
LINEAR, GAUSSIAN = LinearModel.fit(NORMAL), Gaussian.fit(NORMAL)
DETECTORS = [lambda: MahalanobisDetector(GAUSSIAN, 3.0), lambda: PredictionDetector(LINEAR, 3.0)]
DENOISERS = [Identity, lambda: KalmanFilter(LINEAR, Budget(0.5))]


def play(part, obs, episodes=None):
    """What a detector or a denoiser says of sequences ``[N, steps, obs_dim]``, one value a step for each output."""
    part.reset(episodes or range(len(obs)))
    said = [part.step(o) for o in obs.unbind(1)]
    if isinstance(said[0], tuple):
        return [torch.stack(outputs, 1) for outputs in zip(*said, strict=True)]
    return [torch.stack(said, 1)]


def close(one, other) -> bool:
    return all(torch.allclose(a.float(), b.float(), rtol=1e-4, atol=1e-5) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("make", DETECTORS + DENOISERS)
def test_batched_episodes_equal_single_ones_and_reset_forgets(make):
    obs, part = normal(5, 12, 11), make()
    together = play(part, obs)
    assert all(a.shape[:2] == (5, 12) for a in together)
    assert all(torch.equal(a, b) for a, b in zip(play(part, obs), together, strict=True))
    for i in range(5):
        assert close(play(make(), obs[i : i + 1]), [a[i : i + 1] for a in together])


@pytest.mark.parametrize("make", DETECTORS + DENOISERS)
@pytest.mark.parametrize("steps", [0, 4])
def test_restart_begins_an_episode_in_the_given_row_only(make, steps):
    obs, part = normal(3, 10, 11), make()
    whole, anew = play(make(), obs), play(make(), obs[1:2, steps:])
    part.reset(range(3))
    for o in obs[:, :steps].unbind(1):
        part.step(o)
    part.restart(1, 9)
    for t, o in enumerate(obs[:, steps:].unbind(1)):
        said = part.step(o)
        for found, others, new in zip(said if isinstance(said, tuple) else [said], whole, anew, strict=True):
            assert close([found[[0, 2]], found[1]], [others[[0, 2], steps + t], new[0, t]])


@pytest.mark.parametrize("detector", [*DETECTORS, lambda: Detector(make_gruvae(), 1.5)])
@pytest.mark.parametrize("denoiser", [*DENOISERS, lambda: Denoiser(make_gruvae(residual=True))])
def test_every_detector_goes_with_every_denoiser(detector, denoiser):
    victim, defense = make_victim(seed=8), DetectAndDenoise(detector(), denoiser())
    episodes = rollout(victim, HOPPER, range(4), attack=UniformNoise(BUDGET), defense=defense, steps=10)
    shown = np.where(episodes.alarm[..., None], episodes.denoised, episodes.perturbed)
    assert np.array_equal(episodes.shown, shown)
    assert np.array_equal(episodes.alarm, episodes.score > defense.detector.threshold)
    assert {episodes.score.dtype, episodes.denoised.dtype, episodes.shown.dtype} == {np.dtype(np.float32)}


@pytest.mark.parametrize("make", DETECTORS)
def test_the_threshold_is_calibrated_as_the_gruvaes(make):
    detector = make()
    scores = clean_scores(detector, NORMAL)
    detector.threshold = calibrate(scores, 0.05)
    assert scores.size == 600 and 25 <= (scores > detector.threshold).sum() <= 30
    _, alarm, _ = play(detector, torch.from_numpy(NORMAL.obs))
    assert np.array_equal(alarm.flatten(), scores > detector.threshold)


def test_the_identity_errs_by_the_size_of_the_attack():
    class Corner(UniformNoise):
        def __call__(self, obs, world=None):
            return obs + self.budget.epsilon * self.streams.normal(*obs.shape).sign()

    defense = DetectAndDenoise(MahalanobisDetector(GAUSSIAN, inf), Identity(), always=True)
    episodes = rollout(make_victim(seed=8), HOPPER, range(4), attack=Corner(BUDGET), defense=defense, steps=10)
    assert np.array_equal(episodes.shown, episodes.perturbed)
    assert mean_absolute_error(episodes) == pytest.approx(BUDGET.epsilon, rel=1e-4)


# The Kalman filter.


def test_the_settled_kalman_filter_equals_the_scalar_recursion():
    a, b, q, epsilon = 0.95, 0.2, 0.04, 0.3
    scalars = (torch.tensor(x).double() for x in ([[a]], [b], [[q]], [1.0]))
    obs = normal(1, 400, 1) + 4
    [found] = play(KalmanFilter(LinearModel(*scalars), Budget(epsilon)), obs)
    mean, variance, textbook = 1.0, 0.5, []  # any variance to begin with
    for measured in obs.flatten().tolist():
        gain = variance / (variance + epsilon**2)
        mean, variance = mean + gain * (measured - mean), (1 - gain) * variance
        textbook.append(mean)
        mean, variance = a * mean + b, a * variance * a + q
    assert found.flatten()[50:].tolist() == pytest.approx(textbook[50:], abs=1e-5)
    assert abs(float(found.flatten()[1]) - textbook[1]) > 1e-3  # which takes a few steps


def test_the_kalman_filter_beats_noisy_measurements_and_separate_filters():
    """Better than the raw measurement, and than filters of one dimension each, which know nothing of the others."""
    model = LinearModel.fit(planted()[0])
    fresh, *_ = planted(n=20, seed=1)
    truth = torch.from_numpy(fresh.obs[:, :30])
    size = torch.tensor([1.0, 10.0, 0.1])
    budget = Budget(0.5, scale=size)
    measured = truth + budget.epsilon * size * normal(*truth.shape, seed=2)
    alone = []
    for i in range(3):
        one = LinearModel.fit(Trajectories(planted()[0].obs[..., i : i + 1], planted()[0].lengths))
        alone.append(play(KalmanFilter(one, Budget(0.5 * float(size[i]))), measured[..., i : i + 1])[0])

    def error(estimate):
        return float(((estimate - truth) / size).square().mean())

    filtered = error(play(KalmanFilter(model, budget), measured)[0])
    assert filtered < 0.9 * error(torch.cat(alone, -1)) < 0.9 * error(measured)
    assert error(measured) == pytest.approx(0.25, rel=0.1)


@pytest.mark.parametrize("norm", [inf, 2, 1])
def test_no_noise_trusts_observations_and_large_noise_the_model(norm):
    obs = normal(4, 6, 11)
    [trusting] = play(KalmanFilter(LINEAR, Budget(0.0, norm)), obs)
    assert torch.allclose(trusting, obs, atol=1e-5)
    stable = LinearModel(0.9 * torch.eye(11).double(), LINEAR.offset, LINEAR.noise, LINEAR.start)
    [blind] = play(KalmanFilter(stable, Budget(1e5, norm)), obs)
    expected = stable.start.float()
    for t in range(6):
        assert torch.allclose(blind[:, t], expected.expand(4, 11), atol=1e-3)
        expected = stable.predict(expected[None])[0].float()


def test_norms_2_and_1_share_the_noise_among_dimensions():
    gains = [KalmanFilter(LINEAR, budget).gain for budget in (Budget(2.0, 2), Budget(2.0, 1), Budget(2 / sqrt(11)))]
    assert torch.allclose(gains[0], gains[2]) and torch.allclose(gains[1], gains[2])
    assert torch.equal(KalmanFilter(LINEAR, Budget(0.5, scale=torch.full((11,), 4.0))).gain,
                       KalmanFilter(LINEAR, Budget(2.0)).gain)  # fmt: skip


def test_a_scale_of_another_length_is_refused():
    with pytest.raises(ValueError, match="scale"):
        KalmanFilter(LINEAR, Budget(0.5, scale=torch.ones(17)))


# The detectors.


@steady
@given(st.integers(0, 2**32 - 1))
def test_the_scores_are_the_mahalanobis_distances_of_scipy(seed):
    obs = torch.from_numpy(np.random.default_rng(seed).normal(size=(4, 3, 11)).astype(np.float32))
    score, alarm, reconstruction = play(MahalanobisDetector(GAUSSIAN, 3.0), obs)
    inverse = np.linalg.inv(GAUSSIAN.covariance)
    expected = [[mahalanobis(o, GAUSSIAN.mean, inverse) for o in row] for row in obs.double().numpy()]
    assert np.allclose(score, expected, rtol=1e-4) and torch.equal(alarm, score > 3)
    assert torch.equal(reconstruction, GAUSSIAN.mean.float().expand_as(obs))
    score, _, reconstruction = play(PredictionDetector(LINEAR, 3.0), obs)
    inverse = np.linalg.inv(LINEAR.noise)
    for t in (1, 2):
        predicted = LINEAR.predict(obs[:, t - 1])
        expected = [mahalanobis(o, p, inverse) for o, p in zip(obs[:, t].double().numpy(), predicted, strict=True)]
        assert np.allclose(score[:, t], expected, rtol=1e-4)
        assert torch.equal(reconstruction[:, t], predicted.float())


def test_the_mean_squared_distance_of_normal_data_is_obs_dim():
    scores = clean_scores(MahalanobisDetector(GAUSSIAN, 3.0), NORMAL)
    assert np.square(scores).mean() == pytest.approx(11, rel=1e-3)
    scores = clean_scores(PredictionDetector(LINEAR, 3.0), NORMAL).reshape(20, 30)[:, 1:]
    assert np.square(scores).mean() == pytest.approx(11, rel=1e-3)


def test_an_episodes_first_observation_follows_from_nothing():
    score, alarm, reconstruction = play(PredictionDetector(LINEAR, -1.0), normal(3, 2, 11) + 50)
    assert score[:, 0].tolist() == [0, 0, 0] and alarm.all() and (score[:, 1] > 0).all()
    assert torch.equal(reconstruction[:, 0], normal(3, 2, 11)[:, 0] + 50)


def test_baseline_detectors_notice_noise_and_accept_clean_motion():
    victim = make_victim(seed=8)
    clean = collect_normal(victim, HOPPER, range(40), steps=20)
    held_out = collect_normal(victim, HOPPER, range(100, 120), steps=20)
    for detector in (MahalanobisDetector(Gaussian.fit(clean), inf), PredictionDetector(LinearModel.fit(clean), inf)):
        detector.threshold = calibrate(clean_scores(detector, held_out), 0.05)
        defense, rates = DetectAndDenoise(detector, Identity()), []
        for attack in (None, UniformNoise(BUDGET)):
            episodes = rollout(victim, HOPPER, range(200, 220), attack=attack, defense=defense, steps=20)
            rates.append(episodes.alarm[episodes.mask].mean())
        assert rates[0] < 0.15 and rates[1] > 0.85
