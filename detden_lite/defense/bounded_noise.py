"""What is known of a Gaussian quantity that is seen through a perturbation in a ball: Bayes' rule, approximately.

Everything is measured in balls: the perturbation of each number is in [-1, 1]. Tensors are float64, since a covariance
may hold numbers that differ by a factor of 10^8.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

Moments = tuple[Tensor, Tensor]  # mean and variance (or covariance)

LEAST_VARIANCE = 1e-10
DOF = 4.0  # of Student's t: a robot's contacts surprise its model more often than a Gaussian says


def truncated_moments(mean: Tensor, variance: Tensor) -> Moments:
    """Mean and variance of a Gaussian that is known to lie in [-1, 1].

    Example:
        >>> mean, variance = truncated_moments(torch.tensor([0.0, 5.0]), torch.tensor([100.0, 0.01]))
        >>> [round(number, 2) for number in mean.tolist()]  # hardly known: the middle; far outside: the edge
        [0.0, 1.0]
    """
    std = variance.sqrt()
    side = torch.where(mean > 0, -1.0, 1.0).to(mean)  # mirrored, so that no probability is a difference of two near 1
    mirrored = mean * side
    low, high = (((edge - mirrored) / std).clamp(-1e3, 1e3) for edge in (-1, 1))
    above_low, above_high = torch.special.log_ndtr(-low), torch.special.log_ndtr(-high)
    log_mass = above_low + torch.log1p(-torch.exp((above_high - above_low).clamp(max=-1e-9)))
    at_low, at_high = (torch.exp(-0.5 * (edge.square() + math.log(2 * math.pi)) - log_mass) for edge in (low, high))
    shift = at_low - at_high
    shrunk = (1 + low * at_low - high * at_high - shift.square()).clamp(1e-4, 1)
    return ((mirrored + std * shift) * side).clamp(-1, 1), variance * shrunk


def log_student(residual: Tensor, variance: Tensor) -> Tensor:
    """Log density of Student's t with ``DOF`` degrees of freedom, around 0."""
    constant = math.lgamma((DOF + 1) / 2) - math.lgamma(DOF / 2) - 0.5 * math.log(DOF * math.pi)
    return constant - 0.5 * (DOF + 1) * torch.log1p(residual.square() / variance / DOF) - 0.5 * variance.log()


def condition(
    mean: Tensor, covariance: Tensor, rows: Tensor, tilted: Callable[[Moments], Moments], rounds: int = 4
) -> Moments:
    """Update a Gaussian by what is known of each of several linear functions of it: expectation propagation.

    Each function's knowledge is replaced by a Gaussian factor. A round takes one factor away, asks ``tilted`` for the
    exact moments of that function alone, and finds the factor that gives them; all functions at once.

    Args:
        mean: ``[N, D]``.
        covariance: ``[N, D, D]``.
        rows: the functions, ``[K, D]``.
        tilted: from the moments of every function without its own knowledge, ``[N, K]`` each, to those with it.
        rounds: how many.

    Returns:
        The updated mean and covariance.

    Example:
        >>> mean, covariance = torch.zeros(1, 2).double(), torch.tensor([[[1.0, 0.9], [0.9, 1.0]]]).double()
        >>> seen = lambda moments: (torch.ones_like(moments[0]), 1e-4 * torch.ones_like(moments[1]))
        >>> mean, _ = condition(mean, covariance, torch.tensor([[1.0, 0.0]]).double(), seen)
        >>> [round(number, 2) for number in mean[0].tolist()]  # the first is 1, and the second goes with it
        [1.0, 0.9]
    """
    shared = rows @ covariance
    between = shared @ rows.T
    at = mean @ rows.T
    precision = torch.zeros_like(at)
    pull = torch.zeros_like(at)  # precision times mean of each factor
    identity = torch.eye(len(rows), dtype=mean.dtype)
    now = at, between.diagonal(dim1=-2, dim2=-1).clamp(min=LEAST_VARIANCE)
    for _ in range(rounds):
        without = 1 / (1 / now[1] - precision).clamp(min=1e-12)
        cavity = without * (now[0] / now[1] - pull), without
        wanted = tilted(cavity)
        precision = (1 / wanted[1] - 1 / without).clamp(min=0)
        pull = torch.where(precision > 0, wanted[0] / wanted[1] - cavity[0] / without, 0.0)
        root = precision.sqrt()[..., None]
        factor = torch.linalg.cholesky(identity + root * between * root.mT)
        explained = torch.linalg.solve_triangular(factor, root * between, upper=False)
        left = between - explained.mT @ explained
        moved = at + (left @ (pull - precision * at)[..., None])[..., 0]
        now = moved, left.diagonal(dim1=-2, dim2=-1).clamp(min=LEAST_VARIANCE)
    explained = torch.linalg.solve_triangular(factor, root * shared, upper=False)
    covariance = covariance - explained.mT @ explained
    step = covariance @ rows.T @ (pull - precision * at)[..., None]
    return mean + step[..., 0], covariance
