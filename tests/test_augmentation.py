import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_victim

from detden_lite.attacks import OppositeAttack
from detden_lite.attacks.opposite import opposite_objective
from detden_lite.defense.augmentation import augment, collect_normal
from detden_lite.rollout import rollout

SEEDS = range(6)
STEPS = 26


@pytest.fixture(scope="module")
def victim():
    return make_victim(seed=8)


@pytest.fixture(scope="module")
def normal(victim):
    return collect_normal(victim, HOPPER, SEEDS, action_noise=(0.0, 0.3), steps=STEPS)


def test_normal_trajectories_are_whole_clean_episodes(victim, normal):
    noise = np.array([0, 0.3] * 3, np.float32)
    episodes = rollout(victim, HOPPER, SEEDS, action_noise=noise, steps=STEPS)
    assert len(normal) == 6 and normal.obs.shape == (6, STEPS, 11) and normal.obs.dtype == np.float32
    assert np.array_equal(normal.lengths, episodes.lengths) and len(set(normal.lengths)) > 1
    for i, length in enumerate(normal.lengths):
        assert np.array_equal(normal.obs[i, :length], episodes.obs[:length, i])
        assert not normal.obs[i, length:].any()
    assert np.array_equal(normal.mask.sum(1), normal.lengths) and normal.mask[:, 0].all()


def test_episodes_do_not_depend_on_how_many_run_together(victim, normal):
    again = collect_normal(victim, HOPPER, SEEDS, action_noise=(0.0, 0.3), lockstep=3, steps=STEPS)
    assert np.array_equal(again.lengths, normal.lengths) and np.allclose(again.obs, normal.obs, atol=1e-4)


def test_the_first_exploration_is_the_papers_none(victim, normal):
    plain = collect_normal(victim, HOPPER, SEEDS, action_noise=(0.0,), steps=STEPS)
    same = [np.allclose(plain.obs[i, :15], normal.obs[i, :15], atol=1e-5) for i in range(6)]
    assert same == [True, False] * 3


def test_every_observation_is_attacked_offline(victim, normal):
    adversarial = augment(normal, OppositeAttack(victim, BUDGET, steps=3), batch=50)
    assert np.array_equal(adversarial.lengths, normal.lengths)
    true, perturbed = (torch.from_numpy(t.obs[normal.mask]) for t in (normal, adversarial))
    assert BUDGET.contains(true, perturbed).all() and (true != perturbed).any(-1).all()
    assert (opposite_objective(victim, true)(perturbed) > 0).all()
    assert not adversarial.obs[~normal.mask].any()


def test_the_seed_decides_and_the_batch_does_not(victim, normal):
    def attacked(batch, seed):
        return augment(normal, OppositeAttack(victim, BUDGET, steps=3), batch, seed).obs

    assert np.allclose(attacked(7, 0), attacked(1_000, 0), atol=1e-5)
    assert not np.allclose(attacked(1_000, 0), attacked(1_000, 1), atol=1e-5)


def test_selected_trajectories_are_themselves(normal):
    part = normal.select(slice(2, 4))
    assert (
        len(part) == 2
        and np.array_equal(part.obs, normal.obs[2:4])
        and np.array_equal(part.lengths, normal.lengths[2:4])
    )


def test_an_attack_that_needs_the_environment_is_refused(victim, normal):
    class Planner(OppositeAttack):
        needs = frozenset({"policy", "simulator"})

    with pytest.raises(ValueError, match="attack: Planner needs the simulator"):
        augment(normal, Planner(victim, BUDGET))
