"""A rerun recording of episodes side by side: every signal over time, and the robots in 3D.

Each take (clean, attacked, defended) has its own branch of entities:

    NAME/camera              moves along with the robot; the 3D views look from there
    NAME/floor               a line each metre
    NAME/robot               capsules; grey once the episode has ended before its time
    NAME/ghost               the robot as the perturbed observations describe it, while attacked
    NAME/observation         of each dimension true, perturbed, denoised
    NAME/reward              of the step, and summed up so far
    NAME/score               the detector's score and its threshold
    NAME/attacked, alarm     on or off
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from detden_lite.core.files import replacing
from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.looking.recording_content import log_scene, log_signals
from detden_lite.looking.recording_layout import blueprint
from detden_lite.looking.robot import Robot
from detden_lite.looking.takes import Take, takes


def record(
    path: str | Path,
    task: Task,
    nominal: Episodes,
    attacked: Episodes,
    defended: Episodes,
    index: int = 0,
    *,
    threshold: float | None = None,
    dims: Sequence[int] | None = None,
    frame_rate: float = 25.0,
) -> Path:
    """Write a recording of three episodes, to be opened in the book or with ``rerun PATH``.

    Args:
        path: the .rrd file to write.
        task: what the episodes are of.
        nominal: episodes without an attack.
        attacked: episodes with the attack and without a defence.
        defended: episodes with both.
        index: which episode of each.
        threshold: the detector's C_anomaly, drawn beside its score.
        dims: the observations to store; all by default. Ant and Humanoid have so many that a choice is wise.
        frame_rate: poses stored for each second of the simulation; signals are stored at every step.

    Returns:
        The path. The same episodes give a recording with the same id and content.

    Raises:
        ValueError: if the path, the index, the dims or the frame rate are impossible, or if the episodes are of another
            task.

    Example:
        >>> import tempfile
        >>> from detden_lite import get_task, load_victim, record, rollout
        >>> task = get_task("hopper")
        >>> clean = rollout(load_victim("hopper", "td3"), task, [0], steps=5)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     record(f"{folder}/clean.rrd", task, clean, clean, clean).name
        'clean.rrd'
    """
    path = Path(path)
    if path.suffix != ".rrd":
        raise ValueError(f"path: a recording's name ends in .rrd, not {path.name!r}")
    if not frame_rate > 0:
        raise ValueError(f"frame_rate: {frame_rate} must be positive")
    robot = Robot.of(task)
    dims = list(range(len(robot.names)) if dims is None else dims)
    if not len(dims) or not all(0 <= dim < len(robot.names) for dim in dims):
        raise ValueError(f"dims: {dims} must be some of 0 to {len(robot.names) - 1}")
    shots = takes(robot, {"clean": nominal, "attacked": attacked, "defended": defended}, index)

    stream = rr.RecordingStream(f"detden_lite_{task.name}", recording_id=_identity(task, shots), send_properties=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        stream.save(temporary, default_blueprint=blueprint(robot, shots, dims))
        for shot in shots:
            log_signals(stream, robot, shot, dims, threshold)
            log_scene(stream, robot, shot, frame_rate)
        stream.disconnect()
    return path


def _identity(task: Task, shots: Sequence[Take]) -> str:
    digest = hashlib.sha256(task.name.encode())
    for shot in shots:
        for array in (shot.positions, shot.obs, shot.perturbed, shot.denoised, shot.score):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]
