"""Checks of the chapter on offline augmentation and the denoiser."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare, parts
from detden_lite.checks.failure import explained
from detden_lite.defense.gruvae import GRUVAE, kl_divergence, reconstruction_loss


@explained
def check_augment(augment: Callable[[Tensor, Callable[[Tensor], Tensor]], tuple[Tensor, Tensor]]) -> None:
    """``augment(obs, attack)`` gives the denoiser's (input, target); obs is ``[episodes, steps, obs_dim]``."""
    obs = torch.randn(3, 5, 2, generator=torch.Generator().manual_seed(0))
    given = obs.clone()

    def attack(rows: Tensor) -> Tensor:
        assert rows.ndim == 2, f"an attack takes rows [N, obs_dim]; yours was given the shape {list(rows.shape)}"
        assert rows.shape[1] == 2, f"obs_dim is 2 here, but the attack was given rows of {rows.shape[1]} numbers"
        return rows + 0.1 * torch.stack([rows[:, 1], -rows[:, 0]], 1).sign()

    call = "augment(obs, attack)"
    pair = (torch.as_tensor(part) for part in parts(call, augment(given, attack), "inputs", "targets"))
    inputs, targets = (part.to(obs.dtype) for part in pair)
    for name, tensor in (("inputs", inputs), ("targets", targets)):
        assert tensor.shape == obs.shape, (
            f"{name} should have the trajectories' shape {list(obs.shape)}; yours has {list(tensor.shape)}"
        )
    expected = attack(obs.reshape(-1, 2)).reshape(obs.shape)
    assert not (torch.equal(inputs, obs) and torch.allclose(targets, expected)), (
        "inputs and targets are swapped: the input is the attacked observation, and the target the true one"
    )
    assert not torch.allclose(targets, expected), "the targets are attacked too: they must be the true observations"
    assert torch.equal(targets, obs), "the targets should be the clean observations, as they are"
    touched = (inputs != obs).any(-1)
    assert touched.any(), (
        "the inputs are the true observations: the attack is never called, or what it gives is not used"
    )
    assert touched.all(), (
        f"{int((~touched).sum())} of {touched.numel()} observations are not attacked; D_adv attacks every one"
    )
    assert torch.allclose(inputs, expected), (
        "every observation is attacked, but their order has changed: undo the reshape as it was made"
    )
    print("Right. The inputs are attacked, the targets are clean, and no simulator was needed.")


@explained
def check_denoiser_loss(denoiser_loss: Callable[..., Tensor]) -> None:
    """``denoiser_loss(model, true, perturbed, noise, beta)`` is -beta times the denoiser's ELBO, up to a constant."""
    torch.manual_seed(0)
    model = GRUVAE(obs_dim=3, hidden=8, latent=4)
    model.set_statistics(torch.zeros(3), torch.tensor([1.0, 2.0, 0.5]))
    true = torch.randn(2, 6, 3)
    perturbed, noise, beta = true + 0.3 * torch.randn(2, 6, 3), torch.randn(2, 6, 4), 0.1
    with torch.no_grad():
        result = denoiser_loss(model, true, perturbed, noise, beta)

        def value(shown: Tensor, wanted: Tensor, weight: float = beta, latent: Tensor | None = noise) -> Tensor:
            out = model(shown, latent)
            kl = kl_divergence(out.mean, out.log_variance)
            return (reconstruction_loss(model, out.output, wanted) + weight * kl).mean()

        mistakes = {
            "The input is the true observation and the target the perturbed one: swap them": value(true, perturbed),
            "The input and the target are the perturbed observation: that is a detector of attacked "
            "trajectories, not a denoiser": value(perturbed, perturbed),
            "The input and the target are the true observation: that is a detector": value(true, true),
            "The KL is subtracted: an ELBO subtracts it and is maximised, a loss adds it and is minimised": value(
                perturbed, true, -beta
            ),
            "beta is missing before the KL": value(perturbed, true, 1.0),
            "The KL is missing": value(perturbed, true, 0.0),
            "That is the ELBO itself, which is maximised; a loss is minimised: change the sign": -value(
                perturbed, true
            ),
            "noise is not used, so the output is that of the latent's mean: call model(perturbed, noise)": value(
                perturbed, true, latent=None
            ),
            "beta weighs the KL alone, not the error": beta * value(perturbed, true, 1.0),
            "The loss is the mean over episodes and steps; that is the sum": 12 * value(perturbed, true),
        }
        call = "denoiser_loss(model, true, perturbed, noise, 0.1)"
        assert array(call, result).ndim == 0, f"{call} is one number: take the mean of the steps' losses"
        compare(call, result, value(perturbed, true), mistakes, atol=1e-4)
    print("Right. The input is perturbed, the target is true, and the KL is weighted by beta.")


@explained
def check_replace_on_alarm(replace_on_alarm: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``replace_on_alarm(obs, denoised, alarm)`` is what the policy is shown, ``[N, obs_dim]``."""
    obs, denoised = torch.arange(9.0).reshape(3, 3), -torch.arange(9.0).reshape(3, 3) - 1
    alarm = torch.tensor([True, False, False])
    given = obs.clone()
    call = "replace_on_alarm(obs, denoised, alarm)"
    result = replace_on_alarm(given, denoised, alarm)
    mistakes = {
        "An alarm has replaced one DIMENSION of every episode, not every dimension of one EPISODE: "
        "alarm is [N] and obs [N, obs_dim], so write alarm[:, None]": torch.where(alarm, denoised, obs),
        "It is the wrong way round: the denoised observation is for the episodes with an alarm": torch.where(
            alarm[:, None], obs, denoised
        ),
        "Every episode is denoised: without an alarm it keeps its observation, bit for bit": denoised,
        "No episode is denoised: alarm is not used": obs,
        "The observation is replaced, not averaged with the denoised one": torch.where(
            alarm[:, None], (obs + denoised) / 2, obs
        ),
    }
    compare(call, result, torch.where(alarm[:, None], denoised, obs), mistakes, atol=0)
    print("Right. Without an alarm the policy sees the observation unchanged.")


@explained
def check_mae_attacked(mae: Callable[..., float]) -> None:
    """``mae(denoised, obs, attacked, mask)`` is the mean absolute error on attacked steps of episodes still going."""
    obs = np.zeros((4, 2, 3))
    denoised = np.stack([np.full((2, 3), error) for error in (0.1, 0.3, 0.8, 5.0)])
    denoised[..., 0] *= -1  # an error has a sign until its absolute value is taken
    attacked = np.array([[1, 1], [1, 0], [0, 0], [1, 1]], dtype=bool)
    mask = np.array([[1, 1], [1, 1], [1, 1], [0, 0]], dtype=bool)
    call = "mae(denoised, obs, attacked, mask)"
    result = array(call, mae(denoised, obs, attacked, mask))
    assert result.ndim == 0, f"{call} is one number, a mean; yours has the shape {result.shape}"
    error = np.abs(denoised - obs)
    right = error[attacked & mask].mean()
    mistakes = {
        "Steps after an episode's end are counted (mask is False there)": error[attacked].mean(),
        "Steps that were not attacked are counted": error[mask].mean(),
        "All steps are counted, attacked or not, alive or not": error.mean(),
        "Errors of opposite signs cancel: take the absolute value first": (denoised - obs)[attacked & mask].mean(),
        "That is the error summed over the dimensions; take the mean": error[attacked & mask].sum(-1).mean(),
        "The errors are summed over the right steps, but divided by the number of all of them": (
            error * (attacked & mask)[..., None]
        ).mean(),
        "That is the mean SQUARED error": np.square(error[attacked & mask]).mean(),
        "That is the root of the mean squared error": np.sqrt(np.square(error[attacked & mask]).mean()),
    }
    compare(call, result, right, mistakes)
    print("Right. Table 3 of the paper reports this number, in the observations' own units.")
