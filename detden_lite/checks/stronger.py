"""Checks of the chapter on stronger attacks."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from detden_lite.checks.compare import array, compare
from detden_lite.checks.failure import explained


@explained
def check_q_objective(q_objective_by_hand: Callable[[Callable, Callable, Tensor, Tensor], Tensor]) -> None:
    """``q_objective_by_hand(policy, q, obs, perturbed)`` is what the Q-function attack maximises, ``[N]``."""

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
    call = "q_objective_by_hand(policy, q, obs, perturbed)"
    got = q_objective_by_hand(policy, q, obs, perturbed)
    assert array(call, got).shape != (), f"{call} gives one number for both observations; each has its own"
    compare(call, got, [-23.0, -11.0], {hint: wrong.detach() for hint, wrong in mistakes.items()})
    assert getattr(got, "requires_grad", False), (
        f"{call} has no gradient: without `no_grad` and `detach`, autograd finds it through the policy"
    )
    (gradient,) = torch.autograd.grad(got.sum(), perturbed)
    compare("its gradient with respect to perturbed", gradient, [[-2.0, 0.0], [2.0, 0.0]])
    print("Right. The gradient flows through the policy alone, and Q is given the true observation.")


@explained
def check_refit(refit: Callable[[np.ndarray, np.ndarray, int], np.ndarray]) -> None:
    """``refit(plans, returns, elites)`` is the next mean of a cross-entropy search for a small return, ``[dim]``.

    The best of the elites weighs ``elites``, the next one less, and so on to the last, which weighs 1.
    """
    plans = np.array([[4.0, 0.0], [0.0, 8.0], [2.0, 2.0], [-6.0, 6.0]])
    returns = np.array([3.5, 1.0, 9.0, 2.0])  # from best to worst for the attacker: 1, 3, 0, 2
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
        "The weights are a softmax of 3, 2, 1; they are proportional to them: divide by their sum": (
            np.exp(falling) / np.exp(falling).sum() @ best
        ),
        "The weights are a softmax of the returns; they depend on the RANK alone: 3, 2, 1 over their sum": (
            np.exp(-returns[order[:3]]) / np.exp(-returns[order[:3]]).sum() @ best
        ),
        "The weights are a softmax over all plans; only the elites count, by their rank": (
            np.exp(-returns) / np.exp(-returns).sum() @ plans
        ),
        "That is the best plan alone; the mean of the elites depends less on chance": best[0],
    }
    compare("refit(plans, returns, 3)", refit(plans.copy(), returns.copy(), 3), [-4 / 3, 6.0], mistakes)
    generator = np.random.default_rng(0)
    plans, returns = generator.normal(size=(40, 15, 3)), generator.normal(size=40)
    weights = np.arange(8, 0, -1) / 36
    expected = np.tensordot(weights, plans[returns.argsort()[:8]], 1)
    compare("refit of 40 random plans of 15 steps of 3 actions", refit(plans, returns, 8), expected)
    print("Right. The mean moves towards the plans with the smallest returns.")


@explained
def check_adversary_step(adversary_step: Callable[..., Tensor]) -> None:
    """``adversary_step(output, obs, struck, policy, world, epsilon)`` is the adversary's reward, ``[N]``."""

    def policy(obs: Tensor) -> Tensor:
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
    print("Right. To a learner this is an ordinary environment, whose actions are perturbations.")


@explained
def check_director_step(director_step: Callable[..., Tensor]) -> None:
    """``director_step(direction, obs, struck, follow, policy, world)`` is the director's reward, ``[N]``."""

    def follow(obs: Tensor, direction: Tensor) -> Tensor:
        assert obs.shape == (3, 2) and direction.shape == (3, 1), (
            f"follow was given {tuple(obs.shape)} and {tuple(direction.shape)}: give it obs first, then direction"
        )
        return obs + 0.1 * direction

    def policy(obs: Tensor) -> Tensor:
        return obs.sum(-1, keepdim=True)

    def world(action: Tensor) -> Tensor:
        assert action.shape == (3, 1), (
            f"the world is given an action of shape {tuple(action.shape)}; the robot's actions are the policy's"
        )
        return (10 * action + action**2).squeeze(-1)

    obs = torch.tensor([[1.0, 2.0], [0.0, 1.0], [3.0, -1.0]])
    direction = torch.tensor([[0.5], [-1.0], [-0.25]])
    struck = torch.tensor([True, False, True])
    perturbed = obs + 0.1 * direction
    shown = torch.where(struck[:, None], perturbed, obs)
    right, moved = -world(policy(shown)), policy(shown) - policy(obs)
    mistakes = {
        "The director's reward is minus the robot's: change the sign": -right,
        "A director does not move the robot: only the policy acts, on the observation that follow makes": (
            -world(direction)
        ),
        "A director cannot add to the action. They change what the policy is shown, with follow": (
            -world(policy(obs) + direction)
        ),
        "That is how far the action moves along the direction. Follow maximises it; it is no reward": (
            (moved * direction).sum(-1)
        ),
        "That is how far the action moves: a large change need not be harmful": moved.norm(dim=-1),
        "That is how much the robot loses in this step. The director is paid the robot's reward, negated": (
            world(policy(obs)) - world(policy(shown))
        ),
        "Where struck is False, the policy is shown obs": -world(policy(perturbed)),
        "struck is inverted: the perturbation belongs where it is True": (
            -world(policy(torch.where(struck[:, None], obs, perturbed)))
        ),
        "The policy is always shown obs: nothing is attacked": -world(policy(obs)),
    }
    call = "director_step(direction, obs, struck, follow, policy, world)"
    got = director_step(direction.clone(), obs.clone(), struck, follow, policy, world)
    compare(call, got, right, mistakes)
    print("Right. The director's actions are directions, and the perturbation is a part of their world.")


@explained
def check_added_change(added_change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
    """``added_change(obs, perturbed)`` is the largest change that an attack adds from step to step, ``[T - 1, N]``."""
    generator = np.random.default_rng(0)
    obs = generator.normal(size=(5, 3, 4)).cumsum(axis=0)
    delta = generator.uniform(-0.1, 0.1, size=obs.shape)
    perturbed = obs + delta

    def change(seen: np.ndarray) -> np.ndarray:
        return np.abs(np.diff(seen, axis=0))

    right = change(delta).max(-1)
    mistakes = {
        "That is the whole change from step to step; subtract what the robot did itself": change(perturbed).max(-1),
        "That is the size of the perturbation. A detector of changes compares each step with the one before": (
            np.abs(delta[1:]).max(-1)
        ),
        "That is the size of the perturbation one step before; compare each step with the one before": (
            np.abs(delta[:-1]).max(-1)
        ),
        "Subtract the changes first, coordinate by coordinate, and take their largest size then": (
            change(perturbed).max(-1) - change(obs).max(-1)
        ),
        "Take abs() before the maximum: a change may have either sign": np.diff(delta, axis=0).max(-1),
        "The sign is turned: take abs() before the maximum": np.diff(-delta, axis=0).max(-1),
        "That is the mean over the coordinates; take the largest": change(delta).mean(-1),
        "That is the sum over the coordinates; take the largest": change(delta).sum(-1),
        "That is the smallest of the coordinates; take the largest": change(delta).min(-1),
    }
    call = "added_change(obs, perturbed)"
    got = array(call, added_change(obs.copy(), perturbed.copy()))
    assert got.shape != (5, 3), f"{call} has a row for each step: five steps have four changes, so the shape is (4, 3)"
    compare(call, got, right, mistakes)
    held = added_change(obs, obs + 0.1 * np.array([1, -1, 1, 1]))
    compare("added_change of an offset that is held", held, np.zeros((4, 3)))
    print("Right. It is zero where the perturbation stays as it is, however large it is.")


@explained
def check_held_corner(held_corner: Callable[[float, int, np.random.Generator], Callable]) -> None:
    """``held_corner(epsilon, obs_dim, rng)`` is an attack for one episode: it maps obs ``[obs_dim]`` to perturbed."""

    def episode(seed: int) -> np.ndarray:
        attack = held_corner(0.5, 11, np.random.default_rng(seed))
        assert callable(attack), (
            f"held_corner(0.5, 11, rng) gives a {type(attack).__name__}; return the function attack"
        )
        seen = np.arange(33.0).reshape(3, 11)
        return np.stack([array("attack(obs)", attack(row.copy())) - row for row in seen])

    one, again, other = episode(1), episode(1), episode(2)
    size = np.abs(one)
    assert np.isfinite(one).all() and (size <= 0.5 + 1e-6).all(), (
        f"attack(obs) changes an observation by {size.max():g}, and the ball has radius 0.5: give obs plus the corner"
    )
    at_border = float(np.isclose(size, 0.5).mean())
    assert at_border == 1, (
        f"only {at_border:.0%} of the coordinates are changed by epsilon: in a corner each of them is, with either sign"
    )
    assert np.allclose(one, one[:1]), (
        "the corner is another one at the next step. That is noise: draw it before attack is defined, once an episode"
    )
    assert np.allclose(one, again), "two generators with the same seed should give the same corner: draw it with rng"
    assert not np.allclose(one, other), "two episodes have the same corner: draw it with rng, for each episode anew"
    one_sided = [abs(episode(seed)[0].sum()) == 0.5 * 11 for seed in range(4)]
    assert not all(one_sided), "all coordinates are changed to the same side: draw a sign for each of them"
    print("Right. The corner is drawn once, before the episode, and is the same at every step.")
