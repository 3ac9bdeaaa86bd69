"""How the robot moves: a learned one-step model of observations and actions, which says how sure it is."""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from detden_lite.core.arguments import check_whole
from detden_lite.defense.gruvae import Standardized


class Dynamics(Standardized):
    """o_{t+1} = f(o_t, a_t), with a standard deviation for each number.

    The state of a simulator, its positions and velocities, is the first ``state_dim`` numbers of an observation. The
    model sees these and the action alone. It predicts how they change, and what the other sensors will show.

    Args:
        obs_dim: size of an observation.
        action_dim: size of an action.
        state_dim: how many of its first numbers are positions and velocities; None for all.
        hidden: units of each of the three layers.

    Attributes:
        first_mean: the mean first observation of an episode, ``[obs_dim]``.
        first_std: its standard deviation.

    Raises:
        ValueError: if a size is not a whole number of at least 1, or the state has more numbers than the observation.

    Example:
        >>> model = Dynamics(obs_dim=3, action_dim=2, state_dim=2, hidden=8)
        >>> (state, state_std), (sensors, _) = model(torch.zeros(5, 2), torch.zeros(5, 2))
        >>> state.shape, sensors.shape, bool((state_std > 0).all())
        (torch.Size([5, 2]), torch.Size([5, 1]), True)
    """

    change_std: Tensor
    first_mean: Tensor
    first_std: Tensor

    def __init__(self, obs_dim: int, action_dim: int, state_dim: int | None = None, hidden: int = 256):
        state_dim = obs_dim if state_dim is None else state_dim
        check_whole(1, obs_dim=obs_dim, action_dim=action_dim, state_dim=state_dim, hidden=hidden)
        if state_dim > obs_dim:
            raise ValueError(f"state_dim: a state of {state_dim} numbers is no part of an observation of {obs_dim}")
        super().__init__(obs_dim)
        self.state_dim = state_dim
        self.config = dict(obs_dim=obs_dim, action_dim=action_dim, state_dim=state_dim, hidden=hidden)
        sizes = [state_dim + action_dim, hidden, hidden]
        layers = [layer for size in sizes for layer in (nn.Linear(size, hidden), nn.SiLU())]
        self.trunk = nn.Sequential(*layers)
        sizes = [size for size in (state_dim, obs_dim - state_dim) if size]
        self.heads = nn.ModuleList(nn.Linear(hidden, 2 * size) for size in sizes)
        self.register_buffer("change_std", torch.ones(obs_dim))
        self.register_buffer("first_mean", torch.zeros(obs_dim))
        self.register_buffer("first_std", torch.ones(obs_dim))

    def forward(self, state: Tensor, action: Tensor) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """Mean and standard deviation of the next state, and of what the other sensors show then, in raw units.

        Args:
            state: ``[..., state_dim]``.
            action: what is done in it, ``[..., action_dim]``.
        """
        hidden = self._hidden(state, action)
        return self._answer(0, hidden, state), self._sensed(hidden)

    def next_state(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """The first half of ``forward``."""
        return self._answer(0, self._hidden(state, action), state)

    def sensors(self, state: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        """The second half of ``forward``; empty where the state is all that is observed."""
        return self._sensed(self._hidden(state, action))

    def _hidden(self, state: Tensor, action: Tensor) -> Tensor:
        scaled = (state - self.obs_mean[: self.state_dim]) / self.obs_std[: self.state_dim]
        return self.trunk(torch.cat([scaled, action], -1))

    def _sensed(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        if self.state_dim == self.obs_dim:
            return hidden[..., :0], hidden[..., :0]
        return self._answer(1, hidden, self.obs_mean[self.state_dim :])

    def _answer(self, head: int, hidden: Tensor, origin: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_std = self.heads[head](hidden).chunk(2, -1)
        unit = self.change_std.tensor_split([self.state_dim])[head]
        return origin + mean * unit, log_std.clamp(-9, 2).exp() * unit

    @classmethod
    def from_state(cls, config: Mapping[str, Any], state: Mapping[str, Tensor]) -> "Dynamics":
        """The model with this ``config`` (see ``model.config``) and ``state`` (its state dict), frozen."""
        model = cls(**config)
        model.load_state_dict(state)
        return model.requires_grad_(False).eval()
