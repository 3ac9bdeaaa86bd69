"""The optimal attack: perturbations by a policy that learned to harm the victim (section 3.2.1, equation 3)."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from detden_lite.attacks.base import BallAttack
from detden_lite.core.budget import Budget
from detden_lite.core.types import World


def perturb(budget: Budget, obs: Tensor, direction: Tensor) -> Tensor:
    """proj_B(o + epsilon * scale * a), the point of B(o) that a ``direction`` a means, all ``[N, obs_dim]``."""
    return budget.project(obs, obs + budget.epsilon * budget.scale * direction)


class History:
    """The last k observations of N episodes, the newest first; before the first step there was only the first one.

    Example:
        >>> history = History(2)
        >>> history.push(torch.zeros(1, 2)), history.push(torch.ones(1, 2))
        (tensor([[0., 0., 0., 0.]]), tensor([[1., 1., 0., 0.]]))
    """

    def __init__(self, k: int) -> None:
        self.k, self.seen = k, torch.empty(0)

    def reset(self) -> None:
        """Begin new episodes."""
        self.seen = torch.empty(0)

    def push(self, obs: Tensor) -> Tensor:
        """The last k observations ``[N, k * obs_dim]`` after the next one ``[N, obs_dim]``."""
        older = self.seen[:, : -obs.shape[1]] if len(self.seen) else obs.repeat(1, self.k - 1)
        self.seen = torch.cat([obs, older], dim=1)
        return self.seen

    def restart(self, i: int, obs: Tensor) -> None:
        """Begin a new episode in row i with this observation ``[obs_dim]``."""
        self.seen[i] = obs.repeat(self.k)


class OptimalAttack(BallAttack):
    """The perturbation is the action of an adversarial policy, which sees the true observation.

    During an episode it does not query the victim. The adversary has learned before, by acting on the victim in the
    simulator and watching the reward: to it the policy was a black box. So the attack ``needs`` an adversary. One that
    sees k times as many numbers as it perturbs is shown the last k observations.

    Args:
        adversary: maps observations ``[N, obs_dim]`` to as many numbers in [-1, 1], in units of the ball's radius: a
            ``Victim`` whose actions are perturbations, see ``detden_lite.load_adversary``.
        budget: the ball.

    Raises:
        ValueError: if the adversary is a policy with another number of actions, or, at the first call, of another task.

    Example:
        >>> from detden_lite import Budget, OptimalAttack
        >>> attack = OptimalAttack(lambda obs: -obs.sign(), Budget(0.1))  # an adversary that shrinks every number
        >>> attack.reset([0])
        >>> attack(torch.tensor([[1.0, -2.0, 0.0]]))
        tensor([[ 0.9000, -1.9000,  0.0000]])
    """

    needs = frozenset({"adversary"})

    def __init__(self, adversary: Callable[[Tensor], Tensor], budget: Budget) -> None:
        seen = getattr(adversary, "obs_dim", None)
        size = getattr(adversary, "action_dim", seen)
        if seen is not None and (size is None or seen % size):
            raise ValueError(f"adversary: it perturbs {size} numbers of {seen}; give the adversary of this task")
        super().__init__(budget, size, "adversary")
        self.adversary, self.history = adversary, History(seen // size if seen and size else 1)

    def reset(self, episodes: Sequence[int] | None = None) -> None:
        """Begin new episodes, one seed each; None for offline use on any number of rows."""
        super().reset(episodes)
        self.history.reset()

    @torch.no_grad()
    def __call__(self, obs: Tensor, world: World | None = None) -> Tensor:
        """The perturbed observations ``[N, obs_dim]``."""
        self.check(obs)
        direction = self.adversary(self.history.push(obs) if self.history.k > 1 else obs)
        if direction.shape[-1] != obs.shape[1]:
            found, right = direction.shape[-1], obs.shape[1]
            raise ValueError(f"adversary: it perturbs {found} numbers of {right}; give the adversary of this task")
        return perturb(self.budget, obs, direction)
