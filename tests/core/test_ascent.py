import pytest
import torch
from builders import BUDGET, make_victim, normal, steady
from hypothesis import given
from hypothesis import strategies as st
from test_budget import NORMS, cases, excess

from detden_lite.attacks.opposite import opposite_objective
from detden_lite.core.ascent import ascend
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.victims.action_gradients import ActionObjective, Policy


@steady
@given(cases(), st.integers(1, 5), st.sampled_from([None, 10.0]))
def test_nothing_leaves_the_ball(case, steps, step_size):
    budget, obs, far = case
    found = ascend(lambda x: (x * far).sum(-1).sin(), obs, budget, RandomStreams(0), steps, step_size)
    assert excess(budget, obs, found) <= 0


@pytest.mark.parametrize("norm", NORMS)
def test_the_maximum_of_a_linear_objective_is_found(norm):
    """It is epsilon times the dual norm of the gradient."""
    dual = {float("inf"): 1, 2: 2, 1: float("inf")}[norm]
    weights, obs = normal(3, 6), normal(3, 6, seed=1)
    found = ascend(lambda x: (x * weights).sum(-1), obs, Budget(0.5, norm), RandomStreams(0), steps=40, step_size=0.25)
    gained = ((found - obs) * weights).sum(-1)
    assert torch.allclose(gained, 0.5 * torch.linalg.vector_norm(weights, ord=dual, dim=-1), rtol=1e-3)


@pytest.mark.parametrize("norm", NORMS)
def test_restarts_find_a_planted_adversarial_point(norm):
    """A narrow peak hides in a corner, beyond a broad hill that draws most starts to the other side."""
    budget, obs = Budget(1.0, norm), normal(16, 2)
    corner = budget.project(obs, obs + torch.tensor([3.0, 2.9]))
    hill = budget.project(obs, obs - torch.tensor([3.0, 2.9]))

    def objective(x):
        peak = 5 * torch.exp(-((x - corner) ** 2).sum(-1) / 0.1)
        return peak - ((x - hill) ** 2).sum(-1) / 10

    def share_found(restarts: int) -> float:
        found = ascend(objective, obs, budget, RandomStreams(0), 40, step_size=0.06, restarts=restarts)
        return float((torch.linalg.vector_norm(found - corner, dim=-1) < 0.15).double().mean())

    assert share_found(1) < 1
    assert share_found(60) == 1


def test_more_steps_are_not_weaker_and_more_restarts_never():
    victim, obs = make_victim(hidden=64), normal(200, 11)
    objective = opposite_objective(victim, obs)

    def value(steps, restarts=1):
        return objective(ascend(objective, obs, BUDGET, RandomStreams(0), steps, restarts=restarts))

    fgsm, pgd, restarted = value(1), value(20), value(20, restarts=4)
    assert pgd.mean() > fgsm.mean()
    assert (restarted >= pgd).all() and (restarted > pgd).any()


@pytest.mark.parametrize("rows", [1, 14, 4_096])
@pytest.mark.parametrize("norm", NORMS)
def test_restarts_together_find_what_they_find_one_after_another(norm, rows, monkeypatch):
    """However many rows are climbed at once, and for a plain function too, which knows only one restart."""
    victim, obs, budget = make_victim(), normal(7, 11), Budget(0.3, norm)
    wanted = torch.arange(7) != 2
    rising = lambda action: (action - victim(obs[wanted])).square() @ torch.arange(1.0, 4.0)  # noqa: E731
    together, streams = ActionObjective(Policy(victim, clip=False), rising), RandomStreams(0, range(7))

    def plain(x):
        assert x.shape == (6, 11)
        return rising(victim.mean(x))

    alone = [ascend(plain, obs, budget, streams, steps=5, wanted=wanted) for _ in range(5)]
    best = torch.stack([plain(point[wanted]) for point in alone]).argmax(0)
    assert len(best.unique()) > 1
    expected = torch.stack(alone)[:, wanted][best, torch.arange(6)]
    monkeypatch.setattr("detden_lite.core.ascent.ROWS", rows)
    for objective in (plain, together):
        found = ascend(objective, obs, budget, RandomStreams(0, range(7)), steps=5, restarts=5, wanted=wanted)
        assert torch.allclose(found[wanted], expected, atol=1e-5) and torch.equal(found[2], obs[2])


def test_a_step_too_long_does_not_lose_what_was_found():
    """The best point met on the way is returned, not the last one."""
    obs = torch.zeros(1, 1)
    found = ascend(lambda x: -(x - 0.9).square().sum(-1), obs, Budget(1.0), None, steps=4, step_size=0.9)
    assert found.item() == pytest.approx(0.9, abs=1e-6)


@pytest.mark.parametrize("norm", NORMS)
def test_epsilon_zero_changes_nothing(norm):
    obs = normal(5, 11)
    assert torch.equal(ascend(opposite_objective(make_victim(), obs), obs, Budget(0.0, norm), RandomStreams(0)), obs)


def test_one_step_without_random_start_is_fast_gradient_sign():
    obs = torch.zeros(1, 3)
    found = ascend(lambda x: x @ torch.tensor([2.0, -1.0, 0.5]), obs, Budget(0.1), None, steps=1)
    assert torch.allclose(found, torch.tensor([[0.1, -0.1, 0.1]]))


def test_one_step_from_a_random_start_has_length_epsilon():
    weights, obs, budget = normal(5, 6), normal(5, 6, seed=1), Budget(0.3)
    start = budget.sample(obs, RandomStreams(0))
    found = ascend(lambda x: (x * weights).sum(-1), obs, budget, RandomStreams(0), steps=1)
    assert torch.allclose(found, budget.project(obs, start + 0.3 * weights.sign()), atol=1e-6)


def test_rows_do_not_disturb_each_other():
    """Every row's own random numbers, its own gradient, its own best point."""
    victim, obs = make_victim(), normal(4, 11)
    together = ascend(opposite_objective(victim, obs), obs, BUDGET, RandomStreams(0, range(4)), steps=5)
    for i, row in enumerate(obs.split(1)):
        alone = ascend(opposite_objective(victim, row), row, BUDGET, RandomStreams(0, [i]), steps=5)
        assert torch.allclose(together[i], alone[0], atol=1e-5)


def test_ascent_leaves_no_graph_behind():
    obs = normal(3, 11)
    assert not ascend(opposite_objective(make_victim(), obs), obs, BUDGET, RandomStreams(0), steps=2).requires_grad


@pytest.mark.parametrize("arguments", [dict(steps=0), dict(restarts=0)])
def test_no_steps_or_restarts_are_refused(arguments):
    with pytest.raises(ValueError, match=f"{next(iter(arguments))} must be a whole number of at least 1"):
        ascend(lambda x: x.sum(-1), torch.zeros(1, 1), BUDGET, None, **arguments)
