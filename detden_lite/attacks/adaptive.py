"""Adaptive attacks on detect and denoise: the worse of deceiving the detector and of deceiving the denoiser.

The defended policy does pi(o_hat) where the detector is silent and pi(den(o_hat)) where it alarms. So there are two
ways to harm it, and each step takes the better one by what the policy would really do (Tramer et al., 2020).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf

import torch
from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.attacks.informed import InformedAttack, View, view_defense
from detden_lite.attacks.search import climb, evolve
from detden_lite.core.random_streams import RandomStreams

FORBIDDEN = -1e12  # less than any damage: a stand-in's value where the detector does not do what it is to do


@dataclass(frozen=True)
class Outcome:
    """What comes of n perturbed observations, in K samples of the defence's noise."""

    deviation: Tensor  # see ``View``, [K, n, obs_dim]
    bare: Tensor  # the damage of pi(o_hat), [n]
    denoised: Tensor  # the damage of pi(den(o_hat)), [K, n]
    threshold: float

    @classmethod
    def of(
        cls, perturbed: Tensor, view: View, policy: Callable[[Tensor], Tensor], of_action: Callable[[Tensor], Tensor]
    ) -> "Outcome":
        """The outcome of ``perturbed`` ``[n, obs_dim]``.

        Args:
            perturbed: what the defence is shown.
            view: the defence.
            policy: from observations ``[..., obs_dim]`` to actions.
            of_action: the damage ``[n]`` of actions ``[n, action_dim]``.
        """
        denoised = torch.vmap(of_action)(policy(view.denoise(perturbed)))
        return cls(view.deviation(perturbed), of_action(policy(perturbed)), denoised, view.threshold)

    @property
    def alarm(self) -> Tensor:
        """``[K, n]`` bool."""
        return self.deviation.amax(-1) > self.threshold

    @property
    def damage(self) -> Tensor:
        """The expected damage of what the defended policy really does, ``[n]``."""
        return torch.where(self.alarm, self.denoised, self.bare).mean(0)

    def quiet(self, allowed: float = 0.5) -> Tensor:
        """A stand-in for damage under the detector's nose: pi(o_hat)'s, and where too many samples alarm, the excess.

        There every component that deviates too far counts, not only the worst: so all are taken back at once.

        Args:
            allowed: the part of the samples that may alarm.
        """
        excess = (self.deviation - self.threshold).relu().sum(-1).mean(0)
        return torch.where(self.alarm.float().mean(0) > allowed, FORBIDDEN * (1 + excess), self.bare)

    def loud(self) -> Tensor:
        """A stand-in for damage through the denoiser: pi(den(o_hat))'s, and where most are silent, what is missing."""
        missing = (self.threshold - self.deviation.amax(-1)).relu().mean(0)
        return torch.where(self.alarm.float().mean(0) > 0.5, self.denoised.mean(0), FORBIDDEN * (1 + missing))


class AdaptiveAttack(InformedAttack):
    """The attack that the defence has to fear: the most damage by what the defended policy would really do.

    From several starts it climbs the damage of pi(o_hat) while the detector is silent, stepping back where it alarms,
    and the damage of pi(den(o_hat)) while it alarms, going on where it is silent (the switching method of Polyak, 1967,
    for a constraint). The points met on the way are measured by the damage of what is really done, and the best of each
    climb are judged over fresh samples, beside o itself and the point of the attack that does not know the defence. So
    by its own judgement it is never weaker than that attack.

    It looks one step ahead: what an observation leaves in the defence's memory, for later steps, is no part of the
    damage.

    Args:
        attack: opposite, Q-function or enchanting: what damage is, and one of the starts.
        steps: of each climb.
        restarts: random starts, beside that one.
        samples: K, latent samples that a climb averages over, the same ones all along.
        fresh: latent samples of the last judgement.
        seed: of the attacker's draws.
        view: see ``InformedAttack``.

    Raises:
        ValueError: if one of the numbers is not above 0.
    """

    aim: Callable[[Outcome], Tensor] = staticmethod(lambda outcome: outcome.damage)  # what the best point has most of
    ways: tuple[Callable[[Outcome], Tensor], ...] = (Outcome.quiet, Outcome.loud)  # what is climbed

    def __init__(
        self, attack: GradientAttack, steps: int = 100, restarts: int = 1, samples: int = 8, fresh: int = 32,
        seed: int = 0, view: Callable[..., View] = view_defense,
    ):  # fmt: skip
        super().__init__(attack, seed, view)
        self.steps, self.restarts, self.samples, self.fresh = steps, restarts, samples, fresh
        for name, number in self.settings.items():
            if not number > 0:
                raise ValueError(f"{name} must be above 0, not {number}")

    @property
    def settings(self) -> dict:
        return dict(steps=self.steps, restarts=self.restarts, samples=self.samples, fresh=self.fresh)

    def projection(self, obs: Tensor, wanted: Tensor) -> Callable[[Tensor], Tensor]:
        """The projection into what is allowed, for the wanted rows of ``obs`` ``[N, obs_dim]``."""
        return self.budget.projection(obs[wanted])

    def search(self, *problem, streams: RandomStreams) -> Tensor:
        """The point with the most damage that is met; ``problem`` is as in ``climb``, up to ``budget``."""
        return climb(*problem, self.steps)

    def perturb(
        self, obs: Tensor, wanted: Tensor, world, views: Callable[[int], View], streams: RandomStreams
    ) -> Tensor:
        true, project = obs[wanted], self.projection(obs, wanted)
        objective = self.attack.objective(true, world)
        unaware = self.attack.ascend(objective, obs, wanted)[wanted]
        outcome = partial(Outcome.of, view=views(self.samples), policy=self.policy, of_action=objective.of_action)

        def measure(perturbed: Tensor, stand_in: Callable[[Outcome], Tensor]) -> tuple[Tensor, Tensor]:
            found = outcome(perturbed)
            return self.aim(found), stand_in(found)

        candidates = [project(true), project(unaware)]
        for start in (unaware, *(self.budget.sample(true, streams) for _ in range(self.restarts))):
            for stand_in in self.ways:
                problem = partial(measure, stand_in=stand_in), start, project, self.budget
                candidates.append(self.search(*problem, streams=streams))
        judge = partial(outcome, view=views(self.fresh))
        best = torch.stack([self.aim(judge(point)) for point in candidates]).argmax(0)
        found = obs.clone()
        found[wanted] = torch.stack(candidates)[best, torch.arange(len(true))]
        return found


class GradientFreeAttack(AdaptiveAttack):
    """The cross-check: the same stand-ins and the same judgement, and a search that asks for no gradient.

    Where it does more damage than ``AdaptiveAttack`` the gradients are masked, and that attack proves nothing.

    Args:
        attack: see ``AdaptiveAttack``.
        population: points that are tried in each step.
        elites: how many of them the next are drawn like.
        **settings: the others of ``AdaptiveAttack``.
    """

    def __init__(self, attack: GradientAttack, population: int = 32, elites: int = 6, steps: int = 15, **settings):
        if not 2 <= elites <= population:
            raise ValueError(f"elites must be at least 2 and at most the population, not {elites}")
        self.population, self.elites = population, elites
        super().__init__(attack, steps, **settings)

    @property
    def settings(self) -> dict:
        return super().settings | dict(population=self.population, elites=self.elites)

    def search(self, *problem, streams: RandomStreams) -> Tensor:
        return evolve(*problem, self.steps, self.population, self.elites, streams)


class StealthyAttack(AdaptiveAttack):
    """The way under the threshold alone: the most damage to pi(o_hat) of which no sample rings the alarm.

    It is weaker than ``AdaptiveAttack``, and nobody notices. Where even o rings, it gives what rings the least.
    """

    aim = staticmethod(partial(Outcome.quiet, allowed=0.0))
    ways = (aim,)


class CoupledAttack(AdaptiveAttack):
    """An adaptive attack that drifts: for a detector with memory, to which a sudden change is suspicious.

    The perturbation may change by ``pace`` epsilon a step, and is nothing before the first and where it was not wanted.

    Args:
        attack: see ``AdaptiveAttack``; its ball must be of the norm inf, where both conditions together are a box.
        pace: a part of epsilon, above 0; from 2 on it is no condition.
        **settings: the others of ``AdaptiveAttack``.

    Raises:
        ValueError: for another norm.
    """

    def __init__(self, attack: GradientAttack, pace: float = 0.2, **settings):
        self.pace = pace
        super().__init__(attack, **settings)
        if self.budget.norm != inf:
            raise ValueError(f"budget: a coupled attack needs the norm inf, not {self.budget.norm}")

    @property
    def settings(self) -> dict:
        return super().settings | dict(pace=self.pace)

    def reset(self, episodes=None) -> None:
        super().reset(episodes)
        self.last = 0.0

    def __call__(self, obs: Tensor, world=None) -> Tensor:
        found = super().__call__(obs, world)
        self.last = found - obs
        return found

    def projection(self, obs: Tensor, wanted: Tensor) -> Callable[[Tensor], Tensor]:
        radius, true, before = self.budget.epsilon * self.budget.scale, obs[wanted], (obs + self.last)[wanted]
        low = torch.maximum(true - radius, before - self.pace * radius)
        high = torch.minimum(true + radius, before + self.pace * radius)
        return lambda perturbed: perturbed.clamp(low, high)
