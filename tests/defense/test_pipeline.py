import pytest
import torch
from builders import BUDGET, make_defense, make_gruvae, normal

from detden_lite.defense.baselines import Identity
from detden_lite.defense.denoiser import Denoiser
from detden_lite.defense.detector import Detector
from detden_lite.defense.oracles import OracleDetector
from detden_lite.defense.pipeline import DetectAndDenoise


def run(defense, obs):
    """The verdicts on sequences ``[N, steps, obs_dim]``."""
    defense.reset(range(len(obs)))
    return [defense(o) for o in obs.unbind(1)]


def test_an_alarm_shows_the_policy_the_denoised_observation():
    obs = normal(6, 20, 11)
    verdicts = run(make_defense(threshold=2.0), obs)
    alarms = torch.stack([v.alarm for v in verdicts])
    assert alarms.any() and not alarms.all()
    for o, v in zip(obs.unbind(1), verdicts, strict=True):
        assert torch.equal(v.obs[v.alarm], v.denoised[v.alarm]) and torch.equal(v.obs[~v.alarm], o[~v.alarm])
        assert (v.denoised != o).any(-1).all()


def test_both_networks_see_every_observation():
    """The alarms of one do not disturb the memory of the other."""
    obs = normal(6, 20, 11)
    detector, denoiser = make_defense(threshold=2.0).detector, make_defense().denoiser
    detector.reset(range(6))
    denoiser.reset(range(6))
    for o, v in zip(obs.unbind(1), run(make_defense(threshold=2.0), obs), strict=True):
        score, alarm, _ = detector.step(o)
        assert torch.allclose(v.score, score, atol=1e-6) and torch.equal(v.alarm, alarm)
        assert torch.allclose(v.denoised, denoiser.step(o), atol=1e-6)


def test_always_ignores_the_detector():
    defense = make_defense(threshold=float("inf"))
    for verdict in run(DetectAndDenoise(defense.detector, defense.denoiser, always=True), normal(3, 4, 11)):
        assert torch.equal(verdict.obs, verdict.denoised) and not verdict.alarm.any()


def test_without_a_denoiser_the_detectors_reconstruction_is_shown():
    obs, detector = normal(6, 20, 11), make_defense(threshold=2.0).detector
    verdicts = run(DetectAndDenoise(make_defense(threshold=2.0).detector), obs)
    detector.reset(range(6))
    for o, v in zip(obs.unbind(1), verdicts, strict=True):
        _, alarm, reconstruction = detector.step(o)
        assert torch.equal(v.denoised, reconstruction) and torch.equal(v.alarm, alarm)
        assert torch.equal(v.obs, torch.where(alarm[:, None], reconstruction, o))


@pytest.mark.parametrize("denoiser", [None, make_defense().denoiser])
def test_a_budget_projects_the_denoised_observation_into_the_ball(denoiser):
    obs, detector = normal(6, 20, 11), make_defense(threshold=2.0).detector
    free = run(DetectAndDenoise(detector, denoiser), obs)
    projected = run(DetectAndDenoise(detector, denoiser, budget=BUDGET), obs)
    for o, f, p in zip(obs.unbind(1), free, projected, strict=True):
        assert not BUDGET.contains(o, f.denoised).any() and BUDGET.contains(o, p.denoised).all()
        assert torch.equal(p.denoised, BUDGET.project(o, f.denoised))
        assert torch.equal(p.obs, torch.where(p.alarm[:, None], p.denoised, o)) and torch.equal(p.alarm, f.alarm)


def test_detector_and_denoiser_sample_independently():
    """Even where they are the same network."""
    model, obs = make_gruvae(), normal(2, 5, 11)
    detector, denoiser = Detector(model, 1.0), Denoiser(model)
    detector.reset(range(2))
    denoiser.reset(range(2))
    assert not torch.allclose(detector.step(obs[:, 0])[2], denoiser.step(obs[:, 0]))


def test_a_wrong_number_of_rows_is_refused_and_changes_nothing():
    defense, obs = make_defense(), normal(2, 3, 11)
    with pytest.raises(ValueError, match=r"no episode is under way; call reset\(episodes\) first"):
        make_defense()(obs[:, 0])
    expected = run(defense, obs)
    defense.reset(range(2))
    with pytest.raises(ValueError, match="obs has 1 rows, but 2 episodes are under way"):
        defense(obs[:1, 0])
    assert all(torch.equal(defense(o).obs, v.obs) for o, v in zip(obs.unbind(1), expected, strict=True))


@pytest.mark.parametrize("obs", [normal(2, 17), normal(2, 11).double(), normal(11), torch.zeros(2, 11).int()])
def test_observations_of_another_shape_or_type_are_refused(obs):
    defense = make_defense()
    defense.reset(range(2))
    with pytest.raises(ValueError, match=r"obs must be a float32 tensor \[2, 11\]"):
        defense(obs)


def test_parts_for_observations_of_two_sizes_are_refused():
    with pytest.raises(ValueError, match="denoiser: its observations have 17 numbers, and the detector's 11"):
        DetectAndDenoise(make_defense(11).detector, make_defense(17).denoiser)
    assert DetectAndDenoise(OracleDetector(), make_defense(17).denoiser).obs_dim == 17
    assert DetectAndDenoise(OracleDetector(), Identity()).obs_dim is None


def test_its_text_names_both_parts_and_all_ablations():
    detector = make_defense(threshold=1.5).detector
    assert repr(DetectAndDenoise(detector, Identity())) == "DetectAndDenoise(Detector > 1.5, Identity)"
    ablated = repr(DetectAndDenoise(detector, None, always=True, budget=BUDGET))
    assert ablated == "DetectAndDenoise(Detector > 1.5, None, always, projected, detector_only)"


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_an_observation_that_is_not_finite_is_refused_and_forgotten(value):
    defense, obs = make_defense(), normal(2, 3, 11)
    expected = run(defense, obs)
    defense.reset(range(2))
    broken = obs[:, 0].clone()
    broken[1, 4] = value
    with pytest.raises(ValueError, match="obs"):
        defense(broken)
    assert all(torch.equal(defense(o).obs, v.obs) for o, v in zip(obs.unbind(1), expected, strict=True))


@pytest.mark.parametrize("steps", [0, 3])
def test_restart_begins_an_episode_in_the_given_row_only(steps):
    """What it remembers is gone, and its random numbers are those of the new episode."""
    obs, defense, beside, anew = normal(3, 10, 11), make_defense(), make_defense(), make_defense()
    defense.reset([0, 1, 2])
    beside.reset([0, 1, 2])
    for o in obs[:, :steps].unbind(1):
        defense(o), beside(o)
    defense.restart(1, 9)
    anew.reset([9])
    for o in obs[:, steps:].unbind(1):
        found, others, new = defense(o), beside(o), anew(o[1:2])
        for name in ("obs", "score", "denoised"):
            values = getattr(found, name)
            assert torch.allclose(values[[0, 2]], getattr(others, name)[[0, 2]], atol=1e-5)
            assert torch.allclose(values[1], getattr(new, name)[0], atol=1e-5)
