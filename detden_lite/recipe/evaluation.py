"""Running the cells of the tables, a record each."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict

import numpy as np

from detden_lite.attacks import catalogue
from detden_lite.attacks.enchanting import EnchantingAttack
from detden_lite.attacks.gradient import GradientAttack
from detden_lite.attacks.informed import InformedAttack
from detden_lite.attacks.threat import Threat
from detden_lite.attacks.timing import Random, Vulnerable
from detden_lite.core.metrics import summarize
from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.defense import variants
from detden_lite.defense.pipeline import DetectAndDenoise
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import ablations, episode_seeds
from detden_lite.recipe.run import Run
from detden_lite.results.cells import Cell, adaptive_cells, table_cells
from detden_lite.results.records import SCHEMA, EpisodeScores, Record
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest
from detden_lite.store.manifest import versions
from detden_lite.victims.victim import Victim


def run_cell(
    cell: Cell, task: Task, victim: Victim, threat: Threat, defense: DetectAndDenoise | None,
    episode_seeds: Sequence[int], steps: int | None = None, progress: str | None = None, clean: Episodes | None = None,
) -> tuple[Record, Episodes]:  # fmt: skip
    """Run a cell. Returns its record, and the episodes.

    Args:
        cell: the attack, the timing and the name of the defence.
        task: the victim's.
        victim: the policy under attack.
        threat: the attacker's settings.
        defense: the defence called ``cell.defense``; None for "none".
        episode_seeds: one an episode; the same for all cells of a table.
        steps: the longest an episode may be; the task's horizon by default.
        progress: text of a progress bar, None for no bar.
        clean: the episodes of the cell without an attack but with this defence, for the scores that need them.

    Raises:
        ValueError: if the cell says "none" and there is a defence, or the other way round, or its attack or timing does
            not exist.

    Example:
        >>> from detden_lite import Budget, get_task, load_victim
        >>> hopper, victim, threat = get_task("hopper"), load_victim("hopper", "td3"), Threat(Budget(0.075))
        >>> record, episodes = run_cell(Cell("uniform"), hopper, victim, threat, None, [1, 2], steps=5)
        >>> record.lengths, record.attack_rate, record.settings["epsilon"]
        ((5, 5), 1.0, 0.075)
    """
    if (defense is None) != (cell.defense == "none"):
        raise ValueError(f"defense: the cell says {cell.defense!r}, so give {'None' if defense is not None else 'one'}")
    attack, timing = threat.attack(cell.attack, victim, task), threat.timing(cell.timing, victim)
    start = time.perf_counter()
    episodes = rollout(
        victim, task, episode_seeds, attack=attack, timing=timing, defense=defense, steps=steps, progress=progress
    )
    settings: dict[str, object] = dict(epsilon=threat.budget.epsilon, norm=str(threat.budget.norm))
    if cell.attack in threat.learned:
        settings["learned"] = dict(threat.learned[cell.attack])
    if isinstance(attack, InformedAttack):
        settings["adaptive"] = attack.settings
        attack = attack.attack
    if isinstance(attack, GradientAttack):
        settings |= dict(steps=attack.steps, restarts=attack.restarts)
    if isinstance(attack, EnchantingAttack):
        planner = attack.planner
        settings |= dict(horizon=planner.horizon, population=planner.population, iterations=planner.iterations)
    if isinstance(timing, Vulnerable):
        settings["c_vul"] = timing.threshold
    if isinstance(timing, Random):
        settings["rate"] = timing.rate
    if defense is not None:
        threshold = defense.detector.threshold
        settings["c_anomaly"] = threshold if np.isfinite(threshold) else None  # JSON knows no infinity
        settings |= dict.fromkeys(defense.ablations, True)
    record = dict(
        schema=SCHEMA,
        task=task.name,
        cell=asdict(cell),
        settings=settings,
        seeds=[int(episode_seeds[0]), len(episode_seeds)],
        **summarize(episodes, clean),
        episodes={name: list(row) for name, row in vars(EpisodeScores.of(episodes)).items()},
        seconds=time.perf_counter() - start,
        versions=versions(),
    )
    return Record.from_json(record, cell.record_name(task.name, "record")), episodes


def evaluate(
    run: Run, defenses: Sequence[str] = ("none", MAIN), attacks: Sequence[str] = ("none", *catalogue.ATTACKS)
) -> None:
    """Every cell of the tables with these defences and attacks, a record each."""
    run_cells(run, [cell for cell in table_cells(defenses) if cell.attack in attacks], run.threat())


def adapt(run: Run, defenses: Sequence[str] = (MAIN,)) -> None:
    """The cells of the attacks that know these defences, a record each."""
    run_cells(run, [cell for defense in defenses for cell in adaptive_cells(defense)], run.threat())


def run_cells(run: Run, wanted: Iterable[Cell], threat: Threat) -> None:
    """Run these cells of the run's victim on the report's episodes, a record each; existing records are left alone."""
    victim = run.victim()
    unattacked: dict[str, Episodes] = {}  # of the defence at hand: what its attacked cells are compared with
    for cell in wanted:
        name = cell.record_name(run.task.name, run.algo)
        path = run.root / "results" / f"{name}.json"
        if manifest.is_made(path, run.root):
            continue
        defense = None if cell.defense == "none" else ablations.build_defense(run, cell.defense)
        seeds = episode_seeds.seeds("report", run.scale.episodes)
        slow = cell.attack != "none" and catalogue.CATALOGUE[cell.attack].slow
        if defense is not None and cell.attack != "none" and cell.defense not in unattacked:
            clean = rollout(victim, run.task, seeds, defense=defense, steps=run.scale.horizon)
            unattacked = {cell.defense: clean}
        record, episodes = run_cell(
            cell, run.task, victim, threat, defense,
            seeds[: run.scale.planned_episodes] if slow else seeds,
            run.scale.horizon, progress=name, clean=unattacked.get(cell.defense),
        )  # fmt: skip
        if defense is not None and cell.attack == "none":
            unattacked = {cell.defense: episodes}
        manifest.write_json(path, record.to_json(), run.root)
        print(f"{name}: {record.estimate}")


def ablate(run: Run) -> None:
    """The cells of the defences that are assembled around the main one."""
    evaluate(run, tuple(variants.ASSEMBLED))


def explain(run: Run) -> None:
    """The cells of those assembled defences that show which part of the main defence falls short."""
    evaluate(run, variants.EXPLAINING)
