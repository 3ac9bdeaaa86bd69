"""What the defended victims earn, and what detector and denoiser do: the records beside the paper's tables 1 to 3."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from detden_lite import artifacts, stages, study
from detden_lite.attacked import CLEAN
from detden_lite.runs import MAIN


@dataclass(frozen=True)
class Paper:
    """The paper's numbers of one victim. Mappings are by attack, a name of ``study.FOUR``."""

    clean: int  # table 2, "Ours": mean return under the defence when nobody attacks
    returns: Mapping[str, int]  # table 1, behind the slash
    accuracy: float  # table 3: of the detector, when nobody attacks
    f1: Mapping[str, float]
    misses: Mapping[str, float]  # false-negative rates
    mae: Mapping[str, float]  # of the denoiser


_PAPER = {
    ("hopper", "td3"): (
        3_506, (2_219, 3_328, 2_814, 3_287), 0.99,
        (0.82, 0.98, 0.88, 0.99), (0.00, 0.01, 0.07, 0.00), (0.030, 0.023, 0.032, 0.024),
    ),
    ("hopper", "ppo"): (
        3_201, (2_615, 3_569, 3_068, 2_751), 0.99,
        (0.97, 0.94, 0.94, 0.95), (0.00, 0.00, 0.00, 0.00), (0.026, 0.018, 0.034, 0.038),
    ),
    ("walker2d", "td3"): (
        4_712, (4_005, 4_329, 4_772, 4_538), 0.99,
        (0.99, 0.99, 0.99, 0.99), (0.01, 0.01, 0.02, 0.01), (0.030, 0.032, 0.042, 0.045),
    ),
    ("walker2d", "ppo"): (
        3_980, (1_785, 4_737, 1_393, 1_741), 0.95,
        (0.97, 0.93, 0.95, 0.99), (0.05, 0.01, 0.00, 0.01), (0.041, 0.030, 0.033, 0.037),
    ),
    ("halfcheetah", "td3"): (
        8_935, (8_946, 8_471, 8_174, 8_838), 0.95,
        (0.99, 0.98, 0.98, 0.96), (0.00, 0.00, 0.00, 0.00), (0.049, 0.048, 0.050, 0.043),
    ),
    ("halfcheetah", "ppo"): (
        7_634, (6_115, 4_218, 3_765, 4_477), 0.99,
        (0.99, 0.98, 0.96, 0.96), (0.00, 0.01, 0.02, 0.01), (0.057, 0.041, 0.046, 0.048),
    ),
    ("ant", "td3"): (
        5_804, (3_516, 2_137, 2_809, 4_729), 0.99,
        (0.99, 0.99, 0.99, 0.99), (0.00, 0.00, 0.00, 0.00), (0.022, 0.022, 0.022, 0.023),
    ),
    ("ant", "ppo"): (
        5_538, (5_404, 1_042, 4_574, 5_497), 0.99,
        (0.99, 0.99, 0.99, 0.99), (0.00, 0.00, 0.00, 0.00), (0.023, 0.024, 0.027, 0.026),
    ),
    ("humanoid", "td3"): (
        5_438, (4_849, 4_042, 5_130, 5_125), 0.99,
        (0.96, 0.97, 1.00, 0.96), (0.08, 0.04, 0.00, 0.07), (0.048, 0.047, 0.043, 0.046),
    ),
    ("humanoid", "ppo"): (
        4_429, (3_161, 3_508, 3_630, 1_695), 0.99,
        (0.99, 0.99, 0.99, 0.99), (0.00, 0.00, 0.00, 0.00), (0.055, 0.045, 0.048, 0.050),
    ),
}  # fmt: skip


def _paper(clean, returns, accuracy, *scores) -> Paper:
    by_attack = [dict(zip(study.FOUR, row, strict=True)) for row in (returns, *scores)]
    return Paper(clean, by_attack[0], accuracy, *by_attack[1:])


PAPER = {victim: _paper(*row) for victim, row in _PAPER.items()}


@dataclass(frozen=True)
class Share:
    """A part of a clean return, with its 95 % bootstrap interval."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.0%} [{self.low:.0%}, {self.high:.0%}]"


def load(task: str, algo: str, defense: str = MAIN, root: Path = artifacts.DATA) -> dict[tuple[str, str], dict]:
    """The records of a victim with this defence that are there, by (attack, timing).

    Raises:
        ArtifactError: if one of them is altered.
    """
    names = {(cell.attack, cell.timing): cell.record_name(task, algo) for cell in stages.cells((defense,))}
    there = {cell: name for cell, name in names.items() if (root / "results" / f"{name}.json").exists()}
    return {cell: artifacts.load_record(name, root) for cell, name in there.items()}


def worst(records: Mapping[tuple[str, str], Mapping]) -> tuple[str, str] | None:
    """The (attack, timing) that leaves the smallest mean return; None if there is no attacked record."""
    means = {cell: record["estimate"]["mean"] for cell, record in records.items() if cell != CLEAN}
    return min(means, key=means.get) if means else None


def kept(record: Mapping, bare: Mapping) -> Share:
    """The part of the bare victim's clean return that a record keeps: the ratio of the two means.

    Both are of the same episodes; the interval's episodes are drawn with both of their returns.

    Args:
        record: of the defended victim.
        bare: of the undefended victim when nobody attacks.

    Raises:
        ValueError: if the two do not begin with the same episode.
    """
    if record["seeds"][0] != bare["seeds"][0]:
        raise ValueError(f"the records are of other episodes, from {record['seeds'][0]} and {bare['seeds'][0]} on")
    n = min(len(record["returns"]), len(bare["returns"]))
    return _ratio([np.array(record["returns"][:n])], np.array(bare["returns"][:n]))


def kept_on_average(records: Mapping[tuple[str, str], Mapping], bare: Mapping, timing: str = "always") -> Share | None:
    """The mean over the four attacks of what is kept, as the paper's table 2 averages; None if one is missing.

    Args:
        records: of the defended victim, from ``load``.
        bare: of the undefended victim when nobody attacks.
        timing: of the attacks.
    """
    if not all((attack, timing) in records for attack in study.FOUR):
        return None
    four = [records[attack, timing] for attack in study.FOUR]
    n = min(len(record["returns"]) for record in (*four, bare))
    return _ratio([np.array(record["returns"][:n]) for record in four], np.array(bare["returns"][:n]))


def _ratio(parts: list[np.ndarray], whole: np.ndarray, resamples: int = 2_000) -> Share:
    mean = np.mean(parts, axis=0)
    drawn = np.random.default_rng(0).integers(len(whole), size=(resamples, len(whole)))
    low, high = np.quantile(mean[drawn].mean(1) / whole[drawn].mean(1), [0.025, 0.975])
    return Share(mean.mean() / whole.mean(), low, high)
