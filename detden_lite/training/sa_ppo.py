"""SA-PPO (Zhang et al., 2020): PPO whose policy is to change little within the attacker's ball.

Its loss is PPO's plus a regularizer: a weight times the mean, over observations, of the largest KL divergence between
the policy at an observation o and at a point of B(o). PPO's own loss is not touched: the gradient of the regularizer is
added to PPO's before the optimizer takes its step.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax.training.train_state import TrainState
from sbx import PPO

Mean = Callable[[jax.Array], jax.Array]  # maps observations [N, obs_dim] to the policy's means [N, action_dim]


def kl(mean: jax.Array, other: jax.Array, std: jax.Array) -> jax.Array:
    """KL(N(mean, Sigma) || N(other, Sigma)) with Sigma = diag(std^2): half of the squared Mahalanobis distance.

    Args:
        mean: ``[..., d]``.
        other: ``[..., d]``.
        std: ``[d]``.

    Returns:
        ``[...]``, never negative.

    Example:
        >>> kl(jnp.array([3.0, 4.0]), jnp.zeros(2), jnp.array([3.0, 1.0])).item()
        8.5
    """
    return 0.5 * jnp.square((mean - other) / std).sum(-1)


def most_different(
    policy: Mean, std: jax.Array, obs: jax.Array, radius: jax.Array, key: jax.Array, steps: int = 10, clip: float = 10.0
) -> jax.Array:
    """Points of the balls around observations where the KL divergence of the policy is large: the inner maximum.

    Projected gradient ascent with steps of shrinking size, from a random start: at o itself the gradient is zero.

    Args:
        policy: the means.
        std: of the actions, ``[action_dim]``.
        obs: ``[N, obs_dim]``, as the policy's network sees them: normalised.
        radius: of the ball in each dimension, ``[obs_dim]`` or a number.
        key: for the starts.
        steps: gradient steps.
        clip: the largest number that the network ever sees.

    Returns:
        ``[N, obs_dim]``.

    Example:
        >>> point = most_different(lambda obs: obs @ jnp.array([[1.0], [-2.0]]), 1.0, jnp.zeros((1, 2)), 0.5,
        ...                        jax.random.PRNGKey(0))
        >>> abs(point).tolist(), (point[0, 0] * point[0, 1]).item()
        ([[0.5, 0.5]], -0.25)
    """
    clean = policy(obs)
    slope = jax.grad(lambda point: kl(clean, policy(point), std).sum())
    low, high = jnp.clip(obs - radius, -clip, clip), jnp.clip(obs + radius, -clip, clip)

    def climb(step: jax.Array, point: jax.Array) -> jax.Array:
        return jnp.clip(point + (1 - step / steps) * radius * jnp.sign(slope(point)), low, high)

    return jax.lax.fori_loop(0, steps, climb, jax.random.uniform(key, obs.shape, minval=low, maxval=high))


@partial(jax.jit, static_argnames=("steps", "clip"))
def regularizer_gradient(
    state: TrainState, obs: jax.Array, radius: jax.Array, key: jax.Array, steps: int, clip: float
) -> tuple[jax.Array, Any]:
    """The regularizer and its gradient with respect to the policy's parameters, Danskin's: the worst points are fixed.

    So is Sigma: a policy that only explores more, with the same means, is no smoother.
    """
    std = jax.lax.stop_gradient(state.apply_fn(state.params, obs[:1]).stddev()[0])

    def policy(params: Any, obs: jax.Array) -> jax.Array:
        return state.apply_fn(params, obs).mean()

    point = most_different(partial(policy, state.params), std, obs, radius, key, steps, clip)

    def largest(params: Any) -> jax.Array:
        return kl(policy(params, obs), policy(params, point), std).mean()

    return jax.value_and_grad(largest)(state.params)


class WithPull(TrainState):
    """Parameters whose next step follows another gradient too, the ``pull``; None for no other."""

    pull: Any = None

    def apply_gradients(self, *, grads: Any, **changes: Any) -> "WithPull":
        """One step of the optimizer on the sum of both gradients."""
        both = grads if self.pull is None else jax.tree.map(jnp.add, grads, self.pull)
        return super().apply_gradients(grads=both, **changes)


class SAPPO(PPO):
    """PPO of sbx-rl with the regularizer. It learns on normalised observations; see ``SAPPORecipe``.

    Attributes:
        weight: of the regularizer.
        epsilon: the ball's radius.
        normalized: whether that is in units of the normaliser's deviations, and not in the environment's.
        share: of the radius that has been reached; it grows during the training.
        ascent: gradient steps of the inner maximum.
    """

    weight, epsilon, normalized, share, ascent = 0.0, 0.0, False, 0.0, 10
    radius: jax.Array  # in the units of what the policy sees, [obs_dim]
    clip_obs: float  # the largest number that it sees

    def _setup_model(self) -> None:
        super()._setup_model()
        self.policy.actor_state = WithPull(**vars(self.policy.actor_state))
        self.largest: list[float] = []

    def train(self) -> None:
        """PPO's epochs on one rollout, with the ball in the units of what the policy sees."""
        normalizer: Any = self.get_vec_normalize_env()
        unit = 1.0 if self.normalized else np.sqrt(normalizer.obs_rms.var + normalizer.epsilon)
        self.radius = jnp.asarray(self.share * self.epsilon / unit, jnp.float32)
        self.clip_obs = float(normalizer.clip_obs)
        super().train()

    def _one_update(  # type: ignore[override] # PPO's is a function of these alone, and is called with their names
        self, *, actor_state: WithPull, observations: np.ndarray, **rest: Any
    ) -> Any:
        if self.weight and self.share:
            self.key, key = jax.random.split(self.key)
            value, gradient = regularizer_gradient(
                actor_state, observations, self.radius, key, steps=self.ascent, clip=self.clip_obs
            )
            self.largest.append(float(value))
            actor_state = actor_state.replace(pull=jax.tree.map(lambda part: self.weight * part, gradient))
        (actor_state, vf_state), told = super()._one_update(
            actor_state=actor_state, observations=observations, **rest
        )  # fmt: skip
        return (actor_state.replace(pull=None), vf_state), told

    def told(self) -> dict[str, float | None]:
        """The mean of the largest KL divergences since this was asked before; for ``progress.json``."""
        found, self.largest = self.largest, []
        return dict(radius_share=self.share, largest_kl=float(np.mean(found)) if found else None)
