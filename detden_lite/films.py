"""Films and stills of episodes side by side, rendered by MuJoCo.

Rendering needs a GL driver; importing this module does not. Without a display set MUJOCO_GL=egl (or osmesa) before
Python starts.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from detden_lite.playback import COLOURS, GREY, Robot, Take, replacing, takes
from detden_lite.rollout import Episodes
from detden_lite.tasks import Task

GROUND, SKY, MARK, INK = (58, 60, 66), (30, 32, 36), (116, 119, 126), (222, 224, 228)
GHOST, ALARM = COLOURS[3], COLOURS[2]
CAPTION = 46  # pixels


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
        episodes: kinds of episodes by name, such as "clean", "attacked", "defended"; the names are captions.
        index: which episode of each.
        seconds: the longest that the film may be; it ends with its last episode.
        fps: frames a second.
        speed: 1 shows it as fast as it happened, 0.5 half as fast.
        width: of one robot's square picture, pixels; even.
        quality: x264's constant rate factor, lower is better and larger.

    Returns:
        The path.

    Raises:
        ValueError: if an argument is impossible or the episodes are of another task.
        RuntimeError: if no GL driver is found.
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
    with _Studio(robot, width) as studio, replacing(path) as temporary:
        writer = imageio_ffmpeg.write_frames(
            temporary, size, fps=fps, codec="libx264", quality=None, macro_block_size=2, output_params=options
        )
        writer.send(None)
        for frame in range(frames):
            writer.send(studio.row(shots, round(frame / fps * speed / robot.dt)).tobytes())
        writer.close()
    return path


def still(
    path: str | Path, task: Task, episodes: Mapping[str, Episodes], index: int = 0, *, seconds: float, width: int = 300
) -> Path:
    """Write the picture, a .png, that ``film`` of the same episodes has at a time in seconds."""
    path = _checked(path, ".png", width)
    if not seconds >= 0:
        raise ValueError(f"seconds: {seconds} must not be negative")
    robot = Robot.of(task)
    shots = takes(robot, episodes, index)
    with _Studio(robot, width) as studio:
        picture = studio.row(shots, round(seconds / robot.dt))
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
    """Write a .png with a row for each kind of episodes and a column for each time in seconds."""
    path = _checked(path, ".png", width)
    if not len(seconds) or min(seconds) < 0:
        raise ValueError(f"seconds is empty or has negative times: {list(seconds)}; give the times of the columns")
    robot = Robot.of(task)
    shots = takes(robot, episodes, index)
    with _Studio(robot, width) as studio:
        columns = [studio.column(shots, round(time / robot.dt)) for time in seconds]
    return _save(_beside(columns), path)


class _Studio:
    """Draws a robot, as it was at a step of a take, above a caption."""

    def __init__(self, robot: Robot, width: int):
        self.robot, self.width, self.model = robot, width, robot.model
        self.data, self.imagined = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.font, self.small = (ImageFont.load_default(size) for size in (15, 13))
        _paint(self.model)
        self.model.vis.global_.offwidth = self.model.vis.global_.offheight = width
        try:
            self.renderer = mujoco.Renderer(self.model, width, width)
        except Exception as error:
            raise RuntimeError(
                "MuJoCo cannot render: it finds no GL driver. Without a display set MUJOCO_GL=egl (Debian: libegl1 "
                "libgl1-mesa-dri) or MUJOCO_GL=osmesa (libosmesa6) before Python starts"
            ) from error
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION, mujoco.mjtRndFlag.mjRND_HAZE):
            self.renderer.scene.flags[flag] = False

    def __enter__(self) -> "_Studio":
        return self

    def __exit__(self, *_) -> None:
        self.renderer.close()

    def row(self, shots: Sequence[Take], step: int) -> Image.Image:
        return _beside([self.picture(shot, step) for shot in shots])

    def column(self, shots: Sequence[Take], step: int) -> Image.Image:
        return _beside([self.picture(shot, step) for shot in shots], down=True)

    def picture(self, shot: Take, step: int) -> Image.Image:
        over = step >= len(shot)
        position = shot.positions[min(step, len(shot.positions) - 1)]
        colour = GREY if over and shot.fell else shot.colour
        self.model.geom_rgba[self.robot.geoms] = _rgba(colour)
        self.data.qpos[:] = position
        mujoco.mj_forward(self.model, self.data)
        self.renderer.update_scene(self.data, self._camera(position))
        self._mark_floor(position)
        if not over and shot.attacked[step]:
            self._add_ghost(self.robot.imagined(position[None], shot.perturbed[step][None])[0])
        picture = Image.new("RGB", (self.width, self.width + CAPTION), SKY)
        picture.paste(Image.fromarray(self.renderer.render()))
        self._caption(ImageDraw.Draw(picture), shot, step)
        return picture

    def _camera(self, position: np.ndarray) -> mujoco.MjvCamera:
        extent = self.robot.extent
        camera = mujoco.MjvCamera()
        camera.lookat[:] = (0, 0, 0.6 * extent[2])
        camera.lookat[: self.robot.hidden] = position[: self.robot.hidden]
        camera.azimuth, camera.elevation, camera.distance = 73, -12, 2.0 * extent.max()
        return camera

    def _mark_floor(self, position: np.ndarray) -> None:
        """A line each metre, so that one sees how far and how fast."""
        centre = np.zeros(2)
        centre[: self.robot.hidden] = position[: self.robot.hidden]
        for axis in range(self.robot.hidden):
            for metre in np.arange(np.floor(centre[axis]) - 6, centre[axis] + 8):
                where, size = np.append(centre, 0.0), np.array([8.0, 8.0, 0.001])
                where[axis], size[axis] = metre, 0.015
                self._add(mujoco.mjtGeom.mjGEOM_BOX, size, where, np.eye(3).ravel(), _rgba(MARK))

    def _add_ghost(self, position: np.ndarray) -> None:
        self.imagined.qpos[:] = position
        mujoco.mj_kinematics(self.model, self.imagined)
        for geom in self.robot.geoms:
            kind, size = self.model.geom_type[geom], self.model.geom_size[geom]
            self._add(kind, size, self.imagined.geom_xpos[geom], self.imagined.geom_xmat[geom], _rgba(GHOST, 0.45))

    def _add(self, kind: int, size: np.ndarray, where: np.ndarray, turn: np.ndarray, rgba: np.ndarray) -> None:
        scene = self.renderer.scene
        mujoco.mjv_initGeom(scene.geoms[scene.ngeom], kind, size, where, turn, rgba)
        scene.ngeom += 1

    def _caption(self, draw: ImageDraw.ImageDraw, shot: Take, step: int) -> None:
        over, top, right = step >= len(shot), self.width + 5, self.width - 10
        steps = f"step {step}" if not over else f"{'fell' if shot.fell else 'ended'} at step {len(shot)}"
        draw.text((10, top), shot.name, shot.colour, self.font)
        draw.text((10, top + 19), steps, INK, self.small)
        draw.text((right, top + 19), f"return {shot.reward[: step + 1].sum():,.0f}", INK, self.small, anchor="ra")
        flags = [("attack", GHOST, shot.attacked), ("alarm", ALARM, shot.alarm)]
        for name, colour, flag in flags:
            if not over and flag[step]:
                draw.text((right, top + 2), name, colour, self.small, anchor="ra")
                right -= 12 + draw.textlength(name, self.small)


def _paint(model: mujoco.MjModel) -> None:
    """Plain colours, which a film can hold in few bytes."""
    model.geom_matid[:] = -1
    model.geom_rgba[model.geom_bodyid == 0] = _rgba(GROUND)
    model.tex_data.reshape(-1, 3)[:] = SKY
    model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, :2] = 0  # drawn without an edge
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.5, 0.3
    model.light_diffuse[:], model.light_specular[:] = 0.5, 0.0
    model.vis.quality.offsamples = 4


def _rgba(colour: tuple[int, int, int], alpha: float = 1.0) -> np.ndarray:
    return np.append(np.array(colour) / 255, alpha).astype(np.float32)


def _beside(pictures: Sequence[Image.Image], down: bool = False) -> Image.Image:
    arrays = [np.asarray(picture) for picture in pictures]
    return Image.fromarray(np.concatenate(arrays, axis=0 if down else 1))


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
