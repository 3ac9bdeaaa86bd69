from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import BUDGET, NORMS, excess, make_gruvae, make_victim, normal, steady
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from detden_lite.attacks.opposite import opposite_objective
from detden_lite.core.budget import Budget
from detden_lite.core.types import Trajectories
from detden_lite.training.gruvae_training import VAERecipe, train_gruvae
from detden_lite.training.regularizer import Regularizer
from detden_lite.victims.victim import Victim

ALL = torch.ones(3, 6)  # a mask of what the tests below perturb
VICTIMS = [make_victim(), make_victim(gaussian=True)]


def linear_victim(weight: torch.Tensor, std: torch.Tensor | None = None) -> Victim:
    """pi(o) = ``weight`` o; a deterministic one (``std`` None) without the tanh that ``Victim`` ends in."""
    victim = Victim([weight.shape[1], weight.shape[0]], gaussian=std is not None)
    victim.actor = nn.Sequential(nn.Linear(weight.shape[1], weight.shape[0], bias=False)).requires_grad_(False)
    victim.actor[0].weight.copy_(weight)
    if std is not None:
        victim.action_std.copy_(std)
    return victim


def identity_denoiser(obs_dim: int):
    """A residual GRU-VAE whose correction is nothing."""
    model = make_gruvae(obs_dim, residual=True)
    model.to_output.weight.zero_(), model.to_output.bias.zero_()
    return model


def sequences(dim: int = 11) -> torch.Tensor:
    return normal(3, 6, dim)


def attacked(regularizer, model, obs, mask=ALL, seed: int = 0, **context):
    torch.manual_seed(seed)
    return regularizer.attack(model, obs, regularizer.action(model, obs, **context), mask, **context)


@pytest.mark.parametrize("victim", VICTIMS, ids=["td3", "ppo"])
def test_the_policys_kind_selects_the_opposite_attacks_distance(victim):
    obs, seen = normal(5, 11), normal(5, 11, seed=1)
    distance = Regularizer(victim, BUDGET).distance(victim.mean(seen), victim.mean(obs))
    expected = opposite_objective(victim, obs)(seen)
    assert torch.allclose(distance if victim.action_std is not None else distance**2, expected, rtol=1e-4)


@pytest.mark.parametrize("reference", ["denoised", "true"])
@pytest.mark.parametrize("norm", NORMS)
def test_r_of_a_linear_policy_is_the_closed_form(norm, reference):
    """With one action w o the worst perturbation moves it by epsilon ||w||, in the dual norm."""
    weight = torch.tensor([[2.0, -1.0, 0.5, 3.0]])
    largest = 0.3 * torch.linalg.vector_norm(weight, ord={float("inf"): 1, 2: 2, 1: float("inf")}[norm])
    model, obs = identity_denoiser(4), sequences(4)
    for std, expected in ((None, largest), (torch.tensor([0.5]), (largest / 0.5) ** 2)):
        regularizer = Regularizer(linear_victim(weight, std), Budget(0.3, norm), 20, reference)
        assert 0.98 * expected < regularizer(model, obs, ALL) < 1.00001 * expected


@steady
@given(st.sampled_from(NORMS), st.floats(0, 2), st.booleans(), st.integers(1, 4), st.booleans())
def test_the_inner_attack_stays_in_the_ball_of_every_observation(norm, epsilon, scaled, steps, gaussian):
    budget = Budget(epsilon, norm, torch.linspace(0.5, 2, 11) if scaled else 1.0)
    obs = sequences()
    found = attacked(Regularizer(VICTIMS[gaussian], budget, steps), make_gruvae(), obs)
    assert found.shape == obs.shape and excess(budget, obs.flatten(0, 1), found.flatten(0, 1)) <= 0


@pytest.mark.parametrize("victim", VICTIMS, ids=["td3", "ppo"])
def test_the_inner_attack_beats_chance_and_grows_with_steps(victim):
    model, obs = make_gruvae(), normal(20, 6, 11)
    mask, noise = torch.ones(20, 6), normal(20, 6, 4, seed=2)

    def value(steps: int, size: float = 1.0) -> float:
        torch.manual_seed(0)
        budget = Budget(size * BUDGET.epsilon)
        return Regularizer(victim, budget, steps)(model, obs, mask, noise).item()

    chance = Regularizer(victim, BUDGET)
    start = obs + BUDGET.epsilon * (2 * torch.rand(obs.shape, generator=torch.Generator().manual_seed(0)) - 1)
    moved = chance.distance(chance.action(model, start, noise), chance.action(model, obs, noise)).mean().item()
    assert moved < value(1) < value(10)
    assert value(3, size=0.0) == 0 and value(3, size=0.5) < value(3)


def test_earlier_observations_are_perturbed_to_change_later_actions():
    """Only the last action counts; all observations that lead to it are moved, and none in another sequence."""
    obs, mask = sequences(), torch.zeros(3, 6)
    mask[0, -1] = 1
    regularizer = Regularizer(make_victim(), BUDGET, steps=3)
    started = attacked(replace(regularizer, steps=1), make_gruvae(), obs, torch.zeros(3, 6))
    moved = (attacked(regularizer, make_gruvae(), obs, mask) != started).any(-1)
    assert moved[0].all() and not moved[1:].any()


def test_padding_does_not_count():
    regularizer, model, obs = Regularizer(make_victim(), BUDGET), make_gruvae(), sequences()
    mask = (torch.arange(6) < torch.tensor([[6], [2], [4]])).float()
    padded = torch.where(mask[..., None] > 0, obs, 1e3)
    values = []
    for given_obs in (obs, padded):
        torch.manual_seed(0)
        values.append(regularizer(model, given_obs, mask).item())
    assert values[0] == pytest.approx(values[1], rel=1e-5)
    assert regularizer(model, obs, torch.zeros(3, 6)).item() == 0  # of nothing but padding


def test_a_later_chunk_continues_from_the_denoisers_memory():
    regularizer, model, obs = Regularizer(make_victim(), BUDGET), make_gruvae(), sequences()
    noise, whole = normal(3, 6, 4, seed=1), regularizer.action
    first = model(obs[:, :2], noise[:, :2])
    later = whole(model, obs[:, 2:], noise[:, 2:], first.state)
    assert torch.allclose(later, whole(model, obs, noise)[:, 2:], atol=1e-6)
    still = replace(regularizer, budget=Budget(0.0))
    assert still(model, obs[:, 2:], ALL[:, 2:], noise[:, 2:], first.state).item() == 0  # whatever was sampled


def test_only_the_true_reference_penalises_ignoring_the_input():
    model = make_gruvae()
    model.to_output.weight.zero_()
    regularizer, obs = Regularizer(make_victim(), BUDGET), sequences()
    assert regularizer(model, obs, ALL).item() == 0
    assert replace(regularizer, reference="true")(model, obs, ALL).item() > 0.01


@pytest.mark.parametrize("victim", VICTIMS, ids=["td3", "ppo"])
def test_the_gradient_is_the_denoisers_alone(victim):
    model = make_gruvae().requires_grad_(True).train()
    before = {name: tensor.clone() for name, tensor in victim.state_dict().items()}
    Regularizer(victim, BUDGET)(model, sequences(), ALL, normal(3, 6, 4, seed=1)).backward()
    assert all(parameter.grad.abs().sum() > 0 for name, parameter in model.named_parameters() if "weight" in name)
    assert all(parameter.grad is None and not parameter.requires_grad for parameter in victim.parameters())
    assert all(torch.equal(tensor, before[name]) for name, tensor in victim.state_dict().items())


def test_where_both_actions_are_equal_the_gradient_is_finite():
    model = make_gruvae().requires_grad_(True)
    Regularizer(make_victim(), Budget(0.0))(model, sequences(), ALL, normal(3, 6, 4)).backward()
    assert all(parameter.grad.isfinite().all() for parameter in model.parameters())


@pytest.mark.parametrize("arguments", [dict(steps=0), dict(reference="attacked")])
def test_regularizer_settings_that_make_no_sense_are_refused(arguments):
    with pytest.raises(ValueError, match=next(iter(arguments))):
        Regularizer(make_victim(), BUDGET, **arguments)


# Training with it, on a toy: slow waves, a policy that reads two of three numbers, and a ball as large as they vary.
RECIPE = VAERecipe(hidden=16, latent=4, epochs=8, batch=8, chunk=10, learning_rate=1e-2)
TOY = Regularizer(linear_victim(torch.tensor([[1.0, -1.0, 0.0]])), Budget(0.5))


def waves(n: int = 24, steps: int = 20, seed: int = 0) -> Trajectories:
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 6.28, (n, 1, 3))
    obs = np.sin(np.arange(steps)[None, :, None] * [0.3, 0.5, 0.7] + phase)
    return Trajectories(obs.astype(np.float32), np.full(n, steps))


NORMAL = waves()
PAIRS = [(NORMAL, NORMAL)]


def held_out_r(model) -> float:
    """R of sequences that the training has not seen, under a stronger attack than the training's."""
    obs = torch.from_numpy(waves(seed=1).obs)
    torch.manual_seed(0)
    with torch.no_grad():
        return replace(TOY, steps=20)(model, obs, torch.ones(obs.shape[:2])).item()


def test_training_with_r_lowers_it_on_held_out_trajectories():
    """So the sign is right: with the paper's, R would have grown."""
    without, little, much = (
        held_out_r(train_gruvae(replace(RECIPE, lam=lam), PAIRS, 0, regularizer=TOY)) for lam in (0, 0.3, 3)
    )
    assert much < little < without and much < 0.7 * without
