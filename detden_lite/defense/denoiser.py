"""The denoiser: a GRU-VAE that maps perturbed observations to true ones (section 3.1.2)."""

from collections.abc import Sequence

import torch
from torch import Tensor

from detden_lite.core.random_streams import RandomStreams
from detden_lite.defense.gruvae import GRUVAE, forget


class Denoiser:
    """A GRU-VAE trained on D_normal and D_adv, remembering N episodes.

    Args:
        model: the trained network.
        seed: of the latent samples.
        sample: whether to sample the latent, as the paper does, or to take its mean.
    """

    def __init__(self, model: GRUVAE, seed: int = 3, sample: bool = True):
        self.model, self.seed, self.sample = model, seed, sample

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self.state, self.streams = None, RandomStreams(self.seed, episodes)

    def restart(self, i: int, episode: int) -> None:
        """Begin a new episode in row i; the others go on."""
        self.state = forget(self.state, i)
        self.streams.restart(i, episode)

    @torch.no_grad()
    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """den(o_hat): the denoised observation ``[N, obs_dim]``."""
        noise = self.streams.normal(len(obs), self.model.latent_dim)[:, None] if self.sample else None
        result = self.model(obs[:, None], noise, self.state)
        self.state = result.state
        return result.output[:, 0]
