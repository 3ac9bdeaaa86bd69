"""A new policy begins as a copy of another one: behaviour cloning (Pomerleau, 1991), by regression on its actions."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from sbx import PPO


def imitate(
    model: "PPO", teacher: Callable[[Tensor], Tensor], obs: np.ndarray, steps: int = 3_000, batch: int = 512
) -> None:
    """Fit a new model's mean actions to the teacher's, with its own optimizer. Its normaliser learns their scale.

    Args:
        model: PPO of sbx-rl, with a normaliser.
        teacher: maps raw observations ``[N, obs_dim]`` to actions ``[N, action_dim]``.
        obs: raw observations that the teacher has met, ``[N, obs_dim]``.
        steps: gradient steps on the mean squared error.
        batch: rows of each.
    """
    import jax
    import jax.numpy as jnp

    normalizer = model.get_vec_normalize_env()
    assert normalizer is not None and not isinstance(normalizer.obs_rms, dict)  # every recipe of PPO has one
    normalizer.obs_rms.update(obs)
    x = normalizer.normalize_obs(obs).astype(np.float32)
    with torch.no_grad():
        y = teacher(torch.from_numpy(obs)).numpy()
    start = state = model.policy.actor_state

    def error(params: Any, x: jax.Array, y: jax.Array) -> jax.Array:
        return jnp.square(start.apply_fn(params, x).mode() - y).mean()

    @jax.jit
    def update(state: Any, x: jax.Array, y: jax.Array) -> Any:
        return state.apply_gradients(grads=jax.grad(error)(state.params, x, y))

    rng = np.random.default_rng(0)
    for _ in range(steps):
        rows = rng.integers(len(x), size=batch)
        state = update(state, x[rows], y[rows])
    model.policy.actor_state = start.replace(params=state.params)
