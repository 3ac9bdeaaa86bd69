"""The two distances of the paper: Euclidean for deterministic policies, Mahalanobis for Gaussian ones."""

import torch
from torch import Tensor


def euclidean(action: Tensor, reference: Tensor) -> Tensor:
    """R_td3 = ||a - a'||_2 of actions ``[..., action_dim]``, over the last dimension; its gradient at 0 is 0.

    Example:
        >>> euclidean(torch.tensor([[3.0, 4.0]]), torch.zeros(1, 2))
        tensor([5.])
    """
    return torch.linalg.vector_norm(action - reference, dim=-1)


def mahalanobis(
    action: Tensor, reference: Tensor, std: Tensor | None = None, *, precision: Tensor | float | None = None,
    factor: Tensor | None = None,
) -> Tensor:  # fmt: skip
    """R_ppo = (a - a')^T Sigma^-1 (a - a') over the last dimension: the SQUARED Mahalanobis distance.

    Give exactly one description of Sigma. They agree up to rounding; a training that is to be repeated bit by bit has
    to keep to one of them.

    Args:
        action: ``[..., d]``; actions, or anything else that a Gaussian describes.
        reference: like ``action``.
        std: ``[d]``, for Sigma = diag(std^2).
        precision: ``[d]`` or a number, for Sigma^-1 = diag(precision).
        factor: ``[d, d]``, the lower Cholesky factor of any Sigma.

    Returns:
        ``[...]``, never negative.

    Raises:
        ValueError: for none or several of the descriptions.

    Example:
        >>> mahalanobis(torch.tensor([[3.0, 4.0]]), torch.zeros(1, 2), std=torch.tensor([3.0, 1.0]))
        tensor([17.])
    """
    if sum(given is not None for given in (std, precision, factor)) == 1:
        deviation = action - reference
        if factor is not None:
            rows = deviation.reshape(-1, len(factor))
            return torch.linalg.solve_triangular(factor, rows.T, upper=False).square().sum(0).view(deviation.shape[:-1])
        if std is not None:
            return (deviation / std).square().sum(-1)
        if precision is not None:
            return (deviation.square() * precision).sum(-1)
    raise ValueError("give one of std, precision and factor: each describes Sigma alone")
