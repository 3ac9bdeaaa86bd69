"""MDPs so small that values are exact: here the first inequality of appendix A can be checked, and broken."""

from dataclasses import dataclass

import numpy as np

from detden_lite.core.arguments import check_between


@dataclass(frozen=True)
class FiniteMDP:
    """An MDP of numbered states and actions; the policy observes the state, or another one that an attacker shows.

    Args:
        transition: P(s' | s, a), ``[S, A, S]``.
        reward: R(s, a, s'), ``[S, A, S]``.
        gamma: the discount, in [0, 1).

    Raises:
        ValueError: if the shapes differ, a row of ``transition`` is no distribution, a reward is not finite, or gamma
            is out of range.

    Example:
        >>> mdp, policy = leaving(gamma=0.5, tv=0.1)
        >>> mdp.value(policy)
        array([ 2., -2.])
        >>> mdp.value(policy[mdp.worst_attack(policy, np.ones((2, 2), bool))]).round(2)
        array([ 1.27, -2.  ])
    """

    transition: np.ndarray
    reward: np.ndarray
    gamma: float

    def __post_init__(self) -> None:
        shape = self.transition.shape
        if len(shape) != 3 or shape[0] != shape[2] or shape != self.reward.shape:
            raise ValueError(
                f"transition and reward are [S, A, S], not {self.transition.shape} and {self.reward.shape}"
            )
        if (self.transition < 0).any() or not np.allclose(self.transition.sum(-1), 1):
            raise ValueError("transition: from every state, every action's probabilities must sum to 1")
        if not np.isfinite(self.reward).all():
            raise ValueError("reward holds NaN or infinity")
        if not 0 <= self.gamma < 1:
            raise ValueError(f"gamma must be in [0, 1), not {self.gamma}")

    @property
    def reward_range(self) -> float:
        """R_max - R_min over all transitions that can happen."""
        possible = self.reward[self.transition > 0]
        return float(possible.max() - possible.min())

    def action_values(self, value: np.ndarray) -> np.ndarray:
        """sum_s' P(s' | s, a) (R(s, a, s') + gamma value(s')), ``[S, A]``."""
        return (self.transition * (self.reward + self.gamma * value)).sum(-1)

    def value(self, policy: np.ndarray) -> np.ndarray:
        """V_pi ``[S]`` of a policy pi(a | s), ``[S, A]``: the Bellman equation, solved.

        Raises:
            ValueError: if the policy has another shape, or a row of it is no distribution.
        """
        check_policy(policy, self.transition.shape[:2])
        step = np.einsum("sa,sat->st", policy, self.transition)
        reward = (policy * (self.transition * self.reward).sum(-1)).sum(-1)
        return np.linalg.solve(np.eye(len(step)) - self.gamma * step, reward)

    def worst_attack(self, policy: np.ndarray, allowed: np.ndarray) -> np.ndarray:
        """The attacker nu that makes V_{pi o nu} smallest in every state at once, by policy iteration.

        Args:
            policy: pi(a | s), ``[S, A]``.
            allowed: whether state t may be shown in state s, ``[S, S]`` bool; the true state always may.

        Returns:
            The state that is shown in each state, ``[S]`` integers. The policy under attack is ``policy[nu]``.

        Raises:
            ValueError: if the policy does not belong to this MDP, or ``allowed`` has another shape.
        """
        check_policy(policy, self.transition.shape[:2])
        _check_allowed(allowed, len(policy))
        allowed = allowed | np.eye(len(policy), dtype=bool)
        shown = np.arange(len(policy))
        while True:
            values = self.action_values(self.value(policy[shown])) @ policy.T  # of showing t once in s, [S, S]
            values = np.where(allowed, values, np.inf)
            better = values.argmin(1)
            rows = np.arange(len(policy))
            gains = values[rows, better] < values[rows, shown] - 1e-12 * (1 + np.abs(values[rows, shown]))
            if not gains.any():
                return shown
            shown = np.where(gains, better, shown)


def largest_tv(policy: np.ndarray, allowed: np.ndarray) -> float:
    """The largest TV(pi(. | s), pi(. | t)), half the l1 distance, over s and the states t that may be shown there.

    Args:
        policy: pi(a | s), ``[S, A]``.
        allowed: whether state t may be shown in state s, ``[S, S]`` bool.

    Raises:
        ValueError: if a row of the policy is no distribution, or ``allowed`` has another shape.

    Example:
        >>> largest_tv(np.array([[1.0, 0.0], [0.25, 0.75]]), np.ones((2, 2), bool))
        0.75
    """
    check_policy(policy, policy.shape)
    _check_allowed(allowed, len(policy))
    tv = 0.5 * np.abs(policy[:, None] - policy[None]).sum(-1)
    return min(1.0, float(tv[allowed].max(initial=0.0)))  # rounding may exceed 1


def leaving(gamma: float, tv: float) -> tuple[FiniteMDP, np.ndarray]:
    """An MDP and a policy that lose as much as a total variation allows: ``bound.coupled`` is equal to the loss.

    State 0 pays 1 a step as long as action 0 is taken there. Action 1 leads to state 1 for ever and pays -1, as does
    state 1. The policy takes action 0 in state 0, and takes action 1 with probability ``tv`` if it sees state 1.

    Raises:
        ValueError: if ``tv`` is not between 0 and 1, or ``gamma`` not in [0, 1).
    """
    check_between(0, 1, tv=tv)
    transition = np.zeros((2, 2, 2))
    transition[0, 0, 0] = transition[0, 1, 1] = transition[1, :, 1] = 1
    reward = np.broadcast_to([1.0, -1.0], (2, 2, 2)).copy()  # by where it leads
    return FiniteMDP(transition, reward, gamma), np.array([[1.0, 0.0], [1 - tv, tv]])


def check_policy(policy: np.ndarray, shape: tuple[int, ...]) -> None:
    """Refuse an array that is no policy pi(a | s) of this shape ``[S, A]``; a ValueError says why."""
    if policy.shape != shape or policy.ndim != 2:
        raise ValueError(f"policy must be [S, A] = {list(shape)}, not {list(policy.shape)}")
    if not (policy >= 0).all() or not np.allclose(policy.sum(-1), 1):
        raise ValueError("policy: in every state, the actions' probabilities must sum to 1")


def _check_allowed(allowed: np.ndarray, states: int) -> None:
    if allowed.shape != (states, states) or allowed.dtype != bool:
        raise ValueError(f"allowed must be bool [{states}, {states}], not {allowed.dtype} {list(allowed.shape)}")
