"""Adaptive attacks on detect and denoise: the worse of deceiving the detector and of deceiving the denoiser.

The defended policy does pi(o_hat) where the detector is silent and pi(den(o_hat)) where it alarms. So there are two
ways to harm it, and each step takes the better one by what the policy would really do (Tramer et al., 2020).
"""

from collections.abc import Callable, Sequence
from functools import partial
from math import inf
from typing import Any

import torch
from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.attacks.informed import InformedAttack, View, Views, view_defense
from detden_lite.attacks.outcome import Outcome
from detden_lite.attacks.search import Measure, Project, climb, evolve
from detden_lite.core.arguments import check_positive, check_whole
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import World

Value = Callable[[Outcome], Tensor]


class AdaptiveAttack(InformedAttack):
    """The most damage by what the defended policy would really do: the strongest attack here on a defence.

    From several starts it climbs the damage of pi(o_hat) while the detector is silent, stepping back where it alarms,
    and the damage of pi(den(o_hat)) while it alarms, going on where it is silent (the switching method of Polyak, 1967,
    for a constraint). The points met on the way are measured by the damage of what is really done, and the best of each
    climb are judged over fresh samples, beside o itself and the point of the attack that does not know the defence. So
    by its own judgement it is never weaker than that attack.

    It looks one step ahead: how an observation changes the defence's memory, for later steps, is no part of the damage.

    Args:
        attack: opposite, Q-function or enchanting: what damage is, and one of the starts.
        steps: of each climb.
        restarts: random starts, beside that one.
        samples: K, latent samples that a climb averages over, the same ones all along.
        fresh: latent samples of the last judgement.
        seed: of the attacker's random numbers.
        view: see ``InformedAttack``.

    Raises:
        ValueError: if one of the numbers is no whole number of at least 1, or ``attack`` is no gradient attack.

    Example:
        >>> from detden_lite import AdaptiveAttack, Budget, OppositeAttack, get_task, load_defense, load_victim, rollout
        >>> victim, task = load_victim("hopper", "td3"), get_task("hopper")
        >>> attack = AdaptiveAttack(OppositeAttack(victim, Budget(task.epsilon)), steps=5, samples=2, fresh=4)
        >>> sorted(attack.needs)
        ['defense', 'policy']
        >>> episodes = rollout(victim, task, [0], attack=attack, defense=load_defense("hopper", "td3"), steps=3)
        >>> episodes.perturbed.shape
        (3, 1, 11)
    """

    aim: Value = staticmethod(lambda outcome: outcome.damage)  # the best point has the most of it
    ways: tuple[Value, ...] = (Outcome.quiet, Outcome.loud)  # the surrogates that are climbed

    def __init__(
        self, attack: GradientAttack, steps: int = 100, restarts: int = 1, samples: int = 8, fresh: int = 32,
        seed: int = 0, view: Callable[..., View] = view_defense,
    ) -> None:  # fmt: skip
        check_whole(1, steps=steps, restarts=restarts, samples=samples, fresh=fresh)
        super().__init__(attack, seed, view)
        self.steps, self.restarts, self.samples, self.fresh = steps, restarts, samples, fresh

    @property
    def settings(self) -> dict[str, float | str]:
        return dict(steps=self.steps, restarts=self.restarts, samples=self.samples, fresh=self.fresh)

    def projection(self, obs: Tensor, wanted: Tensor) -> Project:
        """The projection into what is allowed, for the wanted rows of ``obs`` ``[N, obs_dim]``."""
        return self.budget.projection(obs[wanted])

    def search(self, measure: Measure, start: Tensor, project: Project, streams: RandomStreams) -> Tensor:
        """The point with the most damage that is met from ``start`` ``[n, obs_dim]`` on; see ``climb``."""
        return climb(measure, start, project, self.budget, self.steps)

    def perturb(self, obs: Tensor, wanted: Tensor, world: World, views: Views, streams: RandomStreams) -> Tensor:
        true, project = obs[wanted], self.projection(obs, wanted)
        objective = self.attack.objective(true, world)
        unaware = self.attack.ascend(objective, obs, wanted)[wanted]
        outcome = partial(Outcome.of, view=views(self.samples), policy=self.policy, of_action=objective.of_action)

        def measure(perturbed: Tensor, surrogate: Value) -> tuple[Tensor, Tensor]:
            found = outcome(perturbed)
            return self.aim(found), surrogate(found)

        candidates = [project(true), project(unaware)]
        for start in (unaware, *(self.budget.sample(true, streams) for _ in range(self.restarts))):
            for surrogate in self.ways:
                candidates.append(self.search(partial(measure, surrogate=surrogate), start, project, streams))
        judge = partial(outcome, view=views(self.fresh))
        best = torch.stack([self.aim(judge(point)) for point in candidates]).argmax(0)
        found = obs.clone()
        found[wanted] = torch.stack(candidates)[best, torch.arange(len(true))]
        return found


class GradientFreeAttack(AdaptiveAttack):
    """The cross-check: the same surrogates and the same judgement, and a search that uses no gradient.

    Where it does more damage than ``AdaptiveAttack`` the gradients are masked, and that attack proves nothing.

    Args:
        attack: see ``AdaptiveAttack``.
        population: points that are tried in each step.
        elites: how many of them the next points' distribution is fitted to; at least 2.
        steps: how often it is fitted.
        **settings: the others of ``AdaptiveAttack``.

    Raises:
        ValueError: as for ``AdaptiveAttack``, and if there are more elites than points.

    Example:
        >>> from detden_lite import Budget, GradientFreeAttack, OppositeAttack, Victim
        >>> attack = GradientFreeAttack(OppositeAttack(Victim([11, 8, 3]), Budget(0.1)), population=16)
        >>> attack.settings
        {'steps': 15, 'restarts': 1, 'samples': 8, 'fresh': 32, 'population': 16, 'elites': 6}
    """

    def __init__(
        self, attack: GradientAttack, population: int = 32, elites: int = 6, steps: int = 15, **settings: Any
    ) -> None:
        check_whole(2, elites=elites, population=population)
        if elites > population:
            raise ValueError(f"elites must be at most the population of {population}, not {elites}")
        self.population, self.elites = population, elites
        super().__init__(attack, steps, **settings)

    @property
    def settings(self) -> dict[str, float | str]:
        return super().settings | dict(population=self.population, elites=self.elites)

    def search(self, measure: Measure, start: Tensor, project: Project, streams: RandomStreams) -> Tensor:
        return evolve(measure, start, project, self.budget, self.steps, self.population, self.elites, streams)


class StealthyAttack(AdaptiveAttack):
    """The most damage to pi(o_hat) that raises no alarm in any sample: the way under the threshold alone.

    It is weaker than ``AdaptiveAttack``, and is not detected. Where even o raises the alarm, it gives the point that
    exceeds the threshold least. The arguments are those of ``AdaptiveAttack``.

    Example:
        >>> from detden_lite import Budget, OppositeAttack, StealthyAttack, Victim
        >>> StealthyAttack(OppositeAttack(Victim([11, 8, 3]), Budget(0.1)), steps=50).settings["steps"]
        50
    """

    aim = staticmethod(partial(Outcome.quiet, allowed=0.0))
    ways = (aim,)


class CoupledAttack(AdaptiveAttack):
    """An adaptive attack that drifts: for a detector with memory, to which a sudden change is suspicious.

    The perturbation may change by ``pace`` epsilon a step. It begins at zero, and is zero again wherever it was not
    wanted one step before.

    Args:
        attack: see ``AdaptiveAttack``; its ball must be of the norm inf, where both conditions together are a box.
        pace: a part of epsilon, above 0; from 2 on it is no condition.
        **settings: the others of ``AdaptiveAttack``.

    Raises:
        ValueError: as for ``AdaptiveAttack``, and for another norm or a pace of 0 or less.

    Example:
        >>> from detden_lite import Budget, CoupledAttack, OppositeAttack, Victim
        >>> CoupledAttack(OppositeAttack(Victim([11, 8, 3]), Budget(0.1)), pace=0.5, steps=50).settings["pace"]
        0.5
    """

    def __init__(self, attack: GradientAttack, pace: float = 0.2, **settings: Any) -> None:
        check_positive(pace=pace)
        super().__init__(attack, **settings)
        if self.budget.norm != inf:
            raise ValueError(f"budget: a coupled attack needs the norm inf, not {self.budget.norm}")
        self.pace = pace

    @property
    def settings(self) -> dict[str, float | str]:
        return super().settings | dict(pace=self.pace)

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        super().reset(episodes)
        self.last: Tensor | float = 0.0  # the perturbation of the step before

    def __call__(self, obs: Tensor, world: World | None = None) -> Tensor:
        found = super().__call__(obs, world)
        self.last = found - obs
        return found

    def projection(self, obs: Tensor, wanted: Tensor) -> Project:
        radius, true, before = self.budget.epsilon * self.budget.scale, obs[wanted], (obs + self.last)[wanted]
        low = torch.maximum(true - radius, before - self.pace * radius)
        high = torch.minimum(true + radius, before + self.pace * radius)
        return lambda perturbed: perturbed.clamp(low, high)
