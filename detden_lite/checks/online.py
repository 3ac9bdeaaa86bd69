"""Checks of the chapter on online adversarial training."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare


def check_kl(kl: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``kl(mean, other, std)`` is the KL divergence of two Gaussians with Sigma = diag(std^2), ``[N]``."""
    draw = torch.Generator().manual_seed(0)
    mean, other = torch.randn(2, 5, 3, generator=draw)
    std = torch.tensor([0.5, 2.0, 1.5])
    moved = mean - other
    squares = (moved / std).square()
    mistakes = {
        "That is the squared Mahalanobis distance, R_ppo; the divergence is half of it": squares.sum(-1),
        "Sigma is missing: divide each difference by its standard deviation": moved.square().sum(-1) / 2,
        "Sigma holds VARIANCES, std squared: divide the squares by std^2": (moved.square() / std).sum(-1) / 2,
        "Sum over the actions; that is their mean": squares.mean(-1) / 2,
        "The divergence is half of the squared distance, without a root": squares.sum(-1).sqrt() / 2,
        "Square before you sum, or differences of opposite signs cancel": (moved / std).sum(-1).square() / 2,
    }
    got, call = kl(mean, other, std), "kl(mean, other, std)"
    assert array(call, got).shape != (), f"{call} gives one number for all observations; each has its own, [N]"
    compare(call, got, squares.sum(-1) / 2, mistakes)
    print("Right. With equal variances it does not matter which of the two comes first.")


def check_inner_maximum(
    inner_maximum: Callable[[Callable[[Tensor], Tensor], Tensor, Tensor, Tensor, float, int], Tensor],
) -> None:
    """``inner_maximum(policy, std, obs, start, epsilon, steps)`` climbs the KL divergence within the ball.

    It gives points ``[N, obs_dim]``. ``policy`` maps observations to means; ``start`` lies in the ball of radius
    ``epsilon`` (l-infinity) around ``obs``.
    """
    draw = torch.Generator().manual_seed(0)
    weights, obs = torch.randn(10, 2, generator=draw) / 2, torch.randn(6, 10, generator=draw)
    std, epsilon = torch.tensor([1.0, 2.0]), 0.2

    def policy(points: Tensor) -> Tensor:
        return torch.tanh(points @ weights)

    def divergence(points: Tensor) -> Tensor:
        return ((policy(points) - policy(obs)) / std).square().sum(-1) / 2

    start = obs + epsilon * (2 * torch.rand(6, 10, generator=draw) - 1)
    call = "inner_maximum(policy, std, obs, start, epsilon, steps=10)"
    got = torch.as_tensor(array(call, inner_maximum(policy, std, obs, start, epsilon, 10)), dtype=torch.float32)
    assert got.shape == obs.shape, f"{call} has the shape {tuple(got.shape)}; it should have {tuple(obs.shape)}"
    outside = (got - obs).abs().max().item()
    assert outside <= epsilon + 1e-5, (
        f"{call} leaves the ball: a number moved by {outside:.3g}, and epsilon is {epsilon}. Clip after each step, to "
        "the ball around obs and not around the last point"
    )
    found, begun = divergence(got), divergence(start)
    assert not torch.allclose(got, obs, atol=1e-6), (
        f"{call} stays at obs: there the divergence is 0, its smallest value, and has no slope. Begin at start"
    )
    assert (found >= begun - 1e-6).all(), (
        f"{call} is smaller than at the start in {int((found < begun).sum())} of 6 rows: climb, along +sign(gradient)"
    )
    tried = [obs + epsilon * (2 * torch.rand(6, 10, generator=draw) - 1) for _ in range(50)]
    best = torch.stack([divergence(points) for points in tried]).amax(0)
    assert found.mean() > best.mean(), (
        f"{call} reaches {found.mean():.3f} on average, and the best of 50 random points {best.mean():.3f}: are the "
        "steps long enough to cross the ball, and is the policy at obs held fixed?"
    )
    print("Right. A few steps find more than many random points do.")


class Statistics:
    """A running mean and variance of observations, for the exercise on turns.

    Example:
        >>> statistics = Statistics(1)
        >>> statistics.update(np.array([[1.0], [3.0]]))
        >>> statistics.normalize(np.array([[2.0], [3.0]])).ravel().round(3)
        array([0., 1.])
    """

    def __init__(self, dim: int) -> None:
        self.count, self.mean, self.var = 0, np.zeros(dim), np.ones(dim)

    def update(self, obs: np.ndarray) -> None:
        """Count these observations, ``[N, dim]``."""
        n, mean, var = len(obs), obs.mean(0), obs.var(0)
        total, gap = self.count + n, mean - self.mean
        old = self.var * self.count
        self.var = (old + var * n + gap**2 * self.count * n / total) / total
        self.mean, self.count = self.mean + gap * n / total, total

    def normalize(self, obs: np.ndarray) -> np.ndarray:
        """Observations in units of the deviation from the mean, ``[N, dim]``."""
        return (obs - self.mean) / np.sqrt(self.var + 1e-8)


def check_turn(turn: Callable[[Statistics, Statistics, Sequence[np.ndarray]], object]) -> None:
    """``turn(learner, other, batches)`` plays one turn: a list of (what the learner sees, what the other sees).

    Both see each batch normalised by their own statistics. Only the learner's count it, before they normalise it.
    """
    rng = np.random.default_rng(0)
    batches = [rng.normal(loc, 2.0, (8, 2)) for loc in (0.0, 1.0, 5.0)]

    def players() -> tuple[Statistics, Statistics]:
        pair = Statistics(2), Statistics(2)
        for one in pair:
            one.update(np.random.default_rng(1).normal(size=(16, 2)))
        return pair

    learner, other = players()
    got, call = turn(learner, other, batches), "turn(learner, other, batches)"
    assert got is not None, f"{call} gives None: does the function end with `return`?"
    assert other.count == 16, (
        f"after {call} the other's statistics have counted {other.count} observations, and before it 16: whoever does "
        "not learn in this turn must not count what they are shown, or their policy changes without learning"
    )
    assert learner.count == 16 + 24, (
        f"after {call} the learner's statistics have counted {learner.count} observations instead of 16 + 24: the "
        "learner counts each batch once"
    )
    expected, (own, frozen) = [], players()
    for batch in batches:
        own.update(batch)
        expected.append((own.normalize(batch), frozen.normalize(batch)))
    compare(call, got, expected, {"First the learner's, then the other's": [pair[::-1] for pair in expected]})
    print("Right. The other is the same at the end of the turn as at its beginning.")
