"""Values and input gradients of small networks.

``value_and_gradient`` is the version to read: autograd. ``Backprop`` computes the same by hand, without autograd's
overhead; attacks use it through ``detden_lite.victims.action_gradients.ActionObjective``. Tests compare the two.
"""

from collections.abc import Callable

import torch
from torch import Tensor, nn

NARROW = 32  # a product with fewer columns is faster transposed

relu_backward = torch.ops.aten.threshold_backward.grad_input

clamp_backward = torch.ops.aten.hardtanh_backward.grad_input

tanh_backward = torch.ops.aten.tanh_backward.grad_input


class Backprop:
    """Forward and backward pass of an ``mlp`` whose parameters are frozen, in buffers that are reused.

    The results of ``forward`` and ``backward`` are overwritten by the next call.

    Args:
        net: from ``detden_lite.core.networks.mlp``.
        dtype: float32, or bfloat16, in which processors with AMX multiply matrices several times as fast.

    Example:
        >>> from detden_lite.core.networks import mlp
        >>> net, x = mlp([3, 8, 1], "tanh"), torch.ones(2, 3)
        >>> by_hand, (value, gradient) = Backprop(net), value_and_gradient(lambda x: net(x).squeeze(-1), x)
        >>> bool(torch.allclose(by_hand.forward(x).squeeze(-1), value))
        True
        >>> bool(torch.allclose(by_hand.backward(torch.ones(2, 1)), gradient))
        True
    """

    def __init__(self, net: nn.Sequential, dtype: torch.dtype = torch.float32) -> None:
        linears = [layer for layer in net if isinstance(layer, nn.Linear)]
        self.weights = [layer.weight.detach().to(dtype).contiguous() for layer in linears]
        self.biases = [layer.bias.detach().to(dtype) for layer in linears]
        # A network ends in a linear layer, or in a tanh of its own.
        self.activations = [type(net[2 * i + 1]) if 2 * i + 1 < len(net) else None for i in range(len(linears))]
        self.dtype = dtype
        self.buffers: dict[str, Tensor] = {}

    def forward(self, x: Tensor) -> Tensor:
        """The network's output ``[N, n_out]`` for ``x`` ``[N, n_in]``; both float32."""
        x, self.outputs = self._cast(x, "x"), []
        for i, (weight, bias, activation) in enumerate(zip(self.weights, self.biases, self.activations, strict=True)):
            x = torch.addmm(bias, x, weight.T, out=self._buffer(f"output {i}", len(x), len(weight)))
            if activation is not None:
                x = x.relu_() if activation is nn.ReLU else x.tanh_()
            self.outputs.append(x)
        return x.float()

    def backward(self, gradient: Tensor) -> Tensor:
        """The gradient ``[N, n_in]`` of a function of the last ``forward``'s output, whose own is ``[N, n_out]``."""
        gradient = self._cast(gradient, "gradient")
        for i in reversed(range(len(self.weights))):
            if (activation := self.activations[i]) is not None:
                out = self._buffer(f"inner {i}", *gradient.shape)
                if activation is nn.ReLU:
                    gradient = relu_backward(gradient, self.outputs[i], 0, grad_input=out)
                else:
                    gradient = tanh_backward(gradient, self.outputs[i], grad_input=out)
            weight = self.weights[i]
            if weight.shape[1] < NARROW:
                gradient = torch.mm(weight.T, gradient.T).T
            else:
                gradient = torch.mm(gradient, weight, out=self._buffer(f"outer {i}", len(gradient), weight.shape[1]))
        return gradient.float()

    def _cast(self, x: Tensor, name: str) -> Tensor:
        return x if x.dtype == self.dtype else self._buffer(name, *x.shape).copy_(x)

    def _buffer(self, name: str, rows: int, columns: int) -> Tensor:
        if name not in self.buffers or len(self.buffers[name]) < rows:
            self.buffers[name] = torch.empty(rows, columns, dtype=self.dtype)
        return self.buffers[name][:rows]


def value_and_gradient(function: Callable[[Tensor], Tensor], x: Tensor) -> tuple[Tensor, Tensor]:
    """Values ``[N]`` of a function that goes row by row, and their gradients, of the shape of ``x``, by autograd.

    Example:
        >>> value_and_gradient(lambda x: x.square().sum(-1), torch.tensor([[1.0, 2.0]]))
        (tensor([5.]), tensor([[2., 4.]]))
    """
    x = x.detach().requires_grad_()
    with torch.enable_grad():
        value = function(x)
        (gradient,) = torch.autograd.grad(value.sum(), x)
    return value.detach(), gradient
