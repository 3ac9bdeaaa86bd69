"""The enchanting attack: lure the policy into the actions of an adversarial planner (section 3.2.1, equation 4)."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from detden_lite.ascent import ascend
from detden_lite.budget import Budget
from detden_lite.draws import Draws
from detden_lite.planner import CEMPlanner
from detden_lite.victims import Victim


class EnchantingAttack:
    """At every attacked step a planner finds the worst actions from the world's present state, and the observation is
    perturbed so that the policy's action comes as close as it can to the first of them.

    Args:
        victim: the policy under attack.
        budget: the ball.
        planner: finds the target actions with the true simulator.
        steps: gradient steps towards the target.
        restarts: random starts; the best is taken.
        seed: of the random starts.
    """

    needs = frozenset({"policy", "simulator"})

    def __init__(
        self, victim: Victim, budget: Budget, planner: CEMPlanner, steps: int = 20, restarts: int = 1, seed: int = 0
    ):
        self.victim, self.budget, self.planner = victim, budget, planner
        self.steps, self.restarts, self.seed = steps, restarts, seed

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self.draws = Draws(self.seed, episodes)
        self.planner.reset(episodes)

    def __call__(self, obs: Tensor, world) -> Tensor:
        wanted = world.wanted if world.wanted is not None else np.ones(len(obs), dtype=bool)
        target = torch.from_numpy(self.planner.plan(world.simulator.envs, wanted)).to(obs.dtype)

        def closeness(perturbed: Tensor) -> Tensor:
            return -(self.victim.straight_through(perturbed) - target).square().sum(-1)

        return ascend(closeness, obs, self.budget, self.draws, self.steps, restarts=self.restarts)
