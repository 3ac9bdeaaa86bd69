"""Checks of the chapter on attackers who know the defence."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare
from detden_lite.checks.failure import explained


@explained
def check_hidden(hidden: Callable[[Callable, Tensor, Tensor, Tensor], Tensor]) -> None:
    """``hidden(det, obs, perturbed, scale)`` is large where the detector sees little of the attack, ``[N]``."""
    shift = torch.tensor([0.3, -0.2, 0.5])

    def det(seen: Tensor) -> Tensor:
        return 0.5 * seen + shift

    obs = torch.tensor([[1.0, 2.0, 0.0], [3.0, 0.5, 1.0]])
    perturbed = (obs + torch.tensor([[0.1, -0.1, 0.1], [-0.1, 0.1, 0.1]])).requires_grad_()
    scale = torch.tensor([1.0, 2.0, 0.5])
    deviation = perturbed - det(perturbed)
    right, appendix = -(deviation / scale).abs().amax(-1), ((det(perturbed) - obs) / scale).abs().amax(-1)
    mistakes = {
        "That is the score itself, and a large score raises the alarm: change the sign": -right,
        "That is the distance from obs, as in appendix B. The detector never sees obs: it compares with perturbed": (
            appendix
        ),
        "The sign is right, but the distance is from obs; the detector compares with perturbed": -appendix,
        "The detector is shown perturbed, and not obs": -((perturbed - det(obs)) / scale).abs().amax(-1),
        "perturbed is not used: that is the score of the true observation": (
            -((obs - det(obs)) / scale).abs().amax(-1)
        ),
        "Divide by scale: the detector's score is z-scored": -deviation.abs().amax(-1),
        "Divide by scale, do not multiply": -(deviation * scale).abs().amax(-1),
        "The score is the LARGEST deviation; that is the mean": -(deviation / scale).abs().mean(-1),
        "The score is the LARGEST deviation in size; that is the l2 norm of all": -(deviation / scale).norm(dim=-1),
        "The score is the LARGEST deviation; those are the squares": -(deviation / scale).square().amax(-1),
        "The score is the LARGEST deviation; that is the sum": -(deviation / scale).abs().sum(-1),
        "The score is the largest deviation in size: abs() before amax": -(deviation / scale).amax(-1),
        "A deviation may have either sign: abs() before amax": -(-deviation / scale).amax(-1),
    }
    call = "hidden(det, obs, perturbed, scale)"
    got = hidden(det, obs, perturbed, scale)
    assert array(call, got).shape != (), f"{call} gives one number for both observations; each has its own"
    compare(call, got, right.detach(), {hint: wrong.detach() for hint, wrong in mistakes.items()})
    assert getattr(got, "requires_grad", False), (
        f"{call} has no gradient: without `no_grad` and `detach`, autograd finds it through the detector"
    )
    (gradient,) = torch.autograd.grad(got.sum(), perturbed, retain_graph=True)
    hints = {
        "det(perturbed) is detached: the attacker knows the detector, and its gradient flows through it": (
            torch.autograd.grad(-((perturbed - det(perturbed).detach()) / scale).abs().amax(-1).sum(), perturbed)[0]
        ),
        "Only the gradient through det is left: perturbed itself is detached": (
            torch.autograd.grad(-((perturbed.detach() - det(perturbed)) / scale).abs().amax(-1).sum(), perturbed)[0]
        ),
    }
    compare(
        f"the gradient of {call} with respect to perturbed",
        gradient,
        torch.autograd.grad(-(deviation / scale).abs().amax(-1).sum(), perturbed)[0],
        hints,
    )
    print("Right. It is large where the score is small, and it does not use obs, which no detector knows.")


@explained
def check_eot_gradient(eot_gradient: Callable[[Callable, Tensor, Tensor], Tensor]) -> None:
    """``eot_gradient(damage, perturbed, noises)`` is the gradient of the mean damage over K samples, like perturbed."""
    draw = torch.Generator().manual_seed(0)
    noises, perturbed = torch.randn(5, 4, 3, generator=draw), torch.randn(4, 3, generator=draw)

    def damage(seen: Tensor, noise: Tensor) -> Tensor:
        assert seen.shape == noise.shape == (4, 3), (
            f"damage is asked about perturbed {tuple(seen.shape)} with noise {tuple(noise.shape)}: give it one sample "
            "at a time, [N, latent_dim]"
        )
        return torch.sin(seen * (1 + noise)).sum(-1)

    def slope(noise: Tensor) -> Tensor:
        return torch.cos(perturbed * (1 + noise)) * (1 + noise)

    every = torch.stack([slope(noise) for noise in noises])
    right = every.mean(0)
    mistakes = {
        "That is the gradient in one sample": every[0],
        "That is the gradient in the last sample: add the gradients up, do not overwrite them": every[-1],
        "That is the sum over the samples; take their mean": every.sum(0),
        "That is the gradient at the mean NOISE. The mean of the damage is another function": slope(noises.mean(0)),
        "That is the gradient without noise": slope(torch.zeros(4, 3)),
        "Minus the gradient: the attacker wants the damage to grow": -right,
        "The mean is over the K samples, not over the N observations": right / 4,
        "That is the mean of the gradients' SIGNS; take the sign of the mean, and leave that to the attack": (
            every.sign().mean(0)
        ),
    }
    call = "eot_gradient(damage, perturbed, noises)"
    got = eot_gradient(damage, perturbed.clone(), noises)
    compare(call, got, right, mistakes)
    print("Right. An attacker averages the noise out, so the noise is no protection.")


@explained
def check_straight_through(straight_through: Callable[[Callable, Tensor], Tensor]) -> None:
    """``straight_through(defense, perturbed)`` is defense(perturbed), and its gradient the identity's."""

    def defense(seen: Tensor) -> Tensor:
        return 0.5 * (seen / 0.25).round() * 0.25 + 0.5 * seen

    perturbed = torch.tensor([[0.3, -0.4], [0.9, 0.05]], requires_grad=True)
    call = "straight_through(defense, perturbed)"
    got = straight_through(defense, perturbed)
    mistakes = {
        "That is perturbed itself. The policy is shown the output of the defence": perturbed.detach(),
        "That is only what the defence changes": (defense(perturbed) - perturbed).detach(),
        "That adds perturbed once too often: it is perturbed + (defense(perturbed) - perturbed)": (
            (perturbed + defense(perturbed)).detach()
        ),
    }
    compare(call, got, defense(perturbed).detach(), mistakes)
    assert getattr(got, "requires_grad", False), (
        f"{call} has no gradient: detach only the CHANGE that the defence makes, not perturbed"
    )
    (gradient,) = torch.autograd.grad(got.sum(), perturbed)
    hints = {
        "Its value is right and its gradient the defence's own: detach what the defence changes": torch.full(
            (2, 2), 0.5
        ),
        "The defence's own gradient is added to it: detach what the defence gives": torch.full((2, 2), 1.5),
    }
    compare("the gradient of its sum", gradient, torch.ones(2, 2), hints)
    print("Right. The forward pass is the defence's, and the backward pass ignores it.")
