"""A cross-entropy planner with the true simulator: open-loop action sequences that minimise a task's return."""

from collections.abc import Sequence
from math import inf

import mujoco
import mujoco.rollout
import numpy as np

from detden_lite.core.arguments import check_between, check_whole
from detden_lite.core.random_streams import RandomStreams
from detden_lite.simulation.fast_simulator import healthy
from detden_lite.simulation.simulator import Robot, make_robot

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS


class OpenLoop:
    """Many action sequences of one task at once, with the task's own rewards in arrays.

    The rewards are gymnasium's, with two differences for Ant and Humanoid, where ``mujoco.rollout`` does not return
    what gymnasium reads: the contact cost (below 0.04 a step) is left out, and the way forward is that between the
    ends of steps, where gymnasium's is between the last stages of the integrator's last small steps.

    Args:
        env_id: a gymnasium MuJoCo environment: Hopper, Walker2d, HalfCheetah, Ant or Humanoid.
        threads: simulate in this many threads.

    Raises:
        ValueError: for another environment, or no threads.

    Example:
        >>> worlds = OpenLoop("Hopper-v5")
        >>> _ = worlds.env.reset(seed=0)
        >>> state, warmstart, x = (np.array([part]) for part in worlds.start(worlds.env))
        >>> worlds.rewards(state, warmstart, x, np.zeros((1, 5, 3))).shape
        (1, 5)
    """

    def __init__(self, env_id: str, threads: int = 1) -> None:
        check_whole(1, threads=threads)
        self.name = env_id.split("-")[0]
        if self.name not in ("Hopper", "Walker2d", "HalfCheetah", "Ant", "Humanoid"):
            raise ValueError(f"env_id: the planner does not know the reward of {env_id}")
        self.env = make_robot(env_id)
        self.model = self.env.model
        if self.name == "Humanoid":  # its reward follows the centre of mass, which is no part of the state
            spec = mujoco.MjSpec.from_file(self.env.fullpath)
            spec.add_sensor(
                type=mujoco.mjtSensor.mjSENS_SUBTREECOM, objtype=mujoco.mjtObj.mjOBJ_BODY, objname="torso", name="com"
            )
            self.model = spec.compile()
        self.data = [mujoco.MjData(self.model) for _ in range(threads)]
        self.pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)

    def start(self, env: Robot) -> tuple[np.ndarray, np.ndarray, float]:
        """The full state, the solver's warm start and the forward position of an environment as it is now."""
        state = np.empty(mujoco.mj_stateSize(env.model, STATE))
        mujoco.mj_getState(env.model, env.data, state, STATE)
        x = env.data.qpos[0]
        if self.name == "Humanoid":
            mujoco.mj_setState(self.model, self.data[0], state, STATE)
            mujoco.mj_kinematics(self.model, self.data[0])
            x = self.model.body_mass @ self.data[0].xipos[:, 0] / self.model.body_mass.sum()
        return state, env.data.qacc_warmstart.copy(), float(x)

    def rewards(self, states: np.ndarray, warmstarts: np.ndarray, x: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Rewards ``[B, H]`` of B action sequences ``[B, H, action_dim]``; 0 after the step that ends an episode.

        ``states``, ``warmstarts`` and ``x`` have B rows from ``start``.
        """
        skip = self.env.frame_skip
        controls = np.repeat(actions, skip, axis=1)
        if self.name == "Humanoid":  # sensors show the beginning of a small step: one more shows the end of the last
            controls = np.concatenate([controls, controls[:, -1:]], axis=1)
        trajectory, sensors = self.pool.rollout(self.model, self.data, states, controls, initial_warmstart=warmstarts)
        last = trajectory[:, skip - 1 :: skip, 1:][:, : actions.shape[1]]  # without the time
        after = sensors[:, skip::skip, 0] if self.name == "Humanoid" else last[:, :, 0]
        before = np.concatenate([x[:, None], after[:, :-1]], axis=1)
        well = healthy(self.env, last)
        reward = self.env._forward_reward_weight * (after - before) / self.env.dt
        reward -= self.env._ctrl_cost_weight * np.square(actions).sum(-1)
        if self.name != "HalfCheetah":
            reward += self.env._healthy_reward * well
        alive = np.ones_like(well)
        alive[:, 1:] = np.logical_and.accumulate(well, axis=1)[:, :-1]
        return reward * alive


class CEMPlanner:
    """The cross-entropy method (Kobilarov, 2012) over open-loop action sequences, minimising the return.

    Args:
        env_id: see ``OpenLoop``.
        horizon: steps of a plan.
        population: action sequences tried in each iteration.
        iterations: how often the distribution is fitted to the elites.
        elites: how many of the population are elites.
        floor: the least standard deviation, in units of the action range.
        threads: simulate in this many threads.
        seed: of the samples.

    Raises:
        ValueError: names the argument that is wrong.

    Example:
        >>> planner = CEMPlanner("Hopper-v5", horizon=3, population=8, elites=2)
        >>> planner.reset([0])
        >>> env = planner.worlds.env
        >>> _ = env.reset(seed=0)
        >>> planner.plan([env], np.array([True])).shape
        (1, 3)
    """

    def __init__(
        self, env_id: str, horizon: int = 15, population: int = 64, iterations: int = 4, elites: int = 8,
        floor: float = 0.01, threads: int = 1, seed: int = 0,
    ) -> None:  # fmt: skip
        check_whole(1, horizon=horizon, population=population, iterations=iterations, elites=elites)
        check_whole(0, seed=seed)
        check_between(0, inf, floor=floor)
        if elites > population:
            raise ValueError(f"elites must be at most the population of {population}, not {elites}")
        self.horizon, self.population, self.iterations, self.elites = horizon, population, iterations, elites
        self.floor = floor
        self.worlds, self.seed = OpenLoop(env_id, threads), seed
        space = self.worlds.env.action_space
        self.low, self.high = space.low.astype(float), space.high.astype(float)

    def reset(self, episodes: Sequence[int]) -> None:
        """Begin new episodes, one seed each."""
        self.streams = RandomStreams(self.seed, episodes)
        middle = (self.low + self.high) / 2
        self.mean = np.tile(middle, (len(episodes), self.horizon, 1))

    def plan(self, envs: Sequence[Robot], wanted: np.ndarray) -> np.ndarray:
        """The best first actions ``[N, action_dim]``; rows that are not ``wanted`` keep what was planned before.

        Args:
            envs: N unwrapped environments, in the order of the episodes; they are only read.
            wanted: for which of them to plan, ``[N]`` bool.
        """
        n, rows = len(envs), np.flatnonzero(wanted).tolist()
        dim = self.population * self.mean[0].size
        # Every episode uses random numbers at every step, so that its samples do not depend on when it is attacked.
        noise = [self.streams.normal(n, dim).numpy()[rows].astype(float) for _ in range(self.iterations)]
        if len(rows):
            self.mean[rows] = self._improve(self.mean[rows], [envs[i] for i in rows], noise)
        first = self.mean[:, 0].copy()
        # The next step begins where this one ends.
        self.mean = np.concatenate([self.mean[:, 1:], self.mean[:, -1:]], axis=1)
        return first

    def _improve(self, mean: np.ndarray, envs: list[Robot], noise: list[np.ndarray]) -> np.ndarray:
        n, p = len(envs), self.population
        starts = [self.worlds.start(env) for env in envs]
        states, warmstarts, x = (np.repeat(np.array(part), p, axis=0) for part in zip(*starts, strict=True))
        std = np.broadcast_to((self.high - self.low) / 2, mean.shape)
        best, least = mean, np.full(n, np.inf)
        for step in noise:
            actions = mean[:, None] + std[:, None] * step.reshape(n, p, *mean.shape[1:])
            actions = actions.clip(self.low, self.high)
            actions[:, 0] = best  # so that the best one so far is never lost
            rewards = self.worlds.rewards(states, warmstarts, x, actions.reshape(n * p, *mean.shape[1:]))
            returns = rewards.reshape(n, p, -1).sum(-1)
            order = returns.argsort(axis=1)
            elite = np.take_along_axis(actions, order[:, : self.elites, None, None], axis=1)
            mean, std = elite.mean(1), elite.std(1) + self.floor * (self.high - self.low)
            better = returns.min(1) < least
            best = np.where(better[:, None, None], elite[:, 0], best)
            least = np.minimum(least, returns.min(1))
        self.least = least
        return best
