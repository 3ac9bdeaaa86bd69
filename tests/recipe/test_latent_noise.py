"""What the noise of the latents costs an attacker: on small real defences, for which some answers are known."""

import copy
import json

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_gruvae, make_victim, normal, ship_victim

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.defense.variants import VARIANTS
from detden_lite.recipe import latent_noise
from detden_lite.recipe.cli import main
from detden_lite.recipe.latent_noise import alignment, attacked, deviation, measure, moment, signal_to_noise, silenced
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models

VICTIM = make_victim(seed=8)
ATTACK = OppositeAttack(VICTIM, BUDGET, steps=3)


@pytest.fixture(scope="module")
def played():
    defense = make_defense()
    return defense, rollout(VICTIM, HOPPER, range(4), attack=ATTACK, defense=defense, steps=8)


def test_a_moment_reproduces_the_episode_at_that_step(played):
    """With the defence's memory, and with its own next random numbers."""
    defense, episodes = played
    now = moment(episodes, defense, 5)
    verdict = copy.deepcopy(now.defense)(torch.from_numpy(episodes.perturbed[5]))
    assert torch.equal(now.obs, torch.from_numpy(episodes.obs[5]))
    assert np.allclose(verdict.denoised, episodes.denoised[5], atol=1e-5)
    assert (verdict.alarm.numpy() == episodes.alarm[5]).all()


def test_without_noise_the_deviation_is_the_policys_own(played):
    defense, episodes = played
    now = silenced(moment(episodes, defense, 5))
    seen = attacked(ATTACK, now)
    done = VICTIM(copy.deepcopy(now.defense)(seen).obs)
    assert torch.allclose(deviation(ATTACK, now, seen), (done - VICTIM(now.obs)).norm(dim=-1), atol=1e-5)
    loud = moment(episodes, defense, 5)
    assert not torch.allclose(deviation(ATTACK, loud, seen), deviation(ATTACK, now, seen), atol=1e-4)


def test_more_samples_align_better_and_noise_is_the_cause(played):
    defense, episodes = played
    now = moment(episodes, defense, 5)
    quiet, seen = silenced(now), attacked(ATTACK, now)
    one, many = (alignment(ATTACK, now, seen, k).mean() for k in (1, 64))
    assert one < many <= 1 + 1e-5
    assert torch.allclose(alignment(ATTACK, quiet, seen, 1), torch.ones(4), atol=1e-5)


def test_more_latent_noise_lowers_the_signal_to_noise():
    model, obs = make_gruvae(), normal(3, 20, 11)
    before = signal_to_noise(model, obs)
    assert before.shape == (4,) and (before > 0).all()
    model.to_log_variance.bias += np.log(4)
    assert torch.allclose(signal_to_noise(model, obs), before / 4, rtol=1e-4)
    model.to_mean.bias += 10  # a constant offset of the mean carries no signal
    assert torch.allclose(signal_to_noise(model, obs), before / 4, rtol=1e-3)


def test_every_quantity_is_measured_at_every_given_step(played, monkeypatch):
    monkeypatch.setattr(latent_noise, "SAMPLES", (1, 2))
    defense, episodes = played
    found = measure(ATTACK, defense, episodes, (1, 5), steps=2)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    rows = [
        *found["samples"].values(),
        *found["alignment"].values(),
        found["clean"],
        found["unaware"],
        found["mean"],
        found["free"],
    ]
    assert {len(row) for row in rows} == {8} and list(found["samples"]) == ["1", "2"]
    assert np.mean(found["samples"]["2"]) >= 0.95 * np.mean(found["unaware"])  # the adaptive attack knows more
    assert found["latent"] == sorted(found["latent"])


def test_the_stage_stores_what_it_measures_once(tmp_path):
    ship_victim(tmp_path)
    for data in {VARIANTS[name].data for name in latent_noise.MEASURED}:
        models.save_model("hopper", "td3", f"detector-{data}", make_gruvae(), dict(threshold=1.0), tmp_path)
    for name in latent_noise.MEASURED:
        card = dict(data=VARIANTS[name].data)
        models.save_model("hopper", "td3", f"denoiser-{name}", make_gruvae(), card, tmp_path)
    path = tmp_path / "hopper-td3" / "barrier.json"
    main(["barrier", "--root", str(tmp_path)])
    record, made = manifest.read_json(path, tmp_path), path.stat().st_mtime_ns
    assert set(record["variants"]) == set(latent_noise.MEASURED) and record["at"] == [10, 40]
    main(["barrier", "--root", str(tmp_path)])
    assert path.stat().st_mtime_ns == made
