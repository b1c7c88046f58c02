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
from workbench.app.figures.overlay import Overlay
from workbench.app.workspace import Workspace

_SPREAD_FACTOR = 3
_MOST_AROUND = 800
"""More points hide the arm among them."""


def scene(work: Workspace) -> go.Figure:
    """Measured points and instrument or artefact, without what depends on the current sample."""
    plot = style.space("recording")
    if not has_arm(work.opened):
        return plot
    drawn = thinned(work.count, _MOST_AROUND)
    _add_places(plot, work, drawn)
    outer = outer_frame(work.opened)
    if outer is not None:
        _outer(plot, work.opened, outer)
    scene_marks(work).add_legend(plot)
    return style.framed(plot, *reach(work.opened, True))


def scene_marks(work: Workspace) -> Overlay:
    """Above the scene: the arm at the current sample with reflectors and the sensor's field."""
    marks = Overlay()
    if has_arm(work.opened):
        add_arm(marks, work)
    return marks


def has_points(work: Workspace) -> bool:
    """Whether the run says where the measured points are."""
    return work.opened.residuals is not None and work.opened.residuals.points is not None


def places_of(work: Workspace, rows: np.ndarray) -> np.ndarray:
    """(3, k) mm: measured points of some rows, or the nominal flange where the run does not say."""
    if has_points(work):
        return work.opened.residuals.points[:, rows]
    return flange_points(work.opened, work.opened.rows[rows])


def _add_places(plot: go.Figure, work: Workspace, rows: np.ndarray) -> None:
    """Points that a click identifies by their row."""
    x, y, z = np.round(places_of(work, rows), 2)
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        name="measured points" if has_points(work) else "flange of all samples",
        customdata=rows,
        text=work.opened.edit_ids[rows],
        marker=dict(size=2, color=style.BLUE, opacity=0.35),
        hovertemplate="sample %{text}<br>(%{x:.1f}, %{y:.1f}, %{z:.1f}) mm<extra></extra>",
    )


def _add_reflectors(plot: go.Figure | Overlay, pose) -> None:
    """Lines from the flange to its reflectors, which have one entry in the legend."""
    for k, target in enumerate(pose.targets.T):
        stalk = np.stack([pose.links[:, -1], target], 1)
        _line(plot, stalk, "reflectors" if k == 0 else "", style.GREEN, 4, 4)


def add_arm(plot: go.Figure | Overlay, work: Workspace) -> None:
    """The nominal arm at the current row with what it carries."""
    opened = work.opened
    row = int(opened.rows[work.current])
    pose = arm_pose(opened, row)
    _line(plot, pose.links, "arm at the current sample", style.INK, 9, 5)
    _add_reflectors(plot, pose)
    if pose.sensor is not None:
        _sensor(plot, opened, pose)
    if has_points(work):
        _current(plot, work)


def _line(
    plot: go.Figure | Overlay,
    path: np.ndarray,
    name: str,
    colour: str,
    width: float,
    size: float = 0,
) -> None:
    x, y, z = np.round(path, 2)
    plot.add_scatter3d(
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


def _current(plot: go.Figure | Overlay, work: Workspace) -> None:
    """The measured point of the current sample."""
    row = work.current
    x, y, z = np.round(work.opened.residuals.points[:, row], 2)
    plot.add_scatter3d(
        x=[x],
        y=[y],
        z=[z],
        mode="markers",
        name="current sample",
        marker=dict(size=5, color=style.ORANGE, symbol="diamond"),
    )


def _sensor(plot: go.Figure, opened, pose) -> None:
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
    _line(plot, placed, "field of the sensor", style.VIOLET, 3)
    _line(plot, np.stack([pose.links[:, -1], pose.sensor[:3, 3]], 1), "", style.VIOLET, 4)


def _outer(plot: go.Figure, opened, frame: np.ndarray) -> None:
    """Axes of the instrument, or of the artefact with its balls."""
    if opened.samples.balls:
        balls = np.array([ball[:3] for ball in opened.samples.balls.values()]).T
        x, y, z = np.round(frame[:3, :3] @ balls + frame[:3, 3:], 2)
        plot.add_scatter3d(
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
            plot, np.stack([origin, end], 1), "frame of the instrument" if k == 0 else "", colour, 6
        )


def coverage(work: Workspace) -> go.Figure:
    """Readings of every joint between its limits, and two projections of the flange."""
    joints = joint_coverage(work.opened)
    views = [("x", "y"), ("x", "z")] if has_arm(work.opened) else []
    titles = [_range_title(joint) for joint in joints]
    titles += [f"flange: {b} over {a} (mm)" for a, b in views]
    rows = max(-(-len(titles) // _SPREAD_FACTOR), 1)
    ground = go.Figure(layout=dict(template=style.TEMPLATE))
    plot = make_subplots(
        rows,
        _SPREAD_FACTOR,
        subplot_titles=titles,
        vertical_spacing=0.16,
        horizontal_spacing=0.08,
        figure=ground,
    )
    for k, joint in enumerate(joints):
        middle = (joint["edges"][:-1] + joint["edges"][1:]) / 2
        bars = dict(x=middle, y=joint["counts"], marker_color=style.BLUE, showlegend=False)
        plot.add_bar(**bars, row=k // _SPREAD_FACTOR + 1, col=k % _SPREAD_FACTOR + 1)
    limits = [
        _limit(k, limit) for k, joint in enumerate(joints) for limit in _finite(joint["limits"])
    ]
    if views:
        _workspace(plot, work, len(joints), views)
    plot.update_xaxes(nticks=4, tickangle=0, ticklabelstandoff=3)
    plot.update_yaxes(nticks=4, ticklabelstandoff=4)
    for place in range(len(joints), len(titles)):  # a flat subplot has room for one tick of four
        plot.update_yaxes(nticks=6, row=place // _SPREAD_FACTOR + 1, col=place % _SPREAD_FACTOR + 1)
    plot.update_annotations(font_size=12)
    return plot.update_layout(
        shapes=limits,
        font=dict(family="Roboto, Arial, sans-serif", size=12, color=style.INK),
        margin=dict(l=44, r=12, t=52, b=30),  # the button of the view stands above the titles
        bargap=0,
        uirevision="coverage",
    )


def _range_title(joint: dict) -> str:
    return f"{joint['label']}: {joint['low']:.0f} to {joint['high']:.0f} {joint['unit']}"


def _finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def _limit(place: int, value: float) -> dict:
    """A vertical line over the whole height of the subplot at `place`."""
    number = "" if place == 0 else str(place + 1)
    return dict(
        type="line",
        x0=value,
        x1=value,
        y0=0,
        y1=1,
        xref=f"x{number}",
        yref=f"y{number} domain",
        line=dict(color=style.ORANGE, width=2),
    )


def _workspace(plot: go.Figure, work: Workspace, first: int, views) -> None:
    """Positions of the flange as points, one subplot a view."""
    drawn = thinned(work.count, MOST_POINTS)
    places = dict(zip("xyz", flange_points(work.opened, work.opened.rows[drawn]).round(1)))
    for k, (a, b) in enumerate(views, start=first):
        plot.add_scattergl(
            x=places[a],
            y=places[b],
            mode="markers",
            marker=dict(size=3, color=style.BLUE, opacity=0.4),
            showlegend=False,
            hoverinfo="skip",
            row=k // _SPREAD_FACTOR + 1,
            col=k % _SPREAD_FACTOR + 1,
        )
