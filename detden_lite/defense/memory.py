"""The memory of a part of a defence: the states of a GRU-VAE in the episodes under way, or none."""

from collections.abc import Sequence

import torch
from torch import Tensor

from detden_lite.core.random_streams import RandomStreams
from detden_lite.defense.gruvae import GRUVAE, State


class Recurrent:
    """A GRU-VAE that is run step by step, and remembers N episodes.

    Args:
        model: the trained network.
        seed: of the latent samples.
        sample: whether to sample the latent, as the paper does, or to take its mean.

    Attributes:
        state: the memory of the GRUs, see ``detden_lite.defense.gruvae.State``; None before the first observation.
    """

    state: State | None

    def __init__(self, model: GRUVAE, seed: int, sample: bool):
        self.model, self.seed, self.sample, self.obs_dim = model, seed, sample, model.obs_dim

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self.state, self.streams = None, RandomStreams(self.seed, episodes)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.streams.restart(i, episode)
        if self.state is not None:
            others = torch.ones(self.state[0].shape[1], 1)
            others[i] = 0
            self.state = self.state[0] * others, self.state[1] * others

    @torch.no_grad()
    def advance(self, obs: Tensor) -> Tensor:
        """The network's output ``[N, obs_dim]`` for the next observation ``[N, obs_dim]`` of each episode."""
        noise = self.streams.normal(len(obs), self.model.latent_dim)[:, None] if self.sample else None
        result = self.model(obs[:, None], noise, self.state)
        self.state = result.state
        return result.output[:, 0]


class Memoryless:
    """A part that treats every observation alone."""

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes; there is no memory."""

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; there is no memory."""
