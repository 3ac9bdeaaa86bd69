"""Checks of the chapter on the results of the defence."""

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from detden_lite.checks.compare import compare, parts
from detden_lite.checks.failure import explained
from detden_lite.core.metrics import detector_scores


@explained
def check_kept_share(kept_share: Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[float, float, float]]) -> None:
    """``kept_share(defended, clean, drawn)`` is the share that is kept and both ends of its paired interval."""
    rng = np.random.default_rng(0)
    clean = rng.uniform(100, 1_000, 40)
    defended = 0.8 * clean + rng.normal(0, 20, 40)
    drawn = rng.integers(40, size=(500, 40))

    def ends(ratios: np.ndarray, tail: float = 0.025) -> tuple[float, float, float]:
        return defended.mean() / clean.mean(), *np.quantile(ratios, [tail, 1 - tail])

    ratios = defended[drawn].mean(1) / clean[drawn].mean(1)
    quotients = defended / clean
    alone = defended[drawn].mean(1) / clean.mean()
    right = ends(ratios)
    call = "kept_share(defended, clean, drawn)"
    given = parts(call, kept_share(defended, clean, drawn), "the share", "the lower end", "the upper end")
    assert [np.ndim(part) for part in given] == [0, 0, 0], f"{call} gives arrays; it should give three numbers"
    apart = [np.quantile(returns[drawn].mean(1), [0.025, 0.975]) for returns in (defended, clean)]
    shuffled = clean[np.roll(drawn, 1, 0)].mean(1)
    mistakes = {
        "That is the mean of the episodes' ratios; it should be the ratio of the two means": (
            quotients.mean(),
            *np.quantile(quotients[drawn].mean(1), [0.025, 0.975]),
        ),
        "That averages ratios of episodes in each resample; take the ratio of the two resampled means": ends(
            quotients[drawn].mean(1)
        ),
        "The clean mean is the same in every resample: use the drawn episodes of clean too": ends(alone),
        "Each is resampled by itself here. Both were measured in the same episodes: take the ratio in each resample, "
        "and the quantiles of the ratios": (right[0], *(apart[0] / apart[1])),
        "Each is resampled by itself, and the worst is combined with the best. Both were measured in the same "
        "episodes: take the ratio in each resample": (right[0], *(apart[0] / apart[1][::-1])),
        "The row of defended belongs to the same row of clean: the same episodes, in pairs": ends(
            defended[drawn].mean(1) / shuffled
        ),
        "That interval holds 90 % of the resamples: leave 2.5 % on either side": ends(ratios, 0.05),
        "Those are the smallest and the largest resample: leave 2.5 % on either side": ends(ratios, 0),
        "The first number is the mean of the resamples; take the ratio of the episodes' means": (
            ratios.mean(),
            *right[1:],
        ),
        "Average over the episodes of a resample, its last axis, not over the resamples": ends(
            defended[drawn].mean(0) / clean[drawn].mean(0)
        ),
    }
    compare(call, given, right, mistakes, atol=1e-9)
    wide = np.ptp(defended[drawn].mean(1) / shuffled)
    print(
        f"Right. These returns rise and fall together, so pairing pays: resampled separately, the ratios range over "
        f"{wide:.2f}, resampled together over {np.ptp(ratios):.2f}."
    )


@explained
def check_worst_elsewhere(worst_elsewhere: Callable[[np.ndarray, np.ndarray], float]) -> None:
    """``worst_elsewhere(chosen_on, reported_on)``: attacks in the rows; the columns are different episodes."""
    chosen_on = np.array(
        [[7, 9, 8, 7, 5], [10, 12, 11, 10, 2], [6, 6, 6, 6, 5], [20, 20, 20, 20, 4], [9, 9, 8, 9, 6.0]]
        + [[3, 4, 4, 14, 15]]
    )
    reported_on = np.array(
        [[3, 1, 5, 4, 2], [9, 0, 3, 4, 6], [6.5, 7, 8, 9, 7], [9, 9, 9, 9.6, 9], [5, 8, 6, 7, 4], [2, 9, 4, 10, 5.5]]
    )
    worst = chosen_on.mean(1).argmin()
    mistakes = {
        "The attack is chosen on the episodes that it is reported on": reported_on.mean(1).min(),
        "The right attack, but reported on the episodes that it was chosen on": chosen_on[worst].mean(),
        "Another attack is chosen in every episode: average over the episodes first": reported_on.min(0).mean(),
        "The attack is chosen by its worst episode; choose it by its mean": reported_on[1].mean(),
        "The attack is chosen by its median: what is reported is a mean, so choose by the mean": (
            reported_on[np.median(chosen_on, 1).argmin()].mean()
        ),
        "The right attack, and its median: report its mean": np.median(reported_on[worst]),
        "The attack is chosen by its median, and its median is reported: take the mean twice": (
            np.median(reported_on[np.median(chosen_on, 1).argmin()])
        ),
        "That is the worst episode of the right attack: report its mean": reported_on[worst].min(),
        "That attack leaves the most; the worst one leaves the least": reported_on[chosen_on.mean(1).argmax()].mean(),
        "That is the mean over all attacks": reported_on.mean(),
        "That is which attack is the worst; report what it leaves": worst,
        "The mean over the episodes of an attack is mean(1)": reported_on[chosen_on.mean(0).argmin()].mean(),
    }
    call, right = "worst_elsewhere(chosen_on, reported_on)", reported_on[worst].mean()
    compare(call, worst_elsewhere(chosen_on, reported_on), right, mistakes, atol=1e-9)
    print(
        f"Right. It left {chosen_on[worst].mean():.2f} where it was chosen and leaves {right:.2f} elsewhere: some of "
        "its strength was chance."
    )


@explained
def check_f1(f1: Callable[[float, float, float], float]) -> None:
    """``f1(rate, misses, false_alarms)`` is the F1 of a detector with these error rates at this attack rate."""
    for attacked, missed, clean, false in ((20, 5, 80, 8), (100, 1, 9_900, 99), (990, 0, 10, 10), (50, 49, 50, 1)):
        truth = np.arange(attacked + clean) < attacked
        alarm = np.concatenate(
            [np.arange(attacked) >= missed, np.arange(clean) < false]
        )  # counted, not calculated: a second way to the same number
        rate, misses, alarms = attacked / len(truth), missed / attacked, false / clean
        hit = rate * (1 - misses)
        raised = hit + (1 - rate) * alarms
        mistakes = {
            "The false alarms are a share of the CLEAN steps: weigh them by 1 - rate": (
                2 * hit / (2 * hit + rate * misses + alarms)
            ),
            "The misses are a share of the ATTACKED steps: weigh them by the rate": (
                2 * hit / (2 * hit + misses + (1 - rate) * alarms)
            ),
            "rate is missing: the share of all steps that are attacked and found is rate (1 - misses)": (
                2 * (1 - misses) / (2 * (1 - misses) + misses + alarms)
            ),
            "That is the mean of precision and recall; F1 is their harmonic mean": (
                ((hit / raised if raised else 0) + 1 - misses) / 2
            ),
            "That is the product of precision and recall; F1 is their harmonic mean": (
                (hit / raised if raised else 0) * (1 - misses)
            ),
            "That is the precision: the share of the alarms that are right": hit / raised if raised else 0,
            "That is the recall: the share of the attacked steps that are found": 1 - misses,
            "That is the accuracy": hit + (1 - rate) * (1 - alarms),
            "Count the hits twice, in the numerator and in the denominator": hit
            / (hit + rate * misses + (1 - rate) * alarms),
        }
        call = f"f1({rate:g}, {misses:g}, {alarms:g})"
        counted = detector_scores(truth, alarm).f1
        assert counted is not None  # some steps are attacked
        compare(call, f1(rate, misses, alarms), counted, mistakes, atol=1e-9)
    print(
        f"Right. A detector that always raises the alarm has {f1(0.99, 0, 1):.3f} if 99 % of the steps are attacked. "
        f"One that errs in 1 % of either kind has {f1(0.01, 0.01, 0.01):.2f} if 1 % are."
    )


@explained
def check_felt(felt: Callable[[Callable[[Tensor], Tensor], Tensor, Tensor], Tensor]) -> None:
    """``felt(policy, obs, denoised)`` is how far each number's error alone moves the action, ``[obs_dim]``."""
    draw = torch.Generator().manual_seed(0)
    obs = torch.randn(6, 4, generator=draw)
    denoised = obs + 0.3 * torch.randn(6, 4, generator=draw)
    weights = torch.randn(4, 2, generator=draw)

    def policy(rows: Tensor) -> Tensor:
        assert rows.ndim == 2 and rows.shape[1] == 4, (
            f"the policy takes whole observations [N, 4]; it was given the shape {list(rows.shape)}"
        )
        return (rows @ weights).tanh()

    def apart(other: Tensor, base: Tensor = obs) -> Tensor:
        return (policy(other) - policy(base)).norm(dim=-1)

    def swapped(base: Tensor, other: Tensor, upto: bool = False) -> list[Tensor]:
        """``base`` with one number of ``other``, for each of the numbers; or with all numbers up to it."""
        places = [torch.arange(4) <= i if upto else torch.arange(4) == i for i in range(4)]
        return [torch.where(place, other, base) for place in places]

    right = torch.stack([apart(mixed).mean() for mixed in swapped(obs, denoised)])
    mistakes = {
        "The numbers before it are still wrong: begin with a fresh copy of obs for each of them": torch.stack(
            [apart(mixed).mean() for mixed in swapped(obs, denoised, upto=True)]
        ),
        "One number is true and all others are wrong; it should be the other way round": torch.stack(
            [apart(mixed).mean() for mixed in swapped(denoised, obs)]
        ),
        "That is the error of the observation; how far does the ACTION move?": (denoised - obs).abs().mean(0),
        "Several actions: take the norm of the difference, for every row": torch.stack(
            [(policy(mixed) - policy(obs)).abs().mean() for mixed in swapped(obs, denoised)]
        ),
        "Take the mean over the rows": torch.stack([apart(mixed).sum() for mixed in swapped(obs, denoised)]),
        "The mean comes last: errors of opposite signs cancel otherwise": torch.stack(
            [(policy(mixed) - policy(obs)).mean(0).norm() for mixed in swapped(obs, denoised)]
        ),
    }
    compare("felt(policy, obs, denoised)", felt(policy, obs, denoised), right, mistakes)
    print("Right. It shows number by number what a mean over all numbers hides.")
