import copy

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_victim, normal

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.timing import Random
from detden_lite.core.metrics import detector_scores, mean_absolute_error
from detden_lite.defense.oracles import OracleDenoiser, OracleDetector
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.simulation.rollout import rollout

VICTIM = make_victim(seed=8)
ATTACKED = dict(attack=OppositeAttack(VICTIM, BUDGET, steps=3), timing=Random(0.5))


def play(defense, **changes):
    return rollout(VICTIM, HOPPER, range(6), defense=defense, **(ATTACKED | dict(steps=26) | changes))


def test_both_oracles_give_the_episodes_of_no_attack():
    """With both oracles the policy sees the truth, and an attack has no effect at all."""
    clean, saved = play(None, attack=None, timing=None), play(DetectAndDenoise(OracleDetector(), OracleDenoiser()))
    assert 0 < saved.attacked.mean() < 1 and (saved.perturbed != saved.obs).any()
    for name in ("obs", "shown", "action", "reward", "mask"):
        assert np.array_equal(getattr(saved, name), getattr(clean, name)), name
    assert np.array_equal(saved.alarm, saved.attacked) and np.array_equal(saved.score, saved.attacked)
    scores = detector_scores(saved.attacked[saved.mask], saved.alarm[saved.mask])
    assert (scores.accuracy, scores.f1, scores.false_negative_rate) == (1, 1, 0) and mean_absolute_error(saved) == 0


def test_one_oracle_leaves_the_other_part_as_it_is():
    own = make_defense()
    detected = play(DetectAndDenoise(OracleDetector(), own.denoiser))
    assert np.array_equal(detected.alarm, detected.attacked) and mean_absolute_error(detected) > 0
    denoised = play(DetectAndDenoise(own.detector, OracleDenoiser()))
    assert not np.array_equal(denoised.alarm, denoised.attacked)
    assert np.array_equal(denoised.denoised, denoised.obs)
    assert np.array_equal(denoised.shown, np.where(denoised.alarm[..., None], denoised.obs, denoised.perturbed))
    # Without a denoiser the oracle's reconstruction is shown: the truth.
    alone = play(DetectAndDenoise(OracleDetector()))
    assert np.array_equal(alone.shown, alone.obs)


def test_without_an_attack_an_oracle_is_silent():
    episodes = play(DetectAndDenoise(OracleDetector(), OracleDenoiser()), attack=None, timing=None)
    assert not episodes.alarm.any() and np.array_equal(episodes.shown, episodes.obs)


@pytest.mark.parametrize(
    "make", [lambda: DetectAndDenoise(OracleDetector(), OracleDenoiser()), lambda: DetectAndDenoise(OracleDetector()),
             lambda: DetectAndDenoise(make_defense().detector, OracleDenoiser())]
)  # fmt: skip
def test_an_oracle_answers_once_for_each_revealed_truth(make):
    """It refuses on a robot, a second time, in another episode, and as an attacker's copy after a reset."""
    defense, obs = make(), normal(3, 11)
    assert defense.needs == {"truth"}
    defense.reset(range(3))
    with pytest.raises(ValueError, match="Oracle.* was not told the truth"):
        defense(obs)
    defense.reveal(obs, torch.tensor([True, False, True]))
    beside = copy.deepcopy(defense)
    defense(obs + 0.01)
    with pytest.raises(ValueError, match="not told"):
        defense(obs + 0.01)
    beside.reset(range(3))
    with pytest.raises(ValueError, match="not told"):
        beside(obs)


def test_a_defence_that_is_no_oracle_is_told_nothing():
    class Curious(DetectAndDenoise):
        def reveal(self, true, attacked):
            raise AssertionError("nobody may tell")

    own = make_defense()
    assert own.needs == frozenset()
    play(Curious(own.detector, own.denoiser), steps=3)
    own.reveal(normal(3, 11), torch.ones(3, dtype=torch.bool))  # nor does it keep what it is told
    assert not hasattr(own.detector, "truth") and not hasattr(own.denoiser, "truth")
