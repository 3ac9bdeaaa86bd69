"""A robot as it is drawn: its capsules, and their poses."""

from dataclasses import dataclass

import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv

from detden_lite.core.tasks import Task
from detden_lite.simulation.simulator import make


@dataclass(frozen=True)
class Robot:
    """The body of a task. In the paper's tasks it is made of capsules, and of spheres: capsules of length zero.

    Args:
        model: MuJoCo's.
        dt: seconds from one action to the next.
        geoms: the model's geoms that are the robot and not the floor, ``[G]``.
        names: of the observations, obs_dim of them.
        hidden: the number of first positions that are not observed: the robot's place on the floor.

    Example:
        >>> from detden_lite import Robot, get_task
        >>> robot = Robot.of(get_task("hopper"))
        >>> robot.names[:3], robot.dt
        (('z', 'pitch', 'thigh'), 0.008)
    """

    model: mujoco.MjModel
    dt: float
    geoms: np.ndarray
    names: tuple[str, ...]
    hidden: int

    @classmethod
    def of(cls, task: Task) -> "Robot":
        """The robot of a task, from gymnasium's own model of it.

        Raises:
            ValueError: if the task's environment has no MuJoCo model.
        """
        env = make(task.env_id).unwrapped
        if not isinstance(env, MujocoEnv):
            raise ValueError(f"task: {task.env_id} is not derived from gymnasium's MujocoEnv, and has no body to draw")
        structure: dict[str, int] = vars(env)["observation_structure"]
        env.close()
        names, geoms = _observation_names(env.model, structure), np.flatnonzero(env.model.geom_bodyid > 0)
        return cls(env.model, float(env.dt), geoms, names, structure["skipped_qpos"])

    @property
    def radii(self) -> np.ndarray:
        """Radius of every capsule in metres, ``[G]``."""
        return self.model.geom_size[self.geoms, 0]

    @property
    def lengths(self) -> np.ndarray:
        """Length of every capsule without its two caps in metres, ``[G]``."""
        capsule = self.model.geom_type[self.geoms] == mujoco.mjtGeom.mjGEOM_CAPSULE
        return np.where(capsule, 2 * self.model.geom_size[self.geoms, 1], 0.0)

    def poses(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forward kinematics of generalised positions ``[T, nq]``.

        Returns:
            One end of every capsule's axis in metres, ``[T, G, 3]``, and the quaternion (x, y, z, w) that turns z into
            the direction of the other end, ``[T, G, 4]``.
        """
        data = mujoco.MjData(self.model)
        ends = np.empty((len(positions), len(self.geoms), 3))
        turns = np.empty((len(positions), len(self.geoms), 4))
        for t, position in enumerate(positions):
            data.qpos[:] = position
            mujoco.mj_kinematics(self.model, data)
            for g, geom in enumerate(self.geoms):
                mujoco.mju_mat2Quat(turns[t, g], data.geom_xmat[geom])
            axes = data.geom_xmat[self.geoms].reshape(-1, 3, 3)[..., 2]
            ends[t] = data.geom_xpos[self.geoms] - axes * self.lengths[:, None] / 2
        return ends, np.roll(turns, -1, axis=-1)

    @property
    def extent(self) -> np.ndarray:
        """Length, width and height of the robot in the model's initial pose, metres, ``[3]``."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        reach = (self.lengths / 2 + self.radii)[:, None] * np.abs(data.geom_xmat[self.geoms].reshape(-1, 3, 3)[..., 2])
        centres = data.geom_xpos[self.geoms]
        return (centres + reach).max(0) - (centres - reach).min(0)

    def imagined(self, positions: np.ndarray, obs: np.ndarray) -> np.ndarray:
        """The pose that observations describe, at the true robot's place on the floor.

        Args:
            positions: of the true robot, ``[T, nq]``.
            obs: ``[T, obs_dim]``.

        Returns:
            Generalised positions ``[T, nq]``.
        """
        described = self.model.nq - self.hidden
        return np.concatenate([positions[:, : self.hidden], obs[:, :described]], axis=1)


def _observation_names(model: mujoco.MjModel, structure: dict[str, int]) -> tuple[str, ...]:
    positions, velocities = [], []
    for i in range(model.njnt):
        joint = model.joint(i)
        if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE:
            positions += ["x", "y", "z", "turn_w", "turn_x", "turn_y", "turn_z"]
            velocities += ["x", "y", "z", "turn_x", "turn_y", "turn_z"]
        else:
            name = {"rootx": "x", "rootz": "z", "rooty": "pitch"}.get(joint.name, joint.name.removesuffix("_joint"))
            positions.append(name)
            velocities.append(name)
    names = positions[structure["skipped_qpos"] :] + [f"velocity_{name}" for name in velocities]
    rest = [key for key in structure if key not in ("skipped_qpos", "qpos", "qvel")]
    return tuple(names + [f"{key}_{i}" for key in rest for i in range(structure[key])])
