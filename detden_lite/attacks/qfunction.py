"""The Q-function attack: make the policy take the action with the lowest Q-value (section 3.2.1, equation 2)."""

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

    Q always sees the true ``obs``: the state of the world does not depend on what the policy is shown.

    Raises:
        ValueError: if the victim has no Q-function.

    Example:
        >>> import torch
        >>> from detden_lite import Victim, q_objective
        >>> victim, obs = Victim([11, 8, 3], critic=[14, 8, 1], n_critics=1), torch.zeros(2, 11)
        >>> bool(torch.allclose(q_objective(victim, obs)(obs), -victim.value(obs)))
        True
    """
    bad = badness(victim, obs)
    return lambda perturbed: bad(victim.straight_through(perturbed))


class QFunctionAttack(GradientAttack):
    """Projected gradient descent on Q(o, pi(.)); see ``GradientAttack`` for the arguments.

    Raises:
        ValueError: if the victim has no Q-function, at the first call.

    Example:
        >>> import torch
        >>> from detden_lite import Budget, QFunctionAttack, Victim
        >>> victim, obs = Victim([11, 8, 3], critic=[14, 8, 1], n_critics=1), torch.zeros(2, 11)
        >>> attack = QFunctionAttack(victim, Budget(0.1))
        >>> attack.reset([0, 1])
        >>> bool((victim.q(obs, victim(attack(obs))) < victim.value(obs)).all())
        True
    """

    needs = frozenset({"policy", "critic"})

    def objective(self, obs: Tensor, world: World | None = None) -> ActionObjective:
        """``q_objective``, with the policy's gradient by hand."""
        return ActionObjective(self.policy, badness(self.victim, obs))
