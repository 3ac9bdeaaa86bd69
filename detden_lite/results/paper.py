"""The numbers that the paper reports of its own experiments: tables 1 to 4, by (task, algorithm).

Four numbers stand for the four attacks in the order of ``catalogue.FOUR``.
"""

from dataclasses import dataclass
from typing import TypeVar

from detden_lite.attacks import catalogue
from detden_lite.core.tasks import ALGORITHMS, TASKS

T = TypeVar("T")

ROWS = tuple((task, algo) for algo in ALGORITHMS for task in TASKS)  # of the paper's tables

# Table 2 of the paper, column "Pre.": mean clean return of the policies that it attacks, 100 episodes each.
CLEAN = {
    ("hopper", "td3"): 3_607,
    ("walker2d", "td3"): 4_719,
    ("halfcheetah", "td3"): 9_790,
    ("ant", "td3"): 5_805,
    ("humanoid", "td3"): 5_531,
    ("hopper", "ppo"): 3_206,
    ("walker2d", "ppo"): 4_007,
    ("halfcheetah", "ppo"): 8_069,
    ("ant", "ppo"): 5_698,
    ("humanoid", "ppo"): 4_568,
}

# Table 1 of the paper, columns "Attack/Defense", before the slash: mean returns of its policies under each attack.
_UNDEFENDED = {
    ("hopper", "td3"): (390, 960, 267, 1_629),
    ("hopper", "ppo"): (271, 700, 247, 217),
    ("walker2d", "td3"): (751, 478, 187, 762),
    ("walker2d", "ppo"): (241, 3_510, -38, 1_582),
    ("halfcheetah", "td3"): (1_770, 1_603, 1_017, 1_802),
    ("halfcheetah", "ppo"): (1_072, 1_665, 833, 274),
    ("ant", "td3"): (603, -46, -893, 522),
    ("ant", "ppo"): (-351, -157, 558, 196),
    ("humanoid", "td3"): (431, 454, 585, 420),
    ("humanoid", "ppo"): (531, 406, 415, 396),
}

ATTACKED = {victim: dict(zip(catalogue.FOUR, row, strict=True)) for victim, row in _UNDEFENDED.items()}

ORDER = tuple((task, algo) for task in TASKS for algo in ALGORITHMS)  # of the paper's own lines


def _by_row(*rows: T) -> dict[tuple[str, str], T]:
    return dict(zip(ORDER, rows, strict=True))


# Table 1, columns "Attack/Defense", after the slash: mean returns of the attacked policies with the defence.
DEFENDED = _by_row(
    (2_219, 3_328, 2_814, 3_287), (2_615, 3_569, 3_068, 2_751),
    (4_005, 4_329, 4_772, 4_538), (1_785, 4_737, 1_393, 1_741),
    (8_946, 8_471, 8_174, 8_838), (6_115, 4_218, 3_765, 4_477),
    (3_516, 2_137, 2_809, 4_729), (5_404, 1_042, 4_574, 5_497),
    (4_849, 4_042, 5_130, 5_125), (3_161, 3_508, 3_630, 1_695),
)  # fmt: skip


@dataclass(frozen=True)
class DefendedRow:
    """A row of table 2: returns of the defended policy when nobody attacks, and over the four attacks.

    Example:
        >>> OURS["hopper", "td3"].best_attack
        'opposite'
    """

    clean: float
    share: float  # of the bare policy's clean return, as printed
    average: float  # over the attacks
    least: float
    best_attack: str  # which leaves the least


OURS = _by_row(
    DefendedRow(3_506, 0.97, 2_912, 2_219, "opposite"), DefendedRow(3_201, 1.00, 3_001, 2_615, "opposite"),
    DefendedRow(4_712, 1.00, 4_411, 4_005, "opposite"), DefendedRow(3_980, 0.99, 2_414, 1_393, "optimal"),
    DefendedRow(8_935, 0.91, 8_607, 8_174, "optimal"), DefendedRow(7_634, 0.95, 4_644, 3_765, "optimal"),
    DefendedRow(5_804, 1.00, 3_298, 2_137, "qfunction"), DefendedRow(5_538, 0.97, 4_129, 1_042, "qfunction"),
    DefendedRow(5_438, 0.98, 4_786, 4_042, "qfunction"), DefendedRow(4_429, 0.97, 2_999, 1_695, "enchanting"),
)  # fmt: skip

# Table 2, columns "ATLA", by task: clean, average over the attacks, least.
ATLA = dict(
    hopper=(3_220, 2_192, 1_761), walker2d=(3_819, 1_988, 1_430), halfcheetah=(6_294, 5_104, 4_617),
    ant=(5_313, 4_310, 3_765), humanoid=(4_108, 3_311, 2_719),
)  # fmt: skip


@dataclass(frozen=True)
class Scores:
    """A row of table 3. Four numbers are of the four attacks.

    Example:
        >>> SCORES["hopper", "td3"].f1
        (0.82, 0.98, 0.88, 0.99)
    """

    accuracy: float  # of the detector where nobody attacks
    f1: tuple[float, ...]
    false_negatives: tuple[float, ...]
    mae: tuple[float, ...]  # of the denoiser, in raw units


SCORES = _by_row(
    Scores(0.99, (0.82, 0.98, 0.88, 0.99), (0.00, 0.01, 0.07, 0.00), (0.030, 0.023, 0.032, 0.024)),
    Scores(0.99, (0.97, 0.94, 0.94, 0.95), (0.00, 0.00, 0.00, 0.00), (0.026, 0.018, 0.034, 0.038)),
    Scores(0.99, (0.99, 0.99, 0.99, 0.99), (0.01, 0.01, 0.02, 0.01), (0.030, 0.032, 0.042, 0.045)),
    Scores(0.95, (0.97, 0.93, 0.95, 0.99), (0.05, 0.01, 0.00, 0.01), (0.041, 0.030, 0.033, 0.037)),
    Scores(0.95, (0.99, 0.98, 0.98, 0.96), (0.00, 0.00, 0.00, 0.00), (0.049, 0.048, 0.050, 0.043)),
    Scores(0.99, (0.99, 0.98, 0.96, 0.96), (0.00, 0.01, 0.02, 0.01), (0.057, 0.041, 0.046, 0.048)),
    Scores(0.99, (0.99, 0.99, 0.99, 0.99), (0.00, 0.00, 0.00, 0.00), (0.022, 0.022, 0.022, 0.023)),
    Scores(0.99, (0.99, 0.99, 0.99, 0.99), (0.00, 0.00, 0.00, 0.00), (0.023, 0.024, 0.027, 0.026)),
    Scores(0.99, (0.96, 0.97, 1.00, 0.96), (0.08, 0.04, 0.00, 0.07), (0.048, 0.047, 0.043, 0.046)),
    Scores(0.99, (0.99, 0.99, 0.99, 0.99), (0.00, 0.00, 0.00, 0.00), (0.055, 0.045, 0.048, 0.050)),
)  # fmt: skip

# Table 4: by how much the adaptive attacks change the returns of table 1, and the columns "Min" and "Max".
ADAPTIVE = _by_row(
    (0.63, 0.06, 0.17, 0.04), (-0.16, -0.18, -0.12, -0.11),
    (0.19, 0.10, 0.00, 0.05), (0.12, -0.18, -0.16, 0.17),
    (-0.14, 0.06, 0.08, 0.03), (-0.23, 0.10, 0.17, 0.20),
    (-0.28, -0.17, -0.14, -0.18), (-0.24, 0.40, 0.11, -0.22),
    (0.09, 0.28, -0.03, -0.06), (0.28, 0.23, 0.01, 0.06),
)  # fmt: skip

ADAPTIVE_RANGE = _by_row(
    (0.04, 0.63), (-0.18, -0.11), (0.00, 0.19), (-0.18, 0.17), (-0.14, 0.08),
    (-0.23, 0.20), (-0.28, -0.14), (-0.24, 0.40), (-0.06, 0.28), (0.01, 0.28),
)  # fmt: skip
