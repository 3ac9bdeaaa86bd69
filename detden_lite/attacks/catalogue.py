"""The list of attacks: everything that tables, figures, pages and the command line know of an attack is here.

To add an attack, write its module, and add one entry here. An entry names the class, whose module is imported when the
attack is made, so that reading the list loads no network.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from detden_lite.attacks.threat import Threat
    from detden_lite.core.tasks import Task
    from detden_lite.core.types import Attack
    from detden_lite.victims.victim import Victim

    Arguments = Callable[[Threat, Victim, Task], dict[str, object]]

# When to attack: "third" is "vulnerable" with the threshold that strikes at about a third of the steps, and each random
# timing strikes as often as the one that it is the control of.
TIMINGS = ("always", "vulnerable", "random", "third", "random-third")
FORMS = dict(text="section 4.4", appendix="appendix B")  # where the paper prints its adaptive attacks, in two forms


@dataclass(frozen=True)
class AttackEntry:
    """One attack of the tables.

    Args:
        name: in record names and on the command line.
        title: in tables and figures.
        group: "control" for what an attack must beat, "paper" for the paper's four, "unaware" for others that do not
            know the defence, "aware" for those that know it.
        kind: the class, with its module in this package: "noise.UniformNoise".
        needs: what it knows beside the observation; see ``detden_lite.core.types.Attack``.
        arguments: the class's arguments, for (threat, victim, task).
        colour: where several attacks share a figure; None for one that is not drawn.
        slow: whether it plans, or searches for each observation, so that fewer episodes are reported.
        unaware: of an attack that knows the defence, the name of the one that does not.

    Example:
        >>> from detden_lite import CATALOGUE
        >>> entry = CATALOGUE["coupled-opposite"]
        >>> entry.title, entry.unaware, sorted(entry.needs)
        ('opposite, drifting', 'opposite', ['defense', 'policy'])
    """

    name: str
    title: str
    group: str
    kind: str
    needs: frozenset[str]
    arguments: Arguments
    colour: str | None = None
    slow: bool = False
    unaware: str | None = None

    def make(self, threat: Threat, victim: Victim, task: Task) -> Attack:
        """The attack on this victim in this task."""
        module, name = self.kind.split(".")
        kind = getattr(import_module(f"detden_lite.attacks.{module}"), name)
        return kind(**self.arguments(threat, victim, task))


def _ball(threat: Threat, victim: Victim, task: Task) -> dict[str, object]:
    return dict(budget=threat.budget)


def _one_step(threat: Threat, victim: Victim, task: Task) -> dict[str, object]:
    return dict(victim=victim, budget=threat.budget, steps=1)


def _ascent(threat: Threat, victim: Victim, task: Task) -> dict[str, object]:
    return dict(victim=victim, budget=threat.budget, steps=threat.steps, restarts=threat.restarts)


def _planned(threat: Threat, victim: Victim, task: Task) -> dict[str, object]:
    from detden_lite.simulation.planner import CEMPlanner

    return _ascent(threat, victim, task) | dict(planner=CEMPlanner(task.env_id, **threat.planner))


def _learned(kind: str) -> Arguments:
    return lambda threat, victim, task: dict(adversary=threat.adversary(kind), budget=threat.budget)


def _directed(kind: str) -> Arguments:
    return lambda threat, victim, task: dict(director=threat.adversary(kind), victim=victim, budget=threat.budget)


_POLICY, _ADVERSARY = frozenset({"policy"}), frozenset({"adversary"})
_CRITIC, _SIMULATOR = _POLICY | {"critic"}, _POLICY | {"simulator"}
_OPPOSITE, _OPTIMAL = "opposite.OppositeAttack", "optimal.OptimalAttack"
_DIRECTOR = "director.DirectorAttack"
_ENTRIES = [
    AttackEntry("uniform", "uniform noise", "control", "noise.UniformNoise", frozenset(), _ball, "#E69F00"),
    AttackEntry("gaussian", "Gaussian noise", "control", "noise.GaussianNoise", frozenset(), _ball),
    AttackEntry("corner", "random corner, held", "control", "held.CornerAttack", frozenset(), _ball),
    AttackEntry("fgsm", "FGSM", "control", _OPPOSITE, _POLICY, _one_step),
    AttackEntry("opposite", "opposite", "paper", _OPPOSITE, _POLICY, _ascent, "#D55E00"),
    AttackEntry("qfunction", "Q-function", "paper", "qfunction.QFunctionAttack", _CRITIC, _ascent, "#CC79A7"),
    AttackEntry("optimal", "optimal", "paper", _OPTIMAL, _ADVERSARY, _learned("optimal"), "#56B4E9"),
    AttackEntry(
        "enchanting", "enchanting", "paper", "enchanting.EnchantingAttack", _SIMULATOR, _planned, "#1a1a1a", slow=True
    ),
    AttackEntry("linear", "linear adversary", "unaware", _OPTIMAL, _ADVERSARY, _learned("linear"), "#767676"),
    AttackEntry("offset", "held offset", "unaware", _OPTIMAL, _ADVERSARY, _learned("offset")),
    AttackEntry("director", "director", "unaware", _DIRECTOR, _POLICY | _ADVERSARY, _directed("director")),
]


def _aware(way: str, name: str, title: str, kind: str, settings: Mapping[str, str] | None = None) -> AttackEntry:
    """An attack that is made of the one of this name; its settings are by default the threat's for adaptive attacks."""
    unaware = next(entry for entry in _ENTRIES if entry.name == name)

    def arguments(threat: Threat, victim: Victim, task: Task) -> dict[str, object]:
        return dict(attack=unaware.make(threat, victim, task), **(threat.adaptive if settings is None else settings))

    whole, needs = f"{unaware.title}, {title}", unaware.needs | {"defense"}
    return AttackEntry(f"{way}-{name}", whole, "aware", kind, needs, arguments, slow=True, unaware=name)


_GRADIENT = ("opposite", "qfunction", "enchanting")
_ENTRIES += [
    *(
        _aware(form, name, f"as in {place}", "printed.PrintedAttack", dict(form=form))
        for form, place in FORMS.items()
        for name in _GRADIENT
    ),
    *(_aware("adaptive", name, "adaptive", "adaptive.AdaptiveAttack") for name in _GRADIENT),
    AttackEntry(
        "adaptive-optimal", "optimal, adaptive", "aware", _OPTIMAL, _ADVERSARY, _learned("adaptive-optimal"),
        slow=True, unaware="optimal",
    ),
    AttackEntry(
        "adaptive-offset", "held offset, adaptive", "aware", _OPTIMAL, _ADVERSARY, _learned("adaptive-offset"),
        unaware="offset",
    ),
    AttackEntry(
        "adaptive-director", "director, adaptive", "aware", _DIRECTOR, _POLICY | _ADVERSARY,
        _directed("adaptive-director"), unaware="director",
    ),
    _aware("coupled", "opposite", "drifting", "adaptive.CoupledAttack"),
]  # fmt: skip
CATALOGUE = {entry.name: entry for entry in _ENTRIES}


def names(*groups: str) -> tuple[str, ...]:
    """The names of the attacks of these groups, in the order of the list."""
    return tuple(entry.name for entry in _ENTRIES if entry.group in groups)


CONTROLS = names("control")
FOUR = names("paper")
UNAWARE = names("unaware")
ATTACKS = names("control", "paper", "unaware")
ADAPTIVE = names("aware")
TITLES = {"none": "clean"} | {entry.name: entry.title for entry in _ENTRIES}
