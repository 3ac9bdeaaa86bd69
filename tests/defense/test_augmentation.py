import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, NORMS, excess, make_victim, steady
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.attacks.noise import UniformNoise
from detden_lite.attacks.opposite import OppositeAttack, opposite_objective
from detden_lite.attacks.qfunction import QFunctionAttack, q_objective
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import Trajectories
from detden_lite.defense.augmentation import augment, intermittent
from detden_lite.defense.autoencoder import train_autoencoder
from detden_lite.defense.linear_models import Gaussian, LinearModel
from detden_lite.simulation.collection import collect_normal
from detden_lite.simulation.rollout import rollout
from detden_lite.training.gruvae_training import VAERecipe, train_gruvae

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
        assert np.array_equal(normal.action[i, :length], episodes.action[:length, i])
        assert not normal.obs[i, length:].any() and not normal.action[i, length:].any()
    assert np.array_equal(normal.mask.sum(1), normal.lengths) and normal.mask[:, 0].all()


def test_episodes_do_not_depend_on_how_many_run_together(victim, normal):
    again = collect_normal(victim, HOPPER, SEEDS, action_noise=(0.0, 0.3), lockstep=3, steps=STEPS)
    assert np.array_equal(again.lengths, normal.lengths) and np.allclose(again.obs, normal.obs, atol=1e-4)


def test_episodes_take_turns_with_noise_and_memory(victim):
    turns = dict(action_noise=(0.0, 0.3), noise_memory=(0.0, 5.0))
    found = collect_normal(victim, HOPPER, SEEDS, steps=STEPS, **turns)
    noise, memory = np.array([0, 0.3] * 3, np.float32), np.array([0, 0, 5, 5, 0, 0], np.float32)
    expected = rollout(victim, HOPPER, SEEDS, action_noise=noise, noise_memory=memory, steps=STEPS)
    assert np.allclose(found.action[3, :5], expected.action[:5, 3], atol=1e-5)
    white = rollout(victim, HOPPER, SEEDS, action_noise=noise, steps=STEPS)
    assert not np.allclose(found.action[3, :5], white.action[:5, 3], atol=1e-2)


def test_the_first_exploration_is_the_papers_none(victim, normal):
    plain = collect_normal(victim, HOPPER, SEEDS, action_noise=(0.0,), steps=STEPS)
    same = [np.allclose(plain.obs[i, :15], normal.obs[i, :15], atol=1e-5) for i in range(6)]
    assert same == [True, False] * 3


@pytest.mark.parametrize(("attack", "of"), [(OppositeAttack, opposite_objective), (QFunctionAttack, q_objective)])
def test_every_observation_is_attacked_offline(victim, normal, attack, of):
    adversarial = augment(normal, attack(victim, BUDGET, steps=3), batch=50)
    assert np.array_equal(adversarial.lengths, normal.lengths)
    true, perturbed = (torch.from_numpy(t.obs[normal.mask]) for t in (normal, adversarial))
    assert BUDGET.contains(true, perturbed).all() and (true != perturbed).any(-1).all()
    objective = of(victim, true)
    assert (objective(perturbed) > objective(true)).all()
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


@pytest.mark.parametrize("attack", ["opposite", None, OppositeAttack])
def test_an_attack_that_is_none_is_refused_by_name(normal, attack):
    with pytest.raises(ValueError, match="attack: give an attack such as"):
        augment(normal, attack)


OBS = np.zeros((3, 5, 2), np.float32)


@pytest.mark.parametrize(
    ("trajectories", "message"),
    [
        (Trajectories(OBS, np.array([1, 5, 6])), "lengths must be 3 whole numbers from 1 to 5"),
        (Trajectories(OBS, np.array([1, 0, 5])), "lengths must be"),
        (Trajectories(OBS, np.array([5, 5])), "lengths must be"),
        (Trajectories(OBS, np.array([1.0, 2.5, 5.0])), "lengths must be"),
        (Trajectories(OBS[0], np.array([5, 5, 5])), "obs must be float32"),
        (Trajectories(OBS[:0], np.array([], int)), "obs must be float32"),
        (Trajectories(OBS.astype(np.float64), np.array([5, 5, 5])), "obs must be float32"),
        (Trajectories(np.where(np.arange(5)[:, None] == 4, np.nan, OBS), np.array([3, 3, 3])), "NaN or infinity"),
        (Trajectories(OBS + np.float32(np.nan), np.array([5, 5, 5])), "NaN or infinity"),
        (Trajectories(OBS + np.float32(np.inf), np.array([5, 5, 5])), "NaN or infinity"),
    ],
)
def test_nothing_is_learned_from_broken_trajectories(trajectories, message):
    recipe = VAERecipe(hidden=2, latent=2, epochs=1)
    for name, learn in dict(
        normal=lambda: augment(trajectories, UniformNoise(BUDGET)),
        inputs=lambda: train_autoencoder(trajectories, [trajectories], 0),
        pairs=lambda: train_gruvae(recipe, [(trajectories, trajectories)], 0),
    ).items():
        with pytest.raises(ValueError, match=f"{name}.*{message}"):
            learn()
    for fit in (Gaussian.fit, LinearModel.fit):
        with pytest.raises(ValueError, match=f"normal.*{message}"):
            fit(trajectories)


SHAPE = (400, 100, 3)
TRUE = np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)


def attacked_everywhere(budget: Budget = BUDGET) -> np.ndarray:
    """A random point of the ball of every observation."""
    flat = torch.from_numpy(TRUE).flatten(0, 1)
    return budget.project(flat, budget.sample(flat, RandomStreams(1))).view(SHAPE).numpy()


def is_attacked(mixed: np.ndarray) -> np.ndarray:
    return (mixed != TRUE).any(-1)


def test_full_share_and_full_size_give_the_attack_itself():
    found = intermittent(TRUE, attacked_everywhere(), least_share=1, least_size=1)
    assert found.dtype == np.float32 and np.allclose(found, attacked_everywhere(), atol=1e-6)


@steady
@given(st.sampled_from(NORMS), st.floats(0, 1), st.floats(0, 1), st.integers(1, 300), st.integers(0, 9))
def test_mixed_sequences_stay_in_the_ball(norm, least_share, least_size, run, seed):
    budget = Budget(0.3, norm, torch.tensor([0.5, 1.0, 2.0]))
    found = intermittent(TRUE, attacked_everywhere(budget), least_share, least_size, seed, run)
    true, found = (torch.from_numpy(obs).flatten(0, 1) for obs in (TRUE, found))
    assert excess(budget, true, found) <= 0


@pytest.mark.parametrize("least_share", [0.0, 0.5, 0.9])
def test_each_sequence_has_its_own_random_share_of_attacks(least_share):
    shares = is_attacked(intermittent(TRUE, attacked_everywhere(), least_share, run=1)).mean(1)
    assert abs(shares.mean() - (least_share + 1) / 2) < 0.05 and shares.min() > least_share - 0.2
    assert shares.std() == pytest.approx((1 - least_share) / np.sqrt(12), abs=0.04)


def test_attacked_steps_come_in_runs_of_one_size():
    delta = intermittent(TRUE, attacked_everywhere(), 0.0, 0.3, run=10) - TRUE
    size = np.abs(delta).sum(-1) / np.abs(attacked_everywhere() - TRUE).sum(-1)
    assert 0.3 - 1e-3 < size[size > 0].min() < 0.35 and 0.95 < size.max() < 1 + 1e-3
    changes = np.abs(np.diff(size)) > 1e-3
    for row in changes:
        where = np.flatnonzero(row)
        assert not (np.diff(where) % 10).any()  # only where a run ends
    assert len({np.flatnonzero(row)[0] % 10 for row in changes if row.any()}) == 10  # elsewhere in each sequence


def test_the_seed_decides_what_is_mixed():
    first, again, other = (intermittent(TRUE, attacked_everywhere(), seed=seed) for seed in (0, 0, 1))
    assert np.array_equal(first, again) and not np.array_equal(first, other)


def test_clean_sequences_stay_clean():
    assert np.array_equal(intermittent(TRUE, TRUE, 0.5, 0.5), TRUE)


@pytest.mark.parametrize(
    "arguments",
    [dict(least_share=-0.1), dict(least_share=float("nan")), dict(least_size=1.1), dict(run=0), dict(run=1.5),
     dict(adversarial=TRUE[1:]), dict(adversarial=TRUE[..., :2])],
)  # fmt: skip
def test_a_mixture_that_makes_no_sense_is_refused_by_name(arguments):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        intermittent(**dict(normal=TRUE, adversarial=TRUE) | arguments)
