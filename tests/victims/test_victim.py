import gymnasium
import numpy as np
import pytest
import torch
from builders import HOPPER, make_victim, normal
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from detden_lite.core.networks import mlp
from detden_lite.victims.victim import Victim

NET = dict(net_arch=[16, 12])  # to be copied: the models write into it


@pytest.fixture(scope="module")
def hopper():
    return gymnasium.make("Hopper-v5")


class Wide(gymnasium.ActionWrapper):
    """Actions in other units than [-1, 1]."""

    def __init__(self):
        super().__init__(gymnasium.make("Hopper-v5"))
        self.action_space = gymnasium.spaces.Box(np.array([-2, 0, 1], np.float32), np.array([2, 3, 5], np.float32))

    def action(self, action):
        return (action - np.array([0, 1.5, 3])) / np.array([2, 1.5, 2])


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


@pytest.mark.parametrize("algorithm", [PPO, A2C])
@pytest.mark.parametrize("normalized", [False, True])
def test_a_gaussian_model_with_and_without_its_normaliser(algorithm, normalized):
    env = DummyVecEnv([lambda: gymnasium.make("Hopper-v5")])
    if normalized:
        env = VecNormalize(env, clip_obs=1.0, epsilon=0.1)
        env.reset()
        for _ in range(30):
            env.step([env.action_space.sample()])
    model = algorithm("MlpPolicy", env, policy_kwargs=dict(NET), seed=1, n_steps=16)
    victim = Victim.from_sb3(model, env if normalized else None)
    obs = normal(50, 11) * 2
    seen = torch.tensor(env.normalize_obs(obs.numpy()) if normalized else obs.numpy())
    assert np.allclose(victim(obs), expected_action(model, seen), atol=1e-5)
    distribution = model.policy.get_distribution(seen).distribution
    assert torch.allclose(victim.mean(obs), distribution.mean, atol=1e-5)
    assert torch.allclose(victim.action_std, distribution.stddev[0])
    assert torch.allclose(victim.value(obs), model.policy.predict_values(seen).squeeze(-1), atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["TD3", "DDPG"])
def test_a_td3_model_of_sbx(hopper, name):
    import sbx

    model = getattr(sbx, name)("MlpPolicy", hopper, policy_kwargs=dict(NET), seed=1, buffer_size=10)
    victim, obs = Victim.from_sb3(model), normal(50, 11)
    action = victim(obs)
    assert np.allclose(action, expected_action(model, obs), atol=1e-5)
    policy = model.policy
    both = policy.qf.apply(policy.qf_state.params, obs.numpy(), action.numpy())
    assert np.allclose(victim.q(obs, action), np.asarray(both).min(0).squeeze(-1), atol=1e-5)
    assert np.allclose(victim.value(obs), np.asarray(both).min(0).squeeze(-1), atol=1e-5)


def trained(algorithm, net=NET, steps: int = 400, seed: int = 1, **settings):
    """A model after some hundred steps, in a VecNormalize whose clipping bites, and observations to ask it about."""
    env = VecNormalize(DummyVecEnv([Wide]), clip_obs=1.5, epsilon=0.01)
    model = algorithm("MlpPolicy", env, policy_kwargs=dict(net), seed=seed, **settings).learn(steps)
    obs = env.obs_rms.mean + np.sqrt(env.obs_rms.var) * normal(50, 11, seed=3).numpy() * 2
    seen = env.normalize_obs(obs)
    assert 0.05 < (np.abs(seen) == 1.5).mean() < 0.95
    return model, env, torch.tensor(obs, dtype=torch.float32), seen.astype(np.float32)


TD3_SETTINGS = dict(buffer_size=500, learning_starts=100, batch_size=16, learning_rate=1e-2)
PPO_SETTINGS = dict(n_steps=64, batch_size=32, n_epochs=2, learning_rate=1e-2)


def test_a_trained_td3_of_stable_baselines3_with_its_normaliser():
    model, env, obs, seen = trained(TD3, **TD3_SETTINGS)
    victim = Victim.from_sb3(model, env)
    action = victim(obs)
    assert np.allclose(action, model.predict(seen, deterministic=True)[0], atol=1e-5)
    scaled = model.policy.scale_action(action.numpy())
    q = torch.stack(model.critic(torch.from_numpy(seen), torch.from_numpy(scaled))).squeeze(-1)
    assert torch.allclose(victim.qs(obs, action), q, rtol=1e-5, atol=1e-5)
    assert torch.allclose(victim.value(obs), q.amin(0), rtol=1e-5, atol=1e-5)


def test_a_trained_ppo_of_stable_baselines3_with_its_normaliser():
    model, env, obs, seen = trained(PPO, **PPO_SETTINGS)
    victim = Victim.from_sb3(model, env)
    distribution = model.policy.get_distribution(torch.from_numpy(seen)).distribution
    assert np.allclose(victim(obs), model.predict(seen, deterministic=True)[0], atol=1e-5)
    assert torch.allclose(victim.mean(obs), distribution.mean, atol=1e-5)
    assert (
        torch.allclose(victim.action_std, distribution.stddev[0]) and (victim.action_std != 1).all()
    )  # it was trained
    values = model.policy.predict_values(torch.from_numpy(seen)).squeeze(-1)
    assert torch.allclose(victim.value(obs), values, rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_a_trained_td3_of_sbx_with_its_normaliser():
    import sbx

    model, env, obs, seen = trained(sbx.TD3, **TD3_SETTINGS)
    victim = Victim.from_sb3(model, env)
    action = victim(obs)
    assert np.allclose(action, model.predict(seen, deterministic=True)[0], atol=1e-5)
    scaled = model.policy.scale_action(action.numpy())
    q = np.asarray(model.policy.qf.apply(model.policy.qf_state.params, seen, scaled)).squeeze(-1)
    assert np.allclose(victim.qs(obs, action), q, rtol=1e-5, atol=1e-5)
    assert np.allclose(victim.value(obs), q.min(0), rtol=1e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("activation", ["tanh", "relu"])
def test_a_trained_ppo_of_sbx_with_its_normaliser(activation):
    import jax
    import sbx

    net = dict(NET, activation_fn=dict(tanh=jax.numpy.tanh, relu=jax.nn.relu)[activation])
    model, env, obs, seen = trained(sbx.PPO, net, **PPO_SETTINGS)
    victim = Victim.from_sb3(model, env)
    assert victim.config["activation"] == activation
    policy = model.policy
    distribution = policy.actor_state.apply_fn(policy.actor_state.params, seen)
    assert np.allclose(victim(obs), model.predict(seen, deterministic=True)[0], atol=1e-5)
    assert np.allclose(victim.mean(obs), distribution.mode(), atol=1e-5)
    assert np.allclose(victim.action_std, np.asarray(distribution.stddev())[0]) and (victim.action_std != 1).all()
    values = policy.vf_state.apply_fn(policy.vf_state.params, seen)
    assert np.allclose(victim.value(obs), np.asarray(values).squeeze(-1), rtol=1e-5, atol=1e-5)


def test_models_of_another_kind_are_refused(hopper):
    import sbx

    for algorithm in (SAC, sbx.SAC, sbx.CrossQ):
        model = algorithm("MlpPolicy", hopper, policy_kwargs=dict(NET))
        with pytest.raises(ValueError, match=f"model: {algorithm.__name__}"):
            Victim.from_sb3(model)
    model = DQN("MlpPolicy", "CartPole-v1", buffer_size=1)
    for other, name in (
        (model, "DQN"),
        (None, "NoneType"),
        ("model.zip", "str"),
        (PPO, "ABCMeta"),
        (object(), "object"),
    ):
        with pytest.raises(ValueError, match=f"model: {name} is none of TD3, DDPG, PPO, A2C"):
            Victim.from_sb3(other)


class Odd(gymnasium.Env):
    """Spaces to be refused; nothing moves in them."""

    def __init__(self, observation_space, action_space):
        self.observation_space, self.action_space = observation_space, action_space


VECTOR, PICTURE = gymnasium.spaces.Box(-1, 1, (3,)), gymnasium.spaces.Box(0, 255, (3, 36, 36), np.uint8)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PPO("CnnPolicy", Odd(PICTURE, VECTOR)), "the observations of this PPO must be vectors.*36"),
        (lambda: TD3("CnnPolicy", Odd(PICTURE, VECTOR), buffer_size=10), "the observations of this TD3"),
        (
            lambda: PPO("MultiInputPolicy", Odd(gymnasium.spaces.Dict(a=VECTOR, b=VECTOR), VECTOR)),
            "the observations of this PPO must be vectors.*Dict",
        ),
        (lambda: PPO("MlpPolicy", Odd(VECTOR, gymnasium.spaces.Discrete(2))), "the actions of this PPO.*Discrete"),
        (lambda: PPO("MlpPolicy", Odd(VECTOR, VECTOR), use_sde=True), "gSDE"),
    ],
    ids=["pictures", "pictures-td3", "dictionaries", "choices", "gsde"],
)
def test_spaces_that_are_no_vectors_are_refused_by_name(make, message):
    with pytest.raises(ValueError, match=f"model: .*{message}"):
        Victim.from_sb3(make())


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


def test_a_forgotten_normaliser_is_refused():
    env = VecNormalize(DummyVecEnv([Wide]))
    model = PPO("MlpPolicy", env, policy_kwargs=dict(NET), n_steps=16, batch_size=16)
    with pytest.raises(ValueError, match="vecnormalize: this PPO saw normalised observations"):
        Victim.from_sb3(model)
    env.norm_obs = False  # it normalised rewards only
    assert torch.equal(Victim.from_sb3(model).normalize(normal(4, 11)), normal(4, 11))


@pytest.mark.parametrize("algorithm", [PPO, A2C, TD3])
def test_a_loaded_model_says_nothing_of_its_normaliser(tmp_path, algorithm):
    """It must be given, or None said: an environment would tell, and a file has none."""
    env, settings = VecNormalize(DummyVecEnv([Wide])), TD3_SETTINGS if algorithm is TD3 else dict(n_steps=16)
    algorithm("MlpPolicy", env, policy_kwargs=dict(NET), **settings).learn(64).save(tmp_path / "model.zip")
    model = algorithm.load(tmp_path / "model.zip")
    with pytest.raises(ValueError, match="vecnormalize: this .* was loaded without its environment.*vecnormalize=None"):
        Victim.from_sb3(model)
    assert torch.equal(Victim.from_sb3(model, vecnormalize=None).obs_mean, torch.zeros(11))
    found = Victim.from_sb3(model, vecnormalize=env)
    assert np.allclose(found.obs_mean, env.obs_rms.mean, atol=1e-6) and (found.obs_mean != 0).any()


def test_a_normaliser_that_is_none_is_refused(hopper):
    model = PPO("MlpPolicy", hopper, policy_kwargs=dict(NET), n_steps=16, batch_size=16)
    for other in ("yes", VecNormalize(DummyVecEnv([lambda: gymnasium.make("Pendulum-v1")]))):
        with pytest.raises(ValueError, match=r"vecnormalize: give a VecNormalize of observations \(11,\), or None"):
            Victim.from_sb3(model, other)


def test_a_model_with_its_bare_environment_has_no_normaliser(hopper):
    """Without VecNormalize the victim sees what the network sees."""
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


def test_actions_keep_the_bounds():
    far = normal(100, 11) * 100
    victim = make_victim(gaussian=True)
    assert (victim.mean(far).abs() > 1).any() and (victim(far).abs() <= 1).all()
    assert torch.equal(make_victim()(far), make_victim().mean(far))


def test_config_and_state_make_the_same_victim():
    for gaussian in (False, True):
        victim, obs = make_victim(HOPPER, 3, gaussian), normal(5, 11)
        again = Victim.from_state(victim.config, victim.state_dict())
        assert torch.equal(again(obs), victim(obs)) and torch.equal(again.value(obs), victim.value(obs))


def test_q_without_a_critic_is_refused():
    with pytest.raises(ValueError, match="no Q-function"):
        make_victim(gaussian=True).q(normal(2, 11), normal(2, 3))


def critic_of(victim: Victim, seed: int = 5) -> dict:
    torch.manual_seed(seed)
    return mlp([victim.obs_dim + victim.action_dim, 8, 1]).state_dict()


def test_a_learned_critic_does_not_change_policy_and_value():
    victim, obs = make_victim(gaussian=True), normal(20, 11)
    before = {name: tensor.clone() for name, tensor in victim.state_dict().items()}
    with_critic = victim.with_critic([14, 8, 1], critic_of(victim))
    for name in ("mean", "value", "normalize", "forward"):
        assert torch.equal(getattr(with_critic, name)(obs), getattr(victim, name)(obs))
    assert torch.equal(with_critic.action_std, victim.action_std)
    assert not torch.equal(with_critic.value(obs), with_critic.q(obs, with_critic(obs)))
    assert not any(parameter.requires_grad for parameter in with_critic.parameters()) and not with_critic.training
    # The first is as it was, and still has none.
    assert victim.state_dict().keys() == before.keys() and not len(victim.critics)
    # Another one takes its place.
    again = with_critic.with_critic([14, 8, 1], critic_of(victim, 6))
    assert len(again.critics) == 1 and not torch.equal(again.q(obs, obs[:, :3]), with_critic.q(obs, obs[:, :3]))


def test_a_learned_critic_sees_normalised_observations_and_scaled_actions():
    victim = make_victim(gaussian=True)
    victim.obs_mean.fill_(2), victim.obs_std.fill_(0.5), victim.obs_clip.fill_(3)
    victim.action_low.fill_(-4), victim.action_high.fill_(2)
    with_critic = victim.with_critic([14, 8, 1], critic_of(victim), activation="tanh")
    net = mlp([14, 8, 1], "tanh")
    net.load_state_dict(critic_of(victim))
    obs, action = normal(20, 11) + 2, normal(20, 3)
    expected = net(torch.cat([((obs - 2) / 0.5).clamp(-3, 3), (action + 1) / 3], -1)).squeeze(-1)
    assert torch.allclose(with_critic.q(obs, action), expected, atol=1e-6)


def test_a_learned_critic_has_gradients_for_action_and_observation():
    victim = make_victim(gaussian=True)
    victim = victim.with_critic([14, 8, 1], critic_of(victim), activation="tanh")
    obs, action = normal(3, 11).requires_grad_(), normal(3, 3).requires_grad_()
    for gradient in torch.autograd.grad(victim.q(obs, action).sum(), (obs, action)):
        assert (gradient != 0).any(-1).all()


@pytest.mark.parametrize("sizes", [[11, 8, 1], [14, 8, 2]])
def test_a_critic_of_another_task_is_refused(sizes):
    with pytest.raises(ValueError, match="critic: .* must lead from 14 numbers to 1"):
        make_victim(gaussian=True).with_critic(sizes, mlp(sizes).state_dict())


def test_an_unknown_activation_is_refused():
    with pytest.raises(ValueError, match="activation"):
        Victim([11, 4, 3], activation="elu")
