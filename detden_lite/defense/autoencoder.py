"""A denoising auto-encoder without memory: a baseline that shows what the GRU-VAE gains by remembering."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from tqdm import tqdm

from detden_lite.core.arguments import check_positive, check_whole
from detden_lite.core.networks import mlp
from detden_lite.core.types import Trajectories
from detden_lite.defense.augmentation import check_trajectories
from detden_lite.defense.gruvae import Standardized, reconstruction_loss
from detden_lite.defense.memory import Memoryless


class DenoisingAutoencoder(Memoryless, Standardized):
    """A perceptron from o_hat to o. It is a denoiser as it stands, see ``detden_lite.core.types.Denoiser``.

    Args:
        obs_dim: size of an observation.
        hidden: size of the layers before and behind the latent one.
        latent: size of the latent layer.
        residual: as in the GRU-VAE: the output is the network's, or the input plus the network's.

    Example:
        >>> DenoisingAutoencoder(obs_dim=3).step(torch.zeros(5, 3)).shape
        torch.Size([5, 3])
    """

    def __init__(self, obs_dim: int, hidden: int = 64, latent: int = 64, residual: bool = False):
        check_whole(1, obs_dim=obs_dim, hidden=hidden, latent=latent)
        super().__init__(obs_dim)
        self.config = dict(obs_dim=obs_dim, hidden=hidden, latent=latent, residual=residual)
        self.net = mlp([obs_dim, hidden, latent, hidden, obs_dim])

    def forward(self, obs: Tensor) -> Tensor:
        """The denoised observation, ``[..., obs_dim]``; z-scored on the way in, and back on the way out."""
        x = (obs - self.obs_mean) / self.obs_std
        out = x + self.net(x) if self.config["residual"] else self.net(x)
        return out * self.obs_std + self.obs_mean

    @torch.no_grad()
    def step(self, obs: Tensor, action: Tensor | None = None) -> Tensor:
        """The denoised observation ``[N, obs_dim]``; the policy's last ``action`` is not used."""
        return self(obs)


def train_autoencoder(
    normal: Trajectories, inputs: Sequence[Trajectories], seed: int, hidden: int = 64, latent: int = 64,
    residual: bool = False, epochs: int = 10, batch: int = 512, learning_rate: float = 1e-3,
) -> DenoisingAutoencoder:  # fmt: skip
    """Learn to predict the true observation from each of its versions, by Adam on the squared z-scored error.

    Args:
        normal: D_normal, the targets.
        inputs: versions of the same trajectories, ``[normal, adversarial]`` for D_normal and D_adv together.
        seed: of initialisation and order.
        hidden: see ``DenoisingAutoencoder``.
        latent: see ``DenoisingAutoencoder``.
        residual: see ``DenoisingAutoencoder``.
        epochs: how often each observation is seen in each version.
        batch: observations of one step, each in all versions.
        learning_rate: at the beginning; it falls along half a cosine to zero, as the GRU-VAE's does.

    Returns:
        The trained model, frozen.

    Raises:
        ValueError: if there are no ``inputs``, one is of other trajectories or not finite, or a setting makes no sense.
    """
    if not inputs:
        raise ValueError("inputs is empty: give at least one version of the trajectories of normal")
    check_trajectories("inputs", normal, *inputs)
    check_whole(1, epochs=epochs, batch=batch)
    check_positive(learning_rate=learning_rate)
    torch.manual_seed(seed)
    model = DenoisingAutoencoder(normal.obs.shape[-1], hidden, latent, residual)
    episode, step = map(torch.from_numpy, normal.mask.nonzero())
    target, versions = torch.from_numpy(normal.obs), [torch.from_numpy(t.obs) for t in inputs]
    std, mean = torch.std_mean(target[episode, step], 0)
    model.set_statistics(mean, std)
    optimizer = torch.optim.Adam(model.parameters(), lr=learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs * math.ceil(len(step) / batch))
    for _ in tqdm(range(epochs), desc="denoising auto-encoder", unit="epoch"):
        for rows in torch.randperm(len(step)).split(batch):
            at = episode[rows], step[rows]
            losses = (reconstruction_loss(model, model(version[at]), target[at]).mean() for version in versions)
            optimizer.zero_grad()
            sum(losses, torch.zeros(())).backward()
            optimizer.step()
            schedule.step()
    return model.requires_grad_(False).eval()
