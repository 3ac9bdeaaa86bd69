"""The paper's five tasks with MuJoCo stepped directly, and observations, rewards and ends computed for all N at once.

They are gymnasium's to the last bit: the same operations in the same order, which a test asserts. To learn what a
simulator does, read ``Simulator``; this module has the same methods, and is faster.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from detden_lite.simulation.simulator import Robot, Simulator, make_robot


def make_simulator(env_id: str, seeds: Sequence[int], fast: bool = True) -> Simulator:
    """The faster simulator for the paper's five tasks, gymnasium's own loop for any other environment.

    Args:
        env_id: a gymnasium MuJoCo environment, such as "Hopper-v5".
        seeds: one seed an episode; N of them.
        fast: False for gymnasium's own loop everywhere, with the same numbers.

    Example:
        >>> [type(make_simulator("Hopper-v5", [0], fast)).__name__ for fast in (True, False)]
        ['Upright', 'Simulator']
        >>> type(make_simulator("Swimmer-v5", [0])).__name__
        'Simulator'
    """
    return (RULES.get(env_id, Simulator) if fast else Simulator)(env_id, seeds)


def healthy(env: Robot, state: np.ndarray) -> np.ndarray:
    """Whether a robot is in a healthy state; where it is not, its episode ends.

    Args:
        env: an unwrapped Hopper, Walker2d, HalfCheetah, Ant or Humanoid, which says what is healthy.
        state: qpos and qvel, ``[..., nq + nv]``.

    Returns:
        ``[...]`` bool.
    """
    name = env.spec.name
    if name == "HalfCheetah":
        return np.ones(state.shape[:-1], dtype=bool)
    upright = name in ("Hopper", "Walker2d")
    z = state[..., 1 if upright else 2]
    low, high = env._healthy_z_range
    if name == "Ant":
        return (low <= z) & (z <= high) & np.isfinite(state).all(-1)
    well = (low < z) & (z < high)
    if upright:
        low, high = env._healthy_angle_range
        well &= (low < state[..., 2]) & (state[..., 2] < high)
    if name == "Hopper":
        low, high = env._healthy_state_range
        well &= ((low < state[..., 2:]) & (state[..., 2:] < high)).all(-1)
    return well


def _twin(env: Robot) -> Robot:
    """The same environment with a world of its own. (copy.copy would compile its model again.)"""
    twin = object.__new__(type(env))
    vars(twin).update(vars(env), data=mujoco.MjData(env.model), mujoco_renderer=None)
    return twin


class FastSimulator(Simulator):
    """N worlds that share one model; see ``Simulator``. This class is HalfCheetah's, the others derive from it.

    The ``envs`` are gymnasium's environments, each with its own world, except that they cannot render. Contact
    forces (``cfrc_ext``, with ``cfrc_int`` and ``cacc``) are computed only for the tasks that show them. Positions
    and velocities are read once a step: a change made to a world from outside shows after the next step.

    Example:
        >>> fast, plain = FastSimulator("HalfCheetah-v5", [0]), Simulator("HalfCheetah-v5", [0])
        >>> bool((fast.reset() == plain.reset()).all())
        True
    """

    def _make(self, env_id: str, n: int) -> list[Robot]:
        self.env = make_robot(env_id)
        envs = [_twin(self.env) for _ in range(n)]
        self.worlds = [(env.data, env.data.ctrl) for env in envs]
        self.moving = [part for env in envs for part in (env.data.qpos, env.data.qvel)]
        # The observations beside the state: MuJoCo's arrays in order, some of them without their first numbers.
        sizes = self.env.observation_structure
        others = [name for name in sizes if sizes[name] and name not in ("skipped_qpos", "qpos", "qvel")]
        self.seen = [getattr(env.data, name).reshape(-1)[-sizes[name] :] for env in envs for name in others]
        self.forces = [env.data.cfrc_ext.reshape(-1) for env in envs] if "cfrc_ext" in others else []
        return envs

    def reset(self) -> np.ndarray:
        """See ``Simulator.reset``."""
        obs = super().reset()
        self.now = self._rows(self.moving)
        return obs

    def restart(self, i: int, seed: int) -> np.ndarray:
        """See ``Simulator.restart``."""
        obs = super().restart(i, seed)
        self.now = self._rows(self.moving)
        return obs

    def step(self, action: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See ``Simulator.step``.

        Raises:
            ValueError: if the actions are not ``[N, action_dim]``.
        """
        model, frame_skip = self.env.model, self.env.frame_skip
        action = np.ascontiguousarray(action)  # or its squares would be added in another order
        if action.shape != (len(self.envs), model.nu):
            raise ValueError(f"action has shape {action.shape}: give one row of {model.nu} to each of {len(self.envs)}")
        before = self._place()
        for (data, control), row, alive in zip(self.worlds, action, self.alive.tolist(), strict=True):
            if alive:
                control[:] = row
                mujoco.mj_step(model, data, frame_skip)
                if self.forces:
                    mujoco.mj_rnePostConstraint(model, data)  # mj_step alone leaves them out
        self.now = self._rows(self.moving)
        well = healthy(self.env, self.now)
        forward = self.env._forward_reward_weight * ((self._place() - before) / self.env.dt)
        reward = forward + well * getattr(self.env, "_healthy_reward", 0.0) - self._costs(action)
        reward[~self.alive] = 0
        self.alive &= well
        self.obs = self._observe()
        return self.obs.astype(np.float32), reward, ~self.alive

    def state(self) -> np.ndarray:
        """See ``Simulator.state``."""
        return self.now.copy()

    def _rows(self, parts: list[np.ndarray]) -> np.ndarray:
        """Flat arrays of the first world, then of the second, ..., as ``[N, ...]``."""
        return np.concatenate(parts).reshape(len(self.envs), -1)

    def _observe(self) -> np.ndarray:
        """Observations ``[N, obs_dim]``."""
        shown = self.now[:, self.env.observation_structure["skipped_qpos"] :]
        return np.concatenate([shown, self._rows(self.seen)], axis=1) if self.seen else shown.copy()

    def _place(self) -> np.ndarray:
        """How far forward each robot is, ``[N]``, in metres."""
        return self.now[:, 0]

    def _costs(self, action: np.ndarray) -> np.ndarray:
        """The costs, subtracted from the rewards, ``[N]``."""
        return self.env._ctrl_cost_weight * np.square(action).sum(-1)


class Upright(FastSimulator):
    """Hopper and Walker2d, whose velocities are shown up to 10."""

    def _observe(self) -> np.ndarray:
        obs = super()._observe()
        velocity = obs[:, -self.env.model.nv :]
        np.clip(velocity, -10, 10, out=velocity)
        return obs


class Ant(FastSimulator):
    """Ant, whose contact forces are clipped, in what it sees and in what they cost."""

    def _make(self, env_id: str, n: int) -> list[Robot]:
        envs = super()._make(env_id, n)
        body = self.env.model.body(self.env._main_body).id
        self.bodies = [env.data.xpos[body] for env in envs]
        return envs

    def _observe(self) -> np.ndarray:
        obs = super()._observe()
        forces = obs[:, -self.env.observation_structure["cfrc_ext"] :]
        np.clip(forces, *self.env._contact_force_range, out=forces)
        return obs

    def _place(self) -> np.ndarray:
        return self._rows(self.bodies)[:, 0]

    def _costs(self, action: np.ndarray) -> np.ndarray:
        forces = self._rows(self.forces).clip(*self.env._contact_force_range)
        return super()._costs(action) + self.env._contact_cost_weight * np.square(forces).sum(-1)


class Humanoid(FastSimulator):
    """Humanoid, whose centre of mass is to go forward and whose contact cost is clipped."""

    def _make(self, env_id: str, n: int) -> list[Robot]:
        envs = super()._make(env_id, n)
        self.bodies = [env.data.xipos.reshape(-1) for env in envs]
        return envs

    def _place(self) -> np.ndarray:
        mass, bodies = self.env.model.body_mass, self._rows(self.bodies).reshape(len(self.envs), -1, 3)
        return (mass[:, None] * bodies).sum(1)[:, 0] / mass.sum()

    def _costs(self, action: np.ndarray) -> np.ndarray:
        contact = self.env._contact_cost_weight * np.square(self._rows(self.forces)).sum(-1)
        return super()._costs(action.astype(float)) + contact.clip(*self.env._contact_cost_range)


RULES = {
    "Hopper-v5": Upright,
    "Walker2d-v5": Upright,
    "HalfCheetah-v5": FastSimulator,
    "Ant-v5": Ant,
    "Humanoid-v5": Humanoid,
}
