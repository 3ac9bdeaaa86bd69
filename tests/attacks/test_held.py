from math import inf

import pytest
import torch
from builders import BUDGET, HOPPER, make_victim, normal
from hypothesis import given
from hypothesis import strategies as st

from detden_lite.attacks.held import CornerAttack, OffsetAttack, extreme_points
from detden_lite.core.budget import Budget
from detden_lite.core.random_streams import RandomStreams
from detden_lite.simulation.rollout import rollout


def offsets(attack, steps: int, n: int = 2, dim: int = 11) -> torch.Tensor:
    """The perturbations of so many steps, ``[steps, n, dim]``, in units of the ball's radius."""
    attack.reset(range(n))
    zero = torch.zeros(n, dim)
    return torch.stack([attack(zero) for _ in range(steps)]) / attack.budget.epsilon


@given(st.sampled_from([inf, 2, 1]), st.integers(1, 20), st.integers(0, 99))
def test_extreme_points_lie_on_the_border_of_the_ball(norm, dim, seed):
    points = extreme_points(norm, 5, dim, RandomStreams(seed))
    size = torch.linalg.vector_norm(points, ord=norm, dim=-1)
    assert torch.allclose(size, torch.ones(5))
    if norm == inf:
        assert (points.abs() == 1).all()


@pytest.mark.parametrize("norm", [inf, 2, 1])
@given(every=st.none() | st.integers(1, 7), drift=st.booleans())
def test_nothing_leaves_the_ball(norm, every, drift):
    budget, obs = Budget(0.3, norm), normal(2, 11)
    attack = CornerAttack(budget, every, drift and every is not None)
    attack.reset([3, 4])
    for _ in range(15):
        assert budget.contains(obs, attack(obs)).all()


def test_a_corner_is_held_for_an_episode_and_another_is_drawn_for_the_next():
    attack = CornerAttack(BUDGET)
    moved = offsets(attack, 20)
    assert torch.allclose(moved, moved[:1].expand_as(moved)) and (moved[0, 0] != moved[0, 1]).any()
    attack.reset([2, 3])
    assert (attack(torch.zeros(2, 11)) / BUDGET.epsilon != moved[0]).any()


def test_an_episode_has_its_corner_whoever_plays_beside_it():
    alone, together = CornerAttack(BUDGET), CornerAttack(BUDGET)
    alone.reset([7])
    together.reset([5, 7])
    assert torch.equal(alone(torch.zeros(1, 11))[0], together(torch.zeros(2, 11))[1])


@pytest.mark.parametrize("attack", [CornerAttack(BUDGET, every=4), OffsetAttack(torch.ones(11), BUDGET, every=4)])
def test_it_switches_every_k_steps_and_not_between(attack):
    moved = offsets(attack, 12)
    changed = [bool((a != b).any()) for a, b in zip(moved, moved[1:], strict=False)]
    assert changed == [step % 4 == 3 for step in range(11)]


def test_a_drifting_corner_walks_straight_to_the_next():
    attack = CornerAttack(BUDGET, every=4, drift=True)
    moved = offsets(attack, 9)
    assert (moved[[0, 4, 8]].abs() > 1 - 1e-5).all()
    for step in range(8):
        first, second = moved[step // 4 * 4], moved[step // 4 * 4 + 4]
        assert torch.allclose(moved[step], first + (second - first) * (step % 4) / 4, atol=1e-5)


def test_an_offset_of_each_row_is_that_row_alone():
    rows = extreme_points(inf, 3, 11, RandomStreams(0))
    together = offsets(OffsetAttack(rows, BUDGET), 1, n=3)[0]
    for row, moved in zip(rows, together, strict=True):
        assert torch.allclose(offsets(OffsetAttack(row, BUDGET), 1, n=1)[0, 0], moved)


def test_rollout_holds_the_offset_in_every_episode():
    offset = torch.tensor([1.0, -1.0] * 5 + [0.5])
    episodes = rollout(make_victim(), HOPPER, range(3), attack=OffsetAttack(offset, BUDGET), steps=6)
    moved = torch.from_numpy((episodes.perturbed - episodes.obs)[episodes.mask])
    assert torch.allclose(moved, BUDGET.epsilon * offset.expand_as(moved), atol=1e-5)
