"""Which episodes are for what: what is tuned on is never reported."""

# Where the seeds of episodes begin, by what they are for: what is tuned on is never reported.
SEEDS = dict(
    normal=1_000_000, calibration=2_000_000, screening=3_000_000, selection=4_000_000, tuning=5_000_000,
    critic=6_000_000, search=6_500_000, adversary=7_000_000, report=8_000_000,
)  # fmt: skip


def seeds(purpose: str, n: int) -> range:
    """The first n episode seeds for a purpose: a key of ``SEEDS``."""
    return range(SEEDS[purpose], SEEDS[purpose] + n)
