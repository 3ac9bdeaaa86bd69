"""The data cards of the victims: how each was trained and chosen, and what it earns."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from detden_lite.core import files
from detden_lite.core.estimates import Estimate
from detden_lite.core.tasks import ONLINE, Task, get_task
from detden_lite.results import records
from detden_lite.results.cells import Cell
from detden_lite.results.paper import ROWS
from detden_lite.store import manifest


@dataclass(frozen=True)
class LearningCurve:
    """The learning curve of one seed: mean return of the screening episodes at each snapshot.

    Example:
        >>> curve = load_card("hopper", "td3").curves[0]
        >>> curve.steps.shape == curve.mean.shape
        True
    """

    seed: int
    steps: np.ndarray  # environment steps
    mean: np.ndarray
    attacked: np.ndarray | None = None  # the same under the opposite attack, of a policy that is to be robust


@dataclass(frozen=True)
class VictimCard:
    """How a shipped victim was trained and chosen, and its returns.

    Example:
        >>> card = load_card("hopper", "td3")
        >>> card.title, card.steps, len(card.returns)
        ('Hopper, TD3', 500000, 100)
    """

    task: Task
    algo: str
    returns: np.ndarray  # of the report episodes, from the clean record if there is one
    estimate: Estimate  # of these
    first_returns: np.ndarray  # of the same episodes, when it was chosen: perhaps on another processor
    curves: tuple[LearningCurve, ...]  # of every seed that was trained
    seed: int  # the chosen snapshot's
    step: int  # the chosen snapshot's, environment steps
    selection_mean: float  # by which it was chosen
    recipe: Mapping[str, object]  # hyperparameters of the training
    config: Mapping[str, object]  # shapes of the networks
    versions: Mapping[str, str]
    fit: Mapping[str, float] | None  # of the learned Q-function; None for TD3, which has critics of its own
    training: tuple[Mapping[str, Any], ...]  # what each seed of ``ONLINE`` went through: ``progress.columns``

    @property
    def name(self) -> str:
        """How data/ calls it: "hopper-td3"."""
        return f"{self.task.name}-{self.algo}"

    @property
    def title(self) -> str:
        """How the book calls it: "Hopper, TD3"."""
        return title(self.task.name, self.algo)

    @property
    def effect_correlation(self) -> float | None:
        """How well the learned Q-function knows what actions do; None if there is none.

        Sidecars made before the effects were measured have the correlation with what exploration happened to gain.
        """
        fit = self.fit or {}
        return fit.get("effect_correlation", fit.get("action_correlation"))

    @property
    def steps(self) -> int:
        """Environment steps that each seed was trained for; of the longest, if they differ."""
        return int(max(curve.steps[-1] for curve in self.curves))


def title(task: str, algo: str) -> str:
    """How the book calls a victim: "Hopper, TD3"."""
    return f"{get_task(task).env_id.removesuffix('-v5')}, {ONLINE.get(algo, algo.upper())}"


def load_card(task: str, algo: str, root: Path = manifest.DATA) -> VictimCard:
    """The card of a shipped victim.

    Its returns are those of the clean record, with which the records of the attacks are compared: the same episodes on
    another processor may have others.

    Raises:
        ArtifactError: if it is not shipped, altered, or lacks an entry.
    """
    path = root / f"{task}-{algo}" / "victim.json"
    about, critic = manifest.read_json(path, root), path.with_name("critic.json")
    record = next(iter(records.load_cells([Cell()], task, algo, root).values()), None)
    try:
        recipe = {key: value for key, value in about["recipe"].items() if key not in ("task", "seed")}
        return VictimCard(
            task=get_task(task),
            algo=algo,
            returns=np.array(record.returns if record else about["returns"]),
            estimate=record.estimate if record else Estimate(**about["estimate"]),
            first_returns=np.array(about["returns"]),
            curves=tuple(
                LearningCurve(
                    curve["seed"],
                    np.array(curve["steps"]),
                    np.array(curve["mean"]),
                    np.array(curve["attacked"]) if "attacked" in curve else None,
                )  # fmt: skip
                for curve in about["learning_curves"]
            ),
            seed=about["recipe"]["seed"],
            step=about["step"],
            selection_mean=about["selection_mean"],
            recipe=recipe,
            config=about["config"],
            versions=about["versions"],
            fit=manifest.read_json(critic, root)["fit"] if critic.exists() else None,
            training=tuple(about.get("training", ())),
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise files.ArtifactError(f"{path} is no victim's card ({error!r}); make it with its recipe") from None


def load_cards(root: Path = manifest.DATA) -> dict[tuple[str, str], VictimCard]:
    """The cards of the paper's victims that are shipped, by (task, algorithm), in the order of ``ROWS``."""
    return {row: load_card(*row, root) for row in ROWS if (root / "-".join(row) / "victim.json").exists()}


def live(obs: np.ndarray, parts: Mapping[str, int]) -> dict[str, tuple[int, int]]:
    """How many observations of each part change at all.

    Args:
        obs: ``[rows, obs_dim]``, seen in episodes.
        parts: how many observations each part has, in their order, ``obs_dim`` in all.

    Returns:
        For each part how many change, and how many there are.

    Example:
        >>> live(np.array([[0, 1, 5], [0, 2, 5]]), dict(position=2, force=1))
        {'position': (1, 2), 'force': (0, 1)}
    """
    if sum(parts.values()) != obs.shape[1]:
        raise ValueError(f"parts: they have {sum(parts.values())} observations in all, and obs has {obs.shape[1]}")
    changes = np.ptp(obs, axis=0) > 0
    ends = np.cumsum(list(parts.values()))
    return {part: (int(changes[end - n : end].sum()), n) for (part, n), end in zip(parts.items(), ends, strict=True)}
