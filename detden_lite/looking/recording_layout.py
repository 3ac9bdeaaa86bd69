"""The layout of a rerun recording in its viewer: 3D scenes above, plots below."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from detden_lite.looking.recording_content import traces
from detden_lite.looking.robot import Robot
from detden_lite.looking.takes import Take

NO_LEGEND = rrb.PlotLegend(visible=False)  # it would cover the plots; colours mean the same everywhere


def blueprint(robot: Robot, shots: Sequence[Take], dims: Sequence[int]) -> rrb.Blueprint:
    """The layout for takes side by side.

    Args:
        robot: its size decides where the camera is.
        shots: the takes; the plots show the last one.
        dims: the observations in the recording; those that the attack changes most get a plot.
    """
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
    kinds = len(traces(shot))
    only = rr.SeriesLines.from_fields(visible_series=[i // kinds == position for i in range(count * kinds)])
    path = f"/{shot.name}/observation"
    return rrb.TimeSeriesView(contents=path, name=name, overrides={path: only}, plot_legend=NO_LEGEND)


def _most_moved(shot: Take, dims: Sequence[int], count: int = 3) -> list[int]:
    """The positions in ``dims`` where the attack is largest, relative to the observation's own variation."""
    moved = np.abs(shot.perturbed - shot.obs)[:, dims].mean(0) / (shot.obs[:, dims].std(0) + 1e-6)
    return sorted(np.argsort(-moved, kind="stable")[:count])
