"""A robot as it is drawn: its capsules, and how they lie at each moment."""

from dataclasses import dataclass

import mujoco
import numpy as np

from detden_lite.core.tasks import Task
from detden_lite.simulation.simulator import make


@dataclass(frozen=True)
class Robot:
    """The body of a task. In all five it is made of capsules, and of spheres, which are capsules of length zero."""

    model: mujoco.MjModel
    dt: float  # seconds from one action to the next
    geoms: np.ndarray  # which of the model's geoms are the robot and not the floor, [G]
    names: tuple[str, ...]  # what each observation measures, obs_dim of them
    hidden: int  # how many of the first positions are not observed: where on the floor the robot is

    @classmethod
    def of(cls, task: Task) -> "Robot":
        """The robot of a task, from gymnasium's own model of it."""
        env = make(task.env_id).unwrapped
        names, hidden = (
            _observation_names(env.model, env.observation_structure),
            env.observation_structure["skipped_qpos"],
        )
        env.close()
        return cls(env.model, float(env.dt), np.flatnonzero(env.model.geom_bodyid > 0), names, hidden)

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
        """Length, width and height of the robot as the model has it before it moves, metres, ``[3]``."""
        data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, data)
        reach = (self.lengths / 2 + self.radii)[:, None] * np.abs(data.geom_xmat[self.geoms].reshape(-1, 3, 3)[..., 2])
        centres = data.geom_xpos[self.geoms]
        return (centres + reach).max(0) - (centres - reach).min(0)

    def imagined(self, positions: np.ndarray, obs: np.ndarray) -> np.ndarray:
        """Positions ``[T, nq]`` of the robot that observations ``[T, obs_dim]`` describe, put where the true one is."""
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
