"""When to attack: the vulnerability indicator 1_vul and its controls (section 3.2.2)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from detden_lite.core.arguments import check_between, check_number, check_whole
from detden_lite.core.random_streams import RandomStreams
from detden_lite.victims.victim import Victim


class Always:
    """Attack at every step.

    Example:
        >>> Always()(torch.zeros(2, 11))
        tensor([True, True])
    """

    def reset(self, episodes: Sequence[int]) -> None:
        pass

    def __call__(self, obs: Tensor) -> Tensor:
        return torch.ones(len(obs), dtype=torch.bool)


class Vulnerable:
    """1_vul: attack where V(o) < C_vul.

    Args:
        victim: its value function is used.
        threshold: C_vul, in units of discounted return.

    Raises:
        ValueError: if the threshold is no number.

    Example:
        >>> from detden_lite import Victim, Vulnerable
        >>> victim, obs = Victim([11, 8, 3], value=[11, 8, 1], gaussian=True), torch.zeros(1, 11)
        >>> Vulnerable(victim, victim.value(obs).item() + 1)(obs), Vulnerable(victim, victim.value(obs).item())(obs)
        (tensor([True]), tensor([False]))
    """

    def __init__(self, victim: Victim, threshold: float) -> None:
        check_number(threshold=threshold)
        self.victim, self.threshold = victim, threshold

    def reset(self, episodes: Sequence[int]) -> None:
        pass

    def __call__(self, obs: Tensor) -> Tensor:
        return self.victim.value(obs) < self.threshold


class After:
    """Attack at every step from ``step`` on: to attack a robot that is already walking.

    Example:
        >>> timing = After(1)
        >>> timing.reset([0])
        >>> [timing(torch.zeros(1, 11)).item() for _ in range(3)]
        [False, True, True]
    """

    def __init__(self, step: int) -> None:
        check_whole(0, step=step)
        self.step = step

    def reset(self, episodes: Sequence[int]) -> None:
        self.passed = 0

    def __call__(self, obs: Tensor) -> Tensor:
        now = self.passed >= self.step
        self.passed += 1
        return torch.full((len(obs),), now)


class Random:
    """Attack at random steps, a fraction ``rate`` of them: the control that a timing must beat at the same rate.

    Example:
        >>> timing = Random(1.0)
        >>> timing.reset([0, 1])
        >>> timing(torch.zeros(2, 11))
        tensor([True, True])
    """

    def __init__(self, rate: float, seed: int = 0) -> None:
        check_between(0, 1, rate=rate)
        self.rate, self.seed = rate, seed

    def reset(self, episodes: Sequence[int]) -> None:
        self.streams = RandomStreams(self.seed, episodes)

    def __call__(self, obs: Tensor) -> Tensor:
        return self.streams.uniform(len(obs), 1).squeeze(-1) < self.rate
