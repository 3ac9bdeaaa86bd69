"""The denoiser: a GRU-VAE that maps perturbed observations to true ones (section 3.1.2)."""

from torch import Tensor

from detden_lite.defense.gruvae import GRUVAE
from detden_lite.defense.memory import Recurrent


class Denoiser(Recurrent):
    """A GRU-VAE trained on D_normal and D_adv, remembering N episodes.

    Args:
        model: the trained network.
        seed: of the latent samples.
        sample: whether to sample the latent, as the paper does, or to take its mean.

    Example:
        >>> import torch
        >>> denoiser = Denoiser(GRUVAE(obs_dim=3, hidden=8, latent=2))
        >>> denoiser.reset(episodes=[0, 1])  # one seed for each row of the observations
        >>> denoiser.step(torch.zeros(2, 3)).shape
        torch.Size([2, 3])
    """

    def __init__(self, model: GRUVAE, seed: int = 3, sample: bool = True):
        super().__init__(model, seed, sample)

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """den(o_hat): the denoised observation ``[N, obs_dim]``.

        Args:
            obs: the observations as the policy would see them, perturbed or not, ``[N, obs_dim]``.
            action: what the policy did one step before, ``[N, action_dim]``; this denoiser does not use it.
        """
        return self.advance(obs)
