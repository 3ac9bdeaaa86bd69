"""N worlds of one task, stepped together: gymnasium's own environments, without their wrappers."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np

Robot = Any  # an unwrapped MujocoEnv; what it says of its rewards and limits is its task's own, and has no type


def make(env_id: str) -> gymnasium.Env:
    """gymnasium.make, without what MuJoCo prints, and writes to a file, about HalfCheetah's model each time."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        return gymnasium.make(env_id)
    finally:
        mujoco.set_mju_user_warning(before)


def make_robot(env_id: str) -> Robot:
    """The environment without its wrappers: that saves the time of the checks, and a time limit is the caller's."""
    return make(env_id).unwrapped


class Simulator:
    """N gymnasium MuJoCo environments in lockstep: the version to read.

    ``make_simulator`` gives a faster one for the paper's tasks, which is the same to the last bit.

    Args:
        env_id: a gymnasium MuJoCo environment, such as "Hopper-v5".
        seeds: one seed an episode; N of them.

    Raises:
        ValueError: if there are no seeds.

    Example:
        >>> simulator = Simulator("Hopper-v5", [0, 1])
        >>> obs = simulator.reset()
        >>> obs, reward, ended = simulator.step(np.zeros((2, 3)))
        >>> obs.shape, reward.shape, ended
        ((2, 11), (2,), array([False, False]))
    """

    def __init__(self, env_id: str, seeds: Sequence[int]) -> None:
        if not len(seeds):
            raise ValueError("seeds is empty: give one seed for each episode")
        self.envs = self._make(env_id, len(seeds))
        self.seeds = [int(seed) for seed in seeds]
        self.alive = np.ones(len(seeds), dtype=bool)

    def _make(self, env_id: str, n: int) -> list[Robot]:
        return [make_robot(env_id) for _ in range(n)]

    def reset(self) -> np.ndarray:
        """Start every episode from its seed. Returns observations ``[N, obs_dim]`` float32."""
        self.alive[:] = True
        self.obs = np.stack([env.reset(seed=seed)[0] for env, seed in zip(self.envs, self.seeds, strict=True)])
        return self.obs.astype(np.float32)

    def restart(self, i: int, seed: int) -> np.ndarray:
        """Start a new episode in one world; the others stay as they are. Returns its observation ``[obs_dim]``."""
        self.seeds[i], self.alive[i] = int(seed), True
        self.obs[i] = self.envs[i].reset(seed=int(seed))[0]
        return self.obs[i].astype(np.float32)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One control step of every living world; a world whose episode has ended stays as it is.

        Args:
            action: ``[N, action_dim]``, in the environment's units.

        Returns:
            Observations ``[N, obs_dim]`` float32, rewards ``[N]`` (0 in an ended world), and terminated ``[N]`` bool.
        """
        reward = np.zeros(len(self.envs))
        for i in np.flatnonzero(self.alive):
            self.obs[i], reward[i], terminated, _, _ = self.envs[i].step(action[i])
            self.alive[i] = not terminated
        return self.obs.astype(np.float32), reward, ~self.alive

    def state(self) -> np.ndarray:
        """qpos and qvel of every world, ``[N, nq + nv]``."""
        return np.stack([np.concatenate([env.data.qpos, env.data.qvel]) for env in self.envs])
