"""The cheapest attack that is searched for: an offset to hold, with the victim as a black box."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from math import inf
from pathlib import Path
from typing import Protocol

import torch
from safetensors.torch import load_file, save
from torch import Tensor
from tqdm import tqdm

from detden_lite.attacks.held import extreme_points
from detden_lite.core.arguments import check_whole
from detden_lite.core.files import replace_file
from detden_lite.core.random_streams import RandomStreams
from detden_lite.core.tasks import Task
from detden_lite.recipe.linear_search import LinearRecipe
from detden_lite.training.resumable import claim
from detden_lite.victims.victim import Victim


class Measure(Protocol):
    """The victim's mean return against each of some offsets ``[K, obs_dim]`` in some tuning episodes, ``[K]``."""

    def __call__(self, offsets: Tensor, numbers: range) -> Tensor: ...


@dataclass(frozen=True)
class OffsetRecipe:
    """Sizes of the search.

    Args:
        candidates: random extreme points of the ball that are tried.
        episodes: of each candidate.
        finalists: how many of them are tried again, in four times as many episodes.
        rounds: of coordinate-wise refinement of the best one.

    Raises:
        ValueError: if one of them is no whole number of at least 1, or there are more finalists than candidates.

    Example:
        >>> OffsetRecipe(candidates=32, finalists=4).rounds
        3
    """

    candidates: int = 256
    episodes: int = 4
    finalists: int = 32
    rounds: int = 3

    def __post_init__(self) -> None:
        check_whole(1, candidates=self.candidates, episodes=self.episodes, finalists=self.finalists, rounds=self.rounds)
        if self.finalists > self.candidates:
            raise ValueError(f"finalists must be at most the {self.candidates} candidates, not {self.finalists}")

    def config(self, task: Task) -> dict:
        """The arguments of the ``Victim`` that stores the offset: a linear adversary whose weights are zero."""
        return LinearRecipe().config(task)


def refine(offset: Tensor, quick: Callable[[Tensor], Tensor], sure: Callable[[Tensor], Tensor]) -> Tensor:
    """One round: every coordinate's sign is turned alone, and then the 1, 2, 4, ... best of these turns together.

    Returns the one of those turns together, or ``offset`` itself, that leaves the smallest return.

    Args:
        offset: ``[obs_dim]``.
        quick: the victim's return against each of some offsets ``[K, obs_dim]``, ``[K]``, for single turns.
        sure: the same, in more episodes, for the choice.

    Example:
        >>> left = lambda offsets: -offsets @ torch.tensor([1.0, -1.0, 1.0, -1.0])
        >>> refine(torch.ones(4), left, left)
        tensor([ 1., -1.,  1., -1.])
    """
    flips = 1 - 2 * torch.eye(len(offset))
    singly = quick(flips * offset)
    order, sizes = singly.argsort(), [2**k for k in range(len(offset).bit_length())]
    together = torch.stack([flips[order[:size]].prod(0) for size in sizes])
    tried = torch.cat([torch.ones(1, len(offset)), together]) * offset
    return tried[sure(tried).argmin()]


def search(
    recipe: OffsetRecipe, task: Task, seed: int, folder: Path, measure: Measure, norm: float = inf,
    about: Mapping | None = None,
) -> list[Path]:  # fmt: skip
    """Search, or go on searching, and return the snapshots: the best so far after each round, ``folder/snapshots``.

    Args:
        recipe: sizes.
        task: whose observations are perturbed.
        seed: of the candidates.
        folder: for the snapshots.
        measure: see ``Measure``; ``numbers`` are those of the tuning episodes.
        norm: of the ball. Refinement turns signs, so the result stays an extreme point.
        about: what else the snapshots of this folder have in common, ready for JSON.

    Raises:
        ValueError: if ``folder`` holds another search.
        ArtifactError: if there is no room for a snapshot.
    """
    few = recipe.episodes
    snapshots = claim(Path(folder), dict(task=task.name, seed=seed, **(about or {}), **asdict(recipe)))
    adversary = Victim(**recipe.config(task))
    weight, bias = adversary.actor.parameters()
    weight.zero_()
    found = sorted(snapshots.glob("*.safetensors"))
    if found:
        adversary.load_state_dict(load_file(found[-1]))

    for step in tqdm(range(len(found), recipe.rounds + 1), desc=f"offset {task.name}", unit="round"):
        # Every round has episodes of its own, so that luck in one does not last.
        first = 5 * few * step
        quick = partial(measure, numbers=range(first, first + few))
        sure = partial(measure, numbers=range(first + few, first + 5 * few))
        if step == 0:
            points = extreme_points(norm, recipe.candidates, task.obs_dim, RandomStreams(seed))
            points = points[quick(points).argsort()[: recipe.finalists]]
            best = points[sure(points).argmin()]
        else:
            best = refine(bias.clone(), quick, sure)
        bias.copy_(best)
        replace_file(snapshots / f"{step:08d}.safetensors", save(adversary.state_dict()))
    return sorted(snapshots.glob("*.safetensors"))
