"""D_normal: clean episodes, with exploration noise on the actions (section 2.4)."""

from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from detden_lite.core.tasks import Task
from detden_lite.core.types import Trajectories
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim


def collect_normal(
    victim: Victim,
    task: Task,
    seeds: Sequence[int],
    action_noise: Sequence[float] = (0.0, 0.1, 0.2, 0.3),
    lockstep: int = 128,
    steps: int | None = None,
) -> Trajectories:
    """D_normal: one clean episode for each seed.

    Args:
        victim: the policy.
        task: where it acts.
        seeds: one an episode.
        action_noise: exploration, in units of half the action range; the episodes take turns. (0.0,) is the paper's. A
            very regular policy shows its defence only one gait; harmless noise shows what lies beside it.
        lockstep: how many episodes run together.
        steps: the longest an episode may be; the task's horizon by default.
    """
    steps = steps or task.horizon
    noise = np.resize(np.asarray(action_noise, dtype=np.float32), len(seeds))
    obs = np.zeros((len(seeds), steps, task.obs_dim), np.float32)
    lengths = np.zeros(len(seeds), np.int64)
    for start in tqdm(range(0, len(seeds), lockstep), desc=f"normal trajectories of {task.name}", unit="batch"):
        part = slice(start, start + lockstep)
        episodes = rollout(victim, task, seeds[part], action_noise=noise[part], steps=steps)
        seen = np.where(episodes.mask[..., None], episodes.obs, 0)
        obs[part, : len(seen)] = seen.swapaxes(0, 1)
        lengths[part] = episodes.lengths
    return Trajectories(obs, lengths)
