"""The list of attacks: everything that tables, figures, pages and the command line know of an attack is here.

To add an attack, write its module, and add one entry here. An entry's maker imports the module when it is called, so
that reading the list loads no network.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from detden_lite.attacks.threat import Threat
    from detden_lite.core.tasks import Task
    from detden_lite.core.types import Attack
    from detden_lite.victims.victim import Victim

Maker = Callable[["Threat", "Victim", "Task"], "Attack"]
TIMINGS = ("always", "vulnerable", "random")
FORMS = ("text", "appendix")  # in which the paper prints its adaptive attacks: in section 4.4, and in appendix B


@dataclass(frozen=True)
class AttackEntry:
    """One attack of the tables.

    Args:
        name: in record names and on the command line.
        title: in tables and figures.
        group: "control" for what an attack must beat, "paper" for the paper's four, "unaware" for others that do not
            know the defence, "aware" for those that know it.
        make: makes the attack for (threat, victim, task).
        colour: where several attacks share a figure; None for one that is not drawn.
        slow: whether it plans, or searches for each observation, so that fewer episodes are reported.
        unaware: of an attack that knows the defence, the name of the one that does not.
    """

    name: str
    title: str
    group: str
    make: Maker
    colour: str | None = None
    slow: bool = False
    unaware: str | None = None


def _uniform(threat: Threat, victim: Victim, task: Task) -> Attack:
    from detden_lite.attacks.noise import UniformNoise

    return UniformNoise(threat.budget)


def _gaussian(threat: Threat, victim: Victim, task: Task) -> Attack:
    from detden_lite.attacks.noise import GaussianNoise

    return GaussianNoise(threat.budget)


def _fgsm(threat: Threat, victim: Victim, task: Task) -> Attack:
    from detden_lite.attacks.opposite import OppositeAttack

    return OppositeAttack(victim, threat.budget, steps=1)


def _opposite(threat: Threat, victim: Victim, task: Task) -> Attack:
    from detden_lite.attacks.opposite import OppositeAttack

    return OppositeAttack(victim, threat.budget, threat.steps, threat.restarts)


def _qfunction(threat: Threat, victim: Victim, task: Task) -> Attack:
    from detden_lite.attacks.qfunction import QFunctionAttack

    return QFunctionAttack(victim, threat.budget, threat.steps, threat.restarts)


def _enchanting(threat: Threat, victim: Victim, task: Task) -> Attack:
    from detden_lite.attacks.enchanting import EnchantingAttack
    from detden_lite.simulation.planner import CEMPlanner

    planner = CEMPlanner(task.env_id, **threat.planner)
    return EnchantingAttack(victim, threat.budget, planner, threat.steps, threat.restarts)


def _learned(name: str) -> Maker:
    def make(threat: Threat, victim: Victim, task: Task) -> Attack:
        from detden_lite.attacks.optimal import OptimalAttack

        if name not in threat.adversaries:
            raise ValueError(f"adversaries: the {name} one is missing; run its stage first, or give one of your own")
        return OptimalAttack(threat.adversaries[name], threat.budget)

    return make


def _printed(form: str, unaware: str) -> Maker:
    def make(threat: Threat, victim: Victim, task: Task) -> Attack:
        from detden_lite.attacks.printed import PrintedAttack

        return PrintedAttack(CATALOGUE[unaware].make(threat, victim, task), form)

    return make


def _adaptive(unaware: str) -> Maker:
    def make(threat: Threat, victim: Victim, task: Task) -> Attack:
        from detden_lite.attacks.adaptive import AdaptiveAttack

        return AdaptiveAttack(CATALOGUE[unaware].make(threat, victim, task), **threat.adaptive)

    return make


def _coupled(threat: Threat, victim: Victim, task: Task) -> Attack:
    from detden_lite.attacks.adaptive import CoupledAttack

    return CoupledAttack(_opposite(threat, victim, task), **threat.adaptive)


_ENTRIES = (
    AttackEntry("uniform", "uniform noise", "control", _uniform, "#E69F00"),
    AttackEntry("gaussian", "Gaussian noise", "control", _gaussian),
    AttackEntry("fgsm", "FGSM", "control", _fgsm),
    AttackEntry("opposite", "opposite", "paper", _opposite, "#D55E00"),
    AttackEntry("qfunction", "Q-function", "paper", _qfunction, "#CC79A7"),
    AttackEntry("optimal", "optimal", "paper", _learned("optimal"), "#56B4E9"),
    AttackEntry("enchanting", "enchanting", "paper", _enchanting, "#1a1a1a", slow=True),
    AttackEntry("linear", "linear adversary", "unaware", _learned("linear"), "#767676"),
    *(
        AttackEntry(f"{form}-{name}", f"{title}, as in {place}", "aware", _printed(form, name), slow=True, unaware=name)
        for form, place in zip(FORMS, ("section 4.4", "appendix B"), strict=True)
        for name, title in (("opposite", "opposite"), ("qfunction", "Q-function"), ("enchanting", "enchanting"))
    ),
    AttackEntry(
        "adaptive-opposite", "opposite, adaptive", "aware", _adaptive("opposite"), slow=True, unaware="opposite"
    ),
    AttackEntry(
        "adaptive-qfunction", "Q-function, adaptive", "aware", _adaptive("qfunction"), slow=True, unaware="qfunction"
    ),
    AttackEntry(
        "adaptive-enchanting", "enchanting, adaptive", "aware", _adaptive("enchanting"), slow=True, unaware="enchanting"
    ),
    AttackEntry(
        "adaptive-optimal", "optimal, adaptive", "aware", _learned("adaptive-optimal"), slow=True, unaware="optimal"
    ),
    AttackEntry("coupled-opposite", "opposite, drifting", "aware", _coupled, slow=True, unaware="opposite"),
)
CATALOGUE = {entry.name: entry for entry in _ENTRIES}


def names(*groups: str) -> tuple[str, ...]:
    """The names of the attacks of these groups, in the order of the list."""
    return tuple(entry.name for entry in _ENTRIES if entry.group in groups)


CONTROLS = names("control")
FOUR = names("paper")
ATTACKS = names("control", "paper", "unaware")
ADAPTIVE = names("aware")
TITLES = {"none": "clean"} | {entry.name: entry.title for entry in _ENTRIES}
