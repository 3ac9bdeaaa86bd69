"""The director attack: a learned director says where the action should go, gradients find how (Sun et al., 2022)."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.core.ascent import ascend
from detden_lite.core.budget import Budget
from detden_lite.core.types import World
from detden_lite.victims.action_gradients import ActionObjective
from detden_lite.victims.victim import Victim


class DirectorAttack(GradientAttack):
    """A director chooses a direction in the space of actions; gradient ascent moves the policy's action along it.

    Learning in the space of actions, of which there are few, is easier than learning perturbations of observations, of
    which there are many. The director learns by reinforcement (PA-AD), with the victim's negated reward; the ascent
    knows the policy.

    Args:
        director: maps observations ``[N, obs_dim]`` to directions ``[N, action_dim]`` in [-1, 1], in units of half an
            action's range; see ``detden_lite.load_adversary``.
        victim: the policy under attack.
        budget: the ball.
        steps: of the ascent.

    Raises:
        ValueError: as ``GradientAttack``; and if the director is a policy of another task.

    Example:
        >>> from detden_lite import Budget, DirectorAttack, Victim
        >>> victim, obs = Victim([11, 8, 3]), torch.zeros(1, 11)
        >>> attack = DirectorAttack(lambda obs: torch.tensor([[1.0, 0.0, 0.0]]), victim, Budget(0.1))
        >>> attack.reset([0])
        >>> bool(victim(attack(obs))[0, 0] > victim(obs)[0, 0])  # the first action is as large as it can be
        True
    """

    needs = frozenset({"policy", "adversary"})

    def __init__(
        self, director: Callable[[Tensor], Tensor] | None, victim: Victim, budget: Budget, steps: int = 5
    ) -> None:
        super().__init__(victim, budget, steps)
        seen, moved = (getattr(director, name, getattr(victim, name)) for name in ("obs_dim", "action_dim"))
        if (seen, moved) != (victim.obs_dim, victim.action_dim):
            own = f"{victim.obs_dim} to {victim.action_dim}"
            raise ValueError(f"director: it leads from {seen} numbers to {moved}, the victim from {own}")
        self.director = director

    def objective(self, obs: Tensor, world: World | None = None) -> ActionObjective:
        """The policy's action along the director's direction."""
        if self.director is None:
            raise ValueError("director is None, which is for the training of one; give one that has learned")
        return self.along(self.director(obs))

    def along(self, direction: Tensor) -> ActionObjective:
        """The action along a ``direction`` ``[N, action_dim]``."""
        weights = 2 * direction / (self.victim.action_high - self.victim.action_low)
        return ActionObjective(self.policy, lambda action: (action * weights).sum(-1))

    def follow(self, obs: Tensor, direction: Tensor) -> Tensor:
        """The perturbed observations ``[N, obs_dim]`` for a ``direction`` that is already known."""
        return self.ascend(self.along(direction), obs, torch.ones(len(obs), dtype=torch.bool))

    def ascend(self, objective: Callable[[Tensor], Tensor], obs: Tensor, wanted: Tensor) -> Tensor:
        # Its gradient is nowhere 0 at o, so that the ascent needs no random start and an episode no random numbers.
        return ascend(objective, obs, self.budget, None, self.steps, wanted=wanted)
