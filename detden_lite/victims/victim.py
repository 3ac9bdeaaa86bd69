"""A frozen policy with its critic: it is attacked and defended, and never retrained."""

from collections.abc import Mapping
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from detden_lite.core.networks import mlp

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize


class Victim(nn.Module):
    """pi, Q and V of a trained agent, with frozen parameters (section 2.1 of the paper).

    Observations are raw, in the environment's units: an observation normaliser, if the agent had one, is the first
    layer. Actions are in the environment's units too. A deterministic policy (TD3) has ``action_std`` None; for a
    Gaussian one (PPO) the forward pass is the mean and ``action_std`` the square root of the diagonal of Sigma.

    Args:
        actor: layer sizes of the policy network, from obs_dim to action_dim.
        critic: layer sizes of each Q network, from obs_dim + action_dim to 1; None if there is none.
        value: layer sizes of the value network, from obs_dim to 1; None if V(o) = Q(o, pi(o)).
        n_critics: how many Q networks (TD3 has two).
        activation: "relu" or "tanh".
        critic_activation: of the Q networks, where it is another one.
        gaussian: whether the policy is stochastic.

    Example:
        >>> victim = Victim(actor=[11, 64, 3], critic=[14, 64, 1])
        >>> obs = torch.zeros(2, 11)
        >>> victim(obs).shape, victim.q(obs, victim(obs)).shape
        (torch.Size([2, 3]), torch.Size([2]))
        >>> victim
        Victim(deterministic policy of layers [11, 64, 3], 2 critics)
    """

    obs_mean: Tensor
    obs_std: Tensor
    obs_clip: Tensor
    action_low: Tensor
    action_high: Tensor
    action_std: Tensor | None

    def __init__(
        self, actor: list[int], critic: list[int] | None = None, value: list[int] | None = None, n_critics: int = 2,
        activation: str = "relu", critic_activation: str | None = None, gaussian: bool = False,
    ) -> None:  # fmt: skip
        super().__init__()
        self.config: dict[str, Any] = dict(
            actor=actor, critic=critic, value=value, n_critics=n_critics, activation=activation,
            critic_activation=critic_activation, gaussian=gaussian,
        )  # fmt: skip
        obs_dim, action_dim = actor[0], actor[-1]
        self.actor = mlp(actor, activation, squash=not gaussian)
        self.critics = nn.ModuleList(mlp(critic, critic_activation or activation) for _ in range(n_critics) if critic)
        self.value_net = mlp(value, activation) if value else None
        self.register_buffer("obs_mean", torch.zeros(obs_dim))
        self.register_buffer("obs_std", torch.ones(obs_dim))
        self.register_buffer("obs_clip", torch.tensor(torch.inf))
        self.register_buffer("action_low", -torch.ones(action_dim))
        self.register_buffer("action_high", torch.ones(action_dim))
        self.register_buffer("action_std", torch.ones(action_dim) if gaussian else None)
        self.requires_grad_(False).eval()

    def __repr__(self) -> str:
        kind = "deterministic" if self.action_std is None else "Gaussian"
        critic = f"{len(self.critics)} critics" if len(self.critics) else "no critic"
        return f"Victim({kind} policy of layers {self.config['actor']}, {critic})"

    @property
    def obs_dim(self) -> int:
        """How many numbers an observation has."""
        return self.config["actor"][0]

    @property
    def action_dim(self) -> int:
        """How many numbers an action has."""
        return self.config["actor"][-1]

    def normalize(self, obs: Tensor) -> Tensor:
        """What the networks see of raw observations ``[N, obs_dim]``."""
        return ((obs - self.obs_mean) / self.obs_std).clamp(-self.obs_clip, self.obs_clip)

    def mean(self, obs: Tensor) -> Tensor:
        """The policy's output ``[N, action_dim]`` before a Gaussian policy's mean is clipped to the action bounds."""
        out = self.actor(self.normalize(obs))
        if self.action_std is not None:
            return out
        return self.action_low + 0.5 * (out + 1) * (self.action_high - self.action_low)

    def forward(self, obs: Tensor) -> Tensor:
        """pi(o): actions ``[N, action_dim]`` for observations ``[N, obs_dim]``, inside the action bounds."""
        return self.mean(obs).clamp(self.action_low, self.action_high)

    def straight_through(self, obs: Tensor) -> Tensor:
        """pi(o) with the gradient of the unclipped mean, so that an attack at a bound still has a gradient."""
        mean = self.mean(obs)
        return mean + (mean.clamp(self.action_low, self.action_high) - mean).detach()

    def q(self, obs: Tensor, action: Tensor) -> Tensor:
        """Q(o, a) ``[N]``: the smallest of the critics, as TD3's own target takes it."""
        return self.qs(obs, action).amin(0)

    def qs(self, obs: Tensor, action: Tensor) -> Tensor:
        """Q(o, a) of each critic, ``[n_critics, N]``."""
        if not len(self.critics):
            raise ValueError("this victim has no Q-function: learn one from clean data first, or attack without it")
        x = self.critic_input(obs, action)
        return torch.stack([critic(x).squeeze(-1) for critic in self.critics])

    def critic_input(self, obs: Tensor, action: Tensor) -> Tensor:
        """What a Q network sees, ``[N, obs_dim + action_dim]``: normalised observations, actions scaled to [-1, 1]."""
        scaled = 2 * (action - self.action_low) / (self.action_high - self.action_low) - 1
        return torch.cat([self.normalize(obs), scaled], dim=-1)

    def value(self, obs: Tensor) -> Tensor:
        """V(o) ``[N]``: the value network's, or Q(o, pi(o)) for a deterministic policy (section 3.2)."""
        if self.value_net is not None:
            return self.value_net(self.normalize(obs)).squeeze(-1)
        return self.q(obs, self(obs))

    def with_critic(self, critic: list[int], state: Mapping[str, Tensor], activation: str = "relu") -> "Victim":
        """This victim with a Q-function that was learned afterwards.

        Args:
            critic: layer sizes, from obs_dim + action_dim to 1.
            state: the state dict of ``mlp(critic, activation)``; see ``detden_lite.victims.critic``.
            activation: of its hidden layers.

        Raises:
            ValueError: if the sizes are not those of a Q-function of this victim.
        """
        if (critic[0], critic[-1]) != (self.obs_dim + self.action_dim, 1):
            raise ValueError(f"critic: {critic} must lead from {self.obs_dim + self.action_dim} numbers to 1")
        own = {name: tensor for name, tensor in self.state_dict().items() if not name.startswith("critics.")}
        config = self.config | dict(critic=critic, n_critics=1, critic_activation=activation)
        return Victim.from_state(config, own | {f"critics.0.{name}": tensor for name, tensor in state.items()})

    @classmethod
    def from_state(cls, config: Mapping, state: Mapping[str, Tensor]) -> "Victim":
        """The victim with this ``config`` (see ``victim.config``) and ``state`` (its state dict)."""
        victim = cls(**config)
        victim.load_state_dict(state)
        return victim

    @classmethod
    def from_sb3(cls, model: "BaseAlgorithm", vecnormalize: "VecNormalize | None | EllipsisType" = ...) -> "Victim":
        """A frozen copy of a TD3, DDPG, PPO or A2C model of stable-baselines3, or of sbx-rl.

        Args:
            model: the trained model, with plain MLP networks and a Box action space.
            vecnormalize: the ``VecNormalize`` it was trained in, which becomes the victim's first layer; None if it was
                trained without one. It may be left out for a model that still has its environment: that one tells. A
                model that was loaded from a file has none.

        Raises:
            ValueError: if the model is of another kind, its networks are no plain MLPs, its VecNormalize was forgotten
                or not spoken of, or the copy acts differently.

        Example:
            >>> from stable_baselines3 import TD3
            >>> model = TD3("MlpPolicy", "Pendulum-v1", policy_kwargs=dict(net_arch=[8]), buffer_size=1)
            >>> Victim.from_sb3(model).config["actor"]
            [3, 8, 1]
        """
        from detden_lite.victims.sb3 import copy_of

        return copy_of(model, vecnormalize)
