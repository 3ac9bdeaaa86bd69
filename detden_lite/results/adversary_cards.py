"""The data cards of learned adversaries: from which trainings and searches each was chosen, and what they cost."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from detden_lite.core import files
from detden_lite.store import manifest


@dataclass(frozen=True)
class Member:
    """One of the trainings or searches that an adversary was chosen from.

    Args:
        recipe: its hyperparameters, with its seed.
        steps: of its snapshots: environment steps of a training, rounds of a search.
        mean: the mean return that the victim has against each snapshot, in the screening episodes.
        selection: the same against its best one, in the selection episodes; None in an older card.
        chosen: whether the adversary is a snapshot of it.
        obs_dim: how many numbers the victim observes.

    Example:
        >>> search = dict(generations=40, population=128, episodes=2)
        >>> member = Member(search, steps=(1, 40), mean=(10.1, 5.1), selection=5.0, chosen=True, obs_dim=11)
        >>> member.title, member.cost
        ('linear map, by search', '10,240 episodes')
    """

    recipe: Mapping[str, Any]
    steps: tuple[int, ...]
    mean: tuple[float, ...]
    selection: float | None
    chosen: bool
    obs_dim: int

    @property
    def title(self) -> str:
        """What a page calls it."""
        recipe = self.recipe
        if "generations" in recipe:
            return "linear map, by search"
        if "candidates" in recipe:
            return "held offset, by search"
        parts = ["director" if recipe.get("director") else "perturbs", f"learning rate {recipe['learning_rate']:g}"]
        if recipe["timing"] != "always":
            parts.append("learns where V is low")
        if recipe.get("history", 1) > 1:
            parts.append(f"sees {recipe['history']} observations")
        if recipe.get("warm"):
            parts.append("begins as the linear map")
        return ", ".join(parts)

    @property
    def environment_steps(self) -> int:
        """Of its training by reinforcement; 0 for a search, which is counted in episodes."""
        return int(self.recipe.get("steps", 0))

    @property
    def episodes(self) -> int:
        """Of its search, of which each is as long as the victim lives; 0 for a training, which is counted in steps."""
        recipe = self.recipe
        if "generations" in recipe:
            return int(recipe["generations"] * recipe["population"] * recipe["episodes"])
        if "candidates" in recipe:
            # Each coordinate alone in a few episodes; 1, 2, 4, ... of them together, and none, in four times as many.
            turns = self.obs_dim + 4 * (self.obs_dim.bit_length() + 1)
            tried = recipe["candidates"] + 4 * recipe["finalists"] + recipe["rounds"] * turns
            return int(tried * recipe["episodes"])
        return 0

    @property
    def cost(self) -> str:
        """What it cost, as a page says it."""
        return f"{self.environment_steps:,} steps" if self.environment_steps else f"{self.episodes:,} episodes"


@dataclass(frozen=True)
class AdversaryCard:
    """How a shipped adversary was learned and chosen.

    Args:
        kind: a key of ``detden_lite.store.models.ADVERSARIES``.
        members: the trainings and searches that it was chosen from.
        selection_mean: mean return that it leaves in the selection episodes.
        clean_mean: what the victim has there when nobody attacks.

    Example:
        >>> card = load_adversary_card("hopper", "td3", "linear")
        >>> [member.title for member in card.members]
        ['linear map, by search']
    """

    kind: str
    members: tuple[Member, ...]
    selection_mean: float
    clean_mean: float

    @property
    def with_search(self) -> bool:
        """Whether a search by black box is among the members."""
        return any(member.episodes for member in self.members)

    @property
    def budget(self) -> dict[str, int]:
        """What it cost to learn: members, steps of the environment, and episodes of searches."""
        total = dict(
            members=len(self.members),
            environment_steps=sum(member.environment_steps for member in self.members),
            episodes=sum(member.episodes for member in self.members),
        )
        return {name: number for name, number in total.items() if number}


def load_adversary_card(task: str, algo: str, kind: str = "optimal", root: Path = manifest.DATA) -> AdversaryCard:
    """The card of a shipped adversary.

    Args:
        task: of the victim that it learned to harm ("hopper").
        algo: that victim's algorithm ("td3").
        kind: a key of ``detden_lite.store.models.ADVERSARIES``.
        root: as data/ is laid out.

    Raises:
        ArtifactError: if it is missing, altered, or lacks an entry.
        ValueError: if the kind is unknown.
    """
    from detden_lite.store.models import adversary_path  # here, so that reading the other cards loads no torch

    path = adversary_path(task, algo, kind, root).with_suffix(".json")
    about = manifest.read_json(path, root)
    try:
        victim_obs = about["config"]["actor"][0 if kind.endswith("director") else -1]
        members = tuple(
            Member(
                recipe=curve["recipe"],
                steps=tuple(curve["steps"]),
                mean=tuple(curve["mean"]),
                selection=curve.get("selection"),
                chosen=curve["recipe"] == about["recipe"],
                obs_dim=victim_obs,
            )
            for curve in about["learning_curves"]
        )
        if not all(member.mean for member in members):
            raise ValueError("a training has no snapshot")
        return AdversaryCard(kind, members, about["selection_mean"], about["clean_mean"])
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise files.ArtifactError(f"{path} is no adversary's card ({error!r}); make it with its recipe") from None


def load_adversary_cards(task: str, algo: str, root: Path = manifest.DATA) -> dict[str, AdversaryCard]:
    """The cards of all adversaries of a victim that are there, by kind.

    Example:
        >>> "optimal" in load_adversary_cards("hopper", "td3")
        True
    """
    from detden_lite.store.models import ADVERSARIES, adversary_path

    there = [kind for kind in ADVERSARIES if adversary_path(task, algo, kind, root).exists()]
    return {kind: load_adversary_card(task, algo, kind, root) for kind in there}
