"""MDPs so small that values are exact: where the first inequality of appendix A can be checked, and broken."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FiniteMDP:
    """States and actions are numbers; the policy observes the state, or what an attacker shows it instead.

    Args:
        transition: P(s' | s, a), ``[S, A, S]``.
        reward: R(s, a, s'), ``[S, A, S]``.
        gamma: the discount, in [0, 1).

    Raises:
        ValueError: if the shapes differ, a row of ``transition`` is no distribution, or gamma is out of range.
    """

    transition: np.ndarray
    reward: np.ndarray
    gamma: float

    def __post_init__(self):
        states, _, following = self.transition.shape
        if states != following or self.transition.shape != self.reward.shape:
            raise ValueError(
                f"transition and reward are [S, A, S], not {self.transition.shape} and {self.reward.shape}"
            )
        if (self.transition < 0).any() or not np.allclose(self.transition.sum(-1), 1):
            raise ValueError("transition: from every state, every action's probabilities must sum to 1")
        if not 0 <= self.gamma < 1:
            raise ValueError(f"gamma must be in [0, 1), not {self.gamma}")

    @property
    def reward_range(self) -> float:
        """R_max - R_min over what can happen."""
        possible = self.reward[self.transition > 0]
        return float(possible.max() - possible.min())

    def action_values(self, value: np.ndarray) -> np.ndarray:
        """sum_s' P(s' | s, a) (R(s, a, s') + gamma value(s')), ``[S, A]``."""
        return (self.transition * (self.reward + self.gamma * value)).sum(-1)

    def value(self, policy: np.ndarray) -> np.ndarray:
        """V_pi ``[S]`` of a policy pi(a | s), ``[S, A]``: the Bellman equation, solved."""
        step = np.einsum("sa,sat->st", policy, self.transition)
        reward = (policy * (self.transition * self.reward).sum(-1)).sum(-1)
        return np.linalg.solve(np.eye(len(step)) - self.gamma * step, reward)

    def worst_attack(self, policy: np.ndarray, allowed: np.ndarray) -> np.ndarray:
        """The attacker nu that makes V_{pi o nu} smallest in every state at once, by policy iteration.

        Args:
            policy: pi(a | s), ``[S, A]``.
            allowed: whether state t may be shown in state s, ``[S, S]`` bool; the true state always may.

        Returns:
            What is shown in each state, ``[S]`` integers. The policy under attack is ``policy[nu]``.
        """
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
    """max over s and what may be shown there of TV(pi(. | s), pi(. | shown)), half the l1 distance."""
    tv = 0.5 * np.abs(policy[:, None] - policy[None]).sum(-1)
    return float(tv[allowed].max(initial=0.0))


def leaving(gamma: float, tv: float) -> tuple[FiniteMDP, np.ndarray]:
    """The MDP and the policy that lose most for their total variation: ``bound.coupled`` is equal to the loss.

    State 0 pays 1 a step as long as action 0 is taken there. Action 1 leads to state 1 for ever and pays -1, as does
    state 1. The policy takes action 0 in state 0, and takes action 1 with probability ``tv`` if it sees state 1.
    """
    transition = np.zeros((2, 2, 2))
    transition[0, 0, 0] = transition[0, 1, 1] = transition[1, :, 1] = 1
    reward = np.broadcast_to([1.0, -1.0], (2, 2, 2)).copy()  # by where it leads
    return FiniteMDP(transition, reward, gamma), np.array([[1.0, 0.0], [1 - tv, tv]])
