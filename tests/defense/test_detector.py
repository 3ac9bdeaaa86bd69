import numpy as np
import pytest
import torch
from builders import make_gruvae, normal, steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.core.metrics import detector_scores
from detden_lite.core.types import Trajectories
from detden_lite.defense.baselines import MahalanobisDetector, PredictionDetector
from detden_lite.defense.detector import Detector, linf_score
from detden_lite.defense.linear_models import Gaussian, LinearModel
from detden_lite.training.thresholds import calibrate, clean_scores, conformal_threshold, tuned_threshold


def scores(detector, obs, episodes):
    """The scores of sequences ``[N, steps, obs_dim]``, ``[N, steps]``."""
    detector.reset(episodes)
    return torch.stack([detector.step(o)[0] for o in obs.unbind(1)], 1)


def test_the_score_is_the_largest_scaled_deviation():
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
    assert detector.step(obs)[1].sum() == 19  # a score equal to the threshold is no alarm


@pytest.mark.parametrize("threshold", [float("nan"), "high", None])
@pytest.mark.parametrize(
    "make",
    [
        lambda threshold: Detector(make_gruvae(), threshold),
        lambda threshold: MahalanobisDetector(Gaussian(torch.zeros(1), torch.eye(1)), threshold),
        lambda threshold: PredictionDetector(
            LinearModel(torch.eye(1), *(torch.eye(1),) * 2, torch.zeros(1)), threshold
        ),
    ],
)
def test_a_threshold_that_is_no_number_is_refused(make, threshold):
    with pytest.raises(ValueError, match="threshold must be a number"):
        make(threshold)
    assert make(float("inf")).threshold == np.inf and make(np.float32(2)).threshold == 2


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


def test_clean_scores_cover_every_observation_and_no_padding():
    obs, lengths = normal(5, 8, 11).numpy(), np.array([8, 3, 5, 1, 8])
    detector = Detector(make_gruvae(), np.inf)
    found = clean_scores(detector, Trajectories(obs, lengths))
    assert len(found) == lengths.sum()
    expected = scores(detector, torch.from_numpy(obs), range(5)).numpy()
    assert np.allclose(found, np.concatenate([expected[i, :length] for i, length in enumerate(lengths)]), atol=1e-6)
    padded = obs.copy()
    padded[np.arange(8) >= lengths[:, None]] = 1e9
    assert np.allclose(clean_scores(detector, Trajectories(padded, lengths), batch=2), found, atol=1e-6)


def test_lengths_beyond_the_array_are_refused():
    with pytest.raises(ValueError, match="trajectories: lengths must be 2 whole numbers from 1 to 8"):
        clean_scores(Detector(make_gruvae(), np.inf), Trajectories(normal(2, 8, 11).numpy(), np.array([8, 9])))


@pytest.mark.parametrize("rate", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("n", [7, 100, 1_003])
def test_at_most_the_given_fraction_of_scores_exceeds_the_threshold(rate, n):
    clean = np.random.default_rng(n).exponential(size=n)
    above = (clean > calibrate(clean, rate)).mean()
    assert rate - 1 / n - 1e-9 <= above <= rate


@pytest.mark.parametrize("rate", [0, 1, -0.1, float("nan")])
def test_a_rate_outside_0_and_1_is_refused(rate):
    for threshold in (calibrate, lambda scores, rate: conformal_threshold([scores], rate)):
        with pytest.raises(ValueError, match="false_alarm_rate"):
            threshold(np.ones(3), rate)


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf]])
def test_empty_or_infinite_scores_are_refused(values):
    with pytest.raises(ValueError, match="clean_scores"):
        calibrate(np.array(values))


@pytest.mark.parametrize("rate", [0.01, 0.1, 0.5])
@pytest.mark.parametrize("n", [99, 100, 1_003])
def test_one_score_an_episode_gives_the_split_conformal_quantile(rate, n):
    scores = np.random.default_rng(n).exponential(size=n)
    expected = np.sort(scores)[int(np.ceil((n + 1) * (1 - rate) - 1e-9)) - 1]
    assert conformal_threshold(scores[:, None], rate) == expected
    assert conformal_threshold(scores[:, None], rate) >= calibrate(scores, rate)


def test_the_conformal_guarantee_holds_where_the_plain_quantile_fails():
    """Steps of an episode share most of their score, and there are eleven episodes to calibrate on and a new one."""
    rng, rate = np.random.default_rng(0), 0.1
    conformal, plain = [], []
    for _ in range(2_000):
        lengths = rng.integers(1, 30, 12)
        *episodes, new = (rng.normal() + 0.3 * rng.normal(size=length) for length in lengths)
        conformal.append((new > conformal_threshold(episodes, rate)).mean())
        plain.append((new > calibrate(np.concatenate(episodes), rate)).mean())
    uncertainty = 2 * np.std(conformal) / np.sqrt(len(conformal))
    assert 0.5 * rate < np.mean(conformal) < rate + uncertainty
    assert np.mean(plain) > rate + uncertainty


@pytest.mark.parametrize(("n", "promised"), [(8, False), (9, True)])
def test_too_few_episodes_give_no_guarantee_however_long(n, promised):
    episodes = [np.arange(1_000.0)] * n
    assert np.isfinite(conformal_threshold(episodes, 0.1)) == promised


def test_every_episode_weighs_the_same_however_long_it_is():
    high, low = np.full(1_000, 2.0), [np.zeros(1)] * 18
    assert conformal_threshold([high, *low], 0.1) == 0 and conformal_threshold([high, high, *low], 0.1) == 2


@pytest.mark.parametrize("episodes", [[], [np.ones(2), np.array([])], [np.array([np.nan])]])
def test_episodes_without_scores_are_refused(episodes):
    with pytest.raises(ValueError, match="episodes must be"):
        conformal_threshold(episodes)


def test_a_planted_threshold_is_found():
    rng = np.random.default_rng(0)
    clean, attacked = rng.uniform(0, 1, 900), rng.uniform(1.4, 2, 100)
    found = tuned_threshold(np.append(clean, attacked), np.arange(1_000) >= 900)
    assert found == pytest.approx((clean.max() + attacked.min()) / 2)


@steady
@given(
    st.lists(st.tuples(st.integers(0, 12), st.booleans()), min_size=2, max_size=60),
    st.sampled_from([0.0, 0.1, 0.5]),
)
def test_no_threshold_with_so_few_misses_has_a_better_f1(steps, misses):
    scores, attacked = np.array([score for score, _ in steps], np.float32), np.array([flag for _, flag in steps])
    if attacked.all() or not attacked.any():
        return

    def judge(threshold: float):
        return detector_scores(attacked, scores > threshold)

    found = judge(tuned_threshold(scores, attacked, misses))
    assert found.false_negative_rate <= misses + 1e-9
    allowed = [judge(t) for t in (-np.inf, *scores) if judge(t).false_negative_rate <= misses + 1e-9]
    assert found.f1 == pytest.approx(max(other.f1 for other in allowed))


def test_fewer_misses_cost_f1():
    """One attacked step scores below all clean ones: to detect it, all of those must raise the alarm."""
    scores, attacked = np.append(np.linspace(0, 1, 100), [2.0] * 9 + [-1.0]), np.arange(110) >= 100
    assert 1 < tuned_threshold(scores, attacked, misses=0.1) < 2
    assert tuned_threshold(scores, attacked, misses=0.05) == -np.inf


@pytest.mark.parametrize(
    ("scores", "attacked", "misses", "message"),
    [
        ([1.0, 2.0], [True], 0.01, "one shape"),
        ([1.0, np.nan], [True, False], 0.01, "finite"),
        ([1.0, 2.0], [True, True], 0.01, "clean steps and attacked"),
        ([1.0, 2.0], [False, False], 0.01, "clean steps and attacked"),
        ([1.0, 2.0], [False, True], 1.0, "misses"),
        ([1.0, 2.0], [False, True], np.nan, "misses"),
    ],
)
def test_scores_that_cannot_be_tuned_on_are_refused(scores, attacked, misses, message):
    with pytest.raises(ValueError, match=message):
        tuned_threshold(np.array(scores), np.array(attacked), misses)
