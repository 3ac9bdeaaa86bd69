"""Films and stills of episodes side by side, rendered by MuJoCo.

Rendering needs a GL driver; importing this module does not. Without a display set MUJOCO_GL=egl (or osmesa) before
Python starts.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import imageio_ffmpeg
from PIL import Image

from detden_lite.core.files import replacing
from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.looking.renderer import CAPTION, Renderer, beside
from detden_lite.looking.robot import Robot
from detden_lite.looking.takes import takes


def film(
    path: str | Path,
    task: Task,
    episodes: Mapping[str, Episodes],
    index: int = 0,
    *,
    seconds: float = 10.0,
    fps: int = 25,
    speed: float = 1.0,
    width: int = 300,
    quality: int = 27,
) -> Path:
    """Write an H.264 film of one episode of each kind, side by side.

    Args:
        path: the .mp4 file to write.
        task: what the episodes are of.
        episodes: kinds of episodes by name, such as "clean", "attacked", "defended"; the names become captions.
        index: which episode of each.
        seconds: the longest that the film may be; it ends when its last episode ends.
        fps: frames a second.
        speed: 1 for the speed of the simulation, 0.5 for half of it.
        width: of one robot's square picture, pixels; even.
        quality: x264's constant rate factor, lower is better and larger.

    Returns:
        The path.

    Raises:
        ValueError: if an argument is impossible or the episodes are of another task.
        RuntimeError: if no GL driver is found.

    Example:
        It needs a GL driver::

            from detden_lite import films, get_task, load_victim, rollout

            task = get_task("hopper")
            clean = rollout(load_victim("hopper", "td3"), task, [0])
            films.film("hopper.mp4", task, dict(clean=clean))
    """
    path = _checked(path, ".mp4", width)
    if not (seconds > 0 and fps > 0 and speed > 0):
        raise ValueError(f"seconds, fps and speed: {seconds}, {fps} and {speed} must be positive")
    robot = Robot.of(task)
    shots = takes(robot, episodes, index)
    longest = max(len(shot.positions) for shot in shots) * robot.dt / speed
    frames = max(1, round(min(seconds, longest) * fps))
    size = (width * len(shots), width + CAPTION)
    # Faststart puts the index first, so that a browser can begin before it has everything.
    options = ["-crf", str(quality), "-preset", "veryslow", "-movflags", "+faststart", "-fflags", "+bitexact"]
    with Renderer(robot, width) as renderer, replacing(path) as temporary:
        writer = imageio_ffmpeg.write_frames(
            temporary, size, fps=fps, codec="libx264", quality=None, macro_block_size=2, output_params=options
        )
        writer.send(None)
        for frame in range(frames):
            writer.send(renderer.row(shots, round(frame / fps * speed / robot.dt)).tobytes())
        writer.close()
    return path


def still(
    path: str | Path, task: Task, episodes: Mapping[str, Episodes], index: int = 0, *, seconds: float, width: int = 300
) -> Path:
    """Write a .png of the frame that ``film`` of the same episodes has at a time in seconds.

    Raises:
        ValueError: if an argument is impossible or the episodes are of another task.
        RuntimeError: if no GL driver is found.
    """
    path = _checked(path, ".png", width)
    if not seconds >= 0:
        raise ValueError(f"seconds: {seconds} must not be negative")
    robot = Robot.of(task)
    shots = takes(robot, episodes, index)
    with Renderer(robot, width) as renderer:
        picture = renderer.row(shots, round(seconds / robot.dt))
    return _save(picture, path)


def filmstrip(
    path: str | Path,
    task: Task,
    episodes: Mapping[str, Episodes],
    index: int = 0,
    *,
    seconds: Sequence[float],
    width: int = 180,
) -> Path:
    """Write a .png with a row for each kind of episodes and a column for each time in seconds.

    Raises:
        ValueError: if an argument is impossible or the episodes are of another task.
        RuntimeError: if no GL driver is found.
    """
    path = _checked(path, ".png", width)
    if not len(seconds) or min(seconds) < 0:
        raise ValueError(f"seconds is empty or has negative times: {list(seconds)}; give the times of the columns")
    robot = Robot.of(task)
    shots = takes(robot, episodes, index)
    with Renderer(robot, width) as renderer:
        columns = [renderer.column(shots, round(time / robot.dt)) for time in seconds]
    return _save(beside(columns), path)


def _checked(path: str | Path, suffix: str, width: int) -> Path:
    path = Path(path)
    if path.suffix != suffix:
        raise ValueError(f"path: the name must end in {suffix}, not {path.name!r}")
    if width < 100 or width % 2:
        raise ValueError(f"width: {width} must be even and at least 100 pixels")
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _save(picture: Image.Image, path: Path) -> Path:
    with replacing(path) as temporary:
        # 64 colours suffice for a scene with a handful of them, and halve the file.
        picture.quantize(64, dither=Image.Dither.NONE).save(temporary, optimize=True)
    return path
