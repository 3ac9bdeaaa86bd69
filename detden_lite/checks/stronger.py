"""Checks of the chapter on stronger attacks."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare


def check_q_objective(q_objective: Callable[[Callable, Callable, Tensor, Tensor], Tensor]) -> None:
    """``q_objective(policy, q, obs, perturbed)`` is what the Q-function attack maximises, ``[N]``."""

    def policy(obs: Tensor) -> Tensor:
        return 2 * obs[:, :1]

    def q(obs: Tensor, action: Tensor) -> Tensor:
        assert action.shape == (len(obs), 1), (
            f"q was given an action of shape {tuple(action.shape)}; give it the policy's action, policy(...)"
        )
        return 10 * obs[:, 1] + obs[:, 0] * action[:, 0]

    obs = torch.tensor([[1.0, 2.0], [-1.0, 1.0]])
    perturbed = torch.tensor([[1.5, 1.0], [-0.5, 3.0]], requires_grad=True)
    mistakes = {
        "Q must be given obs: the state of the world does not depend on what the policy is shown": (
            -q(perturbed, policy(perturbed))
        ),
        "This is large where the victim does well: change the sign": q(obs, policy(perturbed)),
        "The two observations are swapped: the policy is given perturbed, and Q is given obs": (
            -q(perturbed, policy(obs))
        ),
        "perturbed is not used, so the attacker can change nothing": -q(obs, policy(obs)),
        "That is how much Q loses. It has the same maximiser, but the exercise asks for -Q itself": (
            q(obs, policy(obs)) - q(obs, policy(perturbed))
        ),
    }
    call = "q_objective(policy, q, obs, perturbed)"
    got = q_objective(policy, q, obs, perturbed)
    assert array(call, got).shape != (), f"{call} gives one number for both observations; each has its own"
    compare(call, got, [-23.0, -11.0], {hint: wrong.detach() for hint, wrong in mistakes.items()})
    assert getattr(got, "requires_grad", False), (
        f"{call} has no gradient: without `no_grad` and `detach`, autograd finds it through the policy"
    )
    (gradient,) = torch.autograd.grad(got.sum(), perturbed)
    compare("its gradient with respect to perturbed", gradient, [[-2.0, 0.0], [2.0, 0.0]])
    print("Right. The gradient flows through the policy alone, and Q is given the true observation.")


def check_refit(refit: Callable[[np.ndarray, np.ndarray, int], np.ndarray]) -> None:
    """``refit(plans, returns, elites)`` is the next mean of a cross-entropy search for a small return, ``[dim]``.

    The best of the elites weighs ``elites``, the next one less, and so on to the last, which weighs 1.
    """
    plans = np.array([[4.0, 0.0], [0.0, 8.0], [2.0, 2.0], [-6.0, 6.0]])
    returns = np.array([3.0, 1.0, 9.0, 2.0])  # from best to worst for the attacker: 1, 3, 0, 2
    order = returns.argsort()
    best, falling = plans[order[:3]], np.array([3.0, 2.0, 1.0])
    released = np.array([0.0, 1.0, 2.0])
    mistakes = {
        "The best elite has the weight 0 and the last the largest: reverse the weights": (
            released / released.sum() @ best
        ),
        "The last elite weighs 0; it should weigh 1": released[::-1] / released.sum() @ best,
        "The last elite weighs most: the best one should": falling[::-1] / 6 @ best,
        "These are the plans with the LARGEST returns; the attacker wants small ones": (
            falling / 6 @ plans[order[::-1][:3]]
        ),
        "All elites weigh the same here": best.mean(0),
        "The weights must sum to 1": falling @ best,
        "The weights are given to the first plans; sort the plans by their returns before": falling / 6 @ plans[:3],
        "That is the best plan alone; the mean of the elites depends less on chance": best[0],
    }
    compare("refit(plans, returns, 3)", refit(plans.copy(), returns.copy(), 3), [-4 / 3, 6.0], mistakes)
    generator = np.random.default_rng(0)
    plans, returns = generator.normal(size=(40, 15, 3)), generator.normal(size=40)
    weights = np.arange(8, 0, -1) / 36
    expected = np.tensordot(weights, plans[returns.argsort()[:8]], 1)
    compare("refit of 40 random plans of 15 steps of 3 actions", refit(plans, returns, 8), expected)
    print("Right. The mean moves towards the plans with the smallest returns.")


def check_adversary_step(adversary_step: Callable[..., Tensor]) -> None:
    """``adversary_step(output, obs, struck, policy, world, epsilon)`` is the adversary's reward, ``[N]``."""
    seen = []

    def policy(obs: Tensor) -> Tensor:
        seen.append(obs.clone())
        return obs.sum(-1, keepdim=True)

    def world(action: Tensor) -> Tensor:
        assert action.shape == (3, 1), (
            f"the world is given an action of shape {tuple(action.shape)}; the robot's actions are the policy's"
        )
        return 10 * action.squeeze(-1)

    obs = torch.tensor([[1.0, 2.0], [0.0, 1.0], [3.0, -1.0]])
    output = torch.tensor([[0.5, -40.0], [2.0, 1.0], [0.25, 0.0]])
    struck = torch.tensor([True, False, True])
    epsilon = 0.1

    def reward(delta: Tensor, where: Tensor = struck) -> Tensor:
        return -10 * (obs + torch.where(where[:, None], delta, 0.0)).sum(-1)

    right = reward(epsilon * output.clamp(-1, 1))
    mistakes = {
        "The adversary's reward is minus the robot's: change the sign": -right,
        "The output may be of any size: clip it to [-1, 1] before it is multiplied by epsilon": reward(
            epsilon * output
        ),
        "Clip the output first and multiply it then: in the other order the ball has radius 1": (
            reward((epsilon * output).clamp(-1, 1))
        ),
        "The output is in units of epsilon: clip it to [-1, 1], and multiply it by epsilon": (
            reward(output.clamp(-epsilon, epsilon))
        ),
        "tanh never reaches the border, where the best points are; clip instead": reward(epsilon * output.tanh()),
        "Where struck is False, the policy is shown obs": (
            reward(epsilon * output.clamp(-1, 1), torch.ones(3, dtype=torch.bool))
        ),
        "The policy is always shown obs: nothing is attacked": reward(0 * output),
        "The perturbation is added to the observation, it does not replace it": (
            -10 * torch.where(struck[:, None], epsilon * output.clamp(-1, 1), obs).sum(-1)
        ),
        "struck is inverted: the perturbation belongs where it is True": reward(epsilon * output.clamp(-1, 1), ~struck),
    }
    call = "adversary_step(output, obs, struck, policy, world, 0.1)"
    compare(call, adversary_step(output.clone(), obs.clone(), struck, policy, world, epsilon), right, mistakes)
    assert len(seen) == 1, f"the policy was asked {len(seen)} times: in a step it acts once"
    print("Right. To a learner this is an ordinary environment, whose actions are perturbations.")
