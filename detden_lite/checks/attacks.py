"""Checks of the chapter on observation attacks."""

from collections.abc import Callable

import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare
from detden_lite.checks.failure import explained
from detden_lite.core.budget import Budget


@explained
def check_project_l2(project: Callable[[Tensor, Tensor, float], Tensor]) -> None:
    """``project(obs, perturbed, epsilon)`` is the nearest point of the l2 ball around each row of ``obs``."""
    obs = torch.tensor([[1.0, 2.0], [0.0, 0.0], [5.0, 5.0]])
    perturbed = torch.tensor([[4.0, 6.0], [0.3, 0.4], [5.0, 5.0]])  # 5, 0.5 and 0 away
    delta = perturbed - obs
    length = delta.norm(dim=-1, keepdim=True)
    mistakes = {
        "A point that is inside the ball stays where it is": obs + delta / length.clamp_min(1e-9),
        "That clips every coordinate, which is the projection on the l-infinity ball": obs + delta.clamp(-1, 1),
        "The centre is missing: add obs to the projected perturbation": delta
        * (1 / length.clamp_min(1e-9)).clamp(max=1),
        "Every row has a length of its own: take the norm along the last dimension": obs + delta / delta.norm(),
        "Points outside move to the border, at a distance of epsilon; those inside stay": perturbed,
    }
    got = project(obs, perturbed, 1.0)
    assert torch.isfinite(torch.as_tensor(array("project(obs, perturbed, 1.0)", got))).all(), (
        "project gives NaN or infinity for a point that is the centre itself: its length is 0, and you divide by it"
    )
    compare("project(obs, perturbed, 1.0)", got, [[1.6, 2.8], [0.3, 0.4], [5.0, 5.0]], mistakes)
    generator = torch.Generator().manual_seed(0)
    obs, perturbed = torch.randn(2, 50, 11, generator=generator)
    for epsilon in (0.0, 0.5, 4.0):
        expected = Budget(epsilon, norm=2).project(obs, perturbed)
        compare(f"project of 50 random observations with epsilon {epsilon}", project(obs, perturbed, epsilon), expected)
    print("Right. Points inside the ball stay, points outside move straight to its border.")


@explained
def check_opposite(opposite: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
    """``opposite(mean, seen, action_std)`` is l_op of a Gaussian policy with diagonal covariance, ``[N]``."""
    mean = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    seen = torch.tensor([[1.0, 1.0, 2.0], [1.0, 3.0, 2.0]])
    std = torch.tensor([0.5, 2.0, 1.0])
    step = seen - mean
    mistakes = {
        "Divide by Sigma, do not multiply: an action with a large action_std counts less": (step**2 * std**2).sum(-1),
        "Sigma holds variances, and action_std is their square root: square it": (step**2 / std).sum(-1),
        "Sigma is missing: divide the squares by action_std squared": (step**2).sum(-1),
        "Square the differences: that is the sum of their sizes over action_std": (step / std).abs().sum(-1),
        "That is the square root of l_op. It has the same maximiser, but the exercise asks for l_op": (
            (step / std).square().sum(-1).sqrt()
        ),
        "That is the KL divergence; l_op is twice as large": (step / std).square().sum(-1) / 2,
        "One number for every observation: sum over the actions, do not average": (step / std).square().mean(-1),
        "The sign is turned: the attacker makes l_op large, and it is never negative": -(step / std).square().sum(-1),
        "Square before you sum, or differences of opposite signs cancel": (step / std).sum(-1).square(),
    }
    got = opposite(mean, seen, std)
    call = "opposite([[0, 0, 0], [1, 1, 1]], [[1, 1, 2], [1, 3, 2]], action_std=[0.5, 2, 1])"
    assert array(call, got).shape != (), f"{call} gives one number for both observations; each has its own"
    compare(call, got, [8.25, 2.0], mistakes)
    generator = torch.Generator().manual_seed(0)
    mean, seen = torch.randn(2, 20, 6, generator=generator)
    std = torch.rand(6, generator=generator) + 0.1
    expected = torch.stack([d @ torch.diag(1 / std**2) @ d for d in seen - mean])
    compare("opposite of 20 random actions", opposite(mean, seen, std), expected, atol=1e-3)
    print("Right. Half of this is the KL divergence between the two Gaussians.")


@explained
def check_fgsm(fgsm: Callable[[Tensor, Tensor, Tensor, float], Tensor]) -> None:
    """``fgsm(gain, obs, start, epsilon)`` is one FGSM step on l_op of the policy a = gain o, from obs + start."""
    gain = torch.tensor([[1.0, -2.0, 0.0], [0.0, 1.0, 0.5]])
    obs = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    start = torch.tensor([[0.05, 0.02, -0.04], [-0.1, 0.05, 0.1]])
    epsilon = 0.1
    sign = torch.sign(start @ gain.T @ gain)
    at_once = torch.sign(obs @ gain.T @ gain)
    mistakes = {
        "The start is in the ball and the step has length epsilon, so together they may leave it": (
            obs + start + epsilon * sign
        ),
        "At obs itself the objective's gradient is zero, and the sign of 0 is 0: take the gradient at obs + start": obs,
        "That is the start, without a step. Was the gradient taken at obs itself? It is zero there, and the sign of 0 "
        "is 0: take it at obs + start": obs + start,
        "The step is missing its start: obs + start, and from there a step": obs + epsilon * sign,
        "That is gradient descent: the step must increase the objective": obs
        + (start - epsilon * sign).clamp(-epsilon, epsilon),
        "The result lies around 0, and the centre of the ball is obs": (start + epsilon * sign).clamp(
            -epsilon, epsilon
        ),
        "A step without its sign is steepest in l2; in l-infinity it is the sign that counts": (
            obs + (start + epsilon * 2 * start @ gain.T @ gain).clamp(-epsilon, epsilon)
        ),
        "The objective is how far the action moves, gain @ start, not the action itself": (
            obs + (start + epsilon * at_once).clamp(-epsilon, epsilon)
        ),
    }
    expected = obs + (start + epsilon * sign).clamp(-epsilon, epsilon)
    compare("fgsm(gain, obs, start, 0.1)", fgsm(gain, obs, start, epsilon), expected, mistakes)
    generator = torch.Generator().manual_seed(0)
    gain, obs = torch.randn(3, 11, generator=generator), torch.randn(200, 11, generator=generator)
    start = epsilon * (2 * torch.rand(200, 11, generator=generator) - 1)
    got = fgsm(gain, obs, start, epsilon)
    assert Budget(epsilon).contains(obs, got).all(), (
        "of 200 random starts, some steps end outside the ball: project them"
    )
    before, after = (((x - obs) @ gain.T).norm(dim=-1).mean() for x in (obs + start, got))
    compare(
        "fgsm of 200 random observations",
        got,
        obs + (start + epsilon * torch.sign(start @ gain.T @ gain)).clamp(-epsilon, epsilon),
    )
    print(f"Right. The action moves by {after:.2f} on average, by {before:.2f} under noise.")


@explained
def check_vulnerable(vulnerable: Callable) -> None:
    """``vulnerable(policy, q, obs, c_vul)`` is 1_vul of a deterministic policy, ``[N]`` bool."""

    def policy(obs: Tensor) -> Tensor:
        return 2 * obs[:, :1]

    def q(obs: Tensor, action: Tensor) -> Tensor:
        assert action.shape == (len(obs), 1), (
            f"q was given an action of shape {tuple(action.shape)}; give it the policy's action, policy(...)"
        )
        return obs.sum(-1) + action.squeeze(-1)

    obs = torch.tensor([[0.0, 1.0], [1.0, 1.0], [-1.0, 6.0], [2.0, -3.0]])  # V is 1, 4, 3 and 3
    call = "vulnerable(policy, q, obs, 3.0)"
    got = vulnerable(policy, q, obs, 3.0)
    values = q(obs, policy(obs))
    mistakes = {
        "The attacker strikes where V is below the threshold, not above it": values > 3,
        "The paper has V < C_vul: at the threshold itself there is no attack": values <= 3,
        "V(o) = Q(o, pi(o)): the action must be the policy's": obs.sum(-1) < 3,
        "Every observation has its own answer; do not average over them": (values.mean() < 3).expand(4),
    }
    compare(call, got, [1, 0, 0, 0], mistakes)
    assert torch.as_tensor(got).dtype == torch.bool, (
        f"{call} gives numbers; an indicator is True or False (a bool tensor)"
    )
    compare("vulnerable(policy, q, obs, 3.5)", vulnerable(policy, q, obs, 3.5), [1, 0, 1, 1])
    print("Right. The attacker needs the policy, its critic and one threshold.")
