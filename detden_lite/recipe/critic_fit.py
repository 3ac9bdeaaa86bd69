"""How well a Q-function knows what actions do: its prediction against the same episode played again."""

from dataclasses import dataclass
from math import ceil, log

import numpy as np
import torch
from torch import Tensor

from detden_lite.attacks.held import CornerAttack
from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.core.arguments import check_between
from detden_lite.core.budget import Budget
from detden_lite.core.tasks import Task
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim

LATEST = 200  # the last step at which an action is changed
REST = 1e-3  # the weight that later rewards have when an effect counts as complete


@dataclass(frozen=True)
class Fit:
    """How well Q predicts discounted returns, and what a changed action gains or costs.

    ``explained_variance`` is 1 for a perfect prediction and 0 for a constant. ``effect_correlation`` is that of
    Q(o, a) - Q(o, pi(o)) with the measured difference of the returns: above 0, Q knows which actions are worse.

    Example:
        >>> Fit(explained_variance=0.9, effect_correlation=0.4, actions=256, episodes=64).effect_correlation > 0.3
        True
    """

    explained_variance: float
    effect_correlation: float
    actions: int
    episodes: int


class _Once:
    """Attack each episode at one step of its own."""

    def __init__(self, at: np.ndarray) -> None:
        self.at = torch.from_numpy(at)

    def reset(self, episodes: object) -> None:
        self.step = 0

    def __call__(self, obs: Tensor) -> Tensor:
        now = self.at == self.step
        self.step += 1
        return now


def judge_q(victim: Victim, task: Task, seeds: range, budget: Budget, gamma: float, horizon: int | None = None) -> Fit:
    """Play each episode once as it is, and again with one action changed as attacks change it.

    Up to that action both are the same to the last bit, and after it the policy goes on without any attack: the
    difference of the discounted returns is what the action has done. Each episode is played with four changes, two by
    the opposite attack and two by random corners of the ball.

    Args:
        victim: a policy with a Q-function.
        task: where it acts.
        seeds: one an episode; none that Q was learned from.
        budget: the attacker's ball.
        gamma: the discount factor of Q, below 1.
        horizon: the longest an episode may be; the task's by default.

    Raises:
        ValueError: if the victim has no Q-function, or gamma is not above 0 and below 1.

    Example:
        >>> from detden_lite import Budget, get_task, load_victim
        >>> victim, task = load_victim("hopper", "td3"), get_task("hopper")
        >>> judge_q(victim, task, range(2), Budget(task.epsilon), gamma=0.9, horizon=10).actions
        8
    """
    check_between(0, 1, gamma=gamma)
    if gamma in (0, 1):
        raise ValueError(f"gamma must be above 0 and below 1, not {gamma}")
    horizon = horizon or task.horizon
    steps = min(ceil(log(REST) / log(gamma)), -(-horizon // 2))
    longest = min(LATEST, horizon - steps) + steps
    rows, later = np.arange(len(seeds)), np.arange(steps)[:, None]

    clean = rollout(victim, task, seeds, steps=longest)
    share = np.random.default_rng(0).random(len(seeds))
    at = (share * np.minimum(clean.lengths, longest - steps + 1)).astype(int)
    opposite = [OppositeAttack(victim, budget, steps=3, seed=seed) for seed in range(2)]
    attacks: list[OppositeAttack | CornerAttack] = [*opposite, *(CornerAttack(budget, seed=seed) for seed in range(2))]
    changed = [rollout(victim, task, seeds, attack=attack, timing=_Once(at), steps=longest) for attack in attacks]

    obs, q, returns = torch.from_numpy(clean.obs[at, rows]), np.zeros((5, len(seeds))), np.zeros((5, len(seeds)))
    for i, episodes in enumerate([clean, *changed]):
        reward = np.zeros((longest, len(seeds)))
        reward[: len(episodes.reward)] = episodes.reward
        returns[i] = gamma ** later[:, 0] @ reward[at + later, rows]
        q[i] = victim.qs(obs, torch.from_numpy(episodes.action[at, rows])).mean(0)
    predicted, measured = (q[1:] - q[0]).ravel(), (returns[1:] - returns[0]).ravel()
    varied = predicted.std() > 1e-9 and measured.std() > 1e-9
    return Fit(
        explained_variance=float(1 - (returns - q).var() / returns.var()) if returns.std() > 1e-9 else 0.0,
        effect_correlation=float(np.corrcoef(predicted, measured)[0, 1]) if varied else 0.0,
        actions=len(measured),
        episodes=len(seeds),
    )
