"""What attackers who know the defence leave: their records, beside those of the attacks that do not know it (Q5)."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from detden_lite import artifacts, evaluation, kept
from detden_lite.attacked import NAMES, failed
from detden_lite.kept import Share
from detden_lite.runs import MAIN

ROWS = (("hopper", "td3"), ("halfcheetah", "td3"), ("hopper", "ppo"), ("halfcheetah", "ppo"))  # that are adapted to
_FORMS = dict(
    text="{}, as in section 4.4", appendix="{}, as in appendix B", adaptive="{}, adaptive", coupled="{}, drifting",
)  # fmt: skip


@dataclass(frozen=True)
class Comparison:
    """An adaptive attack beside the attack that does not know the defence, on the same defended victim."""

    attack: str  # one of ``study.ADAPTIVE``
    unaware: str  # one of ``study.FOUR``
    record: Mapping  # of the adaptive attack
    change: Share | None  # of the return, by knowing the defence; None if the unaware one leaves no return at all
    failed: bool  # it leaves more than the unaware one, beyond chance: see ``attacked.failed``


def unaware(attack: str) -> str:
    """The attack that an adaptive one is made of: "opposite" for "text-opposite"."""
    return attack.split("-")[1]


def name(attack: str) -> str:
    """How the book calls an adaptive attack: "Q-function, adaptive"."""
    return _FORMS[attack.split("-")[0]].format(NAMES[unaware(attack)])


def load(task: str, algo: str, defense: str = MAIN, root: Path = artifacts.DATA) -> dict[tuple[str, str], dict]:
    """The records of the adaptive attacks on a victim with this defence that are there, by (attack, "always").

    Raises:
        ArtifactError: if one of them is altered.
    """
    return evaluation.load(evaluation.adaptive_cells(defense), task, algo, root)


def change(adaptive: Mapping, plain: Mapping) -> Share | None:
    """By which part of it an attack's return changes if the attacker knows the defence, as table 4 of the paper has it.

    Both are of the same episodes, and the interval's episodes are drawn with both of their returns.

    Args:
        adaptive: the record of the attack that knows the defence.
        plain: the record of the one that does not; None comes back if its mean return is not above 0.

    Raises:
        ValueError: if the two do not begin with the same episode.
    """
    if plain["estimate"]["mean"] <= 0:
        return None
    part = kept.of_clean(adaptive, plain)
    return Share(part.mean - 1, part.low - 1, part.high - 1)


def compare(adaptive: Mapping[tuple[str, str], Mapping], plain: Mapping[tuple[str, str], Mapping]) -> list[Comparison]:
    """Every adaptive attack whose unaware one has a record, too.

    Args:
        adaptive: from ``load``.
        plain: from ``kept.load``, of the same victim and defence.
    """
    found = []
    for (attack, timing), record in adaptive.items():
        if other := plain.get((unaware(attack), timing)):
            found.append(Comparison(attack, unaware(attack), record, change(record, other), failed(record, other)))
    return found
