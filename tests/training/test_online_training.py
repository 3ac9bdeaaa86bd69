"""SA-PPO and ATLA-PPO: the inner maximum, the turns, and trainings that can be repeated and resumed."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import torch
from builders import HOPPER, normal
from torch.distributions import Independent, Normal, kl_divergence

from detden_lite.training import resumable, sa_ppo
from detden_lite.training.atla import AttackedWorlds, Frozen
from detden_lite.training.online_recipes import ATLARecipe, SAPPORecipe
from detden_lite.training.progress import columns, load_progress
from detden_lite.training.recipes import PPORecipe
from detden_lite.training.worlds import task_worlds, train_victim
from detden_lite.victims.victim import Victim

SIZES = dict(steps=768, segment=256, net=16, envs=4, rollout=32, batch=32, epochs=2)
RECIPES = dict(sappo=SAPPORecipe(**SIZES, weight=1.0, grown=0.5), atla=ATLARecipe(**SIZES, grown=0.5))
WORLDS = partial(task_worlds, HOPPER)
KEY = jax.random.PRNGKey(0)
TURN = SIZES["envs"] * SIZES["rollout"]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "snapshots").iterdir()}


def begun(recipe, done: float = 0.9):
    """A model whose worlds are ready, and where the ball is full."""
    model = recipe.start(HOPPER, WORLDS, 0)
    recipe.begin_segment(model, WORLDS, done)
    model.set_random_seed(0)
    return model


@pytest.fixture(scope="module")
def sappo():
    """A model, in its first steps; XLA takes seconds to compile each, so that tests share it."""
    return begun(RECIPES["sappo"])


@pytest.fixture(scope="module")
def atla():
    """The same of ATLA, after two turns."""
    model = begun(RECIPES["atla"])
    model.learn(TURN, reset_num_timesteps=False)
    return model


def state(model) -> list[np.ndarray]:
    """What a turn may change: the parameters of both networks, and the statistics of the normaliser."""
    leaves = jax.tree_util.tree_leaves([model.policy.actor_state.params, model.policy.vf_state.params])
    normalizer = model.get_vec_normalize_env()
    rms = [getattr(rms, name) for rms in (normalizer.obs_rms, normalizer.ret_rms) for name in ("mean", "var", "count")]
    return [np.array(part) for part in (*leaves, *rms)]


def moved(before: list[np.ndarray], after: list[np.ndarray]) -> list[bool]:
    return [not np.array_equal(a, b) for a, b in zip(before, after, strict=True)]


def test_the_kl_divergence_is_torchs():
    mean, other, std = normal(7, 3), normal(7, 3, seed=1), normal(3, seed=2).exp()
    expected = kl_divergence(*(Independent(Normal(m, std), 1) for m in (mean, other)))
    found = sa_ppo.kl(*(jnp.asarray(x.numpy()) for x in (mean, other, std)))
    assert np.allclose(found, expected, rtol=1e-5)


def test_the_inner_maximum_of_a_linear_policy_is_a_planted_corner():
    """|w.(o' - o)| is largest where every number has moved by its radius, with the sign of its weight or against it."""
    weights = normal(6, seed=3).numpy()
    radius, obs = np.linspace(0.1, 0.6, 6, dtype=np.float32), normal(5, 6).numpy()
    found = sa_ppo.most_different(lambda x: x @ weights[:, None], 1.0, obs, radius, KEY)
    corner = np.array(found - obs) * np.sign(weights)
    assert np.allclose(np.abs(corner), radius, atol=1e-6)
    assert (np.sign(corner) == np.sign(corner[:, :1])).all()


def test_the_inner_maximum_beats_random_points_in_the_same_balls():
    w, v = (jnp.asarray(normal(*shape, seed=seed).numpy()) for shape, seed in (((6, 32), 1), ((32, 3), 2)))
    obs, std, radius = jnp.asarray(normal(20, 6).numpy()), jnp.ones(3), jnp.full(6, 0.3)

    def policy(x):
        return jnp.tanh(x @ w) @ v

    def value(point):
        return sa_ppo.kl(policy(obs), policy(point), std)

    found = sa_ppo.most_different(policy, std, obs, radius, KEY, steps=10)
    assert (jnp.abs(found - obs) <= radius + 1e-6).all()
    tried = jax.random.uniform(KEY, (100, *obs.shape), minval=obs - radius, maxval=obs + radius)
    assert value(found).mean() > jnp.stack([value(point) for point in tried]).max(0).mean()
    longer = sa_ppo.most_different(policy, std, obs, radius, KEY, steps=50)
    assert value(longer).mean() >= 0.95 * value(found).mean()


def test_the_inner_maximum_stays_where_a_normaliser_clips():
    found = sa_ppo.most_different(lambda x: x, 1.0, jnp.full((1, 2), 0.5), 100.0, KEY, clip=2.0)
    assert np.allclose(np.abs(found), 2.0)


def regularizer(state):
    obs = normal(64, 11).numpy()
    return sa_ppo.regularizer_gradient(state, obs, jnp.full(11, 0.3), KEY, steps=10, clip=10.0)


def test_a_step_against_the_gradient_makes_the_policy_smoother(sappo):
    before = sappo.policy.actor_state
    value, gradient = regularizer(before)
    size = 0.1 * value / sum(jnp.square(part).sum() for part in jax.tree.leaves(gradient))
    params = jax.tree.map(lambda part, slope: part - size * slope, before.params, gradient)
    assert 0 < regularizer(before.replace(params=params))[0] < value
    assert (gradient["params"]["log_std"] == 0).all()  # not by more exploration


def test_the_pull_is_added_to_ppos_own_gradient(sappo):
    """The step on a sum of gradients is the step on one gradient that is this sum."""
    before = sappo.policy.actor_state
    ones = jax.tree.map(jnp.ones_like, before.params)
    pulled = before.replace(pull=ones).apply_gradients(grads=ones)
    twice = before.apply_gradients(grads=jax.tree.map(lambda part: 2 * part, ones))
    assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, (pulled.params, twice.params)), strict=True))


def test_the_ball_grows_and_is_measured_in_what_the_policy_sees(sappo):
    shares = []
    for done in (0.0, 0.25, 0.5, 0.9):
        RECIPES["sappo"].begin_segment(sappo, WORLDS, done)
        shares.append(sappo.share)
    assert shares == [0, 0.5, 1, 1]
    for sappo.normalized in (True, False):
        sappo.learn(TURN, reset_num_timesteps=False)
        statistics = sappo.get_vec_normalize_env()
        unit = 1 if sappo.normalized else np.sqrt(statistics.obs_rms.var + statistics.epsilon)
        assert np.allclose(sappo.radius, HOPPER.epsilon / unit, rtol=1e-5)
        assert sappo.told()["largest_kl"] > 0 and sappo.told()["largest_kl"] is None


def test_who_does_not_play_a_turn_stays_as_they_are(atla, monkeypatch):
    """Neither networks nor normaliser, which would go on learning if it counted what it is shown."""
    own, other = state(atla), state(atla.adversary)
    atla.adversary_turn()
    assert not any(moved(own, state(atla))) and all(moved(other, state(atla.adversary)))
    other = state(atla.adversary)
    monkeypatch.setattr(atla, "adversary_turn", lambda: None)
    atla.learn(TURN, reset_num_timesteps=False)
    assert all(moved(own, state(atla))) and not any(moved(other, state(atla.adversary)))


def test_both_play_as_many_steps(atla):
    before, _ = (atla.num_timesteps, atla.adversary.num_timesteps), atla.told()
    atla.learn(2 * TURN, reset_num_timesteps=False)
    assert (atla.num_timesteps - before[0], atla.adversary.num_timesteps - before[1]) == (2 * TURN, 2 * TURN)
    told = atla.told()["adversary"]
    assert told["steps"] == 2 * TURN and 0 <= told["falls"] <= told["episodes"]
    assert atla.told()["adversary"]["steps"] == 0  # it was taken


def test_a_frozen_player_acts_as_the_policy_that_will_be_stored(atla):
    stored, obs = Victim.from_sb3(atla, atla.get_vec_normalize_env()), normal(9, 11)
    assert torch.allclose(Frozen(atla, deterministic=True)(obs), stored(obs), atol=1e-4)
    exploring = Frozen(atla.adversary, deterministic=False)
    assert not torch.equal(exploring(obs), exploring(obs)) and exploring(obs).abs().max() <= 1


@pytest.mark.parametrize("normalized", [False, True])
def test_the_policy_sees_perturbed_observations_within_the_ball(atla, normalized, monkeypatch):
    """The last ones of episodes too."""
    model = atla
    monkeypatch.setattr(model, "normalized", normalized)
    std = np.sqrt(model.get_vec_normalize_env().obs_rms.var + 1e-8)
    assert model.ball.epsilon == HOPPER.epsilon
    assert np.allclose(model.ball.scale, std if normalized else 1.0)
    plain, attacked = task_worlds(HOPPER, 4), AttackedWorlds(task_worlds(HOPPER, 4))
    for worlds in (plain, attacked):
        worlds.seed(3)
    assert np.array_equal(plain.reset(), attacked.reset())
    corner = torch.tensor([1.0, -1.0] * 5 + [1.0])
    attacked.attack = lambda obs: model.ball.project(obs, obs + 10 * corner)
    ends = 0
    for _ in range(60):
        action = np.ones((4, 3), np.float32)
        (obs, *rest, infos), (shown, *same, told) = plain.step(action), attacked.step(action)
        assert np.array_equal(rest, same)
        pairs = [(obs, shown), *((i["terminal_observation"][None], j["terminal_observation"][None])
                                 for i, j in zip(infos, told, strict=True) if "terminal_observation" in i)]  # fmt: skip
        for true, perturbed in pairs:
            found = torch.from_numpy(perturbed - true) / (HOPPER.epsilon * torch.as_tensor(model.ball.scale))
            assert torch.allclose(found, corner.expand_as(found), atol=1e-3)
        ends += len(pairs) - 1
    assert ends


def interrupt(monkeypatch, recipe, folder: Path) -> None:
    """Train until the first checkpoint is written."""

    class Interrupting(resumable.tqdm):
        def update(self, n=1):
            raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(resumable, "tqdm", Interrupting)
        train_victim(HOPPER, recipe, 0, folder, checkpoint_seconds=0)


@pytest.fixture(scope="module", params=RECIPES)
def trained(request, tmp_path_factory) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp(request.param)
    train_victim(HOPPER, RECIPES[request.param], 0, folder)
    return request.param, folder


@pytest.mark.slow
def test_a_resumed_training_equals_an_uninterrupted_one(trained, tmp_path, monkeypatch):
    algo, folder = trained
    recipe = RECIPES[algo]
    interrupt(monkeypatch, recipe, tmp_path)
    assert len(contents(tmp_path)) == 1
    train_victim(HOPPER, recipe, 0, tmp_path)
    assert contents(folder) == contents(tmp_path)
    whole, resumed = columns(load_progress(folder)), columns(load_progress(tmp_path))
    assert [whole[key] == resumed[key] for key in whole if "seconds" not in key] == [True] * (len(whole) - 2)
    assert json.loads((folder / "recipe.json").read_text())["epsilon"] == HOPPER.epsilon


@pytest.mark.slow
def test_what_a_training_went_through_is_written_down(trained):
    algo, folder = trained
    told, steps = columns(load_progress(folder)), SIZES["steps"]
    assert told["end"] == [256, 512, 768] and sum(told["steps"]) == steps and min(told["cpu_seconds"]) > 0
    assert 0 < sum(told["falls"]) <= sum(told["episodes"])
    if algo == "atla":
        assert sum(told["attacked_steps"]) == 2 * steps and sum(told["attacked_falls"]) >= sum(told["falls"])
    else:
        assert not any(told["attacked_steps"]) and told["largest_kl"][0] is None and told["largest_kl"][-1] > 0


@pytest.mark.slow
def test_without_a_weight_sa_ppo_is_ppo(tmp_path):
    short = dict(SIZES, steps=512)
    for name, recipe in dict(ppo=PPORecipe(**short), sappo=SAPPORecipe(**short, weight=0.0, grown=0.5)).items():
        train_victim(HOPPER, recipe, 0, tmp_path / name)
    assert contents(tmp_path / "ppo") == contents(tmp_path / "sappo")


@pytest.mark.parametrize(
    ("change", "message"),
    [(dict(grown=1.0), "grown must be"), (dict(weight=-1.0), "weight"), (dict(ascent=0), "ascent")],
)
def test_settings_that_make_no_sense_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(RECIPES["sappo"], **change)
