"""Which episodes are for which purpose: what is tuned on is never reported."""

# The first seed of each purpose; they are far enough apart that no episode serves two.
SEEDS = dict(
    normal=1_000_000, calibration=2_000_000, screening=3_000_000, selection=4_000_000, tuning=5_000_000,
    critic=6_000_000, search=6_500_000, adversary=7_000_000, report=8_000_000,
)  # fmt: skip


def seeds(purpose: str, n: int) -> range:
    """The first n episode seeds of a purpose, a key of ``SEEDS``.

    Example:
        >>> from detden_lite import seeds
        >>> seeds("report", 100)
        range(8000000, 8000100)
    """
    return range(SEEDS[purpose], SEEDS[purpose] + n)
