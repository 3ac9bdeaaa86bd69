"""The enchanting attack: lure the policy into the actions of an adversarial planner (section 3.2.1, equation 4)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.core.budget import Budget
from detden_lite.core.types import World
from detden_lite.simulation.planner import CEMPlanner
from detden_lite.victims.action_gradients import ActionObjective
from detden_lite.victims.victim import Victim


class EnchantingAttack(GradientAttack):
    """A planner finds the worst actions from the world's present state, and the attack lures the policy into the first.

    At every attacked step the observation is perturbed so that the policy's action comes as close as it can to the
    planner's. Planning is slow, and needs the true simulator.

    Args:
        victim: the policy under attack.
        budget: the ball.
        planner: finds the target actions with the true simulator.
        steps: gradient steps towards the target.
        restarts: random starts; the best is taken.
        seed: of the random starts.

    Raises:
        ValueError: as ``GradientAttack``; without the seeds of the episodes; or without a simulator in the world.

    Example:
        >>> from detden_lite import Budget, CEMPlanner, EnchantingAttack, get_task, load_victim, rollout
        >>> victim, task = load_victim("hopper", "td3"), get_task("hopper")
        >>> planner = CEMPlanner(task.env_id, horizon=5, population=8, iterations=1, elites=2)
        >>> attack = EnchantingAttack(victim, Budget(task.epsilon), planner, steps=5)
        >>> rollout(victim, task, [0], attack=attack, steps=3).perturbed.shape
        (3, 1, 11)
    """

    needs = frozenset({"policy", "simulator"})

    def __init__(
        self, victim: Victim, budget: Budget, planner: CEMPlanner, steps: int = 20, restarts: int = 1, seed: int = 0
    ) -> None:
        super().__init__(victim, budget, steps, restarts, seed)
        self.planner = planner

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; there is no offline use."""
        if episodes is None:
            raise ValueError("episodes: this attack plans in the simulator; give one seed for each of its episodes")
        super().reset(episodes)
        self.planner.reset(episodes)

    def objective(self, obs: Tensor, world: World | None = None) -> ActionObjective:
        """Minus the squared distance of the policy's action to the planner's."""
        if world is None or world.simulator is None:
            raise ValueError("world: it has no simulator to plan in; use the attack in detden_lite.rollout")
        target = torch.from_numpy(self.planner.plan(world.simulator.envs, world.wanted)[world.wanted]).to(obs.dtype)
        return ActionObjective(self.policy, lambda action: -(action - target).square().sum(-1))
