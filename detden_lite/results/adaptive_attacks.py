"""Returns under attackers who know the defence, beside those under the attacks that do not know it (Q5)."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from detden_lite.attacks.catalogue import CATALOGUE
from detden_lite.defense.variants import MAIN
from detden_lite.results import bare_victims, cells, defended_victims, records
from detden_lite.results.bare_victims import UNATTACKED, failed
from detden_lite.results.defended_victims import Share
from detden_lite.results.records import Record
from detden_lite.store import manifest

# The victims whose defence meets the attackers who know it.
ADAPTED_ROWS = (("hopper", "td3"), ("halfcheetah", "td3"), ("hopper", "ppo"), ("halfcheetah", "ppo"))


@dataclass(frozen=True)
class AwareAttack:
    """An adaptive attack beside the attack that does not know the defence, on the same defended victim."""

    attack: str  # one of ``catalogue.ADAPTIVE``
    unaware: str  # one of ``catalogue.FOUR``
    record: Record  # of the adaptive attack
    change: Share | None  # of the return, by knowing the defence; None if the unaware one leaves no return at all
    failed: bool  # it leaves more than the unaware one, beyond chance: see ``bare_victims.failed``


def load_adaptive(
    task: str, algo: str, defense: str = MAIN, root: Path = manifest.DATA
) -> dict[tuple[str, str], Record]:
    """The records of the adaptive attacks on a victim with this defence that are there, by (attack, "always").

    Raises:
        ArtifactError: if one of them is altered.
    """
    return records.load_cells(cells.adaptive_cells(defense), task, algo, root)


def worst_on_record(
    task: str, algo: str, defense: str = MAIN, root: Path = manifest.DATA
) -> tuple[tuple[str, str], Share] | None:
    """The (attack, timing) of the whole suite that leaves a victim the least, and the part of its clean return.

    With a defence the suite has the attacks that know it as well; noise and other controls always belong to it.

    None if there is no record of the clean victim, or none of an attack.

    Args:
        task: "hopper".
        algo: "td3" or "ppo".
        defense: the name of a shipped one; "none" for the bare victim.
        root: as data/ is laid out.

    Raises:
        ArtifactError: if one of the records is altered.

    Example:
        >>> worst_on_record("hopper", "ppo", "none")[0]
        ('optimal', 'always')
        >>> cell, share = worst_on_record("hopper", "ppo")
        >>> cell
        ('adaptive-optimal', 'always')
        >>> print(share)
        1% [1%, 1%]
    """
    clean = bare_victims.load_bare(task, algo, root).get(UNATTACKED)
    found = defended_victims.load_defended(task, algo, defense, root) | load_adaptive(task, algo, defense, root)
    return defended_victims.at_worst(found, clean) if clean else None


def change(adaptive: Record, plain: Record) -> Share | None:
    """The relative change of the return under an attack if the attacker knows the defence, as in table 4 of the paper.

    Both are of the same episodes, and the interval's episodes are drawn with both of their returns.

    Args:
        adaptive: the record of the attack that knows the defence.
        plain: the record of the one that does not; None comes back if its mean return is not above 0.

    Raises:
        ValueError: if the two do not begin with the same episode.
    """
    if plain.estimate.mean <= 0:
        return None
    part = defended_victims.of_clean(adaptive, plain)
    return Share(part.mean - 1, part.low - 1, part.high - 1)


def compare(adaptive: Mapping[tuple[str, str], Record], plain: Mapping[tuple[str, str], Record]) -> list[AwareAttack]:
    """Each adaptive attack beside the unaware one, where both have a record.

    Args:
        adaptive: from ``load_adaptive``.
        plain: from ``defended_victims.load_defended``, of the same victim and defence.
    """
    found = []
    for (attack, timing), record in adaptive.items():
        unaware = CATALOGUE[attack].unaware
        if unaware and (other := plain.get((unaware, timing))):
            found.append(AwareAttack(attack, unaware, record, change(record, other), failed(record, other)))
    return found
