"""The content of a rerun recording: the signals of a take over time, and its robot in 3D."""

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from detden_lite.looking.robot import Robot
from detden_lite.looking.takes import GREY, TAKE_COLOURS, Take

WHITE, PINK, GREEN = (225, 225, 225), TAKE_COLOURS[3], TAKE_COLOURS[2]

TRACES = {"true": WHITE, "perturbed": PINK, "denoised": GREEN}

Colour = tuple[int, int, int] | tuple[int, int, int, int]


def _times(steps: np.ndarray, dt: float) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("step", sequence=steps), rr.TimeColumn("time", duration=steps * dt)]


def _log_static(stream: rr.RecordingStream, name: str, what: rr.AsComponents) -> None:
    """Log what does not change, and flush it: a viewer reads in order, so in the file it must stand first."""
    stream.log(name, what, static=True)
    stream.flush()


def _changes(flags: np.ndarray) -> np.ndarray:
    """The steps at which flags ``[T]`` begin to be on or off."""
    return np.flatnonzero(np.diff(flags, prepend=~flags[:1]))


def traces(shot: Take) -> dict[str, np.ndarray]:
    """The observations ``[T, obs_dim]`` of a take by name: only an attack perturbs, only a defence denoises."""
    found = {"true": shot.obs}
    if shot.attacked.any():
        found["perturbed"] = shot.perturbed
    if not np.array_equal(shot.denoised, shot.perturbed):
        found["denoised"] = shot.denoised
    return found


def log_signals(
    stream: rr.RecordingStream, robot: Robot, shot: Take, dims: Sequence[int], threshold: float | None
) -> None:
    """Log the observations, rewards, scores and flags of a take, step by step.

    Args:
        stream: of the recording.
        robot: names the observations.
        shot: the take.
        dims: the observations to log.
        threshold: the detector's C_anomaly; None for none.
    """
    times = _times(np.arange(len(shot)), robot.dt)

    def plot(name: str, series: dict[str, np.ndarray], colours: Sequence[Colour], hidden: Sequence[str] = ()) -> None:
        shown = [title not in hidden for title in series]
        look = rr.SeriesLines(names=list(series), colors=colours, widths=[1.5] * len(series), visible_series=shown)
        _log_static(stream, f"{shot.name}/{name}", look)
        scalars = rr.Scalars.columns(scalars=np.stack(list(series.values()), axis=1).ravel())
        stream.send_columns(f"{shot.name}/{name}", times, scalars.partition([len(series)] * len(shot)))

    found = traces(shot)
    series = {f"{robot.names[dim]}, {trace}": found[trace][:, dim] for dim in dims for trace in found}
    plot("observation", series, [TRACES[trace] for trace in found] * len(dims))
    series = {f"{shot.name}, this step": shot.reward, shot.name: shot.reward.cumsum()}
    plot("reward", series, [WHITE, shot.colour], hidden=[f"{shot.name}, this step"])
    if "denoised" in found:
        level = np.full(len(shot), np.nan if threshold is None else threshold)
        plot("score", {"score": shot.score, "threshold": level}, [shot.colour, WHITE])
    for name, flags, colour in (("attacked", shot.attacked, PINK), ("alarm", shot.alarm, GREEN)):
        look = rr.StateConfiguration(values=["on", "off"], labels=[name, " "], colors=[colour, (52, 54, 58)])
        _log_static(stream, f"{shot.name}/{name}", look)
        changes = _changes(flags)
        states = rr.StateChange.columns(state=np.where(flags[changes], "on", "off"))
        stream.send_columns(f"{shot.name}/{name}", _times(changes, robot.dt), states)


def log_scene(stream: rr.RecordingStream, robot: Robot, shot: Take, frame_rate: float) -> None:
    """Log the robot of a take in 3D, its floor and camera, and while attacked the ghost that the observations describe.

    Args:
        stream: of the recording.
        robot: the body.
        shot: the take.
        frame_rate: poses for each second of the simulation.
    """
    last = len(shot.positions) - 1
    stride = max(1, round(1 / (robot.dt * frame_rate)))
    steps = np.append(np.arange(0, last, stride), last)
    where = np.zeros((len(steps), 3))
    where[:, : robot.hidden] = shot.positions[steps, : robot.hidden]
    stream.send_columns(f"{shot.name}/camera", _times(steps, robot.dt), rr.Transform3D.columns(translation=where))
    _log_static(stream, f"{shot.name}/floor", _floor(where, robot.hidden))
    lit = {0: shot.colour} | ({last: GREY} if shot.fell else {})
    _log_body(stream, robot, f"{shot.name}/robot", steps, shot.positions[steps], lit)
    if shot.fell:
        head = where[-1:] + [0, 0, 1.2 * robot.extent[2]]
        label = rr.Points3D.columns(
            positions=head, radii=[0.0], labels=[f"fell at step {len(shot)}"], colors=[shot.colour]
        )
        stream.send_columns(f"{shot.name}/fall", _times(np.array([last]), robot.dt), label)
    if shot.attacked.any():
        seen = steps[steps < len(shot)]
        ghost = robot.imagined(shot.positions[seen], shot.perturbed[seen])
        colours: dict[int, Colour] = {
            step: (*PINK, 110 if shot.attacked[step] else 0) for step in _changes(shot.attacked).tolist()
        }
        if shot.fell:
            colours[last] = (*PINK, 0)
        _log_body(stream, robot, f"{shot.name}/ghost", seen, ghost, colours)


def _log_body(
    stream: rr.RecordingStream,
    robot: Robot,
    name: str,
    steps: np.ndarray,
    positions: np.ndarray,
    colours: Mapping[int, Colour],
) -> None:
    n = len(robot.geoms)
    ends, turns = robot.poses(positions)
    _log_static(stream, name, rr.Capsules3D(lengths=robot.lengths, radii=robot.radii, fill_mode="solid"))
    columns = rr.Capsules3D.columns(translations=ends.reshape(-1, 3), quaternions=turns.reshape(-1, 4))
    stream.send_columns(name, _times(steps, robot.dt), columns.partition([n] * len(steps)))
    paint = rr.Capsules3D.columns(colors=[colour for colour in colours.values() for _ in range(n)])
    stream.send_columns(name, _times(np.array(list(colours)), robot.dt), paint.partition([n] * len(colours)))


def _floor(where: np.ndarray, directions: int) -> rr.LineStrips3D:
    """A line each metre; a runway for a robot that can only go along x."""
    low, high = np.floor(where.min(0)) - 4, np.ceil(where.max(0)) + 4
    if directions == 1:
        low[1], high[1] = -0.6, 0.6
    across = [[(x, low[1], 0), (x, high[1], 0)] for x in np.arange(low[0], high[0] + 1)]
    along = [[(low[0], y, 0), (high[0], y, 0)] for y in np.linspace(low[1], high[1], round(high[1] - low[1]) + 1)]
    return rr.LineStrips3D(across + along, colors=[(92, 96, 104)], radii=[0.008])
