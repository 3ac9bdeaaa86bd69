"""Running the cells of the tables, a record each."""

import time
from collections.abc import Iterable
from dataclasses import asdict

import numpy as np

from detden_lite.attacks import catalogue
from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.gradient import GradientAttack
from detden_lite.attacks.informed import InformedAttack
from detden_lite.attacks.threat import Threat
from detden_lite.core import estimates
from detden_lite.core.metrics import summarize
from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.defense import variants
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import ablations, episode_seeds
from detden_lite.recipe.run import Run
from detden_lite.results.cells import Cell, adaptive_cells, table_cells
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest
from detden_lite.store.manifest import versions
from detden_lite.victims.victim import Victim


def run_cell(
    cell: Cell, task: Task, victim: Victim, threat: Threat, defense, episode_seeds, steps: int | None = None,
    progress: str | None = None, clean: Episodes | None = None,
) -> tuple[dict, Episodes]:  # fmt: skip
    """Run a cell. Returns its record, ready for JSON, and the episodes.

    Args:
        cell: what to run.
        task: where.
        victim: whom.
        threat: the attacker's settings.
        defense: the defence called ``cell.defense``; None for "none".
        episode_seeds: one an episode; the same for all cells of a table.
        steps: the longest an episode may be; the task's horizon by default.
        progress: text of a progress bar, None for no bar.
        clean: the episodes of the cell without an attack but with this defence, for the scores that need them.
    """
    if (defense is None) != (cell.defense == "none"):
        raise ValueError(f"defense: the cell says {cell.defense!r}, so give {'None' if defense is not None else 'one'}")
    attack, timing = threat.attack(cell.attack, victim, task), threat.timing(cell.timing, victim)
    start = time.perf_counter()
    episodes = rollout(
        victim, task, episode_seeds, attack=attack, timing=timing, defense=defense, steps=steps, progress=progress
    )
    settings = dict(epsilon=threat.budget.epsilon, norm=str(threat.budget.norm))
    if isinstance(attack, InformedAttack):
        settings["adaptive"] = attack.settings
        attack = attack.attack
    if isinstance(attack, GradientAttack):
        settings |= dict(steps=attack.steps, restarts=attack.restarts)
    if isinstance(attack, EnchantingAttack):
        planner = attack.planner
        settings |= dict(horizon=planner.horizon, population=planner.population, iterations=planner.iterations)
    if cell.timing == "vulnerable":
        settings["c_vul"] = threat.c_vul
    if cell.timing == "random":
        settings["rate"] = threat.rate
    if defense is not None:
        threshold = defense.detector.threshold
        settings["c_anomaly"] = threshold if np.isfinite(threshold) else None  # JSON knows no infinity
        settings |= dict.fromkeys(defense.ablations, True)
    record = dict(
        task=task.name,
        cell=asdict(cell),
        settings=settings,
        seeds=[int(episode_seeds[0]), len(episode_seeds)],
        **summarize(episodes, clean),
        seconds=time.perf_counter() - start,
        versions=versions(),
    )
    return record, episodes


def evaluate(run: Run, defenses=("none", MAIN), attacks=("none", *catalogue.ATTACKS)) -> None:
    """Every cell of the tables with these defences and attacks, a record each."""
    run_cells(run, [cell for cell in table_cells(defenses) if cell.attack in attacks], run.threat())


def adapt(run: Run, defenses=(MAIN,)) -> None:
    """The cells of the attacks that know these defences, a record each."""
    run_cells(run, [cell for defense in defenses for cell in adaptive_cells(defense)], run.threat())


def run_cells(run: Run, wanted: Iterable[Cell], threat: Threat) -> None:
    """Run these cells of the run's victim on the report's episodes, a record each; what is there is left as it is."""
    victim = run.victim()
    unattacked: dict[str, Episodes] = {}  # of the defence at hand: what its attacked cells are compared with
    slow = ("enchanting", *catalogue.ADAPTIVE)
    for cell in wanted:
        name = cell.record_name(run.task.name, run.algo)
        path = run.root / "results" / f"{name}.json"
        if manifest.is_made(path, run.root):
            continue
        defense = None if cell.defense == "none" else ablations.build_defense(run, cell.defense)
        seeds = episode_seeds.seeds("report", run.scale.episodes)
        if defense is not None and cell.attack != "none" and cell.defense not in unattacked:
            clean = rollout(victim, run.task, seeds, defense=defense, steps=run.scale.horizon)
            unattacked = {cell.defense: clean}
        record, episodes = run_cell(
            cell, run.task, victim, threat, defense,
            seeds[: run.scale.planned_episodes] if cell.attack in slow else seeds,
            run.scale.horizon, progress=name, clean=unattacked.get(cell.defense),
        )  # fmt: skip
        if defense is not None and cell.attack == "none":
            unattacked = {cell.defense: episodes}
        manifest.write_json(path, record, run.root)
        print(f"{name}: {estimates.Estimate(**record['estimate'])}")


def ablate(run: Run) -> None:
    """The cells of the defences that are assembled around the main one."""
    evaluate(run, tuple(variants.ASSEMBLED))


def explain(run: Run) -> None:
    """Of those, the cells that tell which part of the main defence falls short."""
    evaluate(run, variants.EXPLAINING)
