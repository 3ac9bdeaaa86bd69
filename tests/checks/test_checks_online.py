"""Every check passes on a solution and fails on plausible mistakes."""

import pytest
import torch

from detden_lite.checks import online as checks


def kl(mean, other, std):
    return ((mean - other) / std).square().sum(-1) / 2


def inner_maximum(policy, std, obs, start, epsilon, steps, sign=1, size=None, around="obs", fixed=True):
    clean, point = policy(obs), start.clone()
    for step in range(steps):
        point = point.detach().requires_grad_()
        reference = clean if fixed else policy(point)
        (slope,) = torch.autograd.grad((kl(policy(point), reference, std) + 0 * point.sum(-1)).sum(), point)
        length = epsilon * (1 - step / steps) if size is None else size
        centre = obs if around == "obs" else point.detach()
        point = (point.detach() + sign * length * slope.sign()).clamp(centre - epsilon, centre + epsilon)
    return point


def turn(learner, other, batches, counting=("learner",), early=True):
    seen = []
    for batch in batches:
        for name, player in (("learner", learner), ("other", other)):
            if early and name in counting:
                player.update(batch)
        seen.append((learner.normalize(batch), other.normalize(batch)))
        if not early:
            learner.update(batch)
    return seen


def test_the_solutions_pass(capsys):
    checks.check_kl(kl)
    checks.check_inner_maximum(inner_maximum)
    checks.check_turn(turn)
    assert capsys.readouterr().out.count("Right") == 3


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (lambda a, b, s: 2 * kl(a, b, s), "half of it"),
        (lambda a, b, s: kl(a, b, 1), "Sigma is missing"),
        (lambda a, b, s: kl(a, b, s.sqrt()), "VARIANCES"),
        (lambda a, b, s: ((a - b) / s).square().mean(-1) / 2, "that is their mean"),
        (lambda a, b, s: ((a - b) / s).norm(dim=-1) / 2, "without a root"),
        (lambda a, b, s: ((a - b) / s).sum(-1).square() / 2, "cancel"),
        (lambda a, b, s: kl(a, b, s).mean(), "each has its own"),
        (lambda a, b, s: None, "return"),
    ],
)
def test_a_wrong_divergence_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_kl(mistake)


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (dict(sign=-1), "climb"),
        (dict(size=1e-4), "long enough"),
        (dict(around="point"), "leaves the ball"),
    ],
)
def test_a_wrong_ascent_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_inner_maximum(lambda *given: inner_maximum(*given, **mistake))


def test_an_ascent_from_the_observation_itself_is_explained():
    with pytest.raises(AssertionError, match="Begin at start"):
        checks.check_inner_maximum(lambda p, std, obs, start, *rest: inner_maximum(p, std, obs, obs, *rest))


@pytest.mark.parametrize(
    ("mistake", "says"),
    [
        (dict(counting=("learner", "other")), "the other's statistics have counted 40"),
        (dict(counting=("other",)), "the other's statistics have counted 40"),
        (dict(counting=()), "counted 16 observations instead"),
        (dict(early=False), "it should be"),
    ],
)
def test_a_wrong_turn_is_explained(mistake, says):
    with pytest.raises(AssertionError, match=says):
        checks.check_turn(lambda *given: turn(*given, **mistake))


def test_the_wrong_order_is_explained():
    with pytest.raises(AssertionError, match="First the learner's"):
        checks.check_turn(lambda *given: [pair[::-1] for pair in turn(*given)])


def test_statistics_are_those_of_all_observations_together():
    draw = torch.Generator().manual_seed(0)
    batches = [torch.randn(n, 3, generator=draw).numpy() + n for n in (4, 1, 7)]
    found = checks.Statistics(3)
    for batch in batches:
        found.update(batch)
    whole = torch.cat([torch.from_numpy(batch) for batch in batches])
    assert torch.allclose(torch.from_numpy(found.mean), whole.mean(0).double(), atol=1e-6)
    assert torch.allclose(torch.from_numpy(found.var), whole.var(0, unbiased=False).double(), atol=1e-5)
