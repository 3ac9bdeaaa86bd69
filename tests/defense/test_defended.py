"""A defended policy predicts as its parts do by hand, alone or with other episodes."""

import copy
import pickle
import threading

import numpy as np
import pytest
import torch
from builders import make_defense, make_victim, normal
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

from detden_lite.core.tasks import Task
from detden_lite.defense.defended import Defended
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.simulation.rollout import rollout

TASK = Task("pendulum", "InvertedPendulum-v5", 0.1, 4, 1)
VICTIM = make_victim(TASK)
OBS = (normal(12, 5, 4) * 2).numpy()  # of five episodes


def make_defended(victim=VICTIM) -> Defended:
    return Defended(victim, TASK, make_defense(4))


def predict(policy: Defended, obs, starts=None) -> np.ndarray:
    starts = [None] * len(obs) if starts is None else starts
    return np.stack([policy.predict(o, episode_start=s)[0] for o, s in zip(obs, starts, strict=True)])


def test_it_acts_as_the_victim_on_the_defended_observations():
    policy, by_hand = make_defended(), make_defense(4)
    by_hand.reset(range(5))
    alarms = []
    for obs in OBS:
        action, state = policy.predict(obs, state=("anything",))
        verdict = by_hand(torch.from_numpy(obs))
        assert np.array_equal(action, VICTIM(verdict.obs).numpy()) and state == ("anything",)
        assert torch.equal(policy.verdict.alarm, verdict.alarm) and torch.equal(policy.verdict.score, verdict.score)
        alarms.append(verdict.alarm)
    assert 0 < torch.stack(alarms).float().mean() < 1


def test_one_by_one_is_the_same_as_together():
    together, alone = predict(make_defended(), OBS), make_defended()
    assert together.shape == (12, 5, 1)
    for i in range(5):
        starts = np.arange(12) == 0
        one = predict(alone, OBS[:, i], starts)
        assert one.shape == (12, 1) and np.allclose(one, together[:, i], atol=1e-5)


def test_it_remembers_and_where_an_episode_starts_it_forgets():
    """Six last steps that begin with a start give the actions of a new episode; without it, others."""
    starts = np.zeros((12, 5), bool)
    starts[6, [1, 3]] = True
    found, on = predict(make_defended(), OBS, starts), predict(make_defended(), OBS)
    fresh = make_defended()
    fresh.predict(OBS[0]), fresh.reset()  # five episodes have begun, as above
    begun = predict(fresh, OBS[6:][:, [1, 3]])
    assert np.allclose(found[6:, [1, 3]], begun, atol=1e-5)
    assert np.array_equal(found[:, [0, 2, 4]], on[:, [0, 2, 4]])
    assert np.array_equal(found[:6], on[:6]) and not np.allclose(found[6:, [1, 3]], on[6:, [1, 3]], atol=1e-3)


def test_a_full_restart_may_change_the_number_of_episodes():
    policy = make_defended()
    predict(policy, OBS)
    action, _ = policy.predict(OBS[0, :2], episode_start=[True, True])
    with_reset = make_defended()
    predict(with_reset, OBS)
    with_reset.reset()
    assert np.array_equal(action, with_reset.predict(OBS[0, :2])[0])


def test_another_defended_loop_changes_no_action():
    first, second = make_defended(), make_defended()
    expected = predict(make_defended(), OBS)
    for step in range(12):
        assert np.array_equal(first.predict(OBS[step])[0], expected[step])
        second.predict(OBS[-step - 1])
        first.defense.reset([9])  # a copy


def test_it_equals_rollout():
    episodes = rollout(VICTIM, TASK, range(3), defense=make_defended().defense, steps=4)  # numbered 0, 1, 2
    assert episodes.mask[:4].all() and np.array_equal(predict(make_defended(), episodes.obs), episodes.action)


def test_a_gaussian_policy_samples_if_it_is_asked_to():
    victim = make_victim(TASK, gaussian=True)
    victim.action_std.fill_(0.3)
    policy, mean = make_defended(victim), make_defended(victim).predict(np.zeros((2_000, 4)))[0]
    drawn, _ = policy.predict(np.zeros((2_000, 4)), deterministic=False)
    inside = np.abs(drawn) < 1
    noise = (drawn - mean)[inside]
    assert np.abs(drawn).max() <= 1 and 0.25 < noise.std() < 0.31
    assert np.array_equal(make_defended(victim).predict(np.zeros((2_000, 4)), deterministic=False)[0], drawn)
    assert np.array_equal(make_defended().predict(OBS[0], deterministic=False)[0], make_defended().predict(OBS[0])[0])


def test_stable_baselines3_evaluates_it_as_a_model_of_its_own():
    seeds, env = [3, 4], make_vec_env("InvertedPendulum-v5", n_envs=2)
    env.seed(3)  # which gives 3 and 4 to the two
    silent = Defended(VICTIM, TASK, make_defense(4, threshold=np.inf))
    returns, lengths = evaluate_policy(silent, env, n_eval_episodes=2, return_episode_rewards=True)
    expected = rollout(VICTIM, TASK, seeds)
    assert sorted(lengths) == sorted(expected.lengths) and sorted(returns) == pytest.approx(sorted(expected.returns))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (dict(obs=np.zeros(3)), r"obs must be numbers \[4\] or \[N >= 1, 4\], not \[3\]"),
        (dict(obs=np.zeros((1, 5, 4))), r"obs must be"),
        (dict(obs=np.zeros((0, 4))), r"obs must be"),
        (dict(obs=1.0), r"obs must be"),
        (dict(obs="left"), r"obs must be"),
        (dict(obs=np.zeros((2, 4))), r"obs: it is of 2 episodes, and 5 are under way; call reset"),
        (dict(obs=np.full((5, 4), np.nan)), "obs holds NaN"),
        (dict(obs=np.full((5, 4), np.inf), episode_start=[True, False, True, False, False]), "obs holds NaN or inf"),
        (dict(obs=np.full((2, 4), np.nan), episode_start=[True, True]), "obs holds NaN"),
        (dict(obs=OBS[0], episode_start=[True]), "episode_start: it must have one entry for each of the 5 episodes"),
    ],
)
def test_observations_that_do_not_fit_are_refused(call, message):
    policy, beside = make_defended(), make_defended()
    policy.predict(OBS[0]), beside.predict(OBS[0])
    with pytest.raises(ValueError, match=message):
        policy.predict(**call)
    assert np.array_equal(policy.predict(OBS[1])[0], beside.predict(OBS[1])[0])  # and change nothing


def test_an_episode_may_start_after_the_first_prediction_failed():
    policy = make_defended()
    with pytest.raises(ValueError, match="NaN"):
        policy.predict(np.full((2, 4), np.nan))
    assert policy.predict(OBS[0, :2], episode_start=[False, True])[0].shape == (2, 1)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((make_victim(), TASK, make_defense(4)), "it maps 11 .* to 3 actions, but InvertedPendulum-v5 has 4 and 1"),
        ((VICTIM, TASK, None), "defense: give a DetectAndDenoise, not None"),
        ((VICTIM, TASK, DetectAndDenoise), "defense: give a DetectAndDenoise"),
        ((VICTIM, TASK, make_defense(11)), "defense: it is for 11 observations, and InvertedPendulum-v5 has 4"),
    ],
)
def test_parts_of_another_task_are_refused(parts, message):
    with pytest.raises(ValueError, match=message):
        Defended(*parts)


def test_a_second_thread_is_refused_and_leaves_the_first_undisturbed():
    class Slow(type(VICTIM)):
        """Waits inside ``predict`` until the other thread has tried."""

        def forward(self, obs):
            inside.set()
            assert may_go_on.wait(60)
            return super().forward(obs)

    inside, may_go_on, found = threading.Event(), threading.Event(), []
    victim = Slow(**VICTIM.config)
    victim.load_state_dict(VICTIM.state_dict())
    policy = make_defended(victim)
    thread = threading.Thread(target=lambda: found.append(policy.predict(OBS[0])[0]))
    thread.start()
    assert inside.wait(60)
    try:
        for enter in (lambda: policy.predict(OBS[1]), policy.reset):
            with pytest.raises(RuntimeError, match="two threads .* make one Defended for each loop"):
                enter()
    finally:
        may_go_on.set()
        thread.join()
    assert np.array_equal([*found, policy.predict(OBS[1])[0]], predict(make_defended(), OBS[:2]))


def test_a_copy_goes_on_from_the_same_memory_alone():
    policy = make_defended()
    policy.predict(OBS[0])
    copies = [copy.deepcopy(policy), pickle.loads(pickle.dumps(policy))]
    expected = policy.predict(OBS[1])[0]
    for made in copies:
        assert np.array_equal(made.predict(OBS[1])[0], expected)


def test_a_copy_made_during_a_prediction_can_predict():
    class Copied(type(VICTIM)):
        def forward(self, obs):
            made.append(copy.deepcopy(policy))
            return super().forward(obs)

    made: list[Defended] = []
    victim = Copied(**VICTIM.config)
    victim.load_state_dict(VICTIM.state_dict())
    policy = make_defended(victim)
    policy.predict(OBS[0])
    assert made[0].predict(OBS[1])[0].shape == (5, 1)


@pytest.mark.parametrize(("gaussian", "kind", "critics"), [(False, "deterministic", 2), (True, "Gaussian", "no")])
def test_its_text_names_task_policy_and_defence(gaussian, kind, critics):
    text, what = repr(make_defended(make_victim(TASK, gaussian=gaussian))), f"{critics} critic{'s' * (not gaussian)}"
    victim = f"Victim({kind} policy of layers [4, 16, 1], {what})"
    assert text == f"Defended(InvertedPendulum-v5, {victim}, DetectAndDenoise(Detector > 1.5, Denoiser))"
