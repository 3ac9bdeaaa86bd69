"""Sanity rules for an attack (Carlini et al., 2019): one that breaks a rule is weaker than it could be."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from detden_lite.attacks.noise import UniformNoise
from detden_lite.core.budget import Budget
from detden_lite.core.estimates import Estimate, estimate
from detden_lite.core.tasks import Task
from detden_lite.core.types import Attack
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim


@dataclass(frozen=True)
class RuleCheck:
    """Two attacks on the same episodes, of which the second should do more harm.

    Example:
        >>> check = RuleCheck("noise", "uniform", "gradient", (np.array([9.0, 8.0, 9.0]), np.array([3.0, 1.0, 2.0])))
        >>> bool(check.holds), float(check.gain.mean.round(2))
        (True, 6.67)
    """

    rule: str
    weaker: str
    stronger: str
    returns: tuple[np.ndarray, np.ndarray]  # of each episode, under the weaker and under the stronger
    must_win: bool = True  # otherwise it is enough not to lose

    @property
    def gain(self) -> Estimate:
        """How much less return the stronger one leaves, compared episode by episode."""
        return estimate(self.returns[0] - self.returns[1])

    @property
    def holds(self) -> bool:
        """Whether the interval of the gain lies above 0, or at least not below it."""
        return self.gain.low > 0 if self.must_win else self.gain.high >= 0


def check_attack(
    attack: Callable[[Victim, Budget, int], Attack],
    victim: Victim,
    other: Victim,
    task: Task,
    seeds: Sequence[int],
    steps: int | None = None,
    iterations: int = 20,
) -> list[RuleCheck]:
    """Hold a gradient attack to five rules, in closed loop around the task's epsilon.

    Args:
        attack: makes one of a victim, a budget and a number of gradient steps; the class ``OppositeAttack`` does.
        victim: the policy under attack.
        other: another victim of the same task: an attack that was made for it is tried on this one.
        task: that of both.
        seeds: one an episode; the same for all.
        steps: the longest an episode may be; the task's horizon by default.
        iterations: gradient steps of the attack at its full strength.

    Example:
        >>> from detden_lite import QFunctionAttack, get_task, load_victim, sanity
        >>> victims = load_victim("hopper", "td3"), load_victim("hopper", "ppo")
        >>> found = sanity.check_attack(QFunctionAttack, *victims, get_task("hopper"), [0, 1], steps=5, iterations=2)
        >>> [check.rule for check in found][0]
        'more steps are never weaker'
    """

    def returns(attack: Attack | None) -> np.ndarray:
        return rollout(victim, task, seeds, attack=attack, steps=steps).returns

    half, whole, huge = (Budget(factor * task.epsilon) for factor in (0.5, 1, 10))
    full = returns(attack(victim, whole, iterations))
    one_step, small = returns(attack(victim, whole, 1)), returns(attack(victim, half, iterations))
    noise, transferred = returns(UniformNoise(whole)), returns(attack(other, whole, iterations))
    tenth, destroyed = 0.1 * returns(None), returns(attack(victim, huge, iterations))
    return [
        RuleCheck("more steps are never weaker", "1 step", f"{iterations} steps", (one_step, full), must_win=False),
        RuleCheck("a larger ball is never weaker", "ε / 2", "ε", (small, full), must_win=False),
        RuleCheck("a gradient beats noise", "uniform noise", "gradient", (noise, full)),
        RuleCheck("a white box beats transfer", "made for another victim", "made for this one", (transferred, full)),
        RuleCheck("a huge ball destroys any policy", "a tenth of clean", "10 ε", (tenth, destroyed)),
    ]
