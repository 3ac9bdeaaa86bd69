"""A task whose Q-function is known."""

from types import SimpleNamespace

import gymnasium
import numpy as np
import torch
from torch import nn

from detden_lite.core.tasks import Task
from detden_lite.victims.victim import Victim

DRAG, PUSH, GAIN, GAMMA = 0.9, 0.5, 0.8, 0.8


class Cart(gymnasium.Env):
    """x' = 0.9 x + 0.5 a, with reward -x^2 - a^2: so simple that Q of a linear policy is known."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,))
    action_space = gymnasium.spaces.Box(-3, 3, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.at(self.np_random.uniform(-2, 2, 1)), {}

    def at(self, x):
        self.data = SimpleNamespace(qpos=x, qvel=x[:0])  # as MuJoCo keeps it
        return x

    def step(self, action):
        x = self.data.qpos
        return self.at(DRAG * x + PUSH * action), float(-(x**2 + action**2)[0]), False, False, {}


gymnasium.register("Cart-v0", Cart)
CART = Task("cart", "Cart-v0", epsilon=0.1, obs_dim=1, action_dim=1, horizon=20)


class TrueQ(nn.Module):
    """Q of the policy -GAIN x: V(x) = -slope x^2, from a Bellman equation for the slope."""

    def forward(self, inputs):
        x, action = inputs[..., :1], 3 * inputs[..., 1:]  # what a critic sees: the action is scaled
        slope = (1 + GAIN**2) / (1 - GAMMA * (DRAG - PUSH * GAIN) ** 2)
        return -(x**2) - action**2 - GAMMA * slope * (DRAG * x + PUSH * action) ** 2


def make_driver() -> Victim:
    """The linear policy."""
    victim = Victim([1, 1], value=[1, 1], gaussian=True)
    victim.load_state_dict(
        victim.state_dict()
        | {"actor.0.weight": torch.tensor([[-GAIN]]), "actor.0.bias": torch.zeros(1)}
        | dict(action_low=torch.tensor([-3.0]), action_high=torch.tensor([3.0]))
    )
    return victim
