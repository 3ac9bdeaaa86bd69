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
    """

    def __init__(self, model: GRUVAE, seed: int = 3, sample: bool = True):
        super().__init__(model, seed, sample)

    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """den(o_hat): the denoised observation ``[N, obs_dim]``."""
        return self.advance(obs)
