"""The Q-function attack: make the policy do what its own critic likes least (section 3.2.1, equation 2)."""

from collections.abc import Callable

from torch import Tensor

from detden_lite.attacks.gradient import GradientAttack
from detden_lite.core.types import World
from detden_lite.victims.action_gradients import ActionObjective
from detden_lite.victims.victim import Victim


def badness(victim: Victim, obs: Tensor) -> Callable[[Tensor], Tensor]:
    """-Q(o, .) as a function of actions ``[N, action_dim]``: how bad each is in the true ``obs``, ``[N]``.

    Q is the mean of the critics. Where they disagree at least one is wrong, and in the mean such errors partly cancel;
    the smallest of them would send the attacker to wherever one of them errs.
    """
    return lambda action: -victim.qs(obs, action).mean(0)


def q_objective(victim: Victim, obs: Tensor) -> Callable[[Tensor], Tensor]:
    """-Q(o, pi(.)): how bad the action is that the policy takes when it sees ``[N, obs_dim]`` perturbed.

    Q always sees the true ``obs``, for the world is the same whatever the policy is shown.
    """
    bad = badness(victim, obs)
    return lambda perturbed: bad(victim.straight_through(perturbed))


class QFunctionAttack(GradientAttack):
    """Projected gradient descent on Q(o, pi(.)); see ``GradientAttack`` for the arguments.

    Raises:
        ValueError: if the victim has no Q-function.
    """

    needs = frozenset({"policy", "critic"})

    def objective(self, obs: Tensor, world: World | None = None) -> ActionObjective:
        """``q_objective``, with the policy's gradient by hand."""
        return ActionObjective(self.policy, badness(self.victim, obs))
