from dataclasses import fields, replace

import gymnasium
import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_victim

from detden_lite.attacks.noise import UniformNoise
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.timing import Random
from detden_lite.core.budget import Budget
from detden_lite.core.types import Episodes
from detden_lite.simulation.rollout import rollout

SEEDS = range(20, 28)
STEPS = 26  # of the eight episodes one lasts longer, and the others end at several times
ARRAYS = [field.name for field in fields(Episodes)]


def play(seeds=SEEDS, steps=STEPS, **changes) -> Episodes:
    """A short rollout in which everything takes part."""
    victim = make_victim(seed=8)
    parts = dict(attack=OppositeAttack(victim, BUDGET, steps=3), timing=Random(0.5), defense=make_defense())
    return rollout(victim, HOPPER, seeds, **(parts | dict(steps=steps) | changes))


@pytest.fixture(scope="module")
def episodes() -> Episodes:
    return play()


def test_the_fixture_shows_everything(episodes):
    """What the tests below compare: attacks and alarms, both now and then, and episodes that end or not."""
    assert 0 < episodes.attacked.mean() < 1 and 0 < episodes.alarm.mean() < 1
    assert len(set(episodes.lengths)) > 2 and 0 < (episodes.lengths == STEPS).mean() < 1


def test_it_is_the_plain_loop():
    """One environment of gymnasium's at a time, one call a model and step, written down again."""
    victim, defense = make_victim(seed=8), make_defense()
    attack, timing = OppositeAttack(victim, BUDGET, steps=3), Random(0.5)
    together = play()
    env = gymnasium.make("Hopper-v5")
    for i, seed in enumerate(SEEDS):
        for part in (attack, timing, defense):
            part.reset([seed])
        obs, _ = env.reset(seed=seed)
        for t in range(together.lengths[i]):
            true = torch.tensor(obs[None], dtype=torch.float32)
            perturbed = attack(true)
            if not timing(true):
                perturbed = true
            verdict = defense(perturbed)
            action = victim(verdict.denoised if verdict.alarm else perturbed)
            for name, row in dict(obs=true, perturbed=perturbed, denoised=verdict.denoised, action=action).items():
                assert np.allclose(getattr(together, name)[t, i], row[0], atol=1e-4), (name, t)
            obs, reward, terminated, _, _ = env.step(action[0].numpy())
            assert together.reward[t, i] == pytest.approx(reward, abs=1e-3)
            assert together.mask[t, i]
        assert terminated == (together.lengths[i] < STEPS)
    env.close()


def test_eight_together_are_eight_alone(episodes):
    for i, seed in enumerate(SEEDS):
        alone = play([seed])
        length = episodes.lengths[i]
        assert alone.lengths[0] == length and alone.seeds[0] == episodes.seeds[i]
        for name in ARRAYS[1:]:
            assert np.allclose(getattr(alone, name)[:length, 0], getattr(episodes, name)[:length, i], atol=1e-4), name


def test_the_same_seeds_give_the_same_episodes(episodes):
    again, others = play(), play(range(40, 48))
    assert all(np.array_equal(getattr(again, name), getattr(episodes, name)) for name in ARRAYS)
    assert not np.allclose(others.obs[0], episodes.obs[0])


def test_attack_defence_and_policy_see_what_they_should(episodes):
    attacked, alarm = episodes.attacked[..., None], episodes.alarm[..., None]
    assert np.array_equal(np.where(attacked, episodes.obs, episodes.perturbed), episodes.obs)
    assert (episodes.perturbed != episodes.obs).any(-1)[episodes.attacked & episodes.mask].all()
    assert np.array_equal(episodes.shown, np.where(alarm, episodes.denoised, episodes.perturbed))
    expected = make_victim(seed=8)(torch.from_numpy(episodes.shown)).numpy()
    assert np.allclose(episodes.action, expected, atol=1e-6)  # products of other shapes round otherwise
    inside = BUDGET.contains(torch.from_numpy(episodes.obs), torch.from_numpy(episodes.perturbed))
    assert inside.all()


def test_without_attack_and_defence_the_policy_sees_the_truth():
    clean = play(attack=None, timing=None, defense=None)
    for name in ("perturbed", "denoised", "shown"):
        assert np.array_equal(getattr(clean, name), clean.obs)
    assert not clean.attacked.any() and not clean.alarm.any() and not clean.score.any()


def test_epsilon_zero_changes_nothing():
    clean = play(attack=None, timing=None, defense=None)
    for attack in (OppositeAttack(make_victim(seed=8), Budget(0.0), steps=3), UniformNoise(Budget(0.0))):
        attacked = play(attack=attack, timing=None, defense=None)
        assert attacked.attacked.all()
        for name in ARRAYS:
            assert name == "attacked" or np.array_equal(getattr(attacked, name), getattr(clean, name)), name


def test_lengths_and_returns(episodes):
    assert (np.diff(episodes.mask.astype(int), axis=0) <= 0).all() and episodes.mask[0].all()
    assert np.array_equal(episodes.lengths, [episodes.mask[:, i].sum() for i in range(8)])
    expected = [episodes.reward[: episodes.lengths[i], i].sum() for i in range(8)]
    assert np.allclose(episodes.returns, expected)
    # Whatever stands behind an episode's end does not count.
    garbage = replace(episodes, reward=np.where(episodes.mask, episodes.reward, 1e6))
    assert np.allclose(garbage.returns, expected)


def test_it_ends_when_the_last_episode_has_ended():
    short = play(seeds=[20, 21], steps=1_000)
    assert len(short.mask) == short.lengths.max() < 1_000
    assert len(play(steps=3).mask) == 3


def test_the_state_is_that_before_the_action(episodes):
    """Hopper shows its positions but the first, and its velocities clipped at 10."""
    state = episodes.state
    assert np.allclose(episodes.obs[..., :5], state[..., 1:6], atol=1e-6)
    assert np.allclose(episodes.obs[..., 5:], state[..., 6:].clip(-10, 10), atol=1e-5)


def test_action_noise_is_each_episodes_own():
    size = np.array([0, 0.3] * 4, np.float32)
    clean, noisy = play(attack=None, defense=None), play(attack=None, defense=None, action_noise=size)
    length = clean.lengths.min()
    assert np.array_equal(noisy.obs[:length, ::2], clean.obs[:length, ::2])
    difference = noisy.action[0, 1::2] - clean.action[0, 1::2]
    assert (difference != 0).all() and np.abs(noisy.action).max() <= 1
    victim = make_victim(seed=8)
    victim.action_low.fill_(-0.5)  # the noise is in units of half the range, 0.75
    many = rollout(victim, HOPPER, range(150), action_noise=0.1, steps=1)
    assert (many.action - victim(torch.from_numpy(many.obs)).numpy()).std() == pytest.approx(0.075, abs=0.007)


def test_action_noise_may_be_each_actions_own():
    """One size for each action of each episode, or, from a single row, for those of all episodes."""
    size = np.zeros((8, 3), np.float32)
    size[1, 2] = size[5, 0] = 0.3
    bare = dict(attack=None, timing=None, defense=None, steps=3)
    changed = play(**bare, action_noise=size).action[0] != play(**bare).action[0]
    assert np.array_equal(changed, size > 0)
    row = np.array([[0.0, 0.2, 0.4]], np.float32)
    victim = make_victim(seed=8)
    victim.action_low.fill_(-3), victim.action_high.fill_(5)  # half the range is 4, and no bound is near
    many = rollout(victim, HOPPER, range(400), action_noise=row, steps=1)
    noise = many.action[0] - victim(torch.from_numpy(many.obs))[0].numpy()
    assert np.allclose(noise.std(0), [0, 0.8, 1.6], rtol=0.1) and np.allclose(noise.mean(0), 0, atol=0.25)
    # A Gaussian policy's own spread, whose samples keep the action bounds.
    for n in (1, 8):
        same = play(**bare, action_noise=np.repeat(row, n, 0))
        assert np.array_equal(same.action, play(**bare, action_noise=row).action)
        assert np.abs(same.action).max() <= 1


def test_action_noise_may_come_now_and_then():
    victim = make_victim()
    episodes = rollout(victim, HOPPER, range(100), action_noise=0.3, noise_rate=0.25, steps=4)
    own = torch.stack([victim(torch.from_numpy(obs)) for obs in episodes.obs]).numpy()
    explored = (np.abs(episodes.action - own) > 1e-4).any(-1)
    assert explored.mean() == pytest.approx(0.25, abs=0.08)
    assert 0 < explored[:, 0].sum() + explored[:, 1].sum() < 8  # each step and each episode by itself
    never = rollout(victim, HOPPER, range(3), action_noise=0.3, noise_rate=0.0, steps=4)
    assert np.array_equal(never.action, rollout(victim, HOPPER, range(3), steps=4).action)


def test_action_noise_may_be_correlated():
    """Its size is that of white noise, its correlation that of the memory; an episode without memory is as before."""
    victim = make_victim(seed=8)
    victim.action_low.fill_(-40), victim.action_high.fill_(40)  # no bound is near
    memory = np.array([0, 4] * 100, np.float32)
    episodes = rollout(victim, HOPPER, range(200), action_noise=0.005, noise_memory=memory, steps=12)
    own = torch.stack([victim(torch.from_numpy(obs)) for obs in episodes.obs]).numpy()
    noise = np.where(episodes.mask[..., None], episodes.action - own, np.nan) / 0.2
    for rows, expected in ((slice(0, None, 2), 0.0), (slice(1, None, 2), np.exp(-1 / 4))):
        one = noise[:, rows]
        assert np.nanstd(one[-1]) == pytest.approx(1, abs=0.15)
        assert np.nanmean(one[1:] * one[:-1]) == pytest.approx(expected, abs=0.1)
    white = rollout(victim, HOPPER, range(200), action_noise=0.005, steps=12)
    assert np.array_equal(white.action[:, ::2], episodes.action[:, ::2])


def test_exploration_noise_does_not_depend_on_other_episodes():
    row = np.array([[0.1, 0.2, 0.4]], np.float32)
    bare = dict(attack=None, timing=None, defense=None, steps=5, action_noise=row)
    together, alone = play(**bare), play([SEEDS[3]], **bare)
    assert np.allclose(together.action[:, 3], alone.action[:, 0], atol=1e-5)


def test_selected_episodes_are_themselves(episodes):
    chosen = episodes.select([2, 5])
    assert chosen.seeds.tolist() == [22, 25]
    assert np.array_equal(chosen.obs, episodes.obs[:, [2, 5]]) and np.array_equal(chosen.mask, episodes.mask[:, [2, 5]])
    assert np.array_equal(episodes.select(episodes.seeds > 24).seeds, [25, 26, 27])


class Curious:
    """An attack that changes nothing, but looks at (and meddles with) what it is given."""

    def __init__(self, *needs):
        self.needs, self.seen = frozenset(needs), []

    def reset(self, episodes):
        pass

    def __call__(self, obs, world):
        self.seen.append(world)
        if world.defense is not None:
            world.defense(obs + 5)
        return obs


def test_an_attack_gets_what_it_needs_and_no_more():
    spies = [Curious(), Curious("simulator"), Curious("defense")]
    runs = [play(attack=spy, timing=None) for spy in spies]
    first = [spy.seen[0] for spy in spies]
    assert [world.simulator is not None for world in first] == [False, True, False]
    assert [world.defense is not None for world in first] == [False, False, True]
    assert len(first[1].simulator.envs) == len(SEEDS)
    # What it does to its copy of the defence is without consequence.
    assert np.array_equal(runs[2].score, runs[0].score)


class Broken(Curious):
    """One number is missing."""

    def __call__(self, obs, world):
        return torch.where(torch.arange(11) == 3, torch.nan, obs)


@pytest.mark.parametrize("defense", [None, make_defense()])
def test_nan_never_reaches_the_robot(defense):
    with pytest.raises(ValueError, match="NaN"):
        play(attack=Broken(), defense=defense)
