"""The recipe's stages that make films, stills and recordings of single episodes.

They need a GL driver, and the modules that they import when they run need rerun and ffmpeg.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from detden_lite.attacks import catalogue
from detden_lite.attacks.adaptive import StealthyAttack
from detden_lite.attacks.catalogue import TITLES
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.timing import After
from detden_lite.core.types import Attack, Defense, Episodes
from detden_lite.defense.variants import MAIN
from detden_lite.looking.robot import Robot
from detden_lite.recipe import episode_seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.scales import Scale
from detden_lite.simulation.rollout import rollout


def film_opposite(run: Run[Scale], variant: str = MAIN, n: int = 16) -> None:
    """The stage: a recording, a film and stills of one report episode clean, attacked and defended.

    Args:
        run: where.
        variant: of the defence, a key of ``VARIANTS``.
        n: of the first n report episodes, the one with the median length under the attack is shown.
    """
    from detden_lite.looking import films, recordings

    victim, defense = run.victim(), run.defense(variant)
    attack = run.opposite(victim)

    def play(attack: Attack | None = None, defense: Defense | None = None) -> Episodes:
        seeds = episode_seeds.seeds("report", n)
        return rollout(victim, run.task, seeds, attack=attack, defense=defense, steps=run.scale.horizon)

    takes = dict(clean=play(), attacked=play(attack), defended=play(attack, defense))
    index = _middle(takes["attacked"].lengths)
    name = f"{run.folder.name}-opposite"
    recordings.record(
        run.root / "recordings" / f"{name}.rrd", run.task, takes["clean"], takes["attacked"], takes["defended"], index,
        threshold=defense.detector.threshold,
    )  # fmt: skip
    folder = run.root / "films"
    films.film(folder / f"{name}.mp4", run.task, takes, index)
    films.still(folder / f"{name}.png", run.task, takes, index, seconds=2.0)
    films.filmstrip(folder / f"{name}-strip.png", run.task, takes, index, seconds=(0.3, 0.6, 0.9, 1.2, 2.0, 3.0))


def film_portrait(run: Run[Scale], n: int = 16) -> None:
    """The stage: a film and a still of one clean report episode.

    Args:
        run: where.
        n: of the first n report episodes, the one with the median return is shown.
    """
    from detden_lite.looking import films

    clean = rollout(run.victim(), run.task, episode_seeds.seeds("report", n), steps=run.scale.horizon)
    index = _middle(clean.returns)
    path = run.root / "films" / f"{run.folder.name}-clean"
    films.film(path.with_suffix(".mp4"), run.task, dict(clean=clean), index, seconds=6.0)
    films.still(path.with_suffix(".png"), run.task, dict(clean=clean), index, seconds=2.0)


def film_attacks(
    run: Run[Scale],
    attacks: Sequence[str] = catalogue.FOUR,
    variant: str = MAIN,
    n: int = 8,
    begin: int = 125,
    steps: int = 500,
) -> None:
    """The stage: one report episode clean and under each attack in one film; for each attack a recording with a still.

    ``film_opposite`` records the opposite attack.

    Args:
        run: where.
        attacks: of the catalogue.
        variant: of the defence in the recordings, a key of ``VARIANTS``.
        n: of the first n report episodes, the one with the median length, summed over the attacks, is shown.
        begin: the first step that is attacked, when the robot is already walking.
        steps: the longest an episode may be.
    """
    from detden_lite.looking import films, recordings

    victim, defense, threat = run.victim(), run.defense(variant), run.threat()
    steps = min(steps, run.scale.horizon)
    begin = min(begin, steps // 2)

    def play(name: str, seeds: Sequence[int], defense: Defense | None = None) -> Episodes:
        attack = threat.attack(name, victim, run.task)
        return rollout(victim, run.task, seeds, attack=attack, timing=After(begin), defense=defense, steps=steps)

    seeds = episode_seeds.seeds("report", n)
    played = {name: play(name, seeds) for name in ("none", *attacks)}
    index = _middle(np.sum([take.lengths for take in played.values()], axis=0))
    takes = {TITLES[name]: take.select([index]) for name, take in played.items()}
    seconds = (begin + 32) * Robot.of(run.task).dt  # the still's: the fastest attacks take about so many steps
    folder, stem = run.root / "films", f"{run.folder.name}-attacks"
    films.film(folder / f"{stem}.mp4", run.task, takes, width=220, speed=0.5)
    films.still(folder / f"{stem}.png", run.task, takes, seconds=seconds, width=220)
    for name in attacks:
        if name == "opposite":
            continue
        clean, attacked = takes[TITLES["none"]], takes[TITLES[name]]
        defended = play(name, seeds[index : index + 1], defense)
        three = dict(clean=clean, attacked=attacked, defended=defended)
        recording = run.root / "recordings" / f"{run.folder.name}-{name}.rrd"
        threshold = defense.detector.threshold
        recordings.record(recording, run.task, clean, attacked, defended, threshold=threshold)
        films.still(folder / f"{recording.stem}.png", run.task, three, seconds=seconds)


def film_stealthy(run: Run[Scale], begin: int = 125, steps: int = 300) -> None:
    """The stage: a recording with a still of the first report episode under an attack that stays below the threshold.

    The recording has the episode clean, under the opposite attack without a defence, and with the defence under the
    ``StealthyAttack``.

    Args:
        run: where.
        begin: the first step that is attacked.
        steps: the longest an episode may be.
    """
    from detden_lite.looking import films, recordings

    victim, defense, threat = run.victim(), run.defense(MAIN), run.threat()
    steps = min(steps, run.scale.horizon)
    begin = min(begin, steps // 2)
    opposite = OppositeAttack(victim, threat.budget, threat.steps, threat.restarts)

    def play(attack: Attack | None = None, defense: Defense | None = None) -> Episodes:
        seeds = episode_seeds.seeds("report", 1)
        return rollout(victim, run.task, seeds, attack=attack, timing=After(begin), defense=defense, steps=steps)

    settings: dict[str, Any] = dict(threat.adaptive)
    stealthy = StealthyAttack(opposite, **settings)
    takes = dict(clean=play(), attacked=play(opposite), defended=play(stealthy, defense))
    name = f"{run.folder.name}-stealthy"
    recordings.record(
        run.root / "recordings" / f"{name}.rrd", run.task, takes["clean"], takes["attacked"], takes["defended"],
        threshold=defense.detector.threshold,
    )  # fmt: skip
    end = takes["defended"].lengths[0]  # where it falls, or where the recording ends
    films.still(run.root / "films" / f"{name}.png", run.task, takes, seconds=(end - 1) * Robot.of(run.task).dt)


def _middle(values: np.ndarray) -> int:
    """The position of the median."""
    return int(np.argsort(values, kind="stable")[len(values) // 2])
