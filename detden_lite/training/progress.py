"""What a training went through, segment by segment: episodes, falls, and the time it took.

``progress.json`` beside a training's snapshots has one entry a segment. A segment that is trained again after a kill
replaces its entry, so that the file describes the training that led to the last snapshot.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from detden_lite.core.files import ArtifactError, replace_file


@dataclass
class Tally:
    """Counts the steps, episodes and falls of a training: a callback of stable-baselines3.

    A fall is the end of an episode that is no time limit.

    Example:
        >>> tally = Tally()
        >>> infos = [{}, {"TimeLimit.truncated": True}, {"TimeLimit.truncated": False}]
        >>> tally(dict(dones=np.array([False, True, True]), infos=infos))
        True
        >>> tally
        Tally(steps=3, episodes=2, falls=1)
    """

    steps: int = 0
    episodes: int = 0
    falls: int = 0

    def __call__(self, found: Mapping[str, Any], _: object = None) -> bool:
        """Count one step of N worlds, with ``dones`` [N] and their N ``infos``; True, so that the training goes on."""
        self.steps += len(found["dones"])
        for i in np.flatnonzero(found["dones"]):
            self.episodes += 1
            self.falls += not found["infos"][i].get("TimeLimit.truncated", False)
        return True

    def take(self) -> dict[str, int]:
        """What was counted, and count from 0 again."""
        counted = asdict(self)
        self.steps = self.episodes = self.falls = 0
        return counted


def load_progress(folder: Path) -> dict[str, dict[str, Any]]:
    """The entries of a training's folder, by environment steps; none if it has no file.

    Raises:
        ArtifactError: if the file is damaged.
    """
    path = folder / "progress.json"
    try:
        return json.loads(path.read_text()) if path.exists() else {}
    except (OSError, ValueError) as error:
        raise ArtifactError(f"{path} is damaged ({error}); restore it, or remove {folder} to train anew") from None


def record_progress(folder: Path, steps: int, entry: Mapping[str, Any]) -> None:
    """Write down the segment that ended after so many steps of the environment."""
    known = load_progress(folder) | {f"{steps:08d}": entry}
    replace_file(folder / "progress.json", (json.dumps(known, indent=1, sort_keys=True) + "\n").encode())


def columns(progress: Mapping[str, Mapping[str, Any]]) -> dict[str, list]:
    """The entries of a training as columns, one number a segment.

    ``end`` is the step at which the segment ended. ``steps``, ``episodes`` and ``falls`` are those of the policy's own
    worlds; ``attacked_steps`` and so on are those under attack, the adversary's turns among them.

    Example:
        >>> turn = dict(steps=512, episodes=3, falls=2)
        >>> found = columns({"00000512": turn, "00001024": turn | dict(adversary=turn)})
        >>> found["end"], found["falls"], found["attacked_falls"]
        ([512, 1024], [2, 2], [0, 4])
    """
    entries = [progress[end] for end in sorted(progress)]
    found: dict[str, list] = dict(end=[int(end) for end in sorted(progress)])
    for name in sorted({name for entry in entries for name in entry} - {"adversary"}):
        found[name] = [entry.get(name) for entry in entries]
    for name in ("steps", "episodes", "falls"):
        found[f"attacked_{name}"] = [
            entry[name] + entry["adversary"][name] if "adversary" in entry else 0 for entry in entries
        ]
    return found
