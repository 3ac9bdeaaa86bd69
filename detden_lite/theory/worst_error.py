"""The largest error that an attack finds in a denoiser: the last factor of the paper's theorem 1."""

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from detden_lite.core.ascent import ascend
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.defense.gruvae import GRUVAE, State


def worst_error(
    denoise: Callable[[Tensor], Tensor],
    obs: Tensor,
    budget: Budget,
    streams: RandomStreams,
    steps: int = 20,
    restarts: int = 1,
) -> tuple[Tensor, Tensor]:
    """The last factor of theorem 1, max over o_hat in B(o) of ||den(o_hat) - o||_2, as far as an attack finds it.

    Args:
        denoise: maps ``[N, obs_dim]`` to ``[N, obs_dim]``, row by row.
        obs: true observations ``[N, obs_dim]``.
        budget: the ball.
        streams: of the random starts: at ``obs`` itself the gradient may vanish.
        steps: of gradient ascent.
        restarts: how many starts.

    Returns:
        The perturbed observations ``[N, obs_dim]`` and the error there ``[N]``, a lower estimate of the largest.

    Example:
        >>> _, error = worst_error(lambda perturbed: perturbed, torch.zeros(1, 4), Budget(0.5), RandomStreams(0))
        >>> error  # the denoiser that does nothing errs most at a corner of the box, sqrt(4) / 2 away
        tensor([1.])
    """

    def error(perturbed: Tensor) -> Tensor:
        return torch.linalg.vector_norm(denoise(perturbed) - obs, dim=-1)

    found = ascend(error, obs, budget, streams, steps, restarts=restarts)
    with torch.no_grad():
        return found, error(found)


def worst_errors(
    model: GRUVAE, obs: Tensor, budget: Budget, streams: RandomStreams, steps: int = 20, restarts: int = 1
) -> Tensor:
    """``worst_error`` of a recurrent denoiser along recorded episodes ``[N, steps, obs_dim]``, ``[N, steps]``.

    The denoiser remembers the attacked episode, and takes the mean of its latent. The attacker seeks the largest error
    of the present step, and does not plan for the next.

    Raises:
        ValueError: if the episodes have another shape.
    """
    if obs.ndim != 3 or obs.shape[-1] != model.obs_dim:
        raise ValueError(f"obs must be [N, steps, {model.obs_dim}], not {list(obs.shape)}")
    state: State | None = None
    errors = []
    for now in obs.unbind(1):
        found, error = worst_error(partial(_denoise, model, state), now, budget, streams, steps, restarts)
        with torch.no_grad():
            state = model(found[:, None], state=state).state
        errors.append(error)
    return torch.stack(errors, 1)


def _denoise(model: GRUVAE, state: State | None, perturbed: Tensor) -> Tensor:
    return model(perturbed[:, None], state=state).output[:, 0]
