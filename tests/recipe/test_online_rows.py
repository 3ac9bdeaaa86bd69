"""The rows of policies that are trained online: how they are chosen, and what their cards tell."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import HOPPER
from safetensors.torch import load_file, save_file

from detden_lite.core.tasks import ONLINE
from detden_lite.recipe import victim_stages
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import VICTIMS, get_scale
from detden_lite.results import victim_cards
from detden_lite.simulation.rollout import rollout
from detden_lite.store import models, tensors
from detden_lite.training.online_recipes import OnlineRecipe
from detden_lite.training.progress import record_progress
from detden_lite.victims.victim import Victim

STEPS = (256, 512, 768, 1_024)


def add_training(run: Run, seed: int) -> list[Path]:
    """The folder of a finished training, with random snapshots and what the training went through."""
    folder = run.folder / "checkpoints" / f"victim-{seed}"
    (folder / "snapshots").mkdir(parents=True)
    recipe = run.scale.victim
    (folder / "recipe.json").write_text(json.dumps(dict(task="hopper", seed=seed, epsilon=0.075, **asdict(recipe))))
    for k, end in enumerate(STEPS):
        torch.manual_seed(10 * seed + k)
        victim = Victim(**recipe.config(HOPPER))
        victim.actor[-1].weight.mul_(5)
        save_file(victim.state_dict(), folder / "snapshots" / f"{end:08d}.safetensors")
        entry = dict(steps=256, episodes=4, falls=3, seconds=2.0, cpu_seconds=1.0)
        record_progress(folder, end, entry | dict(adversary=dict(steps=256, episodes=2, falls=1)))
    return sorted((folder / "snapshots").iterdir())


@pytest.fixture
def run(tmp_path) -> Run:
    return Run.of(tmp_path, "hopper", "atla", "tiny")


def test_the_most_robust_grown_up_snapshot_is_chosen(run):
    """By the mean of clean and attacked episodes, among those of the last part of each training."""
    paths = [*add_training(run, 0), *add_training(run, 1)]
    victim_stages.select_victim(run)

    def played(path: Path, purpose: str) -> list[float]:
        victim = Victim.from_state(run.scale.victim.config(HOPPER), load_file(path))
        episodes = seeds(purpose, 5 if purpose == "screening" else run.scale.episodes)
        return [
            float(rollout(victim, HOPPER, episodes, attack=attack, steps=50).returns.mean())
            for attack in (None, run.opposite(victim))
        ]

    screened = [played(path, "screening") for path in paths]
    grown = [path for path in paths if int(path.stem) > 512]  # half of the training, at this scale
    best = max(grown, key=lambda path: np.mean(played(path, "selection")))
    shipped = models.load_victim("hopper", "atla", run.root)
    assert tensors.digest(shipped.state_dict()) == tensors.digest(load_file(best))
    card = json.loads((run.folder / "victim.json").read_text())
    curves = card["learning_curves"]
    assert [curve["seed"] for curve in curves] == [0, 1] and curves[0]["steps"] == list(STEPS)
    for i, name in enumerate(("mean", "attacked")):
        assert [x for curve in curves for x in curve[name]] == pytest.approx([pair[i] for pair in screened])
    assert card["recipe"]["epsilon"] == 0.075


def test_the_card_tells_what_every_training_went_through(run):
    add_training(run, 0)
    add_training(run, 1)
    victim_stages.select_victim(run)
    card = victim_cards.load_card("hopper", "atla", run.root)
    assert card.title == "Hopper, ATLA-PPO" and [told["seed"] for told in card.training] == [0, 1]
    for told in card.training:
        assert told["end"] == list(STEPS) and told["falls"] == [3] * 4
        assert told["attacked_steps"] == [512] * 4 and told["attacked_falls"] == [4] * 4
        assert sum(told["cpu_seconds"]) == 4


def test_a_training_that_is_not_grown_up_is_not_chosen_from(run):
    for path in add_training(run, 0)[2:]:
        path.unlink()
    with pytest.raises(Exception, match="no snapshot to choose"):
        victim_stages.select_victim(run)


def test_every_row_is_trained_as_the_ppo_victim_of_its_task():
    """In what both have, apart from steps and segments."""
    for (task, algo), recipe in VICTIMS.items():
        if algo in ONLINE:
            ppo = vars(VICTIMS[task, "ppo"])
            same = {key: vars(recipe)[key] for key in ppo} | dict(steps=ppo["steps"], segment=ppo["segment"])
            assert same == ppo, (task, algo)
            assert isinstance(recipe, OnlineRecipe) == (algo != "vanilla")
            assert getattr(recipe, "normalized", False) == algo.startswith("z")
    assert VICTIMS["hopper", "zsappo"] == replace(VICTIMS["hopper", "sappo"], normalized=True)


@pytest.mark.parametrize("algo", ONLINE)
def test_every_way_to_train_has_a_tiny_scale(algo):
    assert get_scale("tiny", HOPPER, algo).victim.config(HOPPER)["gaussian"]
