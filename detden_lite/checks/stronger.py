"""Checks of the chapter on attacks that know what hurts."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare


def check_q_objective(q_objective: Callable[[Callable, Callable, Tensor, Tensor], Tensor]) -> None:
    """``q_objective(policy, q, obs, perturbed)`` is what the Q-function attack makes as large as it can, ``[N]``."""

    def policy(obs: Tensor) -> Tensor:
        return 2 * obs[:, :1]

    def q(obs: Tensor, action: Tensor) -> Tensor:
        assert action.shape == (len(obs), 1), (
            f"q is asked about an action of shape {tuple(action.shape)}: what does the policy do?"
        )
        return 10 * obs[:, 1] + obs[:, 0] * action[:, 0]

    obs = torch.tensor([[1.0, 2.0], [-1.0, 1.0]])
    perturbed = torch.tensor([[1.5, 1.0], [-0.5, 3.0]], requires_grad=True)
    mistakes = {
        "Q is asked about an observation that is not true. The world is what it is, whatever the policy is shown": (
            -q(perturbed, policy(perturbed))
        ),
        "This is large where the victim does well: mind the sign": q(obs, policy(perturbed)),
        "The two observations have changed places: the policy is shown the false one, Q the true one": (
            -q(perturbed, policy(obs))
        ),
        "The perturbed observation is not in it, so the attacker can change nothing": -q(obs, policy(obs)),
        "That is how much Q loses, which has the same maximiser; asked for is -Q itself": (
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
    print("Right. The gradient runs through the policy alone, and Q is asked about the world as it is.")


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
        "The best elite has the weight 0 and the last the largest: count from the other end": (
            released / released.sum() @ best
        ),
        "The last elite weighs 0; it should weigh 1": released[::-1] / released.sum() @ best,
        "The last elite weighs most: the best one should": falling[::-1] / 6 @ best,
        "These are the plans with the LARGEST returns; whoever attacks wants small ones": (
            falling / 6 @ plans[order[::-1][:3]]
        ),
        "All elites weigh the same here": best.mean(0),
        "The weights must sum to 1": falling @ best,
        "The weights are given to the plans as they came, not as they rank": falling / 6 @ plans[:3],
        "That is the best plan alone; a mean of elites is less at the mercy of luck": best[0],
    }
    compare("refit(plans, returns, 3)", refit(plans.copy(), returns.copy(), 3), [-4 / 3, 6.0], mistakes)
    generator = np.random.default_rng(0)
    plans, returns = generator.normal(size=(40, 15, 3)), generator.normal(size=40)
    weights = np.arange(8, 0, -1) / 36
    expected = np.tensordot(weights, plans[returns.argsort()[:8]], 1)
    compare("refit of 40 random plans of 15 steps of 3 actions", refit(plans, returns, 8), expected)
    print("Right. The search moves towards what hurts most.")


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
        "The adversary is paid what the robot loses: mind the sign": -right,
        "The output may be of any size: clip it to [-1, 1] before it is multiplied by epsilon": reward(
            epsilon * output
        ),
        "Clip the output first, and multiply then: the other way round the ball has radius 1": (
            reward((epsilon * output).clamp(-1, 1))
        ),
        "That clips to the ball what should be stretched to it: the output is in units of epsilon": (
            reward(output.clamp(-epsilon, epsilon))
        ),
        "tanh never reaches the border, where the best points are; clip instead": reward(epsilon * output.tanh()),
        "Where he does not strike, the policy is shown the truth": (
            reward(epsilon * output.clamp(-1, 1), torch.ones(3, dtype=torch.bool))
        ),
        "The policy is shown the true observation: nobody is attacked": reward(0 * output),
        "The perturbation is added to the observation, it does not replace it": (
            -10 * torch.where(struck[:, None], epsilon * output.clamp(-1, 1), obs).sum(-1)
        ),
        "He strikes in the steps that he should leave alone": reward(epsilon * output.clamp(-1, 1), ~struck),
    }
    call = "adversary_step(output, obs, struck, policy, world, 0.1)"
    compare(call, adversary_step(output.clone(), obs.clone(), struck, policy, world, epsilon), right, mistakes)
    assert len(seen) == 1, f"the policy was asked {len(seen)} times: in a step it acts once"
    print("Right. To a learner this is an environment like any other: its actions are perturbations.")
