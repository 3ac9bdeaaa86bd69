"""The GRU-VAE of figure 3: a variational auto-encoder whose encoder and decoder remember the episode."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from detden_lite.core.arguments import check_whole

LEAST_STD = 1e-2  # of an observation, in raw units; one that never varies needs a unit too

State = tuple[Tensor, Tensor]  # encoder_state h^o and decoder_state h^z, [layers, N, hidden] each


@dataclass(frozen=True)
class Reconstruction:
    """The answer of a GRU-VAE to a sequence: ``output`` in observation units, and the latent Gaussian q(z | o, h)."""

    output: Tensor  # [N, steps, obs_dim]
    mean: Tensor  # mu, [N, steps, latent_dim]
    log_variance: Tensor  # log sigma^2, [N, steps, latent_dim]
    state: State


class Standardized(nn.Module):
    """A network that measures observations in the mean and standard deviation of D_normal (z-scores).

    Args:
        obs_dim: size of an observation.
    """

    obs_mean: Tensor  # [obs_dim]
    obs_std: Tensor  # [obs_dim]

    def __init__(self, obs_dim: int):
        super().__init__()
        self.obs_dim = obs_dim
        self.register_buffer("obs_mean", torch.zeros(obs_dim))
        self.register_buffer("obs_std", torch.ones(obs_dim))

    def set_statistics(self, mean: Tensor, std: Tensor) -> None:
        """Take the z-scoring's statistics, ``[obs_dim]`` each; no observation varies by less than ``LEAST_STD``."""
        self.obs_mean.copy_(mean)
        self.obs_std.copy_(std.clamp(min=LEAST_STD))


class GRUVAE(Standardized):
    """Encoder GRU, Gaussian latent, decoder GRU, linear output.

    Observations are z-scored on the way in, with the statistics of D_normal, and back on the way out.

    Args:
        obs_dim: size of an observation.
        hidden: hidden size of both GRUs (table 5).
        layers: layers of both GRUs (table 5).
        latent: size of z (table 5, "embedding size").
        residual: False, as the paper has it: the output is the decoder's. True: the output is the input plus the
            decoder's, which then only has to learn the correction. Or ``[obs_dim]`` bools: the input is added where
            True.

    Raises:
        ValueError: if a size is not a whole number of at least 1, or ``residual`` has another length than ``obs_dim``.

    Example:
        >>> model = GRUVAE(obs_dim=3, hidden=8, latent=2)
        >>> result = model(torch.zeros(5, 10, 3))
        >>> result.output.shape, result.mean.shape
        (torch.Size([5, 10, 3]), torch.Size([5, 10, 2]))
        >>> model(torch.zeros(5, 1, 3), state=result.state).output.shape  # the next step of the same episodes
        torch.Size([5, 1, 3])
    """

    added: Tensor

    def __init__(
        self, obs_dim: int, hidden: int = 64, layers: int = 1, latent: int = 64, residual: bool | Sequence[bool] = False
    ):
        check_whole(1, obs_dim=obs_dim, hidden=hidden, layers=layers, latent=latent)
        super().__init__(obs_dim)
        self.latent_dim = latent
        self.config = dict(obs_dim=obs_dim, hidden=hidden, layers=layers, latent=latent, residual=residual)
        self.encoder = nn.GRU(obs_dim, hidden, layers, batch_first=True)
        self.to_mean = nn.Linear(hidden, latent)
        self.to_log_variance = nn.Linear(hidden, latent)
        self.decoder = nn.GRU(latent, hidden, layers, batch_first=True)
        self.to_output = nn.Linear(hidden, obs_dim)
        added = torch.as_tensor(residual, dtype=torch.float32)
        if added.shape not in ((), (obs_dim,)):
            raise ValueError(f"residual must be True, False or {obs_dim} of them, not {residual!r}")
        self.register_buffer("added", added.expand(obs_dim).clone(), persistent=False)

    def forward(self, obs: Tensor, noise: Tensor | None = None, state: State | None = None) -> Reconstruction:
        """Encode, sample and decode a sequence.

        Args:
            obs: ``[N, steps, obs_dim]``.
            noise: standard normal ``[N, steps, latent_dim]`` that makes the sample z = mu + sigma * noise; None takes
                the mean.
            state: where an earlier sequence ended; None at an episode's beginning.
        """
        encoder_state, decoder_state = state or (None, None)
        mean, log_variance, encoder_state = self.encode(obs, encoder_state)
        output, decoder_state = self.decode(sample(mean, log_variance, noise), obs, decoder_state)
        return Reconstruction(output, mean, log_variance, (encoder_state, decoder_state))

    def encode(self, obs: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Mean and log variance of q(z | o, h^o), ``[N, steps, latent_dim]`` each, and the encoder's next state."""
        hidden, state = self.encoder((obs - self.obs_mean) / self.obs_std, state)
        return self.to_mean(hidden), self.to_log_variance(hidden).clamp(-20, 10), state

    def decode(self, z: Tensor, obs: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """The output ``[N, steps, obs_dim]`` for a latent of ``obs``, and the decoder's next state."""
        decoded, state = self.decoder(z, state)
        out = self.added * (obs - self.obs_mean) / self.obs_std + self.to_output(decoded)
        return out * self.obs_std + self.obs_mean, state

    @classmethod
    def from_state(cls, config: Mapping[str, Any], state: Mapping[str, Tensor]) -> "GRUVAE":
        """The model with this ``config`` (see ``model.config``) and ``state`` (its state dict), frozen."""
        model = cls(**config)
        model.load_state_dict(state)
        return model.requires_grad_(False).eval()


def sample(mean: Tensor, log_variance: Tensor, noise: Tensor | None) -> Tensor:
    """z = mu + sigma * noise; without noise the mean."""
    return mean if noise is None else mean + (0.5 * log_variance).exp() * noise


def reconstruction_loss(model: Standardized, output: Tensor, target: Tensor) -> Tensor:
    """-log p(o | z, h) up to a constant: half the squared z-scored error, summed over dimensions, ``[N, steps]``."""
    return 0.5 * ((output - target) / model.obs_std).square().sum(-1)


def kl_divergence(mean: Tensor, log_variance: Tensor, prior: str = "free") -> Tensor:
    """D_KL(q || pr), ``[N, steps]``.

    Args:
        mean: mu of q, ``[N, steps, latent_dim]``.
        log_variance: log sigma^2 of q.
        prior: "free" for the paper's N(mu_z, I), whose mean is free. At its best it is equal to q's own mean, so that
            only the variance is penalised. "standard" for N(0, I).

    Raises:
        ValueError: for another prior.

    Example:
        >>> mean, log_variance = torch.full((1, 1, 2), 3.0), torch.zeros(1, 1, 2)
        >>> kl_divergence(mean, log_variance).item(), kl_divergence(mean, log_variance, "standard").item()
        (0.0, 9.0)
    """
    variance_part = 0.5 * (log_variance.exp() - 1 - log_variance).sum(-1)
    if prior == "free":
        return variance_part
    if prior == "standard":
        return variance_part + 0.5 * mean.square().sum(-1)
    raise ValueError(f'prior must be "free" or "standard", not {prior!r}')
