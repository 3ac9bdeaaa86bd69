"""The cells of the tables: which defence meets which attack when, and their records."""

from collections.abc import Iterable
from pathlib import Path

from detden_lite import ablations, artifacts, metrics, study
from detden_lite.rollout import Episodes, rollout
from detden_lite.runs import MAIN, VARIANTS, Run


def cells(defenses=("none", MAIN)) -> list[study.Cell]:
    """The cells of the tables, one defence after the other; "none" is the bare victim.

    The main defence meets all four attacks, the linear adversary and noise; other trained ones those of the four that
    need no planner; and assembled ones the opposite attack, which the denoiser has seen, and the optimal one, which it
    has not.
    """
    both = ("always", "vulnerable")
    found = []
    for name in defenses:
        found.append(study.Cell(defense=name))
        if name == "none":
            found += [study.Cell(attack) for attack in (*study.CONTROLS, "linear")]
            found += [study.Cell(attack, timing) for attack in study.FOUR for timing in both]
            found += [study.Cell("opposite", "random")]
        elif name in VARIANTS:
            attacks = study.FOUR if name == MAIN else ("opposite", "qfunction", "optimal")
            found += [study.Cell(attack, timing, name) for attack in attacks for timing in both]
            found += [study.Cell(attack, "always", name) for attack in ("linear", "uniform") if name == MAIN]
        else:
            found += [study.Cell(attack, "always", name) for attack in ("opposite", "optimal")]
    return found


RESIDUAL_OR_NOT = ("diverse", "residual")  # two variants that differ in the denoiser's residual output alone


def adaptive_cells(defense: str = MAIN) -> list[study.Cell]:
    """The cells of the attacks that know the defence: always, since who fears them asks for the worst.

    The main defence meets all of them, and the two of ``RESIDUAL_OR_NOT`` one: is a residual output a path?
    """
    attacks = dict.fromkeys(RESIDUAL_OR_NOT, ("adaptive-opposite",)) | {MAIN: study.ADAPTIVE}
    return [study.Cell(attack, "always", defense) for attack in attacks.get(defense, ())]


def load(
    wanted: Iterable[study.Cell], task: str, algo: str, root: Path = artifacts.DATA
) -> dict[tuple[str, str], dict]:
    """The records of a victim's cells that are there, by (attack, timing); the cells are of one defence.

    Raises:
        ArtifactError: if one of them is altered.
    """
    names = {(cell.attack, cell.timing): cell.record_name(task, algo) for cell in wanted}
    there = {cell: name for cell, name in names.items() if (root / "results" / f"{name}.json").exists()}
    return {cell: artifacts.load_record(name, root) for cell, name in there.items()}


def evaluate(run: Run, defenses=("none", MAIN), attacks=("none", *study.ATTACKS)) -> None:
    """Every cell of the tables with these defences and attacks, a record each."""
    run_cells(run, [cell for cell in cells(defenses) if cell.attack in attacks], run.threat())


def adapt(run: Run, defenses=(MAIN,)) -> None:
    """The cells of the attacks that know these defences, a record each."""
    run_cells(run, [cell for defense in defenses for cell in adaptive_cells(defense)], run.threat())


def run_cells(run: Run, wanted: Iterable[study.Cell], threat: study.Threat) -> None:
    """Run these cells of the run's victim on the report's episodes, a record each; what is there is left as it is."""
    victim = run.victim()
    unattacked: dict[str, Episodes] = {}  # of the defence at hand: what its attacked cells are compared with
    slow = ("enchanting", *study.ADAPTIVE)
    for cell in wanted:
        name = cell.record_name(run.task.name, run.algo)
        path = run.root / "results" / f"{name}.json"
        if artifacts.is_made(path, run.root):
            continue
        defense = None if cell.defense == "none" else ablations.load(run, cell.defense)
        seeds = study.seeds("report", run.scale.episodes)
        if defense is not None and cell.attack != "none" and cell.defense not in unattacked:
            clean = rollout(victim, run.task, seeds, defense=defense, steps=run.scale.horizon)
            unattacked = {cell.defense: clean}
        record, episodes = study.run_cell(
            cell, run.task, victim, threat, defense,
            seeds[: run.scale.planned_episodes] if cell.attack in slow else seeds,
            run.scale.horizon, progress=name, clean=unattacked.get(cell.defense),
        )  # fmt: skip
        if defense is not None and cell.attack == "none":
            unattacked = {cell.defense: episodes}
        artifacts.write_json(path, record, run.root)
        print(f"{name}: {metrics.Estimate(**record['estimate'])}")


def ablate(run: Run) -> None:
    """The cells of the defences that are assembled around the main one."""
    evaluate(run, tuple(ablations.ASSEMBLED))


def explain(run: Run) -> None:
    """Of those, the cells that tell which part of the main defence falls short."""
    evaluate(run, ablations.EXPLAINING)
