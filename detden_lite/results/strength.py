"""Which attacks have failed: they leave more return than a control, or than an attack that knows less."""

from collections.abc import Mapping, Sequence

import numpy as np

from detden_lite.attacks.catalogue import CATALOGUE, TITLES
from detden_lite.results import bare_victims
from detden_lite.results.records import Record

LEVEL = 0.05  # of one wrong flag or more on a victim
Key = tuple[str, str]  # (attack, timing)


def beaten_by(records: Mapping[Key, Record], level: float = LEVEL) -> dict[Key, tuple[str, ...]]:
    """Of each attack, the controls and the attacks that know less, at the same timing, that leave less, beyond chance.

    An attacker could always do what another does who knows less. So an attack that is beaten has failed, and says
    nothing about the victim or its defence (Carlini et al., 2019; Tramer et al., 2020). The controls are what others
    must beat, and cannot fail themselves. A control that knows what the attack does not, as FGSM, is not compared.

    Args:
        records: of one victim with one defence, or bare, by (attack, timing).
        level: of one wrong entry or more, all comparisons of the victim together (``holm``).

    Returns:
        The names of the attacks, the strongest first; none of an attack that has not failed.

    Raises:
        ValueError: if records of a timing do not begin with the same episode.

    Example:
        >>> from detden_lite.results.bare_victims import load_bare
        >>> beaten_by(load_bare("hopper", "td3"))["qfunction", "always"]
        ()
    """
    known = [key for key in records if key[0] in CATALOGUE]
    judged = [key for key in known if CATALOGUE[key[0]].group != "control"]
    pairs = [
        (key, other)
        for key in judged
        for other in known
        if other[1] == key[1] and other != key and must_beat(key[0], other[0])
    ]
    flags = holm([chance_of_excess(records[key], records[other]) for key, other in pairs], level)
    found: dict[Key, list[str]] = {key: [] for key in judged}
    for (key, other), beaten in sorted(
        zip(pairs, flags, strict=True), key=lambda entry: records[entry[0][1]].estimate.mean
    ):
        if beaten:
            found[key].append(other[0])
    return {key: tuple(others) for key, others in found.items()}


def must_beat(attack: str, other: str) -> bool:
    """Whether the other one is a control that knows no more, or an attack that knows less.

    Example:
        >>> must_beat("optimal", "uniform"), must_beat("optimal", "linear"), must_beat("director", "linear")
        (True, False, True)
    """
    if CATALOGUE[other].group == "control":
        return knowledge(other) <= knowledge(attack)
    return knowledge(other) < knowledge(attack)


def knowledge(attack: str) -> frozenset[str]:
    """What an attack knows: what it asks for in an episode, and the defence that it learned against beforehand.

    Example:
        >>> sorted(knowledge("optimal")), sorted(knowledge("adaptive-optimal"))
        (['adversary'], ['adversary', 'defense'])
    """
    entry = CATALOGUE[attack]
    return entry.needs | {"defense"} if entry.group == "aware" else entry.needs


def verdict(beaten: Sequence[str]) -> str:
    """What a page says of an attack, given the names of those by which it is beaten; nothing if there are none.

    Example:
        >>> verdict(["linear", "uniform"])
        'failed: linear adversary leaves less'
    """
    return f"failed: {TITLES[beaten[0]]} leaves less" if beaten else ""


def chance_of_excess(one: Record, other: Record, draws: int = 9_999) -> float:
    """The p of a one-sided test of whether a record has more return than another, over the episodes that both have.

    If the two attacks were equally strong, the difference in an episode would be as likely to have the other sign. So
    the mean difference is compared with those under random signs; p is the part that is at least as large.

    Args:
        one: the record that may have more.
        other: the one that may have less, of the same episodes.
        draws: of signs; p is at least 1 / (draws + 1).

    Raises:
        ValueError: if the two do not begin with the same episode.
    """
    gaps = bare_victims.gaps(one, other)
    if gaps.sum() <= 0:
        return 1.0
    signs = np.random.default_rng(0).choice([-1.0, 1.0], size=(draws, len(gaps)))
    equal = 1e-9 * np.abs(gaps).sum()  # the same signs may sum to another last digit
    return float((1 + (signs @ gaps >= gaps.sum() - equal).sum()) / (draws + 1))


def holm(chances: Sequence[float], level: float = LEVEL) -> list[bool]:
    """Which hypotheses Holm's method rejects: with this chance of one wrong rejection or more among all of them.

    Args:
        chances: a p for each hypothesis.
        level: between 0 and 1.

    Raises:
        ValueError: if the level or a p is out of its range.

    Example:
        >>> holm([0.01, 0.04, 0.03], level=0.05)
        [True, False, False]
    """
    p = np.asarray(chances, dtype=float)
    if not 0 < level < 1 or not ((p >= 0) & (p <= 1)).all():
        raise ValueError(f"chances must be between 0 and 1, and level inside, not {list(chances)} and {level}")
    order = np.argsort(p, kind="stable")
    passed = np.logical_and.accumulate(p[order] <= level / np.arange(len(p), 0, -1))
    rejected = np.empty(len(p), dtype=bool)
    rejected[order] = passed
    return rejected.tolist()
