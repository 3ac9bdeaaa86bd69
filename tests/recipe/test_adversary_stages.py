import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_gruvae, make_victim, normal
from safetensors.torch import load_file, save_file
from stable_baselines3.common.vec_env import VecMonitor

from detden_lite.attacks import catalogue
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.attacks.timing import Vulnerable
from detden_lite.core import files
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import adversary_stages, episode_seeds, evaluation, search_stages
from detden_lite.recipe.run import Run
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models, tensors
from detden_lite.training import checkpoints, resumable
from detden_lite.training.adversary_recipe import AdversaryRecipe
from detden_lite.training.adversary_world import AdversaryEnv
from detden_lite.training.resumable import train
from detden_lite.victims.victim import Victim

C_VUL = -0.5  # the untrained victim's V lies on both sides of it
RECIPE = AdversaryRecipe(steps=512, segment=128, net=16, envs=4, rollout=32, batch=32, epochs=2, entropy=0.01)


def worlds(n: int):
    return VecMonitor(AdversaryEnv(make_victim(seed=8), HOPPER, BUDGET, n, steps=20))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "snapshots").iterdir()}


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    train(HOPPER, RECIPE, 0, folder, worlds, dict(victim="a"))
    return folder


def test_a_snapshot_is_a_policy_whose_actions_are_perturbations(trained):
    states = [load_file(path) for path in sorted((trained / "snapshots").iterdir())]
    assert len(states) == 4 and not torch.equal(states[0]["actor.0.weight"], states[1]["actor.0.weight"])
    adversary = Victim.from_state(RECIPE.config(HOPPER), states[-1])
    assert (adversary.obs_dim, adversary.action_dim) == (11, 11) and (adversary.obs_std != 1).all()
    assert (adversary.action_low == -1).all() and (adversary.action_high == 1).all()


def test_a_resumed_training_equals_an_uninterrupted_one(trained, tmp_path, monkeypatch):
    class Interrupting(resumable.tqdm):
        def update(self, n=1):
            raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(resumable, "tqdm", Interrupting)
        train(HOPPER, RECIPE, 0, tmp_path, worlds, dict(victim="a"), checkpoint_seconds=0)
    assert (
        len(contents(tmp_path)) == 1 and checkpoints.load(RECIPE.start(HOPPER, worlds, 0), tmp_path / "checkpoint") == 1
    )
    train(HOPPER, RECIPE, 0, tmp_path, worlds, dict(victim="a"))
    assert contents(tmp_path) == contents(trained)
    model = RECIPE.start(HOPPER, worlds, 0)
    assert checkpoints.load(model, tmp_path / "checkpoint") == 4
    assert model.num_timesteps == 512 and model.ent_coef == 0.01


def test_a_folder_with_the_adversary_of_another_victim_is_refused(trained):
    with pytest.raises(ValueError, match="recipe.json describes another run"):
        train(HOPPER, RECIPE, 0, trained, worlds, dict(victim="b"))


@pytest.fixture
def run(tmp_path) -> Run:
    """A run that has a victim, which falls at different times, and its tuned timing, and nothing else."""
    models.save_victim("hopper", "td3", make_victim(seed=8), {}, tmp_path)
    manifest.write_json(tmp_path / "hopper-td3" / "timing.json", dict(c_vul=C_VUL, attack_rate=0.5), tmp_path)
    return Run.of(tmp_path, "hopper", "td3", "tiny")


def add_member(run: Run, member: int, seeds) -> list[Path]:
    """The folder of a finished training, with random snapshots."""
    folder = run.folder / "checkpoints" / f"adversary-{member}"
    (folder / "snapshots").mkdir(parents=True)
    (folder / "recipe.json").write_text(json.dumps(dict(net=16, seed=member)))
    config = AdversaryRecipe(net=16).config(HOPPER)
    for seed in seeds:
        torch.manual_seed(seed)
        adversary = Victim(**config)
        adversary.actor[-1].weight.mul_(20)
        save_file(adversary.state_dict(), folder / "snapshots" / f"{seed:08d}.safetensors")
    return sorted((folder / "snapshots").iterdir())


def left(run: Run, path: Path, episodes) -> float:
    """The victim's mean return over both timings: attacked always by a snapshot, and where it is vulnerable."""
    adversary = Victim.from_state(AdversaryRecipe(net=16).config(HOPPER), load_file(path))
    attack, victim = OptimalAttack(adversary, run.budget), run.victim()
    always, vulnerable = (
        rollout(victim, HOPPER, episodes, attack=attack, timing=timing, steps=50).returns.mean()
        for timing in (None, Vulnerable(victim, C_VUL))
    )
    assert always != vulnerable
    return float(always + vulnerable) / 2


def test_the_adversary_that_leaves_the_smallest_return_is_chosen(run):
    paths = [*add_member(run, 0, range(6)), *add_member(run, 1, range(6, 14))]
    adversary_stages.choose(run)
    episodes = episode_seeds.seeds("adversary", 5 + 4)
    screening = {path: left(run, path, episodes[:5]) for path in paths}
    selection = {path: left(run, path, episodes[5:]) for path in sorted(paths, key=screening.get)[:5]}
    best = min(selection, key=selection.get)
    card = manifest.read_json(run.folder / "adversary.json", run.root)
    assert len(set(screening.values())) == 14 and selection[best] < sorted(selection.values())[1]
    assert card["step"] == int(best.stem) and card["selection_mean"] == pytest.approx(selection[best])
    assert card["recipe"]["seed"] == int(best.stem) // 6 - (best.stem > f"{11:08d}")
    clean = rollout(run.victim(), HOPPER, episodes[5:], steps=50).returns.mean()
    assert card["clean_mean"] == pytest.approx(clean) and card["selection_seeds"] == [episodes[5], 4]
    curves = card["learning_curves"]
    assert [curve["steps"] for curve in curves] == [list(range(6)), list(range(6, 14))]
    assert [m for curve in curves for m in curve["mean"]] == pytest.approx(list(screening.values()))
    shipped = models.load_adversary("hopper", "td3", "optimal", run.root)
    assert tensors.digest(shipped.state_dict()) == tensors.digest(load_file(best))


def test_a_new_adversary_removes_the_records_of_the_last(run):
    add_member(run, 0, [0])
    records = [run.root / "results" / f"hopper-td3.{name}.always.none.json" for name in ("optimal", "linear", "none")]
    adversary_stages.choose(run)
    for path in records:
        manifest.write_json(path, {}, run.root)
    adversary_stages.choose(run)
    assert all(path.exists() for path in records)
    shutil.rmtree(run.folder / "checkpoints" / "adversary-0")
    add_member(run, 0, [1])
    adversary_stages.choose(run)
    assert [path.exists() for path in records] == [False, True, True]


@pytest.mark.parametrize("harm", [lambda path: path.write_bytes(path.read_bytes()[:-10]),
                                  lambda path: save_file(make_victim().state_dict(), path)],
                         ids=["truncated", "another network"])  # fmt: skip
def test_a_bad_snapshot_is_refused(run, harm):
    harm(add_member(run, 0, [0, 1])[1])
    with pytest.raises(files.ArtifactError, match="00000001.safetensors is truncated.*; remove .*adversary-0"):
        adversary_stages.choose(run)
    assert not (run.folder / "adversary.json").exists()


def test_a_member_outside_the_grid_is_refused(tmp_path):
    """Before anything is loaded: this run has no victim."""
    for member in (-1, 4):
        with pytest.raises(ValueError, match=f"member must be between 0 and 3 at this scale, not {member}"):
            adversary_stages.train_member(Run.of(tmp_path, "hopper", "td3", "tiny"), member)


def test_a_member_is_trained_on_the_victim_of_the_run(run):
    adversary_stages.train_member(run, 0)
    recipe = json.loads((run.folder / "checkpoints" / "adversary-0" / "recipe.json").read_text())
    promised = manifest.promised(run.folder / "victim.safetensors", run.root)
    about = dict(task="hopper", algo="td3", seed=0, victim=promised, epsilon=0.075, norm="inf", horizon=50)
    assert run.scale.adversaries[0].timing == "vulnerable"
    assert recipe == about | dict(c_vul=C_VUL) | asdict(run.scale.adversaries[0])
    assert len(contents(run.folder / "checkpoints" / "adversary-0")) == 2


def test_every_kind_of_member_is_trained_and_the_best_of_each_kind_is_stored(run):
    with pytest.raises(ValueError, match="the linear one is missing"):
        adversary_stages.train_member(run, 2)  # it begins as a copy of the linear one
    search_stages.search_linear(run)
    for member in range(4):
        adversary_stages.train_member(run, member)
    adversary_stages.choose(run)
    card, director = (manifest.read_json(run.folder / f"{name}.json", run.root) for name in ("adversary", "director"))
    assert len(card["learning_curves"]) == 3 + 1 and len(director["learning_curves"]) == 1
    assert all(isinstance(curve["selection"], float) for curve in card["learning_curves"])
    assert card["selection_mean"] == min(curve["selection"] for curve in card["learning_curves"])
    assert director["config"]["actor"] == [11, 32, 32, 3] and director["recipe"]["director"]
    threat = run.threat()
    for name in ("optimal", "director"):
        attack = threat.attack(name, run.victim(), HOPPER)
        episodes = rollout(run.victim(), HOPPER, range(2), attack=attack, steps=5)
        assert (episodes.perturbed != episodes.obs).any()


def test_an_adaptive_adversary_is_trained_chosen_and_evaluated(run):
    run = replace(run, scale=replace(run.scale, horizon=8))
    for name, model in ((f"denoiser-{MAIN}", make_gruvae(seed=1, residual=True)), ("detector-diverse", make_gruvae())):
        models.save_model("hopper", "td3", name, model, dict(data="diverse", threshold=1.5), run.root)
    adversary_stages.train_member(run, 0, defended=True)
    adversary_stages.train_member(run, 3, defended=True)
    search_stages.search_offset(run, defended=True)
    folder = run.folder / "checkpoints" / "defended-adversary-0"
    recipe = json.loads((folder / "recipe.json").read_text())
    assert recipe["defense"] == MAIN
    assert recipe["denoiser"] == manifest.promised(run.folder / f"denoiser-{MAIN}.safetensors", run.root)
    with pytest.raises(ValueError, match="no snapshot of an adversary"):
        adversary_stages.choose(run)  # the trained one is for the defended victim
    adversary_stages.choose(run, defended=True)
    card = manifest.read_json(run.folder / "adversary-adaptive.json", run.root)
    n = len(card["learning_curves"][0]["mean"])
    assert card["defense"] == MAIN and n == 2
    attack = OptimalAttack(run.threat().adversaries["adaptive-optimal"], run.budget)
    first, episodes = card["selection_seeds"]
    played = [
        rollout(run.victim(), HOPPER, range(first, first + episodes), defense=run.defense(MAIN), steps=8, **attacked)
        for attacked in (dict(), dict(attack=attack), dict(attack=attack, timing=Vulnerable(run.victim(), C_VUL)))
    ]
    clean, *struck = (float(each.returns.mean()) for each in played)
    assert card["clean_mean"] == pytest.approx(clean) and card["selection_mean"] == pytest.approx(sum(struck) / 2)
    evaluation.adapt(run)
    made = sorted(path.name for path in (run.root / "results").iterdir())
    assert made == sorted(f"hopper-td3.{attack}.always.{MAIN}.json" for attack in catalogue.ADAPTIVE)


def test_a_linear_adversary_is_searched_and_stored(run):
    search_stages.search_linear(run)
    shipped = models.load_adversary("hopper", "td3", "linear", run.root)
    assert shipped.config["actor"] == [11, 11] and (shipped.obs_std != 1).any()
    card = manifest.read_json(run.folder / "adversary-linear.json", run.root)
    assert card["step"] in (1, 2) and card["recipe"]["population"] == 8
    before = (run.folder / "adversary-linear.safetensors").read_bytes()
    shutil.rmtree(run.folder / "checkpoints")
    search_stages.search_linear(run)
    assert (run.folder / "adversary-linear.safetensors").read_bytes() == before


def test_an_offset_is_searched_and_stored_as_an_adversary_that_ignores_what_it_sees(run):
    search_stages.search_offset(run)
    shipped = models.load_adversary("hopper", "td3", "offset", run.root)
    assert (shipped(normal(3, 11)) == shipped(normal(3, 11, seed=1))).all()
    attack = run.threat().attack("offset", run.victim(), HOPPER)
    episodes = rollout(run.victim(), HOPPER, range(3), attack=attack, steps=5)
    moved = (episodes.perturbed - episodes.obs)[episodes.mask]
    assert np.allclose(np.abs(moved), 0.075, atol=1e-5) and np.ptp(moved, axis=0).max() < 1e-5
    before = (run.folder / "adversary-offset.safetensors").read_bytes()
    shutil.rmtree(run.folder / "checkpoints")
    search_stages.search_offset(run)
    assert (run.folder / "adversary-offset.safetensors").read_bytes() == before
