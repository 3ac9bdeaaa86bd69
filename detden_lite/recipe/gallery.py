"""The recipe's stages that make what is looked at: films, stills and recordings of single episodes.

They need a GL driver, and the modules that they import on their way need rerun and ffmpeg.
"""

from collections.abc import Sequence

import numpy as np

from detden_lite.attacks import catalogue
from detden_lite.attacks.adaptive import StealthyAttack
from detden_lite.attacks.catalogue import TITLES
from detden_lite.attacks.timing import After
from detden_lite.core.types import Episodes
from detden_lite.defense.variants import MAIN
from detden_lite.looking.robot import Robot
from detden_lite.recipe import episode_seeds
from detden_lite.recipe.run import Run
from detden_lite.simulation.rollout import rollout


def film_opposite(run: Run, variant: str = MAIN, n: int = 16) -> None:
    """A recording, a film and stills of one report episode clean, attacked and defended.

    Of the first n report episodes it is the one whose attacked length is the median.
    """
    from detden_lite.looking import films, recordings

    victim, defense = run.victim(), run.defense(variant)
    attack = run.opposite(victim)
    takes = {
        name: rollout(victim, run.task, episode_seeds.seeds("report", n), steps=run.scale.horizon, **parts)
        for name, parts in dict(
            clean={}, attacked=dict(attack=attack), defended=dict(attack=attack, defense=defense)
        ).items()
    }
    index = _middle(takes["attacked"].lengths)
    name, threshold = f"{run.folder.name}-opposite", defense.detector.threshold
    recordings.record(run.root / "recordings" / f"{name}.rrd", run.task, *takes.values(), index, threshold=threshold)
    folder = run.root / "films"
    films.film(folder / f"{name}.mp4", run.task, takes, index)
    films.still(folder / f"{name}.png", run.task, takes, index, seconds=2.0)
    films.filmstrip(folder / f"{name}-strip.png", run.task, takes, index, seconds=(0.3, 0.6, 0.9, 1.2, 2.0, 3.0))


def film_portrait(run: Run, n: int = 16) -> None:
    """A film and a still of one clean report episode: of the first n that with the median return."""
    from detden_lite.looking import films

    clean = rollout(run.victim(), run.task, episode_seeds.seeds("report", n), steps=run.scale.horizon)
    index = _middle(clean.returns)
    path = run.root / "films" / f"{run.folder.name}-clean"
    films.film(path.with_suffix(".mp4"), run.task, dict(clean=clean), index, seconds=6.0)
    films.still(path.with_suffix(".png"), run.task, dict(clean=clean), index, seconds=2.0)


def film_attacks(
    run: Run,
    attacks: Sequence[str] = catalogue.FOUR,
    variant: str = MAIN,
    n: int = 8,
    begin: int = 125,
    steps: int = 500,
) -> None:
    """One report episode clean and under each attack, in one film; and for each attack a recording with a still.

    The attacks begin when the robot is on its way. Of the first n report episodes it is the one that lives for the
    median number of steps, summed over the attacks. ``film_opposite`` records the opposite attack.
    """
    from detden_lite.looking import films, recordings

    victim, defense, threat = run.victim(), run.defense(variant), run.threat()
    steps = min(steps, run.scale.horizon)
    begin = min(begin, steps // 2)

    def play(name: str, seeds: Sequence[int], **defended) -> Episodes:
        attack = threat.attack(name, victim, run.task)
        return rollout(victim, run.task, seeds, attack=attack, timing=After(begin), steps=steps, **defended)

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
        defended = play(name, seeds[index : index + 1], defense=defense)
        three = dict(clean=takes[TITLES["none"]], attacked=takes[TITLES[name]], defended=defended)
        recording = run.root / "recordings" / f"{run.folder.name}-{name}.rrd"
        recordings.record(recording, run.task, *three.values(), threshold=defense.detector.threshold)
        films.still(folder / f"{recording.stem}.png", run.task, three, seconds=seconds)


def film_stealthy(run: Run, begin: int = 125, steps: int = 300) -> None:
    """A recording with a still of the first report episode, attacked by one who stays under the threshold.

    The recording has it clean, under the opposite attack without a defence, and with the defence under the
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
    opposite = threat.attack("opposite", victim, run.task)
    played = dict(
        clean={}, attacked=dict(attack=opposite),
        defended=dict(attack=StealthyAttack(opposite, **threat.adaptive), defense=defense),
    )  # fmt: skip
    takes = {
        name: rollout(victim, run.task, episode_seeds.seeds("report", 1), timing=After(begin), steps=steps, **parts)
        for name, parts in played.items()
    }
    name = f"{run.folder.name}-stealthy"
    recordings.record(
        run.root / "recordings" / f"{name}.rrd", run.task, *takes.values(), threshold=defense.detector.threshold
    )
    end = takes["defended"].lengths[0]  # where it falls, or where the recording ends
    films.still(run.root / "films" / f"{name}.png", run.task, takes, seconds=(end - 1) * Robot.of(run.task).dt)


def _middle(values: np.ndarray) -> int:
    """Where the median is."""
    return int(np.argsort(values, kind="stable")[len(values) // 2])
