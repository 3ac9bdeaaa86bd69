"""A cheap adversary: a cross-entropy search for a linear map from observation to perturbation."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save
from torch import Tensor
from tqdm import tqdm

from detden_lite.core.arguments import check_between, check_positive, check_whole
from detden_lite.core.files import replace_file
from detden_lite.core.tasks import Task
from detden_lite.training.resumable import claim
from detden_lite.victims.victim import Victim


@dataclass(frozen=True)
class LinearRecipe:
    """Sizes of the search. Its distribution is a Gaussian whose components are independent.

    Raises:
        ValueError: if one of them is not in its range.

    Example:
        >>> LinearRecipe(population=32).elites
        16
    """

    generations: int = 20
    population: int = 64
    elites: int = 16
    episodes: int = 1  # of each member of the population in a generation
    spread: float = 1.0  # standard deviation of a perturbation at the start, in units of the ball's radius
    floor: float = 0.1  # the least standard deviation, as a share of that at the start

    def __post_init__(self) -> None:
        check_whole(1, generations=self.generations, population=self.population, episodes=self.episodes)
        check_whole(1, elites=self.elites)
        if self.elites > self.population:
            raise ValueError(f"elites must be at most the population of {self.population}, not {self.elites}")
        check_positive(spread=self.spread)
        check_between(0, 1, floor=self.floor)

    def config(self, task: Task) -> dict:
        """The arguments of the ``Victim`` that the adversary is: one linear layer, after a normaliser."""
        return dict(actor=[task.obs_dim, task.obs_dim], n_critics=0, gaussian=True)


class LinearMaps:
    """N linear adversaries, of which each perturbs the observations of its own episode.

    Args:
        normalizer: a policy whose normaliser the observations go through.
        maps: ``[N, obs_dim, obs_dim + 1]``, weights with the bias as last column.

    Example:
        >>> from detden_lite import Budget, LinearMaps, OptimalAttack, Victim
        >>> maps = torch.zeros(2, 11, 12)
        >>> maps[1, :, -1] = 1  # the second always perturbs by the ball's radius
        >>> attack = OptimalAttack(LinearMaps(Victim([11, 11]), maps), Budget(0.5))
        >>> attack.reset([0, 1])
        >>> attack(torch.zeros(2, 11))[:, 0]
        tensor([0.0000, 0.5000])
    """

    def __init__(self, normalizer: Victim, maps: Tensor):
        self.normalizer, self.maps, self.obs_dim = normalizer, maps, maps.shape[1]

    def __call__(self, obs: Tensor) -> Tensor:
        x = self.normalizer.normalize(obs)[:, :, None]
        return torch.baddbmm(self.maps[:, :, -1:], self.maps[:, :, :-1], x).squeeze(-1).clamp(-1, 1)


def elite_weights(n: int) -> Tensor:
    """How much each of n elites counts, ``[n]``, the best first: the logarithmic weights of CMA-ES (Hansen, 2016).

    Example:
        >>> elite_weights(2)
        tensor([0.8042, 0.1958])
    """
    weights = np.log(n + 0.5) - torch.arange(1, n + 1, dtype=torch.float32).log()
    return weights / weights.sum()


def fit(samples: Tensor, returns: Tensor, elites: int) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation of the ``elites`` samples ``[N, ...]`` with the lowest ``returns`` ``[N]``."""
    best = samples[returns.argsort()[:elites]]
    weights = elite_weights(elites).reshape(-1, *[1] * (samples.dim() - 1))
    mean = (weights * best).sum(0)
    return mean, (weights * (best - mean).square()).sum(0).sqrt()


def search(
    recipe: LinearRecipe, task: Task, seed: int, folder: Path, clean: np.ndarray,
    measure: Callable[[LinearMaps, int], Tensor], about: Mapping | None = None,
) -> list[Path]:  # fmt: skip
    """Search, or go on searching, and return the snapshots: the mean of each generation, ``folder/snapshots``.

    Args:
        recipe: sizes.
        task: whose observations are perturbed.
        seed: of the samples.
        folder: for snapshots, and for the state of the search after the last generation.
        clean: clean observations ``[rows, obs_dim]``, for the normaliser.
        measure: the victim's return against each of some adversaries, ``[N]``, in the episodes of a generation.
        about: what else the snapshots of this folder have in common, ready for JSON.

    Raises:
        ValueError: if ``folder`` holds another search.
        ArtifactError: if there is no room for a snapshot.
    """
    folder, d = Path(folder), task.obs_dim
    snapshots = claim(folder, dict(task=task.name, seed=seed, **(about or {}), **asdict(recipe)))
    checkpoint = folder / "search.safetensors"
    adversary = Victim(**recipe.config(task))
    adversary.obs_mean.copy_(torch.from_numpy(clean.mean(0)))
    weight, bias = adversary.actor.parameters()
    spread = torch.from_numpy(clean.std(0))
    adversary.obs_std.copy_(torch.where(spread > 1e-4, spread, 1.0))
    adversary.obs_clip.fill_(10.0)
    # Half of a perturbation's variance comes from the bias, half from the normalised observations.
    start = torch.full((d, d + 1), recipe.spread / (2 * d) ** 0.5)
    start[:, -1] = recipe.spread / 2**0.5
    state = dict(mean=torch.zeros(d, d + 1), std=start, generation=torch.tensor(0))
    if checkpoint.exists():
        state = load_file(checkpoint)
    for generation in tqdm(range(int(state["generation"]), recipe.generations), desc=f"linear {task.name}"):
        rng = np.random.default_rng([seed, generation])
        noise = torch.from_numpy(rng.standard_normal((recipe.population, d, d + 1), dtype=np.float32))
        samples = state["mean"] + state["std"] * noise
        returns = measure(LinearMaps(adversary, samples), generation)
        mean, std = fit(samples, returns, recipe.elites)
        weight.copy_(mean[:, :-1])
        bias.copy_(mean[:, -1])
        replace_file(snapshots / f"{generation + 1:08d}.safetensors", save(adversary.state_dict()))
        state = dict(mean=mean, std=std.maximum(recipe.floor * start), generation=torch.tensor(generation + 1))
        replace_file(checkpoint, save(state))
    return sorted(snapshots.glob("*.safetensors"))
