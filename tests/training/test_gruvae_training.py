import io
import json
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import BUDGET, make_victim

from detden_lite.core.files import ArtifactError
from detden_lite.core.types import Trajectories
from detden_lite.defense.gruvae import LEAST_STD, reconstruction_loss
from detden_lite.training.gruvae_training import VAERecipe, train_gruvae
from detden_lite.training.regularizer import Regularizer
from detden_lite.victims.victim import Victim

RECIPE = VAERecipe(hidden=16, latent=4, epochs=4, batch=8, chunk=7, learning_rate=1e-2)


def waves(n: int = 24, steps: int = 20, seed: int = 0) -> Trajectories:
    """Sine waves of three phases each, of several lengths."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(5, steps + 1, n)
    phase = rng.uniform(0, 6.28, (n, 1, 3))
    obs = np.sin(np.arange(steps)[None, :, None] * [0.3, 0.5, 0.7] + phase).astype(np.float32) * [1, 10, 0.1]
    trajectories = Trajectories(obs.astype(np.float32), lengths)
    trajectories.obs[~trajectories.mask] = 0
    return trajectories


NORMAL = waves()
PAIRS = [(NORMAL, NORMAL)]
ATTACKED = Trajectories(NORMAL.obs + NORMAL.mask[..., None] * np.float32(0.3), NORMAL.lengths)
BOTH = [*PAIRS, (ATTACKED, NORMAL)]
REGULARIZER = Regularizer(Victim([3, 8, 2], [5, 8, 1]), BUDGET)
# The two options of training: R, and inputs that are attacked now and then.
MORE = [dict(lam=0.5), dict(least_share=0.2, least_size=0.5)]


def same(model, other) -> bool:
    return all(torch.equal(value, other.state_dict()[name]) for name, value in model.state_dict().items())


class Killed(Exception):
    pass


def kill_after(last: int):
    def after_epoch(epoch, model):
        if epoch == last:
            raise Killed

    return after_epoch


@pytest.mark.slow
@pytest.mark.parametrize(("last", "more"), [(0, {}), (2, {}), *((1, more) for more in MORE)])
def test_a_killed_and_resumed_training_equals_an_uninterrupted_one(tmp_path, last, more):
    recipe, context = replace(RECIPE, **more), dict(regularizer=REGULARIZER)
    uninterrupted = train_gruvae(recipe, BOTH, seed=3, **context)
    path = tmp_path / "deep" / "model.ckpt"
    with pytest.raises(Killed):
        train_gruvae(recipe, BOTH, 3, path, kill_after(last), **context)
    seen = []
    resumed = train_gruvae(recipe, BOTH, 3, path, lambda epoch, model: seen.append(epoch), **context)
    assert seen == list(range(last, RECIPE.epochs))
    assert same(resumed, uninterrupted)


@pytest.mark.parametrize("more", MORE)
def test_options_that_are_switched_off_change_no_weight(more):
    """With lambda 0 no regularizer is called, and with sequences attacked throughout none is mixed."""
    plain = train_gruvae(RECIPE, BOTH, 0)
    assert same(train_gruvae(RECIPE, BOTH, 0, regularizer=REGULARIZER), plain)
    assert not same(train_gruvae(replace(RECIPE, **more), BOTH, 0, regularizer=REGULARIZER), plain)


def test_a_regularizer_of_another_task_is_refused():
    with pytest.raises(ValueError, match="regularizer: its victim has 11 observations"):
        train_gruvae(replace(RECIPE, lam=0.5), PAIRS, 0, regularizer=Regularizer(make_victim(), BUDGET))


def test_a_checkpoint_from_before_a_hyperparameter_existed_had_its_default(tmp_path):
    path = tmp_path / "model.ckpt"
    with pytest.raises(Killed):
        train_gruvae(RECIPE, PAIRS, 0, path, kill_after(1))
    saved = torch.load(path, weights_only=True)
    known = json.loads(saved["identity"])
    for name in ("lam", "least_share", "least_size", "regularizer"):
        del known[name]
    torch.save(saved | dict(identity=json.dumps(known)), path)
    with pytest.raises(ValueError, match="another recipe"):
        train_gruvae(replace(RECIPE, least_size=0.5), PAIRS, 0, path)
    assert same(train_gruvae(RECIPE, PAIRS, 0, path), train_gruvae(RECIPE, PAIRS, 0))


def test_a_checkpoint_of_another_regularizer_is_refused(tmp_path):
    path, recipe = tmp_path / "model.ckpt", replace(RECIPE, lam=0.1, epochs=1)
    first = train_gruvae(recipe, PAIRS, 0, path, regularizer=REGULARIZER)
    with pytest.raises(ValueError, match="another recipe"):
        train_gruvae(recipe, PAIRS, 0, path, regularizer=replace(REGULARIZER, steps=5))
    assert same(train_gruvae(recipe, PAIRS, 0, path, regularizer=replace(REGULARIZER)), first)


def test_training_leaves_the_victim_as_it_is():
    victim = REGULARIZER.victim
    before = {name: tensor.clone() for name, tensor in victim.state_dict().items()}
    train_gruvae(replace(RECIPE, lam=0.5, epochs=1), BOTH, 0, regularizer=REGULARIZER)
    assert all(torch.equal(tensor, before[name]) for name, tensor in victim.state_dict().items())
    assert all(parameter.grad is None for parameter in victim.parameters())


def test_a_weight_without_a_regularizer_is_refused():
    with pytest.raises(ValueError, match="regularizer: .*lam = 0.5"):
        train_gruvae(replace(RECIPE, lam=0.5), PAIRS, 0)


SIZES = ("hidden", "layers", "latent", "epochs", "batch", "chunk")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, value) for name in SIZES for value in (0, -1, 1.5, "8")),
        *(("learning_rate", value) for value in (0, -1e-3, math.nan, math.inf)),
        *((name, value) for name in ("beta", "lam") for value in (-1, math.nan, math.inf)),
        *((name, value) for name in ("least_share", "least_size") for value in (-0.1, 1.1, math.nan)),
        ("prior", "flat"),
    ],
)
def test_a_recipe_that_makes_no_sense_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"^{name} must be"):
        replace(RECIPE, **{name: value})


def test_a_recipe_takes_numbers_of_numpy():
    assert replace(RECIPE, hidden=np.int64(8), beta=np.float32(0), lam=0, least_share=np.float64(1)).hidden == 8


@pytest.mark.parametrize(
    "pairs",
    [
        [],
        [(NORMAL, waves(n=23))],
        [(waves(steps=21), NORMAL)],
        [(replace(NORMAL, obs=NORMAL.obs[..., :2]), NORMAL)],
        [(replace(NORMAL, lengths=NORMAL.lengths - 1), NORMAL)],
        [*PAIRS, (waves(steps=21), waves(steps=21))],
    ],
)
def test_pairs_of_different_trajectories_are_refused(pairs):
    with pytest.raises(ValueError, match="pairs"):
        train_gruvae(RECIPE, pairs, 0)


def test_a_finished_training_is_not_repeated(tmp_path):
    path = tmp_path / "model.ckpt"
    first = train_gruvae(RECIPE, PAIRS, 0, path)
    content = path.read_bytes()
    assert same(train_gruvae(RECIPE, PAIRS, 0, path, kill_after(0)), first)
    assert path.read_bytes() == content


def test_a_kill_while_writing_leaves_the_last_checkpoint(tmp_path):
    path = tmp_path / "model.ckpt"
    with pytest.raises(Killed):
        train_gruvae(RECIPE, PAIRS, 0, path, kill_after(1))
    path.with_suffix(".new").write_bytes(path.read_bytes()[:100])
    assert same(train_gruvae(RECIPE, PAIRS, 0, path), train_gruvae(RECIPE, PAIRS, 0))


def foreign(**content) -> bytes:
    torch.save(content, file := io.BytesIO())
    return file.getvalue()


class Planted:
    """Would be called if the checkpoint were unpickled as Python does it."""

    def __reduce__(self):
        return pytest.fail, ("the checkpoint was executed",)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: b"garbage",
        lambda content: content[: len(content) // 2],
        lambda content: content[:200] + b"?" * 100 + content[300:],
        lambda content: foreign(),
        lambda content: foreign(identity="{", epochs=1),
        lambda content: foreign(**torch.load(io.BytesIO(content)) | dict(model={})),
        lambda content: foreign(**torch.load(io.BytesIO(content)) | dict(optimizer=3)),
        lambda content: pickle.dumps(Planted(), protocol=2),
    ],
    ids=["empty", "garbage", "cut", "overwritten", "of nothing", "not json", "no weights", "no optimizer", "pickle"],
)
def test_a_damaged_checkpoint_is_refused_by_name(tmp_path, damage):
    path = tmp_path / "model.ckpt"
    with pytest.raises(Killed):
        train_gruvae(RECIPE, PAIRS, 0, path, kill_after(0))
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(ArtifactError, match="model.ckpt is damaged, or no checkpoint .*; remove it to start anew"):
        train_gruvae(RECIPE, PAIRS, 0, path)


@pytest.mark.parametrize("change", [dict(beta=0.5), dict(epochs=5), dict(hidden=8)])
def test_a_checkpoint_of_another_recipe_is_refused(tmp_path, change):
    path = tmp_path / "model.ckpt"
    with pytest.raises(Killed):
        train_gruvae(RECIPE, PAIRS, 0, path, kill_after(0))
    for recipe, seed in ((replace(RECIPE, **change), 0), (RECIPE, 1)):
        with pytest.raises(ValueError, match="model.ckpt.*another recipe"):
            train_gruvae(recipe, PAIRS, seed, path)


def test_the_same_seed_gives_the_same_model():
    assert same(train_gruvae(RECIPE, PAIRS, 0), train_gruvae(RECIPE, PAIRS, 0))
    assert not same(train_gruvae(RECIPE, PAIRS, 0), train_gruvae(RECIPE, PAIRS, 1))


def test_padding_teaches_nothing():
    padded = Trajectories(np.where(NORMAL.mask[..., None], NORMAL.obs, 1e3).astype(np.float32), NORMAL.lengths)
    assert same(train_gruvae(RECIPE, [(padded, padded)], 0), train_gruvae(RECIPE, PAIRS, 0))


def test_statistics_are_those_of_the_true_observations():
    model = train_gruvae(replace(RECIPE, epochs=1), BOTH, 0)
    seen = NORMAL.obs[NORMAL.mask]
    assert np.allclose(model.obs_mean, seen.mean(0), atol=1e-5) and np.allclose(model.obs_std, seen.std(0), rtol=1e-2)


def test_training_lowers_the_loss_on_trajectories_it_has_not_seen():
    held_out = waves(seed=1)
    obs, mask = torch.from_numpy(held_out.obs), torch.from_numpy(held_out.mask)

    def loss(epochs):
        model = train_gruvae(replace(RECIPE, epochs=epochs), PAIRS, 0)
        return float(reconstruction_loss(model, model(obs).output, obs)[mask].mean())

    assert loss(30) < 0.5 * loss(1)


@pytest.mark.slow
def test_a_denoiser_comes_closer_to_the_truth_than_its_input():
    """Attacked trajectories are shifted by as much as they vary; half of the pairs are not attacked."""

    def attacked(t: Trajectories) -> Trajectories:
        return Trajectories((t.obs + t.mask[..., None] * np.float32([1, -10, 0.1])).astype(np.float32), t.lengths)

    recipe = replace(RECIPE, epochs=40, residual=True)
    model = train_gruvae(recipe, [(NORMAL, NORMAL), (attacked(NORMAL), NORMAL)], 0)
    held_out = waves(seed=1)
    given, mask = attacked(held_out).obs, held_out.mask
    denoised = model(torch.from_numpy(given)).output.numpy()
    unit = model.obs_std.numpy()
    assert (
        np.abs((denoised - held_out.obs) / unit)[mask].mean() < 0.6 * np.abs((given - held_out.obs) / unit)[mask].mean()
    )


def test_dimensions_dominated_by_the_perturbation_are_rescaled_and_not_added():
    """The second of three observations varies by seven, the others never; an attack moves each of them by three."""
    still = replace(NORMAL, obs=NORMAL.obs * np.float32([0, 1, 0]))
    attacked = replace(still, obs=still.obs + 3 * still.mask[..., None].astype(np.float32))
    recipe = replace(RECIPE, epochs=1, residual=True)
    model = train_gruvae(recipe, [(still, still), (attacked, still)], 0)
    std = still.obs[still.mask].std(0)[1]
    assert np.allclose(model.obs_std, [3, std, 3], rtol=1e-2) and 3 < 10 * std
    assert model.config["residual"] == [False, True, False]
    # Without an attack, as a detector is trained, no dimension is dominated.
    model = train_gruvae(recipe, [(still, still)], 0)
    assert np.allclose(model.obs_std, [LEAST_STD, std, LEAST_STD], rtol=1e-2) and model.config["residual"] is True


def test_the_trained_model_is_frozen():
    model = train_gruvae(replace(RECIPE, epochs=1), PAIRS, 0)
    assert not model.training and not any(p.requires_grad for p in model.parameters())
