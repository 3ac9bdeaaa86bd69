"""One cell of a table: a victim, an attack, its timing and a defence, run and written down as a result record."""

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np

from detden_lite.artifacts import versions
from detden_lite.attacks import (
    Always,
    EnchantingAttack,
    GaussianNoise,
    OppositeAttack,
    OptimalAttack,
    QFunctionAttack,
    Random,
    UniformNoise,
    Vulnerable,
)
from detden_lite.attacks.adaptive import AdaptiveAttack, CoupledAttack
from detden_lite.attacks.gradient import GradientAttack
from detden_lite.attacks.informed import InformedAttack
from detden_lite.attacks.printed import FORMS, PrintedAttack
from detden_lite.budget import Budget
from detden_lite.metrics import summarize
from detden_lite.planner import CEMPlanner
from detden_lite.rollout import Episodes, rollout
from detden_lite.tasks import Task
from detden_lite.victims import Victim

# Where the seeds of episodes begin, by what they are for: what is tuned on is never reported.
SEEDS = dict(
    normal=1_000_000, calibration=2_000_000, screening=3_000_000, selection=4_000_000, tuning=5_000_000,
    critic=6_000_000, search=6_500_000, adversary=7_000_000, report=8_000_000,
)  # fmt: skip


def seeds(purpose: str, n: int) -> range:
    """The first n episode seeds for a purpose: a key of ``SEEDS``."""
    return range(SEEDS[purpose], SEEDS[purpose] + n)


CONTROLS = ("uniform", "gaussian", "fgsm")
FOUR = ("opposite", "qfunction", "optimal", "enchanting")  # the paper's
ATTACKS = (*CONTROLS, *FOUR, "linear")
# Those that know the defence: as section 4.4 and appendix B print them, and as they should be.
ADAPTIVE = (
    *(f"{form}-{attack}" for form in FORMS for attack in ("opposite", "qfunction", "enchanting")),
    "adaptive-opposite", "adaptive-qfunction", "adaptive-enchanting", "adaptive-optimal", "coupled-opposite",
)  # fmt: skip
_KINDS = dict(adaptive=AdaptiveAttack, coupled=CoupledAttack)
TIMINGS = ("always", "vulnerable", "random")


@dataclass(frozen=True)
class Cell:
    """What is done to whom. The names are those of the book's tables.

    Args:
        attack: "none", or one of ``ATTACKS``; with a defence also one of ``ADAPTIVE``.
        timing: one of ``TIMINGS``.
        defense: "none", or the name of a shipped defence.
    """

    attack: str = "none"
    timing: str = "always"
    defense: str = "none"

    def record_name(self, task: str, algo: str) -> str:
        """The record's file name without its ending."""
        return ".".join([f"{task}-{algo}", self.attack, self.timing, self.defense])


@dataclass(frozen=True)
class Threat:
    """The attacker's settings that all cells of a victim share."""

    budget: Budget
    steps: int = 20
    restarts: int = 1
    c_vul: float = -np.inf  # threshold of the vulnerable timing
    rate: float = 1.0  # of the random timing
    planner: Mapping[str, int] = field(default_factory=dict)  # arguments of ``CEMPlanner``
    adversaries: Mapping[str, Victim] = field(default_factory=dict)  # "optimal", "linear": ``models.load_adversary``
    adaptive: Mapping[str, int] = field(default_factory=dict)  # arguments of ``AdaptiveAttack``, for its variants too

    def attack(self, name: str, victim: Victim, task: Task):
        """The attack of this name, or None for "none"."""
        match name:
            case "none":
                return None
            case "uniform":
                return UniformNoise(self.budget)
            case "gaussian":
                return GaussianNoise(self.budget)
            case "fgsm":
                return OppositeAttack(victim, self.budget, steps=1)
            case "opposite":
                return OppositeAttack(victim, self.budget, self.steps, self.restarts)
            case "qfunction":
                return QFunctionAttack(victim, self.budget, self.steps, self.restarts)
            case "enchanting":
                return EnchantingAttack(
                    victim, self.budget, CEMPlanner(task.env_id, **self.planner), self.steps, self.restarts
                )
            case "optimal" | "linear" | "adaptive-optimal":
                if name not in self.adversaries:
                    raise ValueError(
                        f"adversaries: the {name} one is missing; run its stage first, or give one of your own"
                    )
                return OptimalAttack(self.adversaries[name], self.budget)
        if name not in ADAPTIVE:
            raise ValueError(f"attack must be none or one of {', '.join(ATTACKS + ADAPTIVE)}, not {name!r}")
        kind, unaware = name.split("-")
        attack = self.attack(unaware, victim, task)
        return PrintedAttack(attack, kind) if kind in FORMS else _KINDS[kind](attack, **self.adaptive)

    def timing(self, name: str, victim: Victim):
        """The timing of this name."""
        match name:
            case "always":
                return Always()
            case "vulnerable":
                return Vulnerable(victim, self.c_vul)
            case "random":
                return Random(self.rate)
        raise ValueError(f"timing must be one of {', '.join(TIMINGS)}, not {name!r}")


def run_cell(
    cell: Cell, task: Task, victim: Victim, threat: Threat, defense, episode_seeds, steps: int | None = None,
    progress: str | None = None, clean: Episodes | None = None,
) -> tuple[dict, Episodes]:  # fmt: skip
    """Run a cell. Returns its record, ready for JSON, and the episodes.

    Args:
        cell: what to run.
        task: where.
        victim: whom.
        threat: the attacker's settings.
        defense: the defence called ``cell.defense``; None for "none".
        episode_seeds: one an episode; the same for all cells of a table.
        steps: the longest an episode may be; the task's horizon by default.
        progress: text of a progress bar, None for no bar.
        clean: the episodes of the cell without an attack but with this defence, for the scores that need them.
    """
    if (defense is None) != (cell.defense == "none"):
        raise ValueError(f"defense: the cell says {cell.defense!r}, so give {'None' if defense is not None else 'one'}")
    attack, timing = threat.attack(cell.attack, victim, task), threat.timing(cell.timing, victim)
    start = time.perf_counter()
    episodes = rollout(
        victim, task, episode_seeds, attack=attack, timing=timing, defense=defense, steps=steps, progress=progress
    )
    settings = dict(epsilon=threat.budget.epsilon, norm=str(threat.budget.norm))
    if isinstance(attack, InformedAttack):
        settings["adaptive"] = attack.settings
        attack = attack.attack
    if isinstance(attack, GradientAttack):
        settings |= dict(steps=attack.steps, restarts=attack.restarts)
    if isinstance(attack, EnchantingAttack):
        planner = attack.planner
        settings |= dict(horizon=planner.horizon, population=planner.population, iterations=planner.iterations)
    if cell.timing == "vulnerable":
        settings["c_vul"] = threat.c_vul
    if cell.timing == "random":
        settings["rate"] = threat.rate
    if defense is not None:
        threshold = defense.detector.threshold
        settings["c_anomaly"] = threshold if np.isfinite(threshold) else None  # JSON knows no infinity
        settings |= dict.fromkeys(defense.ablations, True)
    record = dict(
        task=task.name,
        cell=asdict(cell),
        settings=settings,
        seeds=[int(episode_seeds[0]), len(episode_seeds)],
        **summarize(episodes, clean),
        seconds=time.perf_counter() - start,
        versions=versions(),
    )
    return record, episodes
