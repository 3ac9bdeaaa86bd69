"""The stages that search for the cheapest adversaries, with the victim as a black box: a linear map, and an offset."""

from __future__ import annotations

import torch
from torch import Tensor

from detden_lite.attacks.held import OffsetAttack
from detden_lite.attacks.optimal import OptimalAttack
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
    recipe, victim, normal = run.scale.linear, run.victim(), 8
    clean = rollout(victim, run.task, episode_seeds.seeds("search", normal), steps=run.scale.horizon)
    played = episode_seeds.seeds("search", normal + recipe.generations * recipe.episodes)[normal:]

    def measure(adversaries: LinearMaps, generation: int) -> Tensor:
        k = recipe.episodes
        rows = LinearMaps(adversaries.normalizer, adversaries.maps.repeat_interleave(k, 0))
        attack = OptimalAttack(rows, run.budget)
        return _left(run, victim, attack, len(adversaries.maps), played[generation * k : (generation + 1) * k])

    folder = run.folder / "checkpoints" / "linear"
    linear_search.search(recipe, run.task, seed, folder, clean.obs[clean.mask], measure, about(run))
    store_best(run, "linear", {folder: LinearRecipe}, ("always",))


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
        return _left(run, victim, attack, len(offsets), episodes, defense)

    name, known = ("defended-offset", dict(defense=MAIN)) if defended else ("offset", {})
    folder = run.folder / "checkpoints" / name
    offset_search.search(run.scale.offset, run.task, seed, folder, measure, run.budget.norm, about(run) | known)
    store_best(run, "adaptive-offset" if defended else "offset", {folder: OffsetRecipe}, ("always",), defense)


def _left(
    run: Run[Scale], victim: Victim, attack: Attack, n: int, seeds: range, defense: Defense | None = None
) -> Tensor:
    """The mean return against each of n candidates, ``[n]``, which all play the same episodes.

    The attack has a row for each episode of the first candidate, then of the second, and so on.
    """
    played = rollout(victim, run.task, [*seeds] * n, attack=attack, defense=defense, steps=run.scale.horizon)
    return torch.from_numpy(played.returns.reshape(n, len(seeds)).mean(1))
