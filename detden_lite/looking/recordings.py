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
import rerun.blueprint as rrb

from detden_lite.core.files import replacing
from detden_lite.core.tasks import Task
from detden_lite.core.types import Episodes
from detden_lite.looking.robot import Robot
from detden_lite.looking.takes import GREY, TAKE_COLOURS, Take, takes

WHITE, PINK, GREEN = (225, 225, 225), TAKE_COLOURS[3], TAKE_COLOURS[2]

TRACES = {"true": WHITE, "perturbed": PINK, "denoised": GREEN}

NO_LEGEND = rrb.PlotLegend(visible=False)  # it would cover the plots; colours mean the same everywhere


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
    """Write a recording of three episodes: open it in the book, or with ``rerun PATH``.

    Args:
        path: the .rrd file to write.
        task: what the episodes are of.
        nominal: without attack.
        attacked: with the attack and no defence.
        defended: with both.
        index: which episode of each.
        threshold: the detector's C_anomaly, drawn beside its score.
        dims: the observations to keep; all by default. Ant and Humanoid have so many that a choice is wise.
        frame_rate: poses kept for each second of the simulation; signals keep every step.

    Returns:
        The path. The same episodes give a recording with the same id and content.

    Raises:
        ValueError: if a path, an index or the dims are impossible, or if the episodes are of another task.
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
        stream.save(temporary, default_blueprint=_blueprint(robot, shots, dims))
        for shot in shots:
            _log_signals(stream, robot, shot, dims, threshold)
            _log_scene(stream, robot, shot, frame_rate)
        stream.disconnect()
    return path


def _identity(task: Task, shots: Sequence[Take]) -> str:
    digest = hashlib.sha256(task.name.encode())
    for shot in shots:
        for array in (shot.positions, shot.obs, shot.perturbed, shot.denoised, shot.score):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def _times(steps: np.ndarray, dt: float) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("step", sequence=steps), rr.TimeColumn("time", duration=steps * dt)]


def _log_static(stream: rr.RecordingStream, name: str, what: rr.AsComponents) -> None:
    """What does not change. It is flushed, so that in the file it stands before what does: a viewer reads in order."""
    stream.log(name, what, static=True)
    stream.flush()


def _changes(flags: np.ndarray) -> np.ndarray:
    """The steps at which flags ``[T]`` begin to be on or off."""
    return np.flatnonzero(np.diff(flags, prepend=~flags[:1]))


def _traces(shot: Take) -> dict[str, np.ndarray]:
    """The observations ``[T, obs_dim]`` that this take has: only an attack perturbs, only a defence denoises."""
    traces = {"true": shot.obs}
    if shot.attacked.any():
        traces["perturbed"] = shot.perturbed
    if not np.array_equal(shot.denoised, shot.perturbed):
        traces["denoised"] = shot.denoised
    return traces


def _log_signals(stream: rr.RecordingStream, robot: Robot, shot: Take, dims: Sequence[int], threshold: float | None):
    times = _times(np.arange(len(shot)), robot.dt)

    def plot(name: str, series: dict[str, np.ndarray], colours: Sequence[tuple], hidden: Sequence[str] = ()) -> None:
        shown = [title not in hidden for title in series]
        look = rr.SeriesLines(names=list(series), colors=colours, widths=[1.5] * len(series), visible_series=shown)
        _log_static(stream, f"{shot.name}/{name}", look)
        scalars = rr.Scalars.columns(scalars=np.stack(list(series.values()), axis=1).ravel())
        stream.send_columns(f"{shot.name}/{name}", times, scalars.partition([len(series)] * len(shot)))

    traces = _traces(shot)
    series = {f"{robot.names[dim]}, {trace}": traces[trace][:, dim] for dim in dims for trace in traces}
    plot("observation", series, [TRACES[trace] for trace in traces] * len(dims))
    series = {f"{shot.name}, this step": shot.reward, shot.name: shot.reward.cumsum()}
    plot("reward", series, [WHITE, shot.colour], hidden=[f"{shot.name}, this step"])
    if "denoised" in traces:
        level = np.full(len(shot), np.nan if threshold is None else threshold)
        plot("score", {"score": shot.score, "threshold": level}, [shot.colour, WHITE])
    for name, flags, colour in (("attacked", shot.attacked, PINK), ("alarm", shot.alarm, GREEN)):
        look = rr.StateConfiguration(values=["on", "off"], labels=[name, " "], colors=[colour, (52, 54, 58)])
        _log_static(stream, f"{shot.name}/{name}", look)
        changes = _changes(flags)
        states = rr.StateChange.columns(state=np.where(flags[changes], "on", "off"))
        stream.send_columns(f"{shot.name}/{name}", _times(changes, robot.dt), states)


def _log_scene(stream: rr.RecordingStream, robot: Robot, shot: Take, frame_rate: float) -> None:
    last = len(shot.positions) - 1
    stride = max(1, round(1 / (robot.dt * frame_rate)))
    steps = np.append(np.arange(0, last, stride), last)
    where = np.zeros((len(steps), 3))
    where[:, : robot.hidden] = shot.positions[steps, : robot.hidden]
    stream.send_columns(f"{shot.name}/camera", _times(steps, robot.dt), rr.Transform3D.columns(translation=where))
    _log_static(stream, f"{shot.name}/floor", _floor(where, robot.hidden))
    colours = {0: shot.colour} | ({last: GREY} if shot.fell else {})
    _log_body(stream, robot, f"{shot.name}/robot", steps, shot.positions[steps], colours)
    if shot.fell:
        head = where[-1:] + [0, 0, 1.2 * robot.extent[2]]
        label = rr.Points3D.columns(
            positions=head, radii=[0.0], labels=[f"fell at step {len(shot)}"], colors=[shot.colour]
        )
        stream.send_columns(f"{shot.name}/fall", _times(np.array([last]), robot.dt), label)
    if shot.attacked.any():
        seen = steps[steps < len(shot)]
        ghost = robot.imagined(shot.positions[seen], shot.perturbed[seen])
        colours = {step: (*PINK, 110 if shot.attacked[step] else 0) for step in _changes(shot.attacked).tolist()}
        if shot.fell:
            colours[last] = (*PINK, 0)
        _log_body(stream, robot, f"{shot.name}/ghost", seen, ghost, colours)


def _log_body(
    stream: rr.RecordingStream,
    robot: Robot,
    name: str,
    steps: np.ndarray,
    positions: np.ndarray,
    colours: dict[int, tuple],
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


def _blueprint(robot: Robot, shots: Sequence[Take], dims: Sequence[int]) -> rrb.Blueprint:
    size, height = robot.extent.max(), robot.extent[2]
    eye = rrb.EyeControls3D(
        kind="orbital", position=(-0.5 * size, -1.6 * size, 0.4 * size + 0.5 * height), look_target=(0, 0, 0.5 * height)
    )
    scenes = [
        rrb.Spatial3DView(
            origin=f"{shot.name}/camera",
            contents=f"/{shot.name}/**",
            name=shot.name,
            background=(30, 32, 36),
            line_grid=False,
            eye_controls=eye,
        )
        for shot in shots
    ]
    last = shots[-1].name
    observations = [
        _observation_view(shots[-1], robot.names[dims[i]], i, len(dims)) for i in _most_moved(shots[-1], dims)
    ]
    flags = rrb.StateTimelineView(contents=[f"/{last}/attacked", f"/{last}/alarm"], name=f"{last}: attacks and alarms")
    score = rrb.TimeSeriesView(contents=f"/{last}/score", name="detector score and threshold", plot_legend=NO_LEGEND)
    paths = [f"/{shot.name}/reward" for shot in shots]
    returns = rrb.TimeSeriesView(contents=paths, name="return so far", plot_legend=NO_LEGEND)
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*scenes),
            rrb.Horizontal(rrb.Tabs(*observations), score),
            rrb.Horizontal(flags, returns),
            row_shares=[5, 3, 3],
        ),
        rrb.TimePanel(timeline="time", play_state="paused", state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TopPanel(state="hidden"),
        auto_views=False,
    )


def _observation_view(shot: Take, name: str, position: int, count: int) -> rrb.TimeSeriesView:
    traces = len(_traces(shot))
    only = rr.SeriesLines.from_fields(visible_series=[i // traces == position for i in range(count * traces)])
    path = f"/{shot.name}/observation"
    return rrb.TimeSeriesView(contents=path, name=name, overrides={path: only}, plot_legend=NO_LEGEND)


def _most_moved(shot: Take, dims: Sequence[int], count: int = 3) -> list[int]:
    """Where in ``dims`` the attack is largest, compared with how much that observation varies by itself."""
    moved = np.abs(shot.perturbed - shot.obs)[:, dims].mean(0) / (shot.obs[:, dims].std(0) + 1e-6)
    return sorted(np.argsort(-moved, kind="stable")[:count])
