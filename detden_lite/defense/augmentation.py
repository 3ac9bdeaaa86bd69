"""Normal trajectories, and the attacked ones made from them offline (sections 2.4 and 3.1.2)."""

import numpy as np
import torch
from tqdm import tqdm

from detden_lite.core.types import Trajectories


def augment(normal: Trajectories, attack, batch: int = 2_048, seed: int = 0) -> Trajectories:
    """D_adv = {A_B(o) | o in D_normal}: every observation attacked offline, without touching the environment.

    Args:
        normal: D_normal.
        attack: an attack that needs neither simulator nor defence.
        batch: observations attacked together.
        seed: of the attack's random starts.

    Raises:
        ValueError: if the attack needs an environment.
    """
    online = attack.needs & {"simulator", "defense"}
    if online:
        needs = " and ".join(sorted(online))
        raise ValueError(f"attack: {type(attack).__name__} needs the {needs}: it is no offline attack")
    mask = normal.mask
    flat = torch.from_numpy(normal.obs[mask])
    attack.reset([seed])
    parts = [attack(part) for part in tqdm(flat.split(batch), desc="attacking offline", unit="batch")]
    obs = np.zeros_like(normal.obs)
    obs[mask] = torch.cat(parts).numpy()
    return Trajectories(obs, normal.lengths)


def intermittent(
    normal: np.ndarray,
    adversarial: np.ndarray,
    least_share: float = 0.0,
    least_size: float = 1.0,
    seed: int = 0,
    run: int = 10,
) -> np.ndarray:
    """Sequences that are attacked now and then, and with less than the whole ball, out of ones attacked at every step.

    Each sequence draws the share of its steps that are attacked, between ``least_share`` and 1. Its steps are cut into
    runs; each run is attacked with the share's probability, and the perturbation shrunk by a factor between
    ``least_size`` and 1. What is shrunk towards o stays in B(o), in whatever norm, though it is not the attack's best
    in the smaller ball.

    Args:
        normal: true observations ``[n, steps, obs_dim]``.
        adversarial: the same, attacked.
        least_share: between 0 and 1; 1 attacks always.
        least_size: between 0 and 1, in units of the attack's own size; 1 leaves it.
        seed: of all that is drawn.
        run: steps of a run; where the first one begins is drawn too.

    Returns:
        ``[n, steps, obs_dim]``; what is not attacked is equal to ``normal``.

    Raises:
        ValueError: for a share or a size beyond 0 and 1, or a run of less than a step.
    """
    if not (0 <= least_share <= 1 and 0 <= least_size <= 1):
        raise ValueError(f"least_share and least_size must be between 0 and 1, not {least_share} and {least_size}")
    if run < 1:
        raise ValueError(f"run must be at least 1, not {run}")
    rng, (n, steps) = np.random.default_rng(seed), normal.shape[:2]
    runs = (np.arange(steps) + rng.integers(run, size=(n, 1))) // run
    drawn = (n, (steps - 1) // run + 2)
    attacked = rng.random(drawn) < rng.uniform(least_share, 1, (n, 1))
    size = np.where(attacked, rng.uniform(least_size, 1, drawn), 0).astype(np.float32)
    return normal + np.take_along_axis(size, runs, 1)[..., None] * (adversarial - normal)
