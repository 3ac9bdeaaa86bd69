"""Attacks that climb an objective of their own by projected gradient ascent."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from detden_lite.attacks.base import BallAttack
from detden_lite.core.arguments import check_kind, check_whole
from detden_lite.core.ascent import ascend
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.types import World
from detden_lite.victims.action_gradients import ActionObjective, Policy
from detden_lite.victims.victim import Victim


class GradientAttack(BallAttack, ABC):
    """Projected gradient ascent from a random start, at every call.

    Args:
        victim: the policy under attack.
        budget: the ball.
        steps: gradient steps (1 is FGSM).
        restarts: random starts; the best is taken.
        seed: of the random starts.
        dtype: in which the networks are computed. bfloat16 is for large sets offline, on a processor that has it.
        by_hand: whether gradients are computed by hand, or by autograd, which is slower: see ``Policy``.

    Raises:
        ValueError: if an argument is of another kind or not in its range; and at the first call, if the observations
            are of another task.

    Example:
        >>> from detden_lite import ActionObjective, Budget, GradientAttack, Victim
        >>> class Slow(GradientAttack):  # makes the first action as small as possible
        ...     needs = frozenset({"policy"})
        ...     def objective(self, obs, world=None):
        ...         return ActionObjective(self.policy, lambda action: -action[:, 0])
        >>> victim, obs = Victim([11, 8, 3]), torch.zeros(4, 11)
        >>> attack = Slow(victim, Budget(0.1))
        >>> attack.reset(range(4))
        >>> bool((victim(attack(obs))[:, 0] < victim(obs)[:, 0]).all())
        True
    """

    clips = True  # whether a Gaussian policy's mean is clipped to the action bounds before it is judged

    def __init__(
        self, victim: Victim, budget: Budget, steps: int = 20, restarts: int = 1, seed: int = 0,
        dtype: torch.dtype = torch.float32, by_hand: bool = True,
    ) -> None:  # fmt: skip
        check_kind(Victim, victim=victim)
        check_whole(1, steps=steps, restarts=restarts)
        super().__init__(budget, victim.obs_dim)
        self.victim, self.steps, self.restarts, self.seed = victim, steps, restarts, seed
        self.policy = Policy(victim, self.clips, dtype, by_hand)

    @abstractmethod
    def objective(self, obs: Tensor, world: World | None = None) -> ActionObjective:
        """The objective to be maximised, for perturbed observations of ``obs`` ``[n, obs_dim]``, the wanted rows."""

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        super().reset(episodes)
        self.streams = RandomStreams(self.seed, episodes)

    def __call__(self, obs: Tensor, world: World | None = None) -> Tensor:
        """Perturbed observations ``[N, obs_dim]``; rows that the world does not want come back as they are."""
        self.check(obs)
        wanted = torch.ones(len(obs), dtype=torch.bool) if world is None else torch.from_numpy(world.wanted)
        return self.ascend(self.objective(obs[wanted], world), obs, wanted)

    def ascend(self, objective: Callable[[Tensor], Tensor], obs: Tensor, wanted: Tensor) -> Tensor:
        """The ascent on an objective of the wanted rows, with this attack's steps, restarts and random starts."""
        return ascend(objective, obs, self.budget, self.streams, self.steps, restarts=self.restarts, wanted=wanted)
