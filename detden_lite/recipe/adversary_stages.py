"""The stages that make a victim's learned adversaries: train a grid of them, and choose the strongest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from detden_lite.attacks.director import DirectorAttack
from detden_lite.attacks.optimal import OptimalAttack
from detden_lite.core.types import Attack, Timing
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import episode_seeds, selection
from detden_lite.recipe.linear_search import LinearRecipe
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models, tensors
from detden_lite.training import resumable
from detden_lite.training.adversary_recipe import AdversaryRecipe
from detden_lite.training.warm_start import imitate
from detden_lite.victims.victim import Victim

if TYPE_CHECKING:
    from sbx import PPO
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
    victim, threat, recipe = run.victim(), run.threat(), grid[member]

    def worlds(n: int) -> VecEnv:
        timing = threat.timing(recipe.timing, victim)
        defense = run.defense(MAIN) if defended else None
        director = DirectorAttack(None, victim, run.budget) if recipe.director else None
        return VecMonitor(
            AdversaryEnv(
                victim, run.task, run.budget, n, timing, defense, run.scale.horizon, recipe.history, director
            )
        )  # fmt: skip

    folder = run.folder / "checkpoints" / f"{_NAMES[defended]}-{member}"
    known: dict[str, object] = dict(c_vul=threat.c_vul) if recipe.timing == "vulnerable" else {}
    if defended:
        known |= dict(defense=MAIN, denoiser=manifest.promised(run.folder / f"denoiser-{MAIN}.safetensors", run.root))
    if recipe.warm:
        known |= dict(linear=tensors.digest(threat.adversary("linear").state_dict()))

    def copy_linear(model: PPO) -> None:
        linear, seeds = threat.adversary("linear"), episode_seeds.seeds("search", 16)
        attack = OptimalAttack(linear, run.budget)
        seen = rollout(victim, run.task, seeds, attack=attack, steps=run.scale.horizon)
        imitate(model, linear, seen.obs[seen.mask])

    prepare = copy_linear if recipe.warm else None
    resumable.train(run.task, recipe, member, folder, worlds, about(run) | known, prepare=prepare)


def choose(run: Run[Scale], defended: bool = False) -> None:
    """The stage: store the snapshots that leave the victim the smallest return, attacking always and where vulnerable.

    There are two: of those that perturb, among them the linear adversary's, and of the directors.

    Args:
        run: where.
        defended: whether the victim has its main defence, in training and choice.

    Raises:
        ValueError: if no member was trained.
    """
    folders = sorted((run.folder / "checkpoints").glob(f"{_NAMES[defended]}-*"))
    directors = [folder for folder in folders if selection.read_recipe(folder).get("director")]
    learned: dict[Path, type] = {folder: AdversaryRecipe for folder in folders if folder not in directors}
    linear = run.folder / "checkpoints" / "linear"
    if not defended and linear.exists():
        learned[linear] = LinearRecipe
    way, defense = ("adaptive-", run.defense(MAIN)) if defended else ("", None)
    store_best(run, f"{way}optimal", learned, ("always", "vulnerable"), defense)
    if directors:
        store_best(
            run, f"{way}director", dict.fromkeys(directors, AdversaryRecipe), ("always", "vulnerable"), defense
        )  # fmt: skip


def about(run: Run[Scale]) -> dict[str, object]:
    """Which victim the adversary learned to harm, and within which ball."""
    victim = manifest.promised(run.folder / "victim.safetensors", run.root)
    return dict(
        algo=run.algo, victim=victim, epsilon=run.budget.epsilon, norm=str(run.budget.norm), horizon=run.scale.horizon
    )


def store_best(
    run: Run[Scale],
    kind: str,
    folders: Mapping[Path, type],
    timings: Sequence[str],
    defense: DetectAndDenoise | None = None,
) -> None:
    """Store the adversary with the smallest mean return over timings, on episodes that nothing else uses.

    Records of another adversary of this kind are removed.

    Args:
        run: where.
        kind: of the adversary, a key of ``models.ADVERSARIES``.
        folders: of its trainings, each with the class of its recipe.
        timings: when it attacks.
        defense: of the victim.

    Raises:
        ValueError: if there is no snapshot.
    """
    folders = {folder: own for folder, own in folders.items() if any((folder / "snapshots").glob("*.safetensors"))}
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
        director = kind.endswith("director")
        attack = DirectorAttack(adversary, victim, run.budget) if director else OptimalAttack(adversary, run.budget)
        return float(np.mean([play(purpose, attack, threat.timing(name, victim)) for name in timings]))

    chosen = selection.choose(run.task, folders, mean, sign=-1, n=5)
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
