"""Multilayer perceptrons: every policy, critic and adversary is one."""

from torch import nn

ACTIVATIONS = {"relu": nn.ReLU, "tanh": nn.Tanh}


def mlp(sizes: list[int], activation: str = "relu", squash: bool = False) -> nn.Sequential:
    """Linear layers of the given sizes with an activation between them, and a final tanh if ``squash``.

    Raises:
        ValueError: for an unknown activation.

    Example:
        >>> [type(layer).__name__ for layer in mlp([11, 64, 3], squash=True)]
        ['Linear', 'ReLU', 'Linear', 'Tanh']
    """
    if activation not in ACTIVATIONS:
        raise ValueError(f"activation must be {' or '.join(ACTIVATIONS)}, not {activation!r}")
    layers: list[nn.Module] = []
    for n_in, n_out in zip(sizes[:-1], sizes[1:], strict=True):
        layers += [nn.Linear(n_in, n_out), ACTIVATIONS[activation]()]
    layers.pop()
    return nn.Sequential(*layers, *([nn.Tanh()] if squash else []))
