import gymnasium
import numpy as np
import pytest
import torch
from builders import HOPPER, make_victim, normal
from stable_baselines3 import DDPG, PPO, SAC, TD3
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from detden_lite.victims import Victim

NET = dict(net_arch=[16, 12])  # to be copied: the models write into it


@pytest.fixture(scope="module")
def hopper():
    return gymnasium.make("Hopper-v5")


class Wide(gymnasium.ActionWrapper):
    """Actions in other units than [-1, 1]."""

    def __init__(self):
        super().__init__(gymnasium.make("Hopper-v5"))
        self.action_space = gymnasium.spaces.Box(np.array([-2, 0, 1], np.float32), np.array([2, 3, 5], np.float32))


class Doubling(FlattenExtractor):
    """What no MLP knows of."""

    def forward(self, observations):
        return 2 * super().forward(observations)


def expected_action(model, obs):
    return model.predict(obs.numpy(), deterministic=True)[0]


@pytest.mark.parametrize("algorithm", [TD3, DDPG])
@pytest.mark.parametrize("make_env", [lambda: gymnasium.make("Hopper-v5"), Wide])
def test_a_td3_model_of_stable_baselines3(algorithm, make_env):
    model = algorithm("MlpPolicy", make_env(), policy_kwargs=dict(NET), seed=1, buffer_size=10)
    victim, obs = Victim.from_sb3(model), normal(50, 11) * 3
    action = victim(obs)
    assert np.allclose(action, expected_action(model, obs), atol=1e-5)
    low, high = (torch.tensor(bound) for bound in (model.action_space.low, model.action_space.high))
    scaled = 2 * (action - low) / (high - low) - 1  # stable-baselines3's critics take actions in [-1, 1]
    q = torch.stack(model.critic(obs, scaled)).amin(0).squeeze(-1)
    assert torch.allclose(victim.q(obs, action), q, atol=1e-5)
    assert torch.allclose(victim.value(obs), q, atol=1e-5)
    assert victim.action_std is None


@pytest.mark.parametrize("activation", [torch.nn.ReLU, torch.nn.Tanh])
def test_the_activation_is_found(hopper, activation):
    model = TD3("MlpPolicy", hopper, policy_kwargs=dict(NET, activation_fn=activation), seed=1, buffer_size=10)
    obs = normal(50, 11)
    assert np.allclose(Victim.from_sb3(model)(obs), expected_action(model, obs), atol=1e-5)


@pytest.mark.parametrize("normalized", [False, True])
def test_a_ppo_model_with_and_without_its_normaliser(normalized):
    env = DummyVecEnv([lambda: gymnasium.make("Hopper-v5")])
    if normalized:
        env = VecNormalize(env, clip_obs=1.0, epsilon=0.1)
        env.reset()
        for _ in range(30):
            env.step([env.action_space.sample()])
    model = PPO("MlpPolicy", env, policy_kwargs=dict(NET), seed=1, n_steps=16, batch_size=16)
    victim = Victim.from_sb3(model, env if normalized else None)
    obs = normal(50, 11) * 2
    seen = torch.tensor(env.normalize_obs(obs.numpy()) if normalized else obs.numpy())
    assert np.allclose(victim(obs), expected_action(model, seen), atol=1e-5)
    distribution = model.policy.get_distribution(seen).distribution
    assert torch.allclose(victim.mean(obs), distribution.mean, atol=1e-5)
    assert torch.allclose(victim.action_std, distribution.stddev[0])
    assert torch.allclose(victim.value(obs), model.policy.predict_values(seen).squeeze(-1), atol=1e-5)


def test_a_td3_model_of_sbx(hopper):
    import sbx

    model = sbx.TD3("MlpPolicy", hopper, policy_kwargs=dict(NET), seed=1, buffer_size=10)
    victim, obs = Victim.from_sb3(model), normal(50, 11)
    action = victim(obs)
    assert np.allclose(action, expected_action(model, obs), atol=1e-5)
    policy = model.policy
    both = policy.qf.apply(policy.qf_state.params, obs.numpy(), action.numpy())
    assert np.allclose(victim.q(obs, action), np.asarray(both).min(0).squeeze(-1), atol=1e-5)
    assert np.allclose(victim.value(obs), np.asarray(both).min(0).squeeze(-1), atol=1e-5)


def test_models_of_another_kind_are_refused(hopper):
    import sbx

    for algorithm in (SAC, sbx.SAC, sbx.PPO):
        model = algorithm("MlpPolicy", hopper, policy_kwargs=dict(NET))
        with pytest.raises(ValueError, match=f"model: {algorithm.__name__}"):
            Victim.from_sb3(model)


def test_networks_that_are_no_plain_mlp_are_refused(hopper):
    import sbx

    odd = [
        TD3("MlpPolicy", hopper, policy_kwargs=dict(NET, activation_fn=torch.nn.ELU), buffer_size=10),
        TD3("MlpPolicy", hopper, policy_kwargs=dict(NET, features_extractor_class=Doubling), buffer_size=10),
        PPO("MlpPolicy", hopper, policy_kwargs=dict(NET), use_sde=True),
        sbx.TD3("MlpPolicy", hopper, policy_kwargs=dict(NET, layer_norm=True), buffer_size=10),
    ]
    for model in odd:
        with pytest.raises(ValueError, match="model"):
            Victim.from_sb3(model)


def test_a_forgotten_normaliser_is_not_invented(hopper):
    """Without VecNormalize the victim sees what the network sees; with another's it would act differently."""
    model = PPO("MlpPolicy", hopper, policy_kwargs=dict(NET), n_steps=16, batch_size=16)
    assert torch.equal(Victim.from_sb3(model).normalize(normal(4, 11)), normal(4, 11))


def test_a_victim_is_frozen():
    victim = make_victim()
    assert not victim.training and not any(p.requires_grad for p in victim.parameters())
    assert not victim(normal(2, 11)).requires_grad


def test_gradients_reach_the_observation():
    for gaussian in (False, True):
        victim, obs = make_victim(gaussian=gaussian), normal(3, 11).requires_grad_()
        for output in (victim.mean(obs).sum(), victim.value(obs).sum()):
            (gradient,) = torch.autograd.grad(output, obs)
            assert (gradient != 0).any(-1).all()


def test_a_deterministic_action_keeps_the_bounds_and_a_gaussian_mean_is_clipped():
    far = normal(100, 11) * 100
    victim = make_victim(gaussian=True)
    assert (victim.mean(far).abs() > 1).any() and (victim(far).abs() <= 1).all()
    assert torch.equal(make_victim()(far), make_victim().mean(far))


def test_config_and_state_make_the_same_victim():
    for gaussian in (False, True):
        victim, obs = make_victim(HOPPER, 3, gaussian), normal(5, 11)
        again = Victim.from_state(victim.config, victim.state_dict())
        assert torch.equal(again(obs), victim(obs)) and torch.equal(again.value(obs), victim.value(obs))


def test_without_a_critic_the_question_is_refused():
    with pytest.raises(ValueError, match="no Q-function"):
        make_victim(gaussian=True).q(normal(2, 11), normal(2, 3))


def test_an_unknown_activation_is_refused():
    with pytest.raises(ValueError, match="activation"):
        Victim([11, 4, 3], activation="elu")
