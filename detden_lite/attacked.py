"""What the undefended victims earn under each attack: the result records, beside the paper's own numbers."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from detden_lite import artifacts
from detden_lite.metrics import Estimate, estimate
from detden_lite.study import Cell

# In the order of the paper; "linear" is the released code's stand-in for the optimal attack, which the paper has not.
ATTACKS = ("opposite", "qfunction", "optimal", "linear", "enchanting")
TIMINGS = ("always", "vulnerable", "random")
CLEAN = ("none", "always")
NAMES = dict(
    none="clean", uniform="uniform noise", opposite="opposite", qfunction="Q-function", optimal="optimal",
    linear="linear adversary", enchanting="enchanting",
)  # fmt: skip

# Table 1 of the paper, columns "Attack/Defense", before the slash: mean returns of its policies under each attack.
_PAPER = {
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
PAPER = {
    victim: dict(zip(("opposite", "qfunction", "optimal", "enchanting"), row, strict=True))
    for victim, row in _PAPER.items()
}


def load(task: str, algo: str, root: Path = artifacts.DATA) -> dict[tuple[str, str], dict]:
    """The records of an undefended victim that are there, by (attack, timing): clean, noise and the attacks.

    Raises:
        ArtifactError: if one of them is altered.
    """
    cells = [CLEAN, ("uniform", "always"), *((attack, timing) for attack in ATTACKS for timing in TIMINGS)]
    names = {cell: Cell(*cell).record_name(task, algo) for cell in cells}
    there = {cell: name for cell, name in names.items() if (root / "results" / f"{name}.json").exists()}
    return {cell: artifacts.load_record(name, root) for cell, name in there.items()}


def strongest(records: Mapping[tuple[str, str], Mapping]) -> tuple[str, str] | None:
    """The (attack, timing) that leaves the smallest mean return, random timings aside; None if there is no attack."""
    means = {
        (attack, timing): record["estimate"]["mean"]
        for (attack, timing), record in records.items()
        if attack in ATTACKS and timing != "random"
    }
    return min(means, key=means.get) if means else None


def difference(one: Mapping, other: Mapping) -> Estimate:
    """How much more return a record has than another, compared episode by episode.

    Raises:
        ValueError: if they are not of the same episodes.
    """
    if one["seeds"] != other["seeds"]:
        raise ValueError(f"the records are of other episodes: seeds {one['seeds']} and {other['seeds']}")
    return estimate(np.subtract(one["returns"], other["returns"]))


def share(record: Mapping, clean: Mapping) -> float:
    """The mean return of a record as a part of the clean one; below 0 where the return is."""
    return record["estimate"]["mean"] / clean["estimate"]["mean"]
