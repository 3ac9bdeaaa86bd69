import pytest
import torch

from detden_lite.checks import attacks


def length(delta):
    return delta.norm(dim=-1, keepdim=True)


class TestProject:
    def test_the_solution_passes(self):
        def right(obs, perturbed, epsilon):
            delta = perturbed - obs
            return obs + delta * (epsilon / length(delta).clamp_min(1e-12)).clamp(max=1)

        attacks.check_project_l2(right)

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (lambda o, p, e: o + e * (p - o) / length(p - o).clamp_min(1e-9), "inside the ball stays"),
            (lambda o, p, e: o + (p - o).clamp(-e, e), "l-infinity"),
            (lambda o, p, e: (p - o) * (e / length(p - o).clamp_min(1e-9)).clamp(max=1), "centre is missing"),
            (lambda o, p, e: o + (p - o) * min(e / (p - o).norm(), 1), "length of its own"),
            (lambda o, p, e: o + (p - o) * (e / length(p - o)), "NaN"),
            (lambda o, p, e: p, "move to the border"),
        ],
        ids=["always to the border", "clipped", "no centre", "one length for all", "0/0", "unchanged"],
    )
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            attacks.check_project_l2(wrong)


class TestOpposite:
    def test_the_solution_passes(self):
        attacks.check_opposite(lambda mean, seen, std: ((seen - mean) / std).square().sum(-1))

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (lambda m, s, std: ((s - m) * std).square().sum(-1), "counts less"),
            (lambda m, s, std: ((s - m).square() / std).sum(-1), "variances"),
            (lambda m, s, std: (s - m).square().sum(-1), "Sigma is missing"),
            (lambda m, s, std: ((s - m) / std).norm(dim=-1), "square root of l_op"),
            (lambda m, s, std: ((s - m) / std).square().mean(-1), "do not average"),
            (lambda m, s, std: ((s - m) / std).square().sum(), "one number for both"),
            (lambda m, s, std: -((s - m) / std).square().sum(-1), "sign is turned"),
            (lambda m, s, std: ((s - m) / std).sum(-1).square(), "Square before you sum"),
        ],
        ids=["times Sigma", "std for variance", "no Sigma", "root", "mean", "sum over the batch", "sign", "late"],
    )
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            attacks.check_opposite(wrong)


class TestFgsm:
    def test_the_solution_passes(self):
        def right(gain, obs, start, epsilon):
            gradient = 2 * start @ gain.T @ gain
            return obs + (start + epsilon * gradient.sign()).clamp(-epsilon, epsilon)

        attacks.check_fgsm(right)

    def test_a_solution_with_autograd_passes(self):
        def right(gain, obs, start, epsilon):
            x = (obs + start).requires_grad_()
            ((x - obs) @ gain.T).square().sum().backward()
            return obs + (x.detach() + epsilon * x.grad.sign() - obs).clamp(-epsilon, epsilon)

        attacks.check_fgsm(right)

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (lambda k, o, d, e: o + d + e * (d @ k.T @ k).sign(), "may leave it"),
            (lambda k, o, d, e: o + e * ((o - o) @ k.T @ k).sign(), "gradient is zero"),
            (lambda k, o, d, e: o + (d - e * (d @ k.T @ k).sign()).clamp(-e, e), "gradient descent"),
            (lambda k, o, d, e: o + (d + e * 2 * d @ k.T @ k).clamp(-e, e), "sign that counts"),
            (lambda k, o, d, e: (d + e * (d @ k.T @ k).sign()).clamp(-e, e), "centre of the ball"),
            (lambda k, o, d, e: o + (d + e * (o @ k.T @ k).sign()).clamp(-e, e), "how far the action moves"),
            (lambda k, o, d, e: o + d, "gradient taken at obs itself"),
            (lambda k, o, d, e: o + e * (d @ k.T @ k).sign(), "missing its start"),
            (lambda k, o, d, e: o + (d + e * (d @ k @ k.T).sign()).clamp(-e, e), "The shapes do not fit"),
        ],
        ids=[
            "unprojected",
            "from the centre",
            "descent",
            "no sign",
            "clipped around 0",
            "action itself",
            "start only",
            "no start",
            "shapes",
        ],
    )
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            attacks.check_fgsm(wrong)


class TestVulnerable:
    def test_the_solution_passes(self):
        attacks.check_vulnerable(lambda policy, q, obs, c_vul: q(obs, policy(obs)) < c_vul)

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (lambda policy, q, o, c: q(o, policy(o)) > c, "not above"),
            (lambda policy, q, o, c: q(o, policy(o)) <= c, "at the threshold itself"),
            (lambda policy, q, o, c: q(o, torch.zeros(len(o), 1)) < c, "the action must be the policy's"),
            (lambda policy, q, o, c: q(o, o) < c, "give it the policy's action"),
            (lambda policy, q, o, c: (q(o, policy(o)).mean() < c).expand(len(o)), "do not average"),
            (lambda policy, q, o, c: q(o, policy(o)) < q(o, policy(o)).quantile(c), "a share between 0 and 1"),
            (lambda policy, q, o, c: (q(o, policy(o)) < c).float(), "True or False"),
        ],
        ids=["above", "at the threshold", "no action", "obs for action", "averaged", "quantile", "numbers"],
    )
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            attacks.check_vulnerable(wrong)
