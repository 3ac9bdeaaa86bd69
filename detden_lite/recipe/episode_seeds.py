"""Which episodes are for which purpose: what is tuned on is never reported."""

from detden_lite.core.arguments import check_whole

# The first seed of each purpose; they are far enough apart that no episode serves two.
SEEDS = dict(
    normal=1_000_000, calibration=2_000_000, screening=3_000_000, selection=4_000_000, tuning=5_000_000,
    critic=6_000_000, search=6_500_000, adversary=7_000_000, report=8_000_000,
)  # fmt: skip


def seeds(purpose: str, n: int) -> range:
    """The first n episode seeds for a purpose.

    Args:
        purpose: a key of ``SEEDS``.
        n: how many.

    Raises:
        ValueError: for an unknown purpose, or n below 1.

    Example:
        >>> seeds("report", 100)
        range(8000000, 8000100)
    """
    if purpose not in SEEDS:
        raise ValueError(f"purpose must be one of {', '.join(SEEDS)}, not {purpose!r}")
    check_whole(1, n=n)
    return range(SEEDS[purpose], SEEDS[purpose] + n)
