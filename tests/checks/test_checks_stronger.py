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
    policy(obs)
    return step()(output, obs, struck, policy, world, epsilon)


class TestAdversaryStep:
    def test_the_solution_passes(self):
        stronger.check_adversary_step(step())

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
            (asked_twice, "acts once"),
            (lambda output, obs, struck, policy, world, e: -world(obs + e * output.clamp(-1, 1)), "the policy's"),
        ],
        ids=["sign", "unclipped", "clipped late", "clipped to the ball", "tanh", "always", "never", "inverse", "no obs",
             "twice", "no policy"],
    )  # fmt: skip
    def test_a_mistake_is_explained(self, wrong, hint):
        with pytest.raises(AssertionError, match=hint):
            stronger.check_adversary_step(wrong)
