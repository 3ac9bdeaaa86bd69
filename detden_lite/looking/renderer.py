"""A picture of a robot at a moment of an episode, rendered by MuJoCo, with the attacker's ghost and a caption."""

from collections.abc import Sequence

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from detden_lite.looking.robot import Robot
from detden_lite.looking.takes import GREY, TAKE_COLOURS, Take

GROUND, SKY, MARK, INK = (58, 60, 66), (30, 32, 36), (116, 119, 126), (222, 224, 228)

GHOST, ALARM = TAKE_COLOURS[3], TAKE_COLOURS[2]

CAPTION = 46  # pixels


class Renderer:
    """Draws a robot at a step of a take, above a caption; a context manager.

    Args:
        robot: whose takes are drawn; its model is painted.
        width: of one square picture, pixels; the caption comes on top of its height.

    Raises:
        RuntimeError: if no GL driver is found.

    Example:
        It needs a GL driver::

            from detden_lite import Robot, get_task, takes
            from detden_lite.looking.renderer import Renderer

            robot = Robot.of(get_task("hopper"))
            with Renderer(robot, width=300) as renderer:
                picture = renderer.row(takes(robot, dict(clean=episodes), index=0), step=10)
    """

    def __init__(self, robot: Robot, width: int) -> None:
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

    def __enter__(self) -> "Renderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.renderer.close()

    def row(self, shots: Sequence[Take], step: int) -> Image.Image:
        """The takes at a step, side by side."""
        return beside([self.picture(shot, step) for shot in shots])

    def column(self, shots: Sequence[Take], step: int) -> Image.Image:
        """The takes at a step, one below the other."""
        return beside([self.picture(shot, step) for shot in shots], down=True)

    def picture(self, shot: Take, step: int) -> Image.Image:
        """One take at a step; after its end, as it was at its last step."""
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
        """Draw a line each metre, which shows distance and speed."""
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
        over, top, right = step >= len(shot), self.width + 5, float(self.width - 10)
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
    """Give the model plain colours, which make a film small."""
    model.geom_matid[:] = -1
    model.geom_rgba[model.geom_bodyid == 0] = _rgba(GROUND)
    model.tex_data.reshape(-1, 3)[:] = SKY
    model.geom_size[model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE, :2] = 0  # drawn without an edge
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.5, 0.3
    model.light_diffuse[:], model.light_specular[:] = 0.5, 0.0
    model.vis.quality.offsamples = 4


def _rgba(colour: tuple[int, int, int], alpha: float = 1.0) -> np.ndarray:
    return np.append(np.array(colour) / 255, alpha).astype(np.float32)


def beside(pictures: Sequence[Image.Image], down: bool = False) -> Image.Image:
    """Pictures of one size in a row, or one below the other."""
    arrays = [np.asarray(picture) for picture in pictures]
    return Image.fromarray(np.concatenate(arrays, axis=0 if down else 1))
