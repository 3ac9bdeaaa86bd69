"""Every check passes on a solution and knows the planted mistakes."""

import numpy as np
import pytest
import torch

from detden_lite.checks import stronger


class TestQObjective:
    def test_the_solution_passes(self):
        stronger.check_q_objective(lambda policy, q, obs, perturbed: -q(obs, policy(perturbed)))

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (lambda policy, q, o, x: -q(x, policy(x)), "Q must be given obs"),
            (lambda policy, q, o, x: q(o, policy(x)), "change the sign"),
            (lambda policy, q, o, x: -q(x, policy(o)), "are swapped"),
            (lambda policy, q, o, x: -q(o, policy(o)), "can change nothing"),
            (lambda policy, q, o, x: q(o, policy(o)) - q(o, policy(x)), "-Q itself"),
            (lambda policy, q, o, x: -q(o, policy(x)).mean(), "each has its own"),
            (lambda policy, q, o, x: -q(o, policy(x)).detach(), "no gradient"),
            (lambda policy, q, o, x: -q(o, policy(x)) + 0 * policy(x)[:, 0] ** 2 + (x - x.detach())[:, 1], "gradient"),
            (lambda policy, q, o, x: -q(o, x), "give it the policy's action"),
        ],
        ids=["wrong argument", "sign", "swapped", "clean", "loss", "mean", "detached", "leak", "no policy"],
    )
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            stronger.check_q_objective(wrong)


def weighted(weights):
    """A refit with these weights from the best to the last elite."""

    def refit(plans, returns, elites):
        return np.tensordot(weights(elites), plans[returns.argsort()[:elites]], 1)

    return refit


def softmax(values):
    return np.exp(values) / np.exp(values).sum()


class TestRefit:
    def test_the_solution_passes(self):
        stronger.check_refit(weighted(lambda n: np.arange(n, 0, -1) / np.arange(n + 1).sum()))

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (weighted(lambda n: np.arange(n) / np.arange(n).sum()), "reverse the weights"),
            (weighted(lambda n: np.arange(n)[::-1] / np.arange(n).sum()), "it should weigh 1"),
            (weighted(lambda n: np.arange(1, n + 1) / np.arange(n + 1).sum()), "the best one should"),
            (lambda p, r, n: weighted(lambda k: np.arange(k, 0, -1) / 6)(p, -r, n), "LARGEST"),
            (weighted(lambda n: np.ones(n) / n), "weigh the same"),
            (weighted(lambda n: np.arange(n, 0, -1)), "sum to 1"),
            (lambda p, r, n: np.tensordot(np.arange(n, 0, -1) / 6, p[:n], 1), "sort the plans"),
            (lambda p, r, n: p[r.argmin()], "best plan alone"),
            (weighted(lambda n: np.exp(np.arange(n, 0, -1)) / np.exp(np.arange(n, 0, -1)).sum()), "softmax of 3, 2, 1"),
            (lambda p, r, n: weighted(lambda n: softmax(-np.sort(r)[:n]))(p, r, n), "depend on the RANK"),
            (lambda p, r, n: softmax(-r) @ p, "only the elites"),
            (lambda p, r, n: p[r.argsort()[:n]], "shape"),
            (weighted(lambda n: np.arange(n, 0, -1) / 6), "random plans"),
        ],
        ids=[
            "released",
            "last 0",
            "turned",
            "largest",
            "equal",
            "not normalised",
            "unsorted",
            "best",
            "softmax of ranks",
            "softmax of returns",
            "softmax of all",
            "elites",
            "always by 6",
        ],
    )
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            stronger.check_refit(wrong)


def step(squash=lambda output, e: e * output.clamp(-1, 1), sign=-1, where=lambda struck: struck):
    def adversary_step(output, obs, struck, policy, world, epsilon):
        perturbed = torch.where(where(struck)[:, None], obs + squash(output, epsilon), obs)
        return sign * world(policy(perturbed))

    return adversary_step


def replaced(output, obs, struck, policy, world, epsilon):
    return -world(policy(torch.where(struck[:, None], epsilon * output.clamp(-1, 1), obs)))


def asked_twice(output, obs, struck, policy, world, epsilon):
    perturbed = obs + epsilon * output.clamp(-1, 1)
    return -world(torch.where(struck[:, None], policy(perturbed), policy(obs)))


class TestAdversaryStep:
    def test_the_solution_passes(self):
        stronger.check_adversary_step(step())

    def test_a_solution_that_asks_the_policy_twice_passes(self):
        stronger.check_adversary_step(asked_twice)

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (step(sign=1), "minus the robot's"),
            (step(lambda output, e: e * output), "any size"),
            (step(lambda output, e: (e * output).clamp(-1, 1)), "in the other order"),
            (step(lambda output, e: output.clamp(-e, e)), "in units of epsilon"),
            (step(lambda output, e: e * output.tanh()), "never reaches the border"),
            (step(where=lambda struck: torch.ones_like(struck)), "Where struck is False"),
            (step(where=lambda struck: torch.zeros_like(struck)), "nothing is attacked"),
            (step(where=lambda struck: ~struck), "struck is inverted"),
            (replaced, "does not replace it"),
            (lambda output, obs, struck, policy, world, e: -world(obs + e * output.clamp(-1, 1)), "the policy's"),
        ],
        ids=["sign", "unclipped", "clipped late", "clipped to the ball", "tanh", "always", "never", "inverse", "no obs",
             "no policy"],
    )  # fmt: skip
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            stronger.check_adversary_step(wrong)


def directed(pay=lambda world, action, meant: -world(action), where=lambda struck: struck):
    def director_step(direction, obs, struck, follow, policy, world):
        shown = torch.where(where(struck)[:, None], follow(obs, direction), obs)
        return pay(world, policy(shown), policy(obs))

    return director_step


class TestDirectorStep:
    def test_the_solution_passes(self):
        stronger.check_director_step(directed())

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (directed(lambda world, action, meant: world(action)), "minus the robot's"),
            (lambda d, obs, struck, follow, policy, world: -world(d), "does not move the robot"),
            (lambda d, obs, struck, follow, policy, world: -world(policy(obs) + d), "cannot add to the action"),
            (
                lambda d, obs, struck, follow, policy, world: (
                    (policy(torch.where(struck[:, None], follow(obs, d), obs)) - policy(obs)) * d
                ).sum(-1),
                "Follow maximises it",
            ),
            (directed(lambda world, action, meant: (action - meant).norm(dim=-1)), "need not be harmful"),
            (directed(lambda world, action, meant: world(meant) - world(action)), "loses in this step"),
            (directed(where=torch.ones_like), "Where struck is False"),
            (directed(where=lambda struck: ~struck), "struck is inverted"),
            (directed(where=torch.zeros_like), "nothing is attacked"),
            (lambda d, obs, struck, follow, policy, world: -world(policy(follow(d, obs))), "give it obs first"),
            (lambda d, obs, struck, follow, policy, world: -world(follow(obs, d)), "the policy's"),
        ],
        ids=["sign", "acts", "adds", "along", "change", "loss", "always", "inverse", "never", "swapped", "no policy"],
    )  # fmt: skip
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            stronger.check_director_step(wrong)


def changes(obs, perturbed):
    return np.diff(perturbed - obs, axis=0)


class TestAddedChange:
    def test_the_solution_passes(self):
        stronger.check_added_change(lambda o, x: np.abs(changes(o, x)).max(-1))

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (lambda o, x: np.abs(np.diff(x, axis=0)).max(-1), "what the robot did itself"),
            (lambda o, x: np.abs(x - o)[1:].max(-1), "size of the perturbation. A detector"),
            (lambda o, x: np.abs(x - o)[:-1].max(-1), "one step before"),
            (
                lambda o, x: np.abs(np.diff(x, axis=0)).max(-1) - np.abs(np.diff(o, axis=0)).max(-1),
                "coordinate by coordinate",
            ),
            (lambda o, x: changes(o, x).max(-1), "either sign"),
            (lambda o, x: changes(x, o).max(-1), "sign is turned"),
            (lambda o, x: np.abs(changes(o, x)).mean(-1), "mean over the coordinates"),
            (lambda o, x: np.abs(changes(o, x)).sum(-1), "sum over the coordinates"),
            (lambda o, x: np.abs(changes(o, x)).min(-1), "the smallest"),
            (lambda o, x: np.abs(x - o).max(-1), "four changes"),
            (lambda o, x: np.abs(changes(o, x)).max(), "shape"),
        ],
        ids=["whole", "size", "size before", "late", "signed", "turned", "mean", "sum", "min", "rows", "one number"],
    )
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            stronger.check_added_change(wrong)


def corner(draw=lambda epsilon, d, rng: epsilon * rng.choice([-1, 1], d)):
    def held_corner(epsilon, obs_dim, rng):
        offset = draw(epsilon, obs_dim, rng)
        return lambda obs: obs + offset

    return held_corner


def drawn_anew(epsilon, obs_dim, rng):
    return lambda obs: obs + epsilon * rng.choice([-1, 1], obs_dim)


class TestHeldCorner:
    def test_the_solution_passes(self):
        stronger.check_held_corner(corner())

    @pytest.mark.parametrize(
        "wrong, hint",
        [
            (drawn_anew, "That is noise"),
            (lambda e, d, rng: e * rng.choice([-1, 1], d), "return the function attack"),
            (lambda e, d, rng: lambda obs: e * rng.choice([-1, 1], d), "obs plus the corner"),
            (corner(lambda e, d, rng: rng.choice([-1, 1], d)), "radius 0.5"),
            (corner(lambda e, d, rng: rng.uniform(-e, e, d)), "in a corner each of them is"),
            (corner(lambda e, d, rng: e * np.random.default_rng(3).choice([-1, 1], d)), "two episodes have"),
            (corner(lambda e, d, rng: e * np.random.default_rng().choice([-1, 1], d)), "with the same seed"),
            (corner(lambda e, d, rng: e * rng.choice([-1, 1])), "two episodes have|the same side"),
            (lambda e, d, rng: lambda obs: None, "gives None"),
        ],
        ids=["anew", "no function", "no obs", "no epsilon", "inside", "same", "unseeded", "one sign", "None"],
    )  # fmt: skip
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            stronger.check_held_corner(wrong)
