import numpy as np
import pytest

from detden_lite.checks import mdp


class TestReturnsToGo:
    @staticmethod
    def right(reward, gamma):
        out, later = np.zeros(len(reward)), 0.0
        for t in reversed(range(len(reward))):
            out[t] = later = reward[t] + gamma * later
        return out

    def test_the_solution_passes(self):
        mdp.check_returns_to_go(self.right)

    def test_a_missing_own_reward_is_explained(self):
        with pytest.raises(AssertionError, match="reward of the step itself"):
            mdp.check_returns_to_go(lambda r, gamma: gamma * np.append(self.right(r, gamma)[1:], 0))

    def test_discounting_from_the_start_is_explained(self):
        def wrong(reward, gamma):
            return np.cumsum((reward * gamma ** np.arange(len(reward)))[::-1])[::-1]

        with pytest.raises(AssertionError, match="counts from step t"):
            mdp.check_returns_to_go(wrong)

    def test_a_missing_gamma_is_explained(self):
        with pytest.raises(AssertionError, match="gamma is missing"):
            mdp.check_returns_to_go(lambda reward, gamma: np.cumsum(reward[::-1])[::-1])

    def test_a_single_return_is_explained(self):
        with pytest.raises(AssertionError, match="gives one number"):
            mdp.check_returns_to_go(lambda r, gamma: self.right(r, gamma)[0])

    def test_a_sum_over_the_past_is_explained(self):
        with pytest.raises(AssertionError, match="what came before"):
            mdp.check_returns_to_go(lambda r, gamma: np.cumsum(r * gamma ** np.arange(len(r))))

    def test_reversed_order_is_explained(self):
        with pytest.raises(AssertionError, match="order is reversed"):
            mdp.check_returns_to_go(lambda r, gamma: self.right(r, gamma)[::-1])

    def test_work_in_place_is_explained(self):
        def wrong(reward, gamma):
            for t in reversed(range(len(reward) - 1)):
                reward[t] += gamma * reward[t + 1]
            return reward

        with pytest.raises(AssertionError, match="changes its argument reward"):
            mdp.check_returns_to_go(wrong)


class TestReturnsAndLengths:
    def test_the_solution_passes(self):
        def right(reward, terminated):
            mask = np.ones_like(terminated)
            mask[1:] = ~terminated[:-1]
            return (reward * mask).sum(0), mask.sum(0)

        mdp.check_returns_and_lengths(right)

    @pytest.mark.parametrize(
        "mask, hint",
        [
            (lambda terminated: ~terminated, "still earns its reward"),
            (lambda terminated: np.ones_like(terminated), "after an episode's end"),
            (
                lambda terminated: np.vstack([[True] * 3, ~terminated.any(1, keepdims=True)[:-1].repeat(3, 1)]),
                "end one by one",
            ),
        ],
        ids=["last reward lost", "no mask", "all stop with the first"],
    )
    def test_a_wrong_mask_is_explained(self, mask, hint):
        with pytest.raises(AssertionError, match=hint):
            mdp.check_returns_and_lengths(lambda r, t: ((r * mask(t)).sum(0), mask(t).sum(0)))

    @pytest.mark.parametrize("first", [0, 1])
    def test_argmax_of_a_column_that_is_never_true_is_explained(self, first):
        def right(reward, terminated):
            return [3, 100, 100], terminated.argmax(0) + first

        with pytest.raises(AssertionError, match="argmax is"):
            mdp.check_returns_and_lengths(right)

        def wrong(reward, terminated):
            lengths = terminated.argmax(0) + 1
            return [column[:n].sum() for column, n in zip(reward.T, lengths, strict=True)], lengths

        with pytest.raises(AssertionError, match="returns .*argmax is 0"):
            mdp.check_returns_and_lengths(wrong)

    def test_wrong_lengths_are_explained(self):
        def wrong(reward, terminated):
            mask = np.vstack([[True] * reward.shape[1], ~terminated[:-1]])
            return (reward * mask).sum(0), (~terminated).sum(0)

        with pytest.raises(AssertionError, match="lengths .*one of its steps"):
            mdp.check_returns_and_lengths(wrong)


class TestChoose:
    def test_the_solution_passes(self):
        def right(screening, selection, report, keep):
            short = np.argsort(-screening)[:keep]
            best = short[selection[short].mean(1).argmax()]
            return best, report[best].mean()

        mdp.check_choose(right)

    def test_a_missing_short_list_is_explained(self):
        def wrong(screening, selection, report, keep):
            best = selection.mean(1).argmax()
            return best, report[best].mean()

        with pytest.raises(AssertionError, match="selection does not look at it"):
            mdp.check_choose(wrong)

    def test_choosing_in_the_report_is_explained(self):
        def wrong(screening, selection, report, keep):
            best = report.mean(1).argmax()
            return best, report[best].mean()

        with pytest.raises(AssertionError, match="cannot be used to report"):
            mdp.check_choose(wrong)

    def test_a_place_for_an_index_is_explained(self):
        def wrong(screening, selection, report, keep):
            short = np.argsort(-screening)[:keep]
            best = selection[short].mean(1).argmax()
            return best, report[best].mean()

        with pytest.raises(AssertionError, match="short list"):
            mdp.check_choose(wrong)

    def test_reporting_the_selection_score_is_explained(self):
        with pytest.raises(AssertionError, match="biased upwards"):
            mdp.check_choose(lambda screening, selection, report, keep: (1, selection[1].mean()))


class TestInterval:
    @staticmethod
    def right(values, rng, resamples):
        means = values[rng.integers(len(values), size=(resamples, len(values)))].mean(1)
        return tuple(np.quantile(means, [0.025, 0.975]))

    def test_the_solution_passes(self):
        mdp.check_interval(self.right)

    def test_quantiles_of_the_values_are_explained(self):
        with pytest.raises(AssertionError, match="values themselves spread"):
            mdp.check_interval(lambda values, rng, n: tuple(np.quantile(values, [0.025, 0.975])))

    def test_missing_replacement_is_explained(self):
        def wrong(values, rng, resamples):
            means = [rng.permutation(values).mean() for _ in range(resamples)]
            return tuple(np.quantile(means, [0.025, 0.975]))

        with pytest.raises(AssertionError, match="with replacement"):
            mdp.check_interval(wrong)

    def test_resamples_of_another_size_are_explained(self):
        def wrong(values, rng, resamples):
            means = [rng.choice(values, 20).mean() for _ in range(resamples)]
            return tuple(np.quantile(means, [0.025, 0.975]))

        with pytest.raises(AssertionError, match="as many values"):
            mdp.check_interval(wrong)

    def test_an_interval_of_90_percent_is_explained(self):
        def wrong(values, rng, resamples):
            means = [rng.choice(values, len(values)).mean() for _ in range(resamples)]
            return tuple(np.quantile(means, [0.05, 0.95]))

        with pytest.raises(AssertionError, match="2.5 %"):
            mdp.check_interval(wrong)

    @pytest.mark.parametrize("give", [list, np.array])
    def test_a_list_or_an_array_passes(self, give):
        mdp.check_interval(lambda *arguments: give(self.right(*arguments)))

    def test_the_normal_formula_is_explained(self):
        def wrong(values, rng, resamples):
            half = 1.96 * values.std() / np.sqrt(len(values))
            return values.mean() - half, values.mean() + half

        with pytest.raises(AssertionError, match="assume a Gaussian"):
            mdp.check_interval(wrong)

    def test_standard_deviations_of_the_resamples_are_explained(self):
        def wrong(values, rng, resamples):
            half = 1.96 * values[rng.integers(len(values), size=(resamples, len(values)))].mean(1).std()
            return values.mean() - half, values.mean() + half

        with pytest.raises(AssertionError, match="1.96 standard deviations"):
            mdp.check_interval(wrong)

    def test_the_basic_interval_is_explained(self):
        def wrong(values, rng, resamples):
            low, high = self.right(values, rng, resamples)
            return 2 * values.mean() - high, 2 * values.mean() - low

        with pytest.raises(AssertionError, match="2 mean - quantile"):
            mdp.check_interval(wrong)

    def test_random_numbers_from_elsewhere_are_explained(self):
        with pytest.raises(AssertionError, match="same rng"):
            mdp.check_interval(lambda values, rng, n: self.right(values, np.random.default_rng(), n))
