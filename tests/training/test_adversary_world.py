import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_victim

from detden_lite.attacks.director import DirectorAttack
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.attacks.timing import Random, Vulnerable
from detden_lite.recipe.episode_seeds import SEEDS
from detden_lite.simulation.rollout import rollout
from detden_lite.training.adversary_world import AdversaryEnv
from detden_lite.victims.victim import Victim

N, STEPS = 3, 40


class Scripted:
    """Perturbs with the same actions as the adversary, one a step."""

    needs = frozenset()

    def __init__(self, actions):
        self.actions = actions

    def reset(self, episodes):
        self.step = -1

    def __call__(self, obs, world=None):
        self.step += 1
        return obs + BUDGET.epsilon * self.actions[self.step]


def play(env, actions):
    """The environment's answers to these actions, and the seeds of the first episodes."""
    first = env.reset()
    seeds = list(env.simulator.seeds)
    obs, rewards, dones, infos = zip(*(env.step(a) for a in actions), strict=True)
    return np.stack([first, *obs]), np.stack(rewards), np.stack(dones), infos, seeds


def actions(steps: int = STEPS, n: int = N) -> torch.Tensor:
    return torch.rand(steps, n, 11, generator=torch.Generator().manual_seed(0)) * 2 - 1


def make(timing: str = "always", defense=None, **options) -> tuple:
    """The environment, and what a rollout with the same parts needs. The victim stands for 20 steps or more."""
    victim = make_victim(seed=8)
    values = victim.value(torch.from_numpy(rollout(victim, HOPPER, range(4), steps=20).obs.reshape(-1, 11)))
    parts = dict(always=lambda: None, vulnerable=lambda: Vulnerable(victim, float(values.median())),
                 random=lambda: Random(0.5))  # fmt: skip
    env = AdversaryEnv(victim, HOPPER, BUDGET, N, parts[timing](), defense and make_defense(), **options)
    return env, victim, dict(timing=parts[timing](), defense=defense and make_defense())


@pytest.mark.parametrize("defense", [None, True])
@pytest.mark.parametrize("timing", ["always", "vulnerable", "random"])
def test_rewards_are_the_negated_rewards_of_the_victim(timing, defense):
    """A rollout with the same seeds, timing and defence; the timing lets some observations through, and not others."""
    env, victim, parts = make(timing, defense)
    obs, rewards, dones, _, seeds = play(env, actions().numpy())
    episodes = rollout(victim, HOPPER, seeds, attack=Scripted(actions()), steps=STEPS, **parts)
    assert episodes.attacked[episodes.mask].any() and (timing == "always" or not episodes.attacked[episodes.mask].all())
    for i, length in enumerate(episodes.lengths):
        assert np.allclose(rewards[:length, i], -episodes.reward[:length, i], atol=1e-5)
        assert np.allclose(obs[:length, i], episodes.obs[:length, i], atol=1e-5)
        assert not dones[: length - 1, i].any()


@pytest.mark.parametrize("defense", [None, True])
def test_the_next_episode_equals_one_that_began_alone(defense):
    """After a fall another episode begins with a fresh seed, and does not depend on the one before."""
    env, victim, _ = make(defense=defense)
    script = actions(200)
    obs, rewards, dones, infos, seeds = play(env, script.numpy())
    for i in range(N):
        begin = int(dones[:, i].argmax()) + 1
        assert 1 < begin < 190 and env.simulator.seeds[i] != seeds[i]
        end = begin + int(dones[begin:, i].argmax()) + 1
        assert end - begin > 5
    env, victim, parts = make(defense=defense)
    env.reset()
    begin, seed = None, None
    for t, action in enumerate(script.numpy()):
        _, _, done, _ = env.step(action)
        if done[0]:
            begin, seed = t + 1, env.simulator.seeds[0]
            break
    alone = rollout(victim, HOPPER, [seed], attack=Scripted(script[begin:, :1]), steps=200 - begin, **parts)
    assert alone.lengths[0] == dones[begin:, 0].argmax() + 1
    assert np.allclose(rewards[begin : begin + alone.lengths[0], 0], -alone.reward[: alone.lengths[0], 0], atol=1e-5)


def test_a_fall_ends_and_a_time_limit_truncates():
    env, victim, _ = make(steps=35)
    obs, _, dones, infos, _ = play(env, actions(120).numpy())
    age, kinds = np.zeros(N, dtype=int), set()
    for t in range(120):
        age += 1
        for i in range(N):
            assert bool(infos[t][i]) == dones[t, i]
            if dones[t, i]:
                truncated = infos[t][i]["TimeLimit.truncated"]
                kinds.add(truncated)
                assert truncated is True or truncated is False
                assert age[i] <= 35 and (not truncated or age[i] == 35)
                end = infos[t][i]["terminal_observation"]
                assert end.shape == (11,) and not np.allclose(end, obs[t + 1, i])
                assert np.abs(obs[t + 1, i]).max() < 1.3  # an upright hopper at rest
                age[i] = 0
    assert kinds == {True, False}


def test_a_fall_at_the_time_limit_is_an_end():
    env, _, _ = make()
    _, _, dones, _, _ = play(env, actions(200).numpy())
    length = int(dones[:, 0].argmax()) + 1
    env, _, _ = make(steps=length)
    _, _, dones, infos, _ = play(env, actions(200).numpy())
    assert dones[length - 1, 0] and infos[length - 1][0]["TimeLimit.truncated"] is False


def test_the_same_seed_gives_the_same_unreported_episodes():
    first, second, other = (make()[0] for _ in range(3))
    for env, seed in ((first, 3), (second, 3), (other, 4)):
        env.seed(seed)
    one, two, three = (play(env, actions(60).numpy()) for env in (first, second, other))
    assert all(np.array_equal(a, b) for a, b in zip(one[:3], two[:3], strict=True))
    assert not np.allclose(one[0][0], three[0][0])
    assert min(one[4]) > max(SEEDS.values()) + 1_000_000
    assert len({*one[4], *first.simulator.seeds}) > N  # fresh ones at each end


def test_a_reset_begins_all_episodes_anew():
    env, _, _ = make()
    obs = env.reset()
    seeds = list(env.simulator.seeds)
    again = env.reset()
    assert not np.allclose(obs, again) and not set(seeds) & set(env.simulator.seeds)
    assert env.observation_space.contains(again[0]) and env.action_space.shape == (11,)


def test_an_action_that_is_not_finite_is_refused():
    env, _, _ = make()
    env.reset()
    with pytest.raises(ValueError, match="NaN.*diverged"):
        env.step(np.full((N, 11), np.nan))


def test_the_interface_of_stable_baselines3_works():
    env, _, _ = make()
    assert env.get_attr("render_mode") == [None] * N and env.env_is_wrapped(object) == [False] * N
    env.set_attr("mark", 5, indices=[1])
    assert env.get_attr("mark", indices=1) == [5] and not env.has_attr("mark")
    env.reset()
    assert [len(state) for state in env.env_method("state_vector")] == [12] * N
    env.close()


def compare(env: AdversaryEnv, adversary: Victim, attack, steps: int = 15) -> None:
    """An adversary acts in the environment as the attack does that plays it in a rollout."""
    obs, seeds = env.reset(), list(env.simulator.seeds)
    rewards, going = [], np.ones(N, dtype=bool)
    for _ in range(steps):
        obs, reward, done, _ = env.step(adversary(torch.from_numpy(obs)).numpy())
        rewards.append(np.where(going, reward, 0.0))
        going &= ~done
    episodes = rollout(env.victim, HOPPER, seeds, attack=attack, steps=steps)
    assert np.allclose(-np.stack(rewards)[: len(episodes.reward)], episodes.reward * episodes.mask, atol=1e-4)
    assert (episodes.perturbed != episodes.obs).any()


def test_an_adversary_with_a_history_sees_in_training_what_it_sees_later():
    torch.manual_seed(3)
    adversary, (env, *_) = Victim([33, 16, 11], gaussian=True), make(history=3)
    assert env.observation_space.shape == (33,) and env.action_space.shape == (11,)
    compare(env, adversary, OptimalAttack(adversary, BUDGET))


def test_a_director_moves_the_policy_in_training_as_it_does_later():
    torch.manual_seed(3)
    victim, director = make_victim(seed=8), Victim([11, 16, 3], gaussian=True)
    env = AdversaryEnv(victim, HOPPER, BUDGET, N, director=DirectorAttack(None, victim, BUDGET))
    assert env.action_space.shape == (3,)
    compare(env, director, DirectorAttack(director, victim, BUDGET))


def test_a_new_episode_knows_nothing_of_the_last_one():
    env, *_ = make(history=2, steps=5)
    obs = env.reset()
    assert np.array_equal(obs[:, :11], obs[:, 11:])
    for _ in range(5):
        before = obs
        obs, _, done, infos = env.step(np.zeros((N, 11), np.float32))
    assert done.all() and np.array_equal(obs[:, :11], obs[:, 11:])
    for i, info in enumerate(infos):
        assert np.array_equal(info["terminal_observation"][11:], before[i, :11])
        assert not np.array_equal(info["terminal_observation"][:11], obs[i, :11])
