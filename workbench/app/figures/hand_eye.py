"""A hand-eye run: bars of the errors by image, and flange, camera and board in space."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from workbench.app.data.arm import has_arm
from workbench.app.data.decimate import thinned
from workbench.app.data.hand_eye import Placed, flange_poses_of, placed, pose_errors
from workbench.app.data.sensor import camera_of
from workbench.app.figures import style
from workbench.app.figures.robot import add_arm
from workbench.app.workspace import Workspace
from workbench.report.sensor.space import lines, moved, pyramid

_MOST_FLANGES = 800
_MOST_CAMERAS = 40
_DEPTH = 0.25
"""Drawn depth of the camera's field as a share of its distance from the board."""
_AXIS = 0.15
"""Length of the drawn axes of the flange as a share of the same distance."""
_MARGIN = 0.05
_NAMED = 24
"""More names of images overlap below the bars."""


def bars(work: Workspace) -> go.Figure:
    """Residual of the fit and held out of each image or pose; a click gives its place in the list of errors."""
    errors = pose_errors(work.opened)
    unit = errors[0].unit if errors else ""
    plot = style.plane("image or pose", f"RMS residual ({unit})", "pose errors")
    places = list(range(len(errors)))
    names = [style.plain(error.name) for error in errors]
    chosen = [bool(error.rows) and bool(work.selected[list(error.rows)].any()) for error in errors]
    for label, key, colour in (
        ("fit", "residual", style.GREEN),
        ("held out", "held_out", style.BLUE),
    ):
        plot.add_bar(
            x=places,
            y=[getattr(error, key) for error in errors],
            name=label,
            customdata=places,
            text=names,
            textposition="none",
            marker=dict(
                color=[style.ORANGE if error.is_outlier else colour for error in errors],
                line=dict(color=style.INK, width=[2 if is_chosen else 0 for is_chosen in chosen]),
            ),
            hovertemplate="%{text}: %{y:.4f} " + unit + "<extra>" + label + "</extra>",
        )
    tick_step = -(-len(errors) // _NAMED) or 1
    short = [style.plain(Path(error.name).stem) for error in errors]
    plot.update_xaxes(tickvals=places[::tick_step], ticktext=short[::tick_step])
    return plot.update_layout(barmode="group", bargap=0.25)


def scene(work: Workspace) -> go.Figure:
    """Flange of all samples; frame, camera and board at the current one; the board or the ball that was seen."""
    opened = work.opened
    plot = style.space("recording")
    flange_poses = flange_poses_of(opened)[opened.rows]
    drawn = thinned(work.count, _MOST_FLANGES)
    nearby_poses = flange_poses[np.union1d(thinned(work.count, _MOST_CAMERAS), [work.current])]
    now = flange_poses[work.current : work.current + 1]
    found = placed(opened, nearby_poses)
    current = placed(opened, now)
    _flanges(plot, work, drawn, flange_poses[drawn, :3, 3].T)
    size = _distance(flange_poses, current)
    shapes = _Shapes(opened, size)
    seen = [flange_poses[drawn, :3, 3].T]
    if found is not None:
        seen += shapes.add(plot, found, "camera of each pose", style.GREY, 1)
        shapes.add(plot, current, "camera at the current sample", style.VIOLET, 4)
    if has_arm(opened):
        add_arm(plot, work)
        seen += [np.array([point.x, point.y, point.z], float) for point in plot.data[-2:]]
    _axes(plot, now, _AXIS * size)
    points = np.concatenate(seen, axis=1)
    low = np.nanmin(points, axis=1)
    high = np.nanmax(points, axis=1)
    margin = max(_MARGIN * float(np.linalg.norm(high - low)), _AXIS * size)
    return style.framed(plot, low - margin, high + margin)


def _distance(flange: np.ndarray, current: Placed | None) -> float:
    """mm, from the sensor to what it sees; of flange poses alone a third of their extent."""
    if current is not None:
        target = current.ball if current.boards is None else current.boards[0, :3, 3]
        if target is not None:
            return float(np.linalg.norm(current.sensors[0, :3, 3] - target)) or 100.0
    return float(np.ptp(flange[:, :3, 3], axis=0).max()) / 3 or 100.0


class _Shapes:
    """Camera and board of a run as paths. size: mm, from the camera to the board."""

    def __init__(self, opened, size: float):
        camera = camera_of(opened)
        depth = _DEPTH * size
        self.camera = (
            np.array([[0, 0, 0], [0, 0, depth]]) if camera is None else pyramid(camera, depth)
        )
        self.board = _outline(opened.recording.board)

    def add(self, plot: go.Figure, placed: Placed, name: str, colour: str, width: float) -> list:
        """Draw camera and board; list of (3, k) mm that the view has to hold."""
        path = moved(placed.sensors, self.camera)
        lines(plot, path, name, colour, width)
        seen = [path.reshape(-1, 3).T]
        if placed.boards is not None and self.board is not None:
            path = moved(placed.boards, self.board)
            is_current = width > 1
            lines(plot, path, "board" if is_current else "", style.ORANGE, 4 if is_current else 1)
            plot.data[-1].showlegend = is_current
            seen.append(path.reshape(-1, 3).T)
        if placed.ball is not None and width > 1:
            x, y, z = placed.ball[:, None]
            marker = dict(size=8, color=style.ORANGE)
            plot.add_scatter3d(
                x=x, y=y, z=z, mode="markers", name="ball", hoverinfo="skip", marker=marker
            )
        if placed.ball is not None:
            seen.append(placed.ball[:, None])
        return seen


def _outline(keys) -> np.ndarray | None:
    """(5, 3) mm: path around the marks of a board; None where the recording describes none."""
    if keys is None:
        return None
    from sensors.boards.board import Board

    board = Board.of({key: value for key, value in keys.items() if key != "fixed_to"})
    return np.asarray(board.points)[:, [0, board.columns - 1, -1, -board.columns, 0]].T


def _flanges(plot: go.Figure, work: Workspace, rows: np.ndarray, places: np.ndarray) -> None:
    """Points that a click identifies by their row."""
    x, y, z = np.round(places, 2)
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        name="flange of all samples",
        customdata=rows,
        text=work.opened.edit_ids[rows],
        marker=dict(size=4, color=style.BLUE, opacity=0.6),
        hovertemplate="sample %{text}<br>(%{x:.1f}, %{y:.1f}, %{z:.1f}) mm<extra></extra>",
    )


def _axes(plot: go.Figure, flange: np.ndarray, length: float) -> None:
    """x, y and z of the flange at the current sample."""
    for axis, colour in zip("xyz", (style.ORANGE, style.GREEN, style.BLUE)):
        end = np.stack([np.zeros(3), length * np.eye(3)["xyz".index(axis)]])
        lines(plot, moved(flange, end), f"flange {axis} at the current sample", colour, 6)
