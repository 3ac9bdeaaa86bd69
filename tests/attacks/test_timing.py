import pytest
import torch
from builders import make_victim, normal

from detden_lite.attacks.timing import After, Always, Random, Vulnerable


def test_always_attacks_everyone():
    timing = Always()
    timing.reset(range(5))
    assert timing(normal(5, 11)).tolist() == [True] * 5


@pytest.mark.parametrize("gaussian", [False, True])
def test_vulnerable_is_where_the_value_is_below_the_threshold(gaussian):
    victim, obs = make_victim(gaussian=gaussian), normal(20, 11)
    values = victim.value(obs)
    timing = Vulnerable(victim, float(values.sort().values[7]))
    timing.reset(range(20))
    attacked = timing(obs)
    assert attacked.sum() == 7 and values[attacked].max() < values[~attacked].min()


def test_random_attacks_at_its_rate():
    timing = Random(0.3)
    timing.reset([0])
    assert abs(float(timing(torch.zeros(20_000, 11)).double().mean()) - 0.3) < 0.02


@pytest.mark.parametrize("rate", [0, 1])
def test_random_at_the_ends_is_never_and_always(rate):
    timing = Random(rate)
    timing.reset(range(50))
    assert set(timing(torch.zeros(50, 11)).tolist()) == {bool(rate)}


def test_random_belongs_to_the_episode():
    together, alone = Random(0.5), Random(0.5)
    together.reset([1, 2, 3])
    alone.reset([2])
    assert all(together(torch.zeros(3, 11))[1] == alone(torch.zeros(1, 11))[0] for _ in range(20))


def test_after_attacks_from_its_step_on_in_every_episode():
    timing = After(2)
    for _ in range(2):
        timing.reset(range(3))
        assert [timing(normal(3, 11)).tolist() for _ in range(4)] == [[False] * 3] * 2 + [[True] * 3] * 2
