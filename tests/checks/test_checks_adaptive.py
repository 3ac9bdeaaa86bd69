"""Every check passes on a solution and fails on plausible mistakes."""

import pytest
import torch

from detden_lite.checks import adaptive as checks

CHECKS = [checks.check_hidden, checks.check_eot_gradient, checks.check_straight_through]


def hidden(det, obs, perturbed, scale):
    return -((perturbed - det(perturbed)) / scale).abs().amax(-1)


def eot_gradient(damage, perturbed, noises):
    x = perturbed.detach().requires_grad_()
    mean = torch.stack([damage(x, noise) for noise in noises]).mean(0)
    return torch.autograd.grad(mean.sum(), x)[0]


def straight_through(defense, perturbed):
    return perturbed + (defense(perturbed) - perturbed).detach()


def test_the_solutions_pass(capsys):
    for check, solution in zip(CHECKS, (hidden, eot_gradient, straight_through), strict=True):
        check(solution)
    assert capsys.readouterr().out.count("Right") == 3


def test_other_ways_to_say_the_same_pass():
    checks.check_hidden(lambda det, obs, seen, scale: (-(det(seen) - seen).abs() / scale).min(-1).values)
    checks.check_eot_gradient(
        lambda damage, x, noises: torch.stack([eot_gradient(damage, x, noise[None]) for noise in noises]).mean(0)
    )
    checks.check_straight_through(lambda defense, x: defense(x).detach() + x - x.detach())


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda *given: -hidden(*given), "raises the alarm"),
        (lambda det, o, x, s: ((det(x) - o) / s).abs().amax(-1), "appendix B"),
        (lambda det, o, x, s: -((det(x) - o) / s).abs().amax(-1), "distance is from obs"),
        (lambda det, o, x, s: -((x - det(o)) / s).abs().amax(-1), "shown perturbed, and not obs"),
        (lambda det, o, x, s: hidden(det, o, o, s), "score of the true"),
        (lambda det, o, x, s: hidden(det, o, x, 1.0), "Divide by scale: "),
        (lambda det, o, x, s: hidden(det, o, x, 1 / s), "do not multiply"),
        (lambda det, o, x, s: -((x - det(x)) / s).abs().mean(-1), "that is the mean"),
        (lambda det, o, x, s: -((x - det(x)) / s).abs().sum(-1), "that is the sum"),
        (lambda det, o, x, s: -((x - det(x)) / s).amax(-1), "abs"),
        (lambda det, o, x, s: -((det(x) - x) / s).amax(-1), "abs"),
        (lambda *given: hidden(*given).sum(), "each has its own"),
        (lambda *given: hidden(*given).detach(), "no gradient"),
        (lambda det, o, x, s: hidden(lambda seen: det(seen).detach(), o, x, s), "is detached"),
        (lambda det, o, x, s: -((x.detach() - det(x)) / s).abs().amax(-1), "perturbed itself is detached"),
        (lambda det, o, x, s: -((x - det(x)) / s).norm(dim=-1), "l2 norm"),
        (lambda det, o, x, s: -((x - det(x)) / s).square().amax(-1), "squares"),
        (lambda det, o, x, s: (-((x - det(x)) / s).abs()).min(-1), "values and indices"),
    ],
)
def test_a_wrong_l_det_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_hidden(mistake)


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda f, x, z: eot_gradient(f, x, z[:1]), "in one sample"),
        (lambda f, x, z: eot_gradient(f, x, z[-1:]), "overwrite"),
        (lambda f, x, z: 5 * eot_gradient(f, x, z), "sum over the samples"),
        (lambda f, x, z: eot_gradient(f, x, z.mean(0, keepdim=True)), "mean NOISE"),
        (lambda f, x, z: eot_gradient(f, x, torch.zeros_like(z)), "without noise"),
        (lambda f, x, z: -eot_gradient(f, x, z), "Minus"),
        (lambda f, x, z: eot_gradient(f, x, z) / 4, "not over the N"),
        (lambda f, x, z: torch.stack([eot_gradient(f, x, e[None]).sign() for e in z]).mean(0), "SIGNS"),
        (lambda f, x, z: eot_gradient(f, x, z).sum(-1), "shape"),
        (lambda f, x, z: torch.autograd.grad(f(x, z[0]).sum(), x)[0], "requires_grad_"),
        (lambda f, x, z: f(x, z).mean(0), "one sample"),
    ],
)
def test_a_wrong_expectation_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_eot_gradient(mistake)


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda defense, x: x, "perturbed itself"),
        (lambda defense, x: (defense(x) - x).detach(), "only what the defence changes"),
        (lambda defense, x: x + defense(x).detach(), "once too often"),
        (lambda defense, x: defense(x), "gradient the defence's own"),
        (lambda defense, x: defense(x) + x - x.detach(), "is added to it"),
        (lambda defense, x: defense(x).detach(), "no gradient"),
        (lambda defense, x: defense(x).detach() + 2 * (x - x.detach()), "should be 1"),
    ],
)
def test_a_wrong_straight_through_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_straight_through(mistake)
