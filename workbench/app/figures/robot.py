"""The arm in space: at the current sample, with all measured points, and how much of the workspace is covered."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from workbench.app.data.arm import (
    AXIS_MM,
    SENSOR_DEPTH_MM,
    arm_pose,
    flange_points,
    has_arm,
    joint_coverage,
    outer_frame,
    reach,
)
from workbench.app.data.decimate import MOST_POINTS, thinned
from workbench.app.figures import style
from workbench.app.workspace import Workspace

_ACROSS = 3


def scene(work: Workspace) -> go.Figure:
    """The arm at the current sample, measured points, reflectors, instrument or artefact, and the sensor's field."""
    made = style.space("recording")
    if not has_arm(work.opened):
        return made
    drawn = thinned(work.count, MOST_POINTS)
    add_places(
        made,
        places_of(work, drawn),
        drawn,
        "measured points" if has_points(work) else "flange of all samples",
    )
    add_arm(made, work)
    return style.framed(made, *reach(work.opened, True))


def has_points(work: Workspace) -> bool:
    """Whether the run says where the measured points are."""
    return work.opened.residuals is not None and work.opened.residuals.points is not None


def places_of(work: Workspace, rows: np.ndarray) -> np.ndarray:
    """(3, k) mm: measured points of some rows, or the nominal flange where the run does not say."""
    if has_points(work):
        return work.opened.residuals.points[:, rows]
    return flange_points(work.opened, work.opened.rows[rows])


def add_places(made: go.Figure, places: np.ndarray, rows: np.ndarray, name: str) -> None:
    """Points that a click identifies by their row."""
    x, y, z = np.round(places, 2)
    made.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        name=name,
        customdata=rows,
        marker=dict(size=2.5, color=style.BLUE, opacity=0.6),
        hovertemplate="row %{customdata}<br>(%{x:.1f}, %{y:.1f}, %{z:.1f}) mm<extra></extra>",
    )


def add_arm(made: go.Figure, work: Workspace, with_outer: bool = True) -> None:
    """The nominal arm at the current row with what it carries.

    with_outer: also the frame of the instrument, or the balls of the artefact.
    """
    opened = work.opened
    row = int(opened.rows[work.current])
    pose = arm_pose(opened, row)
    _line(made, pose.links, "arm at the current sample", style.INK, 9, 5)
    for k, target in enumerate(pose.targets.T):
        stalk = np.stack([pose.links[:, -1], target], 1)
        _line(made, stalk, "reflectors" if k == 0 else "", style.GREEN, 4, 4)
    if pose.sensor is not None:
        _sensor(made, opened, pose)
    outer = outer_frame(opened)
    if outer is not None and with_outer:
        _outer(made, opened, outer)
    if has_points(work):
        _current(made, opened.residuals.points[:, work.current])


def _line(
    made: go.Figure, path: np.ndarray, name: str, colour: str, width: float, size: float = 0
) -> None:
    x, y, z = np.round(path, 2)
    made.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="lines+markers" if size else "lines",
        name=name,
        showlegend=bool(name),
        hoverinfo="skip",
        line=dict(color=colour, width=width),
        marker=dict(size=size, color=colour),
    )


def _current(made: go.Figure, point: np.ndarray) -> None:
    x, y, z = np.round(point, 2)
    made.add_scatter3d(
        x=[x],
        y=[y],
        z=[z],
        mode="markers",
        name="current sample",
        hoverinfo="skip",
        marker=dict(size=7, color=style.ORANGE, symbol="diamond"),
    )


def _sensor(made: go.Figure, opened, pose) -> None:
    """The pyramid of the camera's field, 30 degrees wide where no camera is known."""
    from workbench.app.data.sensor import camera_of
    from workbench.report.sensor.space import pyramid

    camera = camera_of(opened)
    depth = SENSOR_DEPTH_MM
    if camera is None:
        side = depth * np.tan(np.deg2rad(15))
        corners = np.array(
            [[-side, -side, depth], [side, -side, depth], [side, side, depth], [-side, side, depth]]
        )
        eye = np.zeros(3)
        a, b, c, d = corners
        path = np.stack([eye, a, b, eye, c, d, eye, a, d, c, b])
    else:
        path = pyramid(camera, depth)
    placed = pose.sensor[:3, :3] @ path.T + pose.sensor[:3, 3:]
    _line(made, placed, "field of the sensor", style.VIOLET, 3)
    _line(made, np.stack([pose.links[:, -1], pose.sensor[:3, 3]], 1), "", style.VIOLET, 4)


def _outer(made: go.Figure, opened, frame: np.ndarray) -> None:
    """Axes of the instrument, or of the artefact with its balls."""
    if opened.samples.balls:
        balls = np.array([ball[:3] for ball in opened.samples.balls.values()]).T
        x, y, z = np.round(frame[:3, :3] @ balls + frame[:3, 3:], 2)
        made.add_scatter3d(
            x=x,
            y=y,
            z=z,
            mode="markers",
            name="balls of the artefact",
            hoverinfo="skip",
            marker=dict(size=8, color=style.GREEN, opacity=0.6),
        )
        return
    origin = frame[:3, 3]
    for k, colour in enumerate((style.ORANGE, style.GREEN, style.BLUE)):
        end = origin + AXIS_MM * frame[:3, k]
        _line(
            made, np.stack([origin, end], 1), "frame of the instrument" if k == 0 else "", colour, 6
        )


def coverage(work: Workspace) -> go.Figure:
    """Readings of every joint between its limits, and two projections of the workspace."""
    joints = joint_coverage(work.opened)
    rows = -(-(len(joints) + 2) // _ACROSS)
    titles = [f"{one['label']}: {one['low']:.0f} to {one['high']:.0f}" for one in joints]
    titles += ["from above (x, y)", "from the side (x, z)"] if has_arm(work.opened) else []
    made = make_subplots(
        rows, _ACROSS, subplot_titles=titles, vertical_spacing=0.16, horizontal_spacing=0.07
    )
    for k, one in enumerate(joints):
        at = dict(row=k // _ACROSS + 1, col=k % _ACROSS + 1)
        middle = (one["edges"][:-1] + one["edges"][1:]) / 2
        made.add_bar(x=middle, y=one["counts"], marker_color=style.BLUE, showlegend=False, **at)
        for limit in one["limits"][np.isfinite(one["limits"])]:
            made.add_vline(x=limit, line_color=style.ORANGE, line_width=2, **at)
    if has_arm(work.opened):
        _workspace(made, work, len(joints))
    made.update_layout(
        template="plotly_white",
        font=dict(family="Roboto, Arial, sans-serif", size=12, color=style.INK),
        margin=dict(l=44, r=12, t=30, b=30),
        bargap=0,
        uirevision="coverage",
    )
    return made


def _workspace(made: go.Figure, work: Workspace, first: int) -> None:
    places = places_of(work, thinned(work.count, MOST_POINTS))
    for k, (a, b) in enumerate(((0, 1), (0, 2)), start=first):
        made.add_scattergl(
            x=np.round(places[a], 1),
            y=np.round(places[b], 1),
            mode="markers",
            marker=dict(size=3, color=style.BLUE, opacity=0.4),
            showlegend=False,
            hoverinfo="skip",
            row=k // _ACROSS + 1,
            col=k % _ACROSS + 1,
        )
