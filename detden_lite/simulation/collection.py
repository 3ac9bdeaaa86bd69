"""D_normal: clean episodes, with exploration noise on the actions (section 2.4)."""

from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from detden_lite.core.arguments import check_whole
from detden_lite.core.tasks import Task
from detden_lite.core.types import Trajectories
from detden_lite.simulation import guests
from detden_lite.simulation.rollout import rollout
from detden_lite.victims.victim import Victim


def collect_normal(
    victim: Victim,
    task: Task,
    seeds: Sequence[int],
    action_noise: Sequence[float] = (0.0, 0.1, 0.2, 0.3),
    lockstep: int = 128,
    noise_memory: Sequence[float] = (0.0,),
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
        noise_memory: for how many steps the exploration is correlated; the episodes take turns with these, too, each
            memory with every noise. See ``rollout``.
        steps: the longest an episode may be; the task's horizon by default.

    Raises:
        ValueError: names the argument that is wrong.

    Returns:
        Observations and actions.

    Example:
        >>> from detden_lite import get_task, load_victim
        >>> collect_normal(load_victim("hopper", "td3"), get_task("hopper"), range(3), steps=5).obs.shape
        (3, 5, 11)
    """
    guests.check_seeds(seeds)
    guests.check_horizon(steps)
    check_whole(1, lockstep=lockstep)
    if not len(action_noise):
        raise ValueError("action_noise is empty: give the noise of at least one episode, such as (0.0,)")
    if not len(noise_memory):
        raise ValueError("noise_memory is empty: give that of at least one episode, such as (0.0,)")
    n = len(seeds)
    noise = guests.check_noise(np.resize(np.asarray(action_noise, dtype=np.float32), n), n, 1)
    turns = np.repeat(np.asarray(noise_memory, dtype=np.float32), len(action_noise))
    memory = guests.check_noise(np.resize(turns, n), n, 1, "noise_memory")
    steps = steps or task.horizon
    obs, action = (np.zeros((n, steps, size), np.float32) for size in (task.obs_dim, task.action_dim))
    lengths = np.zeros(n, np.int64)
    for start in tqdm(range(0, n, lockstep), desc=f"normal trajectories of {task.name}", unit="batch"):
        part = slice(start, start + lockstep)
        episodes = rollout(victim, task, seeds[part], action_noise=noise[part], noise_memory=memory[part], steps=steps)
        for kept, found in ((obs, episodes.obs), (action, episodes.action)):
            kept[part, : len(found)] = np.where(episodes.mask[..., None], found, 0).swapaxes(0, 1)
        lengths[part] = episodes.lengths
    return Trajectories(obs, lengths, action)
