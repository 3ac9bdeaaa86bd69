"""The stages that search for the cheapest adversaries, with the victim as a black box: a linear map, and an offset."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from detden_lite.attacks.held import OffsetAttack
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task
from detden_lite.core.types import Attack, Defense
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import episode_seeds, linear_search, offset_search
from detden_lite.recipe.adversary_stages import about, store_best
from detden_lite.recipe.linear_search import LinearMaps, LinearRecipe
from detden_lite.recipe.offset_search import OffsetRecipe
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim


def search_linear(run: Run[Scale], seed: int = 0) -> None:
    """The stage: search for a linear adversary, and store the generation's mean that leaves the smallest return.

    Args:
        run: where.
        seed: of the search.
    """
    folder = run.folder / "checkpoints" / "linear"
    search_maps(run.scale.linear, run.task, run.victim(), run.budget, folder, run.scale.horizon, about(run), seed)
    store_best(run, "linear", {folder: LinearRecipe}, ("always",))


def search_maps(
    recipe: LinearRecipe, task: Task, victim: Victim, budget: Budget, folder: Path, steps: int | None,
    about: Mapping[str, object], seed: int = 0,
) -> list[Path]:  # fmt: skip
    """Search for a linear adversary of a bare victim; see ``linear_search.search`` for what it returns."""
    normal, k = 8, recipe.episodes
    clean = rollout(victim, task, episode_seeds.seeds("search", normal), steps=steps)
    played = episode_seeds.seeds("search", normal + recipe.generations * k)[normal:]

    def measure(adversaries: LinearMaps, generation: int) -> Tensor:
        return returns_under(adversaries, victim, task, budget, played[generation * k : (generation + 1) * k], steps)

    return linear_search.search(recipe, task, seed, folder, clean.obs[clean.mask], measure, about)


def returns_under(
    adversaries: LinearMaps, victim: Victim, task: Task, budget: Budget, seeds: range, steps: int | None
) -> Tensor:
    """The mean return against each of n linear adversaries, ``[n]``."""
    rows = LinearMaps(adversaries.normalizer, adversaries.maps.repeat_interleave(len(seeds), 0))
    return _left(victim, task, OptimalAttack(rows, budget), len(adversaries.maps), seeds, steps)


def search_offset(run: Run[Scale], seed: int = 0, defended: bool = False) -> None:
    """The stage: search for the offset that leaves the smallest return when it is held, and store it.

    Args:
        run: where.
        seed: of the search.
        defended: whether the victim has its main defence during the search.
    """
    victim, defense = run.victim(), run.defense(MAIN) if defended else None

    def measure(offsets: Tensor, numbers: range) -> Tensor:
        episodes = episode_seeds.seeds("search", numbers.stop)[numbers.start :]
        attack = OffsetAttack(offsets.repeat_interleave(len(episodes), 0), run.budget)
        return _left(victim, run.task, attack, len(offsets), episodes, run.scale.horizon, defense)

    name, known = ("defended-offset", dict(defense=MAIN)) if defended else ("offset", {})
    folder = run.folder / "checkpoints" / name
    offset_search.search(run.scale.offset, run.task, seed, folder, measure, run.budget.norm, about(run) | known)
    store_best(run, "adaptive-offset" if defended else "offset", {folder: OffsetRecipe}, ("always",), defense)


def _left(
    victim: Victim, task: Task, attack: Attack, n: int, seeds: range, steps: int | None, defense: Defense | None = None
) -> Tensor:
    """The mean return against each of n candidates, ``[n]``, which all play the same episodes.

    The attack has a row for each episode of the first candidate, then of the second, and so on.
    """
    played = rollout(victim, task, [*seeds] * n, attack=attack, defense=defense, steps=steps)
    return torch.from_numpy(played.returns.reshape(n, len(seeds)).mean(1))
