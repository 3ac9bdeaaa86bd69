"""Checks of the chapter on the robustness regulariser."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare
from detden_lite.checks.failure import explained
from detden_lite.core.budget import Budget
from detden_lite.defense.gruvae import GRUVAE, kl_divergence, reconstruction_loss
from detden_lite.training.regularizer import Regularizer
from detden_lite.victims.victim import Victim


@explained
def check_r_ppo(r_ppo: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``r_ppo(action, reference, std)`` is R_ppo of each observation, ``[N, steps]``; std is ``[action_dim]``."""
    draw = torch.Generator().manual_seed(0)
    action, reference = torch.randn(2, 3, 4, 3, generator=draw)
    std = torch.tensor([0.5, 2.0, 1.5])
    moved, call = action - reference, "r_ppo(action, reference, std)"
    mistakes = {
        "Sigma is missing: that is the plain squared distance": moved.square().sum(-1),
        "Sigma holds VARIANCES, std squared: weigh the squares by 1 / std^2": (moved.square() / std).sum(-1),
        "Divide by the variance once: (x / std) squared, or x squared / std^2": (moved / std.square()).square().sum(-1),
        "It is Sigma^-1: an action with a small std counts more, not less": (moved * std).square().sum(-1),
        "R_ppo is the squared distance, without a root (R_td3 has one)": (moved / std).norm(dim=-1),
        "That is the KL divergence; R_ppo is twice as large": (moved / std).square().sum(-1) / 2,
        "Sum over the actions; that is their mean": (moved / std).square().mean(-1),
        "Square before you sum, or differences of opposite signs cancel": (moved / std).sum(-1).square(),
    }
    got = r_ppo(action, reference, std)
    assert array(call, got).shape != (), f"{call} gives one number for all observations; each has its own, [N, steps]"
    compare(call, got, (moved / std).square().sum(-1), mistakes)
    print("Right. Half the standard deviation makes the same difference count four times as much.")


@explained
def check_training_loss(training_loss: Callable[..., Tensor]) -> None:
    """``training_loss(model, regularizer, true, perturbed, mask, noise, beta, lam)`` is the loss that Adam minimises.

    beta (-L_den) + lam R, both as means over what is not padding; R is of the true sequences with the same noise.
    """
    torch.manual_seed(0)
    model = GRUVAE(obs_dim=3, hidden=8, latent=4)
    model.set_statistics(torch.zeros(3), torch.tensor([1.0, 2.0, 0.5]))
    regularizer = Regularizer(Victim([3, 8, 2]), Budget(0.2), steps=1)
    true = torch.randn(2, 6, 3)
    perturbed, noise, beta, lam = true + 0.3 * torch.randn(2, 6, 3), torch.randn(2, 6, 4), 0.1, 0.5
    mask = (torch.arange(6) < torch.tensor([[6], [3]])).float()

    def r(obs: Tensor, where: Tensor = mask, z: Tensor | None = noise) -> float:
        torch.manual_seed(1)  # of the inner attack's random start
        return regularizer(model, obs, where, z).item()

    def elbo_part(
        shown: Tensor, wanted: Tensor, where: Tensor = mask, weight: float = beta, over: float | None = None
    ) -> float:
        with torch.no_grad():
            result = model(shown, noise)
            loss = reconstruction_loss(model, result.output, wanted)
            loss = loss + weight * kl_divergence(result.mean, result.log_variance)
            return ((loss * where).sum() / (over or where.sum())).item()

    all_steps, error = torch.ones(2, 6), elbo_part(perturbed, true)
    mistakes = {
        "R is subtracted: minimising this makes R LARGE. It must become small, so add it": error - lam * r(true),
        "L_den has the printed sign: it is an ELBO, and minimising it makes the denoiser worse": -error + lam * r(true),
        "That is minus what should be minimised": -error - lam * r(true),
        "lam is missing before R": error + r(true),
        "R is missing": error,
        "lam weighs the ELBO; it should weigh R": lam * error + r(true),
        "R is given perturbed, which is attacked already. It makes its own attack, so give it true": (
            error + lam * r(perturbed)
        ),
        "R is of the latent's mean here; give it the same noise": error + lam * r(true, z=None),
        "steps after an episode's end are counted in R": error + lam * r(true, all_steps),
        "steps after an episode's end are counted in the error": elbo_part(perturbed, true, all_steps) + lam * r(true),
        "the input is true and the target perturbed: swap them": elbo_part(true, perturbed) + lam * r(true),
        "the input is true, and must be perturbed": elbo_part(true, true) + lam * r(true),
        "beta is missing before the KL": elbo_part(perturbed, true, weight=1.0) + lam * r(true),
        "the KL is subtracted; it must become small": elbo_part(perturbed, true, weight=-beta) + lam * r(true),
        "reconstruction_loss has beta in it already; beta weighs the KL alone": (
            beta * elbo_part(perturbed, true, weight=1.0) + lam * r(true)
        ),
        "divide by the number of steps that count, mask.sum()": elbo_part(perturbed, true, over=12.0) + lam * r(true),
        "the KL is missing": elbo_part(perturbed, true, weight=0.0) + lam * r(true),
    }
    call = "training_loss(model, regularizer, true, perturbed, mask, noise, 0.1, 0.5)"
    torch.manual_seed(1)
    got = training_loss(model, regularizer, true, perturbed, mask, noise, beta, lam)
    compare(call, got, error + lam * r(true), mistakes)
    assert getattr(got, "requires_grad", False), f"{call} has no gradient: leave `detach` and `no_grad` out"
    gradients = torch.autograd.grad(got, list(model.parameters()), allow_unused=True)
    assert all(g is not None and g.isfinite().all() for g in gradients), (
        "some of the denoiser's weights have no gradient"
    )
    torch.manual_seed(1)
    compare("with lam = 0 it", training_loss(model, regularizer, true, perturbed, mask, noise, beta, 0.0), error)
    print("Right. Both terms must become small, so both are added; with lam = 0 this is chapter 4's loss.")


@explained
def check_survives(survives: Callable[[Tensor, Tensor], Tensor]) -> None:
    """``survives(action, denoised_action)`` is the share of the actions' variance that is left, a number up to 1."""
    draw = torch.Generator().manual_seed(0)
    action = torch.randn(50, 3, generator=draw) * torch.tensor([1.0, 0.3, 2.0]) + torch.tensor([0.5, -1.0, 3.0])
    mean = action.mean(0)
    shrunk, away = mean + 0.6 * (action - mean), action + 0.4 * torch.randn(50, 3, generator=draw)

    def total(x: Tensor) -> Tensor:
        return (x - x.mean(0)).square().sum()

    def squared_correlation(a: Tensor, b: Tensor) -> Tensor:
        a, b = a - a.mean(), b - b.mean()
        return (a * b).sum().square() / (a.square().sum() * b.square().sum()).clamp_min(1e-12)

    for name, other, expected in (
        ("the same actions", action, 1.0),
        ("actions that vary less", shrunk, 0.84),
        ("the mean action for every observation", mean.expand_as(action), 0.0),
        ("actions with errors", away, float(1 - (away - action).square().sum() / total(action))),
    ):
        wrong = (other - action).square().sum()
        spread = total(other)
        mistakes = {
            "That is the share that is LOST; survives is 1 minus it": wrong / total(action),
            "Divide by how much pi(o) itself varies: the squared distance from its mean, not from 0": (
                1 - wrong / action.square().sum()
            ),
            "Each action has its own mean over the observations: mean(0)": (
                1 - wrong / (action - action.mean()).square().sum()
            ),
            "Compare denoised with true actions, not how much each of them varies": (spread / total(action)),
            "Divide by how much the TRUE actions vary, not the denoised ones": 1 - wrong / spread,
            "var divides by n - 1; take unbiased=False, or the mean of squares": (
                1 - (other - action).square().mean(0).sum() / action.var(0).sum()
            ),
            "That is the squared correlation. It forgives actions that are too small or shifted; take the errors": (
                squared_correlation(action.flatten(), other.flatten())
            ),
            "That is the mean of the actions' squared correlations. It forgives actions that are too small or "
            "shifted; take the errors": (
                torch.stack([squared_correlation(a, b) for a, b in zip(action.T, other.T, strict=True)]).mean()
            ),
            "That is the correlation of the actions. It forgives actions that are too small or shifted; take the "
            "errors": squared_correlation(action.flatten(), other.flatten()).sqrt(),
            "That is the mean of the actions' own shares (R^2); sum over the actions before you divide": (
                1 - ((other - action).square().sum(0) / (action - mean).square().sum(0)).mean()
            ),
            "Square the differences": 1 - (other - action).abs().sum() / (action - mean).abs().sum(),
        }
        compare(f"survives for {name}", survives(action, other), expected, mistakes)
    constant = survives(action, torch.full_like(action, 3.0))
    assert constant < 0, "a constant far from the mean is worse than the mean: the share is negative, do not clip it"
    print("Right. 1 means that the actions are unchanged, 0 that they are no better than a constant action.")
