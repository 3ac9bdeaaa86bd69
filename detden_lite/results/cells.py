"""The cells of the tables: which victim meets which attack, when, with which defence."""

from collections.abc import Iterable
from dataclasses import dataclass

from detden_lite.attacks import catalogue
from detden_lite.defense.variants import MAIN, VARIANTS


@dataclass(frozen=True)
class Cell:
    """One experiment: a victim meets an attack, with a defence or without. The names are those of the book's tables.

    Args:
        attack: "none", or one of ``ATTACKS``; with a defence also one of ``ADAPTIVE``.
        timing: one of ``TIMINGS``.
        defense: "none", or the name of a shipped defence.

    Example:
        >>> Cell("opposite", "vulnerable", "mixed").record_name("hopper", "td3")
        'hopper-td3.opposite.vulnerable.mixed'
    """

    attack: str = "none"
    timing: str = "always"
    defense: str = "none"

    def record_name(self, task: str, algo: str) -> str:
        """The record's file name without its ending."""
        return ".".join([f"{task}-{algo}", self.attack, self.timing, self.defense])


def table_cells(defenses: Iterable[str] = ("none", MAIN)) -> list[Cell]:
    """The cells of the tables, one defence after the other; "none" is the bare victim.

    The bare victim, the main defence and one that predicts meet all attacks that do not know it, those of the paper at
    every timing. Other trained ones meet those of the four that need no planner; and assembled ones the opposite
    attack, which the denoiser has seen, and the optimal one, which it has not. The random timings are controls, of the
    bare victim alone.

    Example:
        >>> [cell.attack for cell in table_cells(["oracle-detector"])]
        ['none', 'opposite', 'optimal']
    """
    both, three = ("always", "vulnerable"), ("always", "vulnerable", "third")
    found = []
    for name in defenses:
        found.append(Cell(defense=name))
        if name == "none":
            found += [Cell(attack) for attack in (*catalogue.CONTROLS, *catalogue.UNAWARE)]
            found += [Cell(attack, timing) for attack in catalogue.FOUR for timing in three]
            found += [Cell("opposite", timing) for timing in ("random", "random-third")]
        elif name in VARIANTS:
            whole = name == MAIN or VARIANTS[name].predicts
            attacks, timings = (catalogue.FOUR, three) if whole else (("opposite", "qfunction", "optimal"), both)
            found += [Cell(attack, timing, name) for attack in attacks for timing in timings]
            held = (*catalogue.UNAWARE, "uniform", "corner")
            found += [Cell(attack, "always", name) for attack in held if whole]
        else:
            found += [Cell(attack, "always", name) for attack in ("opposite", "optimal")]
    return found


RESIDUAL_OR_NOT = ("diverse", "residual")  # two variants that differ in the denoiser's residual output alone


def adaptive_cells(defense: str = MAIN) -> list[Cell]:
    """The cells of the attacks that know the defence. They always attack, since the worst case is of interest.

    The main defence meets all of them. The two of ``RESIDUAL_OR_NOT`` meet one, which shows whether a residual output
    gives the attacker a path.
    """
    attacks = dict.fromkeys(RESIDUAL_OR_NOT, ("adaptive-opposite",)) | {MAIN: catalogue.ADAPTIVE}
    return [Cell(attack, "always", defense) for attack in attacks.get(defense, ())]
