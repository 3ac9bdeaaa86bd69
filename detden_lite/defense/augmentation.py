"""Trajectories to learn from: their checks, and adversarial ones made offline (sections 2.4 and 3.1.2)."""

from collections.abc import Sequence

import numpy as np
import torch
from tqdm import tqdm

from detden_lite.core.arguments import check_between, check_whole
from detden_lite.core.types import Attack, Trajectories, World

Pair = tuple[Trajectories, Trajectories]  # input and target


def check_trajectories(name: str, *versions: Trajectories) -> None:
    """Refuse trajectories that break their contract, see ``detden_lite.core.types.Trajectories``.

    Args:
        name: of the argument, for the error.
        versions: of the same trajectories, clean or attacked. Their padding is checked too, since NaN times zero is
            NaN.

    Raises:
        ValueError: if an array is empty or of another shape or type, a length is not between 1 and the number of steps,
            an observation is not finite, or the versions differ in shape or lengths.

    Example:
        >>> check_trajectories("normal", Trajectories(np.zeros((2, 5, 3), np.float32), np.array([5, 6])))
        Traceback (most recent call last):
        ValueError: normal: lengths must be 2 whole numbers from 1 to 5, one for each episode
    """
    for obs, lengths in ((version.obs, np.asarray(version.lengths)) for version in versions):
        if obs.ndim != 3 or not obs.size or obs.dtype != np.float32:
            raise ValueError(f"{name}: obs must be float32 [episodes, steps, obs_dim], not {obs.dtype} {obs.shape}")
        n, steps, _ = obs.shape
        if lengths.shape != (n,) or lengths.dtype.kind not in "iu" or lengths.min() < 1 or lengths.max() > steps:
            raise ValueError(f"{name}: lengths must be {n} whole numbers from 1 to {steps}, one for each episode")
        if not np.isfinite([obs.min(), obs.max()]).all():
            raise ValueError(f"{name}: obs holds NaN or infinity; leave such episodes out")
        if obs.shape != versions[0].obs.shape or (lengths != versions[0].lengths).any():
            raise ValueError(
                f"{name}: inputs and targets must be versions of the same trajectories, of the same lengths"
            )


def check_pairs(pairs: Sequence[Pair]) -> None:
    """Refuse pairs of (input, target) that are empty or of different trajectories; a ValueError says which."""
    if not pairs:
        raise ValueError("pairs is empty: give at least [(normal, normal)]")
    for i, (inputs, targets) in enumerate(pairs):
        check_trajectories(f"pairs[{i}]", targets, inputs)
        if (shape := targets.obs.shape[1:]) != (first := pairs[0][1].obs.shape[1:]):
            raise ValueError(f"pairs[{i}]: its steps and observations are {shape}, and must be {first} as in pairs[0]")


def augment(normal: Trajectories, attack: Attack, batch: int = 2_048, seed: int = 0) -> Trajectories:
    """D_adv = {A_B(o) | o in D_normal}: every observation is attacked offline, without touching the environment.

    Args:
        normal: D_normal.
        attack: an attack that needs neither simulator nor defence.
        batch: observations attacked together.
        seed: of the attack's random starts.

    Raises:
        ValueError: if the attack needs an environment or is no attack, or the trajectories cannot be learned from.

    Example:
        >>> from detden_lite import Budget, UniformNoise
        >>> normal = Trajectories(np.zeros((4, 5, 3), np.float32), np.array([5, 5, 2, 3]))
        >>> adversarial = augment(normal, UniformNoise(Budget(0.1)))
        >>> adversarial.obs.shape, bool(np.abs(adversarial.obs).max() <= 0.1)
        ((4, 5, 3), True)
    """
    if isinstance(attack, type) or not (hasattr(attack, "needs") and callable(attack)):
        raise ValueError(f"attack: give an attack such as OppositeAttack(victim, budget), not {attack!r}")
    if online := attack.needs & {"simulator", "defense"}:
        raise ValueError(
            f"attack: {type(attack).__name__} needs the {' and the '.join(sorted(online))}: it is no offline attack"
        )
    check_whole(1, batch=batch)
    check_trajectories("normal", normal)
    mask = normal.mask
    flat = torch.from_numpy(normal.obs[mask])
    attack.reset([seed])
    parts = tqdm(flat.split(batch), desc="attacking offline", unit="batch")
    obs = np.zeros_like(normal.obs)
    obs[mask] = torch.cat([attack(part, World(np.ones(len(part), bool))) for part in parts]).numpy()
    return Trajectories(obs, normal.lengths)


def intermittent(
    normal: np.ndarray, adversarial: np.ndarray, least_share: float = 0.0, least_size: float = 1.0, seed: int = 0,
    run: int = 10,
) -> np.ndarray:  # fmt: skip
    """Mix normal and adversarial sequences: attacked now and then, and with less than the whole ball.

    Each sequence gets a random share of attacked steps, between ``least_share`` and 1. Its steps are cut into runs;
    each run is attacked with that share as probability, and its perturbation is shrunk by a random factor between
    ``least_size`` and 1. A perturbation that is shrunk towards o stays in B(o), in whatever norm, though it is not the
    strongest in the smaller ball.

    Args:
        normal: true observations ``[n, steps, obs_dim]``.
        adversarial: the same, attacked at every step.
        least_share: between 0 and 1; 1 attacks always.
        least_size: between 0 and 1, in units of the attack's own size; 1 leaves it.
        seed: of all random numbers.
        run: steps of a run; where the first one begins is random too.

    Returns:
        ``[n, steps, obs_dim]``; steps that are not attacked are equal to ``normal``.

    Raises:
        ValueError: for a share or a size beyond 0 and 1, a run of less than a step, or arrays of two shapes.

    Example:
        >>> normal = np.zeros((1, 6, 1), np.float32)
        >>> intermittent(normal, normal + 1, seed=1, run=2)[0, :, 0]
        array([0., 0., 1., 1., 0., 0.], dtype=float32)
    """
    check_between(0, 1, least_share=least_share, least_size=least_size)
    check_whole(1, run=run)
    if normal.ndim != 3 or normal.shape != adversarial.shape:
        raise ValueError(
            f"adversarial: its shape {adversarial.shape} must be that of normal, {normal.shape}, of 3 axes"
        )
    rng, (n, steps) = np.random.default_rng(seed), normal.shape[:2]
    runs = (np.arange(steps) + rng.integers(run, size=(n, 1))) // run
    table = (n, (steps - 1) // run + 2)
    attacked = rng.random(table) < rng.uniform(least_share, 1, (n, 1))
    size = np.where(attacked, rng.uniform(least_size, 1, table), 0).astype(np.float32)
    return normal + np.take_along_axis(size, runs, 1)[..., None] * (adversarial - normal)
