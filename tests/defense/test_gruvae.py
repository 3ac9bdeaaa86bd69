import numpy as np
import pytest
import torch
from builders import make_gruvae, normal
from torch.distributions import Normal, kl_divergence

from detden_lite.defense import gruvae
from detden_lite.defense.gruvae import GRUVAE, reconstruction_loss

KINDS = [dict(), dict(residual=True), dict(layers=2)]


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sampled", [False, True])
def test_stepping_is_the_whole_sequence_pass(kind, sampled):
    model, obs = make_gruvae(**kind), normal(5, 12, 11)
    noise = normal(5, 12, 4, seed=1) if sampled else None
    whole = model(obs, noise)
    state, outputs = None, []
    for t in range(12):
        step = model(obs[:, t : t + 1], None if noise is None else noise[:, t : t + 1], state)
        state = step.state
        outputs.append(step.output)
    assert torch.allclose(torch.cat(outputs, 1), whole.output, atol=1e-5)
    assert all(torch.allclose(a, b, atol=1e-6) for a, b in zip(state, whole.state, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_chunks_are_the_whole_sequence_pass(kind):
    model, obs, noise = make_gruvae(**kind), normal(5, 12, 11), normal(5, 12, 4, seed=1)
    state, outputs = None, []
    for part in (slice(0, 5), slice(5, 10), slice(10, 12)):
        result = model(obs[:, part], noise[:, part], state)
        state = result.state
        outputs.append(result.output)
    assert torch.allclose(torch.cat(outputs, 1), model(obs, noise).output, atol=1e-5)


@pytest.mark.parametrize("residual", [False, True])
def test_it_is_figure_3_written_down_in_numpy(residual):
    model, obs, noise = make_gruvae(residual=residual), normal(2, 6, 11).numpy(), normal(2, 6, 4, seed=1).numpy()
    p = {name: value.numpy() for name, value in model.state_dict().items()}

    def gru(name, x, h):
        gates_x = x @ p[f"{name}.weight_ih_l0"].T + p[f"{name}.bias_ih_l0"]
        gates_h = h @ p[f"{name}.weight_hh_l0"].T + p[f"{name}.bias_hh_l0"]
        (rx, zx, nx), (rh, zh, nh) = np.split(gates_x, 3, -1), np.split(gates_h, 3, -1)
        update, candidate = sigmoid(zx + zh), np.tanh(nx + sigmoid(rx + rh) * nh)
        return (1 - update) * candidate + update * h

    encoder_state, decoder_state, outputs = np.zeros((2, 8)), np.zeros((2, 8)), []
    for t in range(6):
        x = (obs[:, t] - p["obs_mean"]) / p["obs_std"]
        encoder_state = gru("encoder", x, encoder_state)
        mean = encoder_state @ p["to_mean.weight"].T + p["to_mean.bias"]
        log_variance = encoder_state @ p["to_log_variance.weight"].T + p["to_log_variance.bias"]
        decoder_state = gru("decoder", mean + np.exp(log_variance / 2) * noise[:, t], decoder_state)
        out = decoder_state @ p["to_output.weight"].T + p["to_output.bias"] + (x if residual else 0)
        outputs.append(out * p["obs_std"] + p["obs_mean"])
    result = model(torch.from_numpy(obs), torch.from_numpy(noise))
    assert np.allclose(result.output, np.stack(outputs, 1), atol=1e-5)
    assert np.allclose(result.mean[:, -1], mean, atol=1e-5)
    assert np.allclose(result.log_variance[:, -1], log_variance, atol=1e-5)


def test_the_units_of_observations_do_not_matter():
    model, other, obs = make_gruvae(), make_gruvae(), normal(2, 5, 11)
    unit, offset = torch.linspace(0.1, 100, 11), 7.0
    other.set_statistics(model.obs_mean * unit + offset, model.obs_std * unit)
    assert torch.allclose(other(obs * unit + offset).output, model(obs).output * unit + offset, rtol=1e-3, atol=1e-3)


def test_observations_that_hardly_vary_are_not_blown_up():
    model = GRUVAE(3)
    model.set_statistics(torch.zeros(3), torch.tensor([0.0, 1e-9, 2.0]))
    assert np.allclose(model.obs_std, [0.01, 0.01, 2.0])


def test_a_residual_model_without_a_correction_is_the_identity():
    model, obs = make_gruvae(residual=True), normal(2, 5, 11)
    model.to_output.weight.zero_()
    model.to_output.bias.zero_()
    assert torch.allclose(model(obs, normal(2, 5, 4)).output, obs, atol=1e-6)


def test_a_residual_output_may_leave_observations_out():
    """Of the same weights: where the input is added it agrees with the residual model, elsewhere with the plain one."""
    added = [True] * 4 + [False] * 7
    obs, noise = normal(2, 5, 11), normal(2, 5, 4)
    some, every, none = (make_gruvae(residual=kind)(obs, noise).output for kind in (added, True, False))
    assert torch.equal(some, torch.where(torch.tensor(added), every, none)) and not torch.equal(every, none)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("obs_dim", 0), ("hidden", 0), ("layers", -1), ("latent", 0), ("hidden", 1.5), ("latent", "64"),
        ("residual", [True, False]),
    ],
)  # fmt: skip
def test_sizes_that_make_no_sense_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        GRUVAE(**dict(obs_dim=3) | {name: value})


def test_kl_divergence_is_that_of_torch():
    mean, log_variance = normal(3, 4, 6), normal(3, 4, 6, seed=1)
    q = Normal(mean, (0.5 * log_variance).exp())
    # The paper's prior N(mu_z, I) has a free mean, which at its best is q's own.
    for prior, pr in (("free", Normal(mean, 1.0)), ("standard", Normal(torch.zeros(6), torch.ones(6)))):
        ours = gruvae.kl_divergence(mean, log_variance, prior)
        assert torch.allclose(ours, kl_divergence(q, pr).sum(-1), rtol=1e-4, atol=1e-5), prior
    with pytest.raises(ValueError, match="prior"):
        gruvae.kl_divergence(mean, log_variance, "none")


def test_the_free_prior_is_the_best_of_all_means():
    mean, log_variance = normal(1, 1, 6), normal(1, 1, 6, seed=1)
    q = Normal(mean, (0.5 * log_variance).exp())
    free = gruvae.kl_divergence(mean, log_variance, "free")
    for seed in range(20):
        assert free <= kl_divergence(q, Normal(mean + 0.1 * normal(6, seed=seed), 1.0)).sum(-1)


def test_reconstruction_loss_is_a_negative_log_likelihood():
    model, output, target = make_gruvae(), normal(3, 4, 11), normal(3, 4, 11, seed=1)
    likelihood = Normal(output, model.obs_std)
    constant = -likelihood.log_prob(output).sum(-1)
    expected = -likelihood.log_prob(target).sum(-1) - constant
    assert torch.allclose(reconstruction_loss(model, output, target), expected, rtol=1e-3)


@pytest.mark.parametrize("prior", ["free", "standard"])
def test_the_gradient_of_the_elbo_is_that_of_finite_differences(prior):
    model, obs, noise = make_gruvae().double(), normal(2, 3, 11).double(), normal(2, 3, 4, seed=1).double()

    def negative_elbo(*parameters):
        named = dict(zip(dict(model.named_parameters()), parameters, strict=True))
        result = torch.func.functional_call(model, named, (obs, noise))
        loss = reconstruction_loss(model, result.output, obs)
        return (loss + 0.1 * gruvae.kl_divergence(result.mean, result.log_variance, prior)).mean()

    parameters = [p.detach().clone().requires_grad_() for p in model.parameters()]
    assert torch.autograd.gradcheck(negative_elbo, parameters, fast_mode=True)


def test_later_observations_do_not_change_earlier_outputs():
    model, obs = make_gruvae(), normal(1, 8, 11)
    changed = obs.clone()
    changed[:, 5:] += 1
    before, after = model(obs).output, model(changed).output
    assert torch.equal(before[:, :5], after[:, :5]) and not torch.allclose(before[:, 5:], after[:, 5:])


def test_config_and_state_make_the_same_model():
    for kind in KINDS:
        model, obs = make_gruvae(**kind), normal(2, 3, 11)
        again = GRUVAE.from_state(model.config, model.state_dict())
        assert torch.equal(again(obs).output, model(obs).output)
        assert not again.training and not any(p.requires_grad for p in again.parameters())
