import numpy as np
import pytest
import torch
from builders import make_gruvae, normal

from detden_lite.defense import Detector
from detden_lite.defense.augmentation import Trajectories
from detden_lite.defense.detector import calibrate, clean_scores, linf_score


def scores(detector, obs, episodes):
    """The scores of sequences ``[N, steps, obs_dim]``, ``[N, steps]``."""
    detector.reset(episodes)
    return torch.stack([detector.step(o)[0] for o in obs.unbind(1)], 1)


def test_the_score_is_the_largest_deviation_in_units_of_the_scale():
    obs, reconstruction = torch.tensor([[1.0, 2.0, 3.0]]), torch.tensor([[1.5, 2.0, 1.0]])
    assert linf_score(obs, reconstruction, torch.ones(3)).tolist() == [2.0]
    assert linf_score(obs, reconstruction, torch.tensor([0.1, 1.0, 1.0])).tolist() == [5.0]


def test_without_sampling_it_is_the_whole_sequence_pass():
    model, obs = make_gruvae(), normal(3, 10, 11)
    expected = linf_score(obs, model(obs).output, model.obs_std)
    assert torch.allclose(scores(Detector(model, 1.0, sample=False), obs, range(3)), expected, atol=1e-5)


def test_an_alarm_is_a_score_above_the_threshold():
    model, obs = make_gruvae(), normal(50, 11)
    detector = Detector(model, 0.0)
    detector.reset(range(50))
    score, alarm, reconstruction = detector.step(obs)
    assert alarm.all() and torch.equal(score, linf_score(obs, reconstruction, model.obs_std))
    detector = Detector(model, float(score.sort().values[30]))
    detector.reset(range(50))
    assert detector.step(obs)[1].sum() == 19  # not the one that equals it


def test_memory_begins_anew_at_reset_and_only_there():
    detector, obs = Detector(make_gruvae(), 1.0, sample=False), normal(2, 5, 11)
    first = scores(detector, obs, range(2))
    assert torch.equal(scores(detector, obs, range(2)), first)
    remembering = torch.stack([detector.step(o)[0] for o in obs.unbind(1)], 1)
    assert not torch.allclose(remembering, first)


def test_the_latent_is_sampled_with_the_episodes_own_numbers():
    obs = normal(3, 5, 11)
    together = scores(Detector(make_gruvae(), 1.0), obs, [4, 5, 6])
    assert torch.allclose(scores(Detector(make_gruvae(), 1.0), obs[1:2], [5]), together[1:2], atol=1e-6)
    assert not torch.allclose(scores(Detector(make_gruvae(), 1.0), obs, [7, 8, 9]), together)
    assert not torch.allclose(scores(Detector(make_gruvae(), 1.0, seed=9), obs, [4, 5, 6]), together)


def test_clean_scores_are_those_of_every_observation_and_of_no_padding():
    obs, lengths = normal(5, 8, 11).numpy(), np.array([8, 3, 5, 1, 8])
    detector = Detector(make_gruvae(), np.inf)
    found = clean_scores(detector, Trajectories(obs, lengths))
    assert len(found) == lengths.sum()
    expected = scores(detector, torch.from_numpy(obs), range(5)).numpy()
    assert np.allclose(found, np.concatenate([expected[i, :length] for i, length in enumerate(lengths)]), atol=1e-6)
    padded = obs.copy()
    padded[np.arange(8) >= lengths[:, None]] = 1e9
    assert np.allclose(clean_scores(detector, Trajectories(padded, lengths), batch=2), found, atol=1e-6)


@pytest.mark.parametrize("rate", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("n", [7, 100, 1_003])
def test_at_most_the_wanted_fraction_of_clean_scores_is_above_the_threshold(rate, n):
    clean = np.random.default_rng(n).exponential(size=n)
    above = (clean > calibrate(clean, rate)).mean()
    assert rate - 1 / n - 1e-9 <= above <= rate


@pytest.mark.parametrize("rate", [0, 1, -0.1, float("nan")])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="false_alarm_rate"):
        calibrate(np.ones(3), rate)


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf]])
def test_scores_that_are_none_are_refused(values):
    with pytest.raises(ValueError, match="clean_scores"):
        calibrate(np.array(values))
