"""The stages that make a victim's adversaries: train a grid of them, search for a linear one, and choose."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.core.types import Attack, Timing
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import episode_seeds, linear_search, selection
from detden_lite.recipe.linear_search import LinearMaps, LinearRecipe
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models, tensors
from detden_lite.training import resumable
from detden_lite.training.recipes import AdversaryRecipe
from detden_lite.victims.victim import Victim

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

SCREENING, SELECTION = 5, 32  # episodes of each snapshot

_NAMES = {False: "adversary", True: "defended-adversary"}  # of the checkpoints' folders


def train_member(run: Run[Scale], member: int, defended: bool = False) -> None:
    """The stage: train one member of the grid by PPO; its snapshots are stored in the run's checkpoints.

    Args:
        run: where.
        member: its place in the grid.
        defended: whether the victim has its main defence during the training: the optimal adaptive attack (appendix B).

    Raises:
        ValueError: if the grid has no such member.
    """
    from stable_baselines3.common.vec_env import VecMonitor

    from detden_lite.training.adversary_world import AdversaryEnv

    grid = run.scale.adversaries
    if not 0 <= member < len(grid):
        raise ValueError(f"member must be between 0 and {len(grid) - 1} at this scale, not {member}")
    victim, threat = run.victim(), run.threat()

    def worlds(n: int) -> VecEnv:
        timing = threat.timing(grid[member].timing, victim)
        defense = run.defense(MAIN) if defended else None
        return VecMonitor(AdversaryEnv(victim, run.task, run.budget, n, timing, defense, run.scale.horizon))

    folder = run.folder / "checkpoints" / f"{_NAMES[defended]}-{member}"
    about: dict[str, object] = dict(c_vul=threat.c_vul) if grid[member].timing == "vulnerable" else {}
    if defended:
        about |= dict(defense=MAIN, denoiser=manifest.promised(run.folder / f"denoiser-{MAIN}.safetensors", run.root))
    resumable.train(run.task, grid[member], member, folder, worlds, _about(run) | about)


def choose(run: Run[Scale], defended: bool = False) -> None:
    """The stage: store the snapshot that leaves the victim the smallest return, attacking always and where vulnerable.

    Args:
        run: where.
        defended: whether the victim has its main defence, in training and choice.

    Raises:
        ValueError: if no member was trained.
    """
    folders = sorted((run.folder / "checkpoints").glob(f"{_NAMES[defended]}-*"))
    kind, defense = ("adaptive-optimal", run.defense(MAIN)) if defended else ("optimal", None)
    _store(run, kind, AdversaryRecipe, folders, ("always", "vulnerable"), defense)


def search_linear(run: Run[Scale], seed: int = 0) -> None:
    """The stage: search for a linear adversary, and store the generation's mean that leaves the smallest return.

    Args:
        run: where.
        seed: of the search.
    """
    recipe, victim, normal = run.scale.linear, run.victim(), 8
    clean = rollout(victim, run.task, episode_seeds.seeds("search", normal), steps=run.scale.horizon)
    played = episode_seeds.seeds("search", normal + recipe.generations * recipe.episodes)[normal:]

    def measure(adversaries: LinearMaps, generation: int) -> torch.Tensor:
        """All members of the population play the same episodes."""
        n, k = len(adversaries.maps), recipe.episodes
        rows = LinearMaps(adversaries.normalizer, adversaries.maps.repeat_interleave(k, 0))
        episodes = list(played[generation * k : (generation + 1) * k]) * n
        attacked = rollout(victim, run.task, episodes, attack=OptimalAttack(rows, run.budget), steps=run.scale.horizon)
        return torch.from_numpy(attacked.returns.reshape(n, k).mean(1))

    folder = run.folder / "checkpoints" / "linear"
    linear_search.search(recipe, run.task, seed, folder, clean.obs[clean.mask], measure, _about(run))
    _store(run, "linear", LinearRecipe, [folder], ("always",))


def _about(run: Run[Scale]) -> dict[str, object]:
    """Which victim the adversary learned to harm, and within which ball."""
    victim = manifest.promised(run.folder / "victim.safetensors", run.root)
    return dict(
        algo=run.algo, victim=victim, epsilon=run.budget.epsilon, norm=str(run.budget.norm), horizon=run.scale.horizon
    )


def _store(
    run: Run[Scale],
    kind: str,
    recipe: type,
    folders: Iterable[Path],
    timings: Sequence[str],
    defense: DetectAndDenoise | None = None,
) -> None:
    """Choose by the mean over timings, on episodes that nothing else uses. Records of another adversary are removed."""
    folders = [folder for folder in folders if any((folder / "snapshots").glob("*.safetensors"))]
    if not folders:
        where = run.folder / "checkpoints"
        raise ValueError(f"{where} holds no snapshot of an adversary; run the adversary stage first")
    victim, threat, n = run.victim(), run.threat(), min(SELECTION, run.scale.episodes)
    seeds = episode_seeds.seeds("adversary", SCREENING + n)
    episodes = dict(screening=seeds[:SCREENING], selection=seeds[SCREENING:])

    def play(purpose: str, attack: Attack | None = None, timing: Timing | None = None) -> np.ndarray:
        return rollout(
            victim, run.task, episodes[purpose], attack=attack, timing=timing, defense=defense, steps=run.scale.horizon
        ).returns

    def mean(adversary: Victim, purpose: str) -> float:
        attack = OptimalAttack(adversary, run.budget)
        return float(np.mean([play(purpose, attack, threat.timing(name, victim)) for name in timings]))

    chosen = selection.choose(run.task, recipe, folders, mean, sign=-1, n=5)
    sidecar = dict(
        task=run.task.name,
        algo=run.algo,
        defense="none" if defense is None else MAIN,
        recipe=chosen.recipe,
        step=chosen.step,
        timings=list(timings),
        selection_mean=chosen.selection,
        clean_mean=float(play("selection").mean()),
        selection_seeds=[episodes["selection"][0], n],
        learning_curves=chosen.curves,
    )
    path = models.adversary_path(run.task.name, run.algo, kind, run.root)
    if manifest.promised(path, run.root) not in (None, tensors.digest(chosen.policy.state_dict())):
        for record in (run.root / "results").glob(f"{run.folder.name}.{kind}.*"):
            record.unlink()
    models.save_adversary(run.task.name, run.algo, kind, chosen.policy, sidecar, run.root)
