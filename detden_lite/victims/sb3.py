"""Frozen copies of what stable-baselines3 and sbx-rl trained: see ``Victim.from_sb3``."""

from collections.abc import Mapping

import gymnasium
import numpy as np
import torch
from torch import Tensor, nn

from detden_lite.core.networks import ACTIVATIONS
from detden_lite.victims.victim import Victim


@torch.no_grad()
def copy_of(model, vecnormalize=None) -> Victim:
    """The victim that acts as ``model`` does; the arguments and errors are those of ``Victim.from_sb3``."""
    kinds = {kind.__name__ for kind in type(getattr(model, "policy", None)).__mro__}
    name = type(model).__name__
    if not kinds & {"TD3Policy", "ActorCriticPolicy", "PPOPolicy"}:
        raise ValueError(f"model: {name} is neither a TD3 nor a PPO model with an MLP policy")
    for what, space in (("observations", model.observation_space), ("actions", model.action_space)):
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise ValueError(f"model: the {what} of this {name} must be vectors (a Box of one axis), not {space}")
    if getattr(model, "use_sde", False):
        raise ValueError(f"model: this {name} explores with gSDE, so that no one Sigma describes its actions")
    if vecnormalize is None and getattr(model.get_vec_normalize_env(), "norm_obs", False):
        raise ValueError(f"vecnormalize: this {name} saw normalised observations; give its VecNormalize too")
    try:
        in_jax = hasattr(model.policy, "actor_state")
        if "TD3Policy" in kinds:
            victim = _from_sbx_td3(model) if in_jax else _from_sb3_td3(model)
        else:
            victim = _from_sbx_ppo(model) if in_jax else _from_sb3_ppo(model)
        victim.action_low.copy_(torch.as_tensor(model.action_space.low))
        victim.action_high.copy_(torch.as_tensor(model.action_space.high))
        if vecnormalize is not None and vecnormalize.norm_obs:
            victim.obs_mean.copy_(torch.as_tensor(vecnormalize.obs_rms.mean))
            victim.obs_std.copy_(torch.as_tensor(np.sqrt(vecnormalize.obs_rms.var + vecnormalize.epsilon)))
            victim.obs_clip.fill_(vecnormalize.clip_obs)
        obs = torch.linspace(-1, 1, 8 * victim.obs_dim).reshape(8, victim.obs_dim)
        seen = obs.numpy() if vecnormalize is None else vecnormalize.normalize_obs(obs.numpy())
        difference = np.abs(victim(obs).numpy() - model.predict(seen, deterministic=True)[0]).max()
    except (KeyError, RuntimeError) as error:
        raise ValueError(f"model: the networks of this {name} are no plain MLPs ({error})") from error
    if not difference < 1e-3:
        raise ValueError(f"model: a copy of this {name} acts differently ({difference:.2g}): it is no plain MLP")
    return victim


def _linears(net: nn.Module) -> list[tuple[Tensor, Tensor]]:
    return [(m.weight, m.bias) for m in net.modules() if isinstance(m, nn.Linear)]


def _sizes(layers: list[tuple[Tensor, Tensor]]) -> list[int]:
    return [layers[0][0].shape[1], *(weight.shape[0] for weight, _ in layers)]


def _fill(net: nn.Module, layers: list[tuple[Tensor, Tensor]]) -> None:
    for (weight, bias), (new_weight, new_bias) in zip(_linears(net), layers, strict=True):
        weight.copy_(new_weight)
        bias.copy_(new_bias)


def _activation(net: nn.Module) -> str:
    names = {name for name, kind in ACTIVATIONS.items() for m in net.modules() if isinstance(m, kind)}
    if len(names) != 1:
        raise ValueError(f"model: its hidden layers must be all relu or all tanh, not {sorted(names) or 'neither'}")
    return names.pop()


def _deterministic(actor, critics, activation: str) -> Victim:
    victim = Victim(_sizes(actor), _sizes(critics[0]), n_critics=len(critics), activation=activation)
    _fill(victim.actor, actor)
    for net, layers in zip(victim.critics, critics, strict=True):
        _fill(net, layers)
    return victim


def _from_sb3_td3(model) -> Victim:
    critics = [_linears(net) for net in model.critic.q_networks]
    return _deterministic(_linears(model.actor.mu), critics, _activation(model.critic))


def _dense(params: Mapping) -> list[tuple[Tensor, Tensor]]:
    """Kernels and biases of a flax MLP, in order; a KeyError for layers of another kind."""
    if "Dense_0" not in params:  # flax wraps the layers in modules of its own
        return _dense(next(iter(params.values())))
    names = sorted((name for name in params if name.startswith("Dense_")), key=lambda name: int(name.split("_")[1]))
    if others := params.keys() - {*names, "log_std"}:
        raise KeyError(*sorted(others))
    return [tuple(torch.tensor(np.asarray(params[n][k])) for k in ("kernel", "bias")) for n in names]


def _jax_activation(function) -> str:
    """By what it does: a function of a model that was loaded from a file may have lost its name."""
    x = torch.linspace(-3, 3, 7)
    names = [name for name, kind in ACTIVATIONS.items() if np.allclose(function(x.numpy()), kind()(x), atol=1e-4)]
    if not names:
        raise ValueError("model: its hidden layers must be all relu or all tanh")
    return names[0]


def _from_sbx_td3(model) -> Victim:
    actor = [(kernel.T, bias) for kernel, bias in _dense(model.policy.actor_state.params)]
    both = _dense(model.policy.qf_state.params)
    critics = [[(kernel[i].T, bias[i]) for kernel, bias in both] for i in range(len(both[0][0]))]
    return _deterministic(actor, critics, _jax_activation(model.policy.activation_fn))


def _gaussian(actor, value, activation: str, log_std: Tensor) -> Victim:
    victim = Victim(_sizes(actor), value=_sizes(value), n_critics=0, activation=activation, gaussian=True)
    _fill(victim.actor, actor)
    _fill(victim.value_net, value)
    victim.action_std.copy_(log_std.exp())
    return victim


def _from_sb3_ppo(model) -> Victim:
    policy = model.policy
    actor = _linears(policy.mlp_extractor.policy_net) + _linears(policy.action_net)
    value = _linears(policy.mlp_extractor.value_net) + _linears(policy.value_net)
    return _gaussian(actor, value, _activation(policy.mlp_extractor.policy_net), policy.log_std)


def _from_sbx_ppo(model) -> Victim:
    policy = model.policy
    actor, value = (
        [(kernel.T, bias) for kernel, bias in _dense(state.params)] for state in (policy.actor_state, policy.vf_state)
    )
    log_std = torch.tensor(np.asarray(policy.actor_state.params["params"]["log_std"]))
    return _gaussian(actor, value, _jax_activation(model.policy.activation_fn), log_std)
