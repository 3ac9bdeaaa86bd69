import pytest
import torch

from detden_lite.core.random_streams import RandomStreams


@pytest.mark.parametrize("kind", ["normal", "uniform"])
def test_an_episodes_random_numbers_do_not_depend_on_others(kind):
    alone, beside = RandomStreams(3, [7]), RandomStreams(3, [5, 7, 9])
    for _ in range(3):
        assert torch.equal(getattr(alone, kind)(1, 4)[0], getattr(beside, kind)(3, 4)[1])


def test_episodes_and_seeds_are_independent():
    first = RandomStreams(0, [1, 2]).normal(2, 8)
    assert not torch.equal(first[0], first[1])
    assert not torch.equal(first, RandomStreams(1, [1, 2]).normal(2, 8))
    # Neither the sum nor the order of (seed, episode) decides.
    assert not torch.equal(RandomStreams(1, [2]).normal(1, 8), RandomStreams(2, [1]).normal(1, 8))


def test_random_numbers_are_new_and_repeat_with_the_seed():
    streams, again = RandomStreams(0, [1]), RandomStreams(0, [1])
    first, second = streams.normal(1, 8), streams.normal(1, 8)
    assert not torch.equal(first, second)
    assert torch.equal(first, again.normal(1, 8)) and torch.equal(second, again.normal(1, 8))


def test_without_episodes_one_stream_serves_any_number_of_rows():
    whole = RandomStreams(4).uniform(10, 3)
    streams = RandomStreams(4)
    assert torch.equal(whole, torch.cat([streams.uniform(4, 3), streams.uniform(6, 3)]))


def test_moments():
    normal, uniform = RandomStreams(0).normal(50_000, 2), RandomStreams(0).uniform(50_000, 2)
    assert normal.mean().abs() < 0.02 and (normal.std() - 1).abs() < 0.02
    assert 0 <= uniform.min() and uniform.max() < 1
    assert (uniform.mean() - 0.5).abs() < 0.01 and (uniform.var() - 1 / 12).abs() < 0.005


def test_rows_that_do_not_fit_the_episodes_are_refused():
    with pytest.raises(ValueError, match="3 rows for 2 episodes"):
        RandomStreams(0, [1, 2]).normal(3, 4)


@pytest.mark.parametrize("seed", [-1, 1.5, "a", None])
def test_a_seed_that_is_no_whole_number_is_refused(seed):
    with pytest.raises(ValueError, match="seed must be a whole number of at least 0"):
        RandomStreams(seed)
    with pytest.raises(ValueError, match="the seed of an episode must be a whole number of at least 0"):
        RandomStreams(0, [1, seed])
    with pytest.raises(ValueError, match="the seed of an episode must be"):
        RandomStreams(0, [1]).restart(0, seed)


def test_streams_without_any_episode_are_refused():
    with pytest.raises(ValueError, match="episodes is empty"):
        RandomStreams(0, [])


def test_restart_changes_only_the_given_row():
    streams, beside, anew = RandomStreams(3, [5, 7]), RandomStreams(3, [5]), RandomStreams(3, [9])
    streams.normal(2, 4), beside.normal(1, 4)
    streams.restart(1, 9)
    found = streams.normal(2, 4)
    assert torch.equal(found[0], beside.normal(1, 4)[0]) and torch.equal(found[1], anew.normal(1, 4)[0])
