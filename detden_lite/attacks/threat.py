"""The settings of an attacker that all cells of a victim share."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf

from detden_lite.attacks.catalogue import CATALOGUE, TIMINGS
from detden_lite.attacks.timing import Always, Random, Vulnerable
from detden_lite.core.arguments import check_between, check_kind, check_number, check_whole
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task
from detden_lite.core.types import Attack, Timing
from detden_lite.victims.victim import Victim


@dataclass(frozen=True)
class Threat:
    """The attacker's settings that all cells of a victim share.

    Raises:
        ValueError: if one of them is not in its range.

    Example:
        >>> from detden_lite import Budget, Threat, Victim, get_task
        >>> threat, victim = Threat(Budget(0.1), steps=10, rate=0.5), Victim([11, 8, 3])
        >>> threat.attack("opposite", victim, get_task("hopper")).steps, threat.timing("random", victim).rate
        (10, 0.5)
    """

    budget: Budget
    steps: int = 20
    restarts: int = 1
    c_vul: float = -inf  # threshold of the vulnerable timing
    rate: float = 1.0  # of the random timing
    c_third: float | None = None  # the threshold that strikes at a third of the steps; None: not tuned
    rate_third: float | None = None  # how often it strikes: the rate of its control
    planner: Mapping[str, int] = field(default_factory=dict)  # arguments of ``CEMPlanner``
    adversaries: Mapping[str, Victim] = field(default_factory=dict)  # by kind, see ``models.load_adversary``
    learned: Mapping[str, Mapping[str, int]] = field(default_factory=dict)  # what each cost to learn, for the records
    adaptive: Mapping[str, int] = field(default_factory=dict)  # arguments of ``AdaptiveAttack``, for its variants too

    def __post_init__(self) -> None:
        check_kind(Budget, budget=self.budget)
        check_whole(1, steps=self.steps, restarts=self.restarts)
        check_between(0, 1, rate=self.rate, rate_third=self.rate_third or 0)
        check_number(c_vul=self.c_vul, c_third=self.c_third or 0)

    def attack(self, name: str, victim: Victim, task: Task) -> Attack | None:
        """The attack of this name, or None for "none"; a ValueError that lists the names otherwise."""
        if name == "none":
            return None
        if name not in CATALOGUE:
            raise ValueError(f"attack must be none or one of {', '.join(CATALOGUE)}, not {name!r}")
        return CATALOGUE[name].make(self, victim, task)

    def adversary(self, kind: str) -> Victim:
        """The adversary of this kind, or a ValueError that says which is missing."""
        if kind not in self.adversaries:
            raise ValueError(f"adversaries: the {kind} one is missing; run its stage first, or give one of your own")
        return self.adversaries[kind]

    def timing(self, name: str, victim: Victim) -> Timing:
        """The timing of this name.

        Raises:
            ValueError: for another name; or if a timing at a third of the steps is asked for and not tuned.
        """
        if name not in TIMINGS:
            raise ValueError(f"timing must be one of {', '.join(TIMINGS)}, not {name!r}")
        if name == "always":
            return Always()
        third = name.endswith("third")
        rate, c_vul = (self.rate_third, self.c_third) if third else (self.rate, self.c_vul)
        if rate is None or c_vul is None:
            raise ValueError(f"c_third, rate_third: timing {name!r} is not tuned; run the stage timing, or give both")
        return Random(rate) if name.startswith("random") else Vulnerable(victim, c_vul)
