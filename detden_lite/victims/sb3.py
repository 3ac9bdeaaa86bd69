"""Frozen copies of what stable-baselines3 and sbx-rl trained: see ``Victim.from_sb3``."""

from collections.abc import Callable, Mapping, Sequence
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn

from detden_lite.core.networks import ACTIVATIONS
from detden_lite.victims.victim import Victim

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

Layers = list[tuple[Tensor, Tensor]]  # weights [n_out, n_in] and biases [n_out]


KINDS = ("TD3", "DDPG", "PPO", "A2C")  # classes whose MLP policies are copied, and what is derived from them


@torch.no_grad()
def copy_of(model: "BaseAlgorithm", vecnormalize: "VecNormalize | None | EllipsisType" = ...) -> Victim:
    """The victim that acts as ``model`` does; the arguments and errors are those of ``Victim.from_sb3``."""
    kinds = {kind.__name__ for kind in type(model).__mro__}
    name = type(model).__name__
    if not kinds & set(KINDS) or not hasattr(model, "policy"):
        raise ValueError(f"model: {name} is none of {', '.join(KINDS)} with an MLP policy")
    for what, space in (("observations", model.observation_space), ("actions", model.action_space)):
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise ValueError(f"model: the {what} of this {name} must be vectors (a Box of one axis), not {space}")
    if getattr(model, "use_sde", False):
        raise ValueError(f"model: this {name} explores with gSDE, so that no one Sigma describes its actions")
    normalizer = _normalizer(model, vecnormalize)
    try:
        in_jax = hasattr(model.policy, "actor_state")
        if kinds & {"TD3", "DDPG"}:
            victim = (_from_sbx_td3 if in_jax else _from_sb3_td3)(model.policy)
        else:
            victim = (_from_sbx_ppo if in_jax else _from_sb3_ppo)(model.policy)
        assert isinstance(model.action_space, gymnasium.spaces.Box)  # as was checked above
        victim.action_low.copy_(torch.as_tensor(model.action_space.low))
        victim.action_high.copy_(torch.as_tensor(model.action_space.high))
        if normalizer is not None and normalizer.norm_obs:
            assert not isinstance(normalizer.obs_rms, dict)  # which it is for dictionaries of observations
            victim.obs_mean.copy_(torch.as_tensor(normalizer.obs_rms.mean))
            victim.obs_std.copy_(torch.as_tensor(np.sqrt(normalizer.obs_rms.var + normalizer.epsilon)))
            victim.obs_clip.fill_(normalizer.clip_obs)
        obs = torch.linspace(-1, 1, 8 * victim.obs_dim).reshape(8, victim.obs_dim)
        seen = obs.numpy() if normalizer is None else normalizer.normalize_obs(obs.numpy())
        difference = np.abs(victim(obs).numpy() - model.predict(seen, deterministic=True)[0]).max()
    except (AttributeError, KeyError, RuntimeError) as error:
        raise ValueError(f"model: the networks of this {name} are no plain MLPs ({error})") from error
    if not difference < 1e-3:
        raise ValueError(f"model: a copy of this {name} acts differently ({difference:.2g}): it is no plain MLP")
    return victim


def _normalizer(model: "BaseAlgorithm", given: "VecNormalize | None | EllipsisType") -> "VecNormalize | None":
    """The ``VecNormalize`` to copy, after a check that none was forgotten."""
    name = type(model).__name__
    if given is None or given is ...:
        if getattr(model.get_vec_normalize_env(), "norm_obs", False):
            raise ValueError(f"vecnormalize: this {name} saw normalised observations; give its VecNormalize too")
        if given is ... and model.get_env() is None:
            raise ValueError(
                f"vecnormalize: this {name} was loaded without its environment, which would tell whether it saw "
                f"normalised observations; give its VecNormalize, or vecnormalize=None if it was trained without one"
            )
        return None
    shape, wanted = (getattr(getattr(x, "observation_space", x), "shape", None) for x in (given, model))
    if not hasattr(given, "norm_obs") or shape != wanted:
        raise ValueError(f"vecnormalize: give a VecNormalize of observations {wanted}, or None, not {given!r}")
    return given


def _linears(net: nn.Module) -> Layers:
    return [(m.weight, m.bias) for m in net.modules() if isinstance(m, nn.Linear)]


def _sizes(layers: Layers) -> list[int]:
    return [layers[0][0].shape[1], *(weight.shape[0] for weight, _ in layers)]


def _fill(net: nn.Module, layers: Layers) -> None:
    for (weight, bias), (new_weight, new_bias) in zip(_linears(net), layers, strict=True):
        weight.copy_(new_weight)
        bias.copy_(new_bias)


def _activation(net: nn.Module) -> str:
    names = {name for name, kind in ACTIVATIONS.items() for m in net.modules() if isinstance(m, kind)}
    if len(names) != 1:
        raise ValueError(f"model: its hidden layers must be all relu or all tanh, not {sorted(names) or 'neither'}")
    return names.pop()


def _deterministic(actor: Layers, critics: Sequence[Layers], activation: str) -> Victim:
    victim = Victim(_sizes(actor), _sizes(critics[0]), n_critics=len(critics), activation=activation)
    _fill(victim.actor, actor)
    for net, layers in zip(victim.critics, critics, strict=True):
        _fill(net, layers)
    return victim


# What a policy of these libraries is made of has no types of its own.
def _from_sb3_td3(policy: Any) -> Victim:
    critics = [_linears(net) for net in policy.critic.q_networks]
    return _deterministic(_linears(policy.actor.mu), critics, _activation(policy.critic))


def _dense(params: Mapping) -> Layers:
    """Kernels and biases of a flax MLP, in order; a KeyError for layers of another kind."""
    if "Dense_0" not in params:  # flax wraps the layers in modules of its own
        return _dense(next(iter(params.values())))
    names = sorted((name for name in params if name.startswith("Dense_")), key=lambda name: int(name.split("_")[1]))
    if others := params.keys() - {*names, "log_std"}:
        raise KeyError(*sorted(others))
    layers = [{key: torch.tensor(np.asarray(array)) for key, array in params[name].items()} for name in names]
    return [(layer["kernel"], layer["bias"]) for layer in layers]


def _jax_activation(function: Callable) -> str:
    """By what it does: a function of a model that was loaded from a file may have lost its name."""
    x = torch.linspace(-3, 3, 7)
    names = [name for name, kind in ACTIVATIONS.items() if np.allclose(function(x.numpy()), kind()(x), atol=1e-4)]
    if not names:
        raise ValueError("model: its hidden layers must be all relu or all tanh")
    return names[0]


def _from_sbx_td3(policy: Any) -> Victim:
    actor = [(kernel.T, bias) for kernel, bias in _dense(policy.actor_state.params)]
    both = _dense(policy.qf_state.params)
    critics = [[(kernel[i].T, bias[i]) for kernel, bias in both] for i in range(len(both[0][0]))]
    return _deterministic(actor, critics, _jax_activation(policy.activation_fn))


def _gaussian(actor: Layers, value: Layers, activation: str, log_std: Tensor) -> Victim:
    victim = Victim(_sizes(actor), value=_sizes(value), n_critics=0, activation=activation, gaussian=True)
    assert victim.value_net is not None and victim.action_std is not None
    _fill(victim.actor, actor)
    _fill(victim.value_net, value)
    victim.action_std.copy_(log_std.exp())
    return victim


def _from_sb3_ppo(policy: Any) -> Victim:
    actor = _linears(policy.mlp_extractor.policy_net) + _linears(policy.action_net)
    value = _linears(policy.mlp_extractor.value_net) + _linears(policy.value_net)
    return _gaussian(actor, value, _activation(policy.mlp_extractor.policy_net), policy.log_std)


def _from_sbx_ppo(policy: Any) -> Victim:
    actor, value = (
        [(kernel.T, bias) for kernel, bias in _dense(state.params)] for state in (policy.actor_state, policy.vf_state)
    )
    log_std = torch.tensor(np.asarray(policy.actor_state.params["params"]["log_std"]))
    return _gaussian(actor, value, _jax_activation(policy.activation_fn), log_std)
