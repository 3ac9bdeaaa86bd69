"""Checks of the chapter on the MDP and the victim."""

from collections.abc import Callable

import numpy as np

from detden_lite.checks.compare import array, compare, parts
from detden_lite.checks.failure import explained


@explained
def check_returns_to_go(returns_to_go: Callable[[np.ndarray, float], np.ndarray]) -> None:
    """``returns_to_go(reward, gamma)`` is the discounted return from every step on, ``[steps]``."""
    reward = np.array([1.0, 0.0, 0.0, 2.0])
    call = "returns_to_go([1, 0, 0, 2], 0.5)"
    got = returns_to_go(reward, 0.5)
    if array(call, got).ndim == 0:
        raise AssertionError(f"{call} gives one number; there is a return from each of the 4 steps on")
    mistakes = {
        "The reward of the step itself is missing": [0.25, 0.5, 1.0, 0.0],
        "The discount counts from step t, not from the start of the episode": [1.25, 0.25, 0.25, 0.25],
        "gamma is missing: later rewards count less": [3.0, 2.0, 2.0, 2.0],
        "This sums what came before the step; a return sums what comes after it": [1.0, 1.0, 1.0, 1.25],
        "The order is reversed: the first entry belongs to the first step": [2.0, 1.0, 0.5, 1.25],
    }
    compare(call, got, [1.25, 0.5, 1.0, 2.0], mistakes)
    reward = np.random.default_rng(0).normal(size=40)
    for gamma in (0.0, 0.9, 1.0):
        ahead = np.arange(40) - np.arange(40)[:, None]
        weights = np.where(ahead >= 0, gamma ** np.maximum(ahead, 0.0), 0)
        compare(f"returns_to_go(reward, {gamma}) of 40 random rewards", returns_to_go(reward, gamma), weights @ reward)
    print("Right. With gamma = 0 only the next reward counts, with gamma = 1 all.")


@explained
def check_returns_and_lengths(
    returns_and_lengths: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
) -> None:
    """``returns_and_lengths(reward, terminated)`` of episodes in lockstep, all ``[steps, N]``, gives two ``[N]``."""
    reward = np.array([[1.0, 10.0, 100.0], [2.0, 20.0, 200.0], [3.0, 30.0, 300.0], [4.0, 40.0, 400.0]])
    terminated = np.array([[0, 0, 1], [1, 0, 1], [1, 0, 1], [1, 0, 1]], dtype=bool)  # after 2 steps, never, after 1
    call = "returns_and_lengths(reward, terminated)"
    returns, lengths = parts(call, returns_and_lengths(reward.copy(), terminated.copy()), "returns", "lengths")
    returns_hints = {
        "The step that ends an episode still earns its reward": [1.0, 100.0, 0.0],
        "Rewards after an episode's end are counted; leave them out": reward.sum(0),
        "Episodes end one by one: do not stop all of them with the first": [1.0, 10.0, 100.0],
        "argmax is 0 where terminated is never True: an episode that does not end keeps all its rewards": [3, 10, 100],
        "That is each episode's mean reward; a return is the sum": [1.5, 25.0, 100.0],
        "Sum over the steps, axis 0; an episode is a column": [111.0, 22.0, 33.0],
    }
    lengths_hints = {
        "The step that ends an episode is one of its steps": [1, 4, 0],
        "A world that has ended takes no more steps": [4, 4, 4],
        "argmax is 0 where terminated is never True, as in the second episode: it has all its steps": [2, 1, 1],
        "argmax is the place of the last step, counted from 0, and 0 where terminated is never True": [1, 0, 0],
        "That counts the steps after the end; a length counts those before it, and the last one": [3, 0, 4],
    }
    compare("returns", returns, [3.0, 100.0, 100.0], returns_hints)
    compare("lengths", lengths, [2, 4, 1], lengths_hints)
    print("Right. One array operation serves all episodes, and none of them affects another.")


@explained
def check_choose(
    choose: Callable[[np.ndarray, np.ndarray, np.ndarray, int], tuple[int, float]],
) -> None:
    """``choose(screening, selection, report, keep)`` gives the chosen snapshot's index and the mean to report of it."""
    screening = np.array([2_000.0, 3_100.0, 1_500.0, 900.0, 3_400.0, 3_300.0])
    selection = np.array([[3_500, 3_500], [3_200, 3_300], [2_000, 2_200], [900, 800], [3_000, 3_100], [3_100, 3_200]])
    report = np.array([[3_300, 3_400], [3_170, 3_070], [2_100, 2_000], [900, 900], [3_000, 3_000], [3_500, 3_400]])
    call = "choose(screening, selection, report, 3)"
    result = parts(call, choose(screening, selection, report, 3), "an index", "a mean")
    chosen = array("the index that choose gives", result[0])
    assert chosen.ndim == 0, f"{call} gives an index of the shape {chosen.shape}; choose one snapshot"
    index = float(chosen)
    hints = {
        0: "It is not among the 3 best of the screening, so the selection does not look at it",
        2: "That is its place in the short list; give the snapshot's own index",
        3: "The best has the highest mean, not the lowest",
        4: "That is the best of the screening; the selection episodes decide among the 3",
        5: "That one is best in the report, and episodes that are used to choose cannot be used to report",
    }
    assert index == 1, (
        f"choose takes snapshot {index:g}, and not the right one. {hints.get(int(index), 'There are only six')}"
    )
    mistakes = {
        "That is the score it was chosen by, which is biased upwards; take its mean on the report's episodes": 3_250,
        "That is its screening score; take its mean on the report's episodes": 3_100,
    }
    compare("the mean to report", result[1], 3_120, mistakes)
    print("Right. The snapshot is reported on other episodes than it was chosen on.")


@explained
def check_interval(interval: Callable[[np.ndarray, np.random.Generator, int], tuple[float, float]]) -> None:
    """``interval(values, rng, resamples)`` is the 95 % percentile bootstrap interval of the mean, low and high."""
    call = "interval(values, rng, resamples)"

    def ends(values: np.ndarray, seed: int = 0, resamples: int = 2_000) -> tuple[float, float]:
        rng = np.random.default_rng(seed)
        low, high = (array(call, end) for end in parts(call, interval(values.copy(), rng, resamples), "low", "high"))
        assert low.shape == high.shape == (), (
            f"{call} gives ends of the shapes {low.shape} and {high.shape}: one number each"
        )
        assert low <= high, f"low is {low:.6g} and high is {high:.6g}: they are swapped"
        return float(low), float(high)

    values = np.random.default_rng(7).normal(3_000, 200, size=100)
    low, high = ends(values)
    width, right = high - low, 2 * 1.96 * values.std() / np.sqrt(len(values))
    shown = f"For 100 values with a standard deviation of {values.std():.0f} the interval is {width:.3g} wide"
    assert width > 0.05 * right, f"{shown}. Are the values drawn with replacement? Without, every mean is the same"
    assert width < 0.75 * 2 * 1.96 * values.std(), (
        f"{shown}: as wide as the values themselves spread. Take the quantiles of the resamples' means"
    )
    assert 0.85 * right < width < 1.15 * right, (
        f"{shown}, and about {right:.3g} is expected. Does each resample have as many values as there are, "
        "and do 2.5 % of the means lie on each side?"
    )
    assert abs((low + high) / 2 - values.mean()) < 0.1 * right, (
        "the middle of the interval is far from the values' mean"
    )
    again = ends(values)
    assert np.allclose((low, high), again), (
        "the same rng should give the same interval: take all random numbers from rng"
    )
    assert not np.allclose((low, high), ends(values, seed=1)), (
        "every rng gives the same interval, so nothing is resampled: 1.96 standard errors around the mean assume a "
        "Gaussian, and a bootstrap draws from the values themselves"
    )
    compare("interval of 5 equal values", ends(np.full(5, 3.0)), [3.0, 3.0])

    skewed = np.array([1.0, 1, 1, 1, 1, 1, 1, 1, 2, 30])  # its means are skewed too: the upper end is the farther one
    below, above = skewed.mean() - ends(skewed)[0], ends(skewed)[1] - skewed.mean()
    case = f"For ten values of which one is far larger, low is {below:.3g} below the mean and high {above:.3g} above it"
    assert above > 1.2 * below or below > 1.2 * above, (
        f"{case}: the same, as in the formula with 1.96 standard deviations. Take the 2.5 % and 97.5 % quantiles of "
        "the resamples' means, which are skewed as the values are"
    )
    assert above > below, f"{case}: the wrong way round. The ends are the quantiles themselves, not 2 mean - quantile"
    trials = [(np.random.default_rng(1_000 + i).exponential(size=40), i) for i in range(200)]
    hits = np.mean([low <= 1 <= high for low, high in (ends(values, seed, 400) for values, seed in trials)])
    assert hits > 0.85, f"of 200 intervals only {hits:.0%} hold the true mean"
    print(f"Right. Of 200 such intervals {hits:.0%} hold the true mean; 95 % is promised,")
    print("but each came from only 40 values, and very skewed ones.")
