"""Figures of the poses of an arm: range of every joint, and the flange in the base frame."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from robot_model.chain import forward
from workbench.report import style
from workbench.report.sensor import space

_MOST_POINTS = 4000


def flange_places(robot, joints: np.ndarray) -> np.ndarray:
    """(3, n) mm: origin of the nominal flange for readings (n, R) in rad and mm."""
    return forward(robot, robot.mixing @ joints.T).end_origin


def poses_in_space(point_sets: Sequence[tuple[str, np.ndarray, str, float]]) -> go.Figure:
    """Flange places (3, n) mm of several sets of poses: name, places, colour and size of the marks."""
    drawn = space.space()
    for name, places, colour, size in point_sets:
        step = max(1, places.shape[1] // _MOST_POINTS)
        space.points(drawn, places[:, ::step], name, size=size, color=colour)
    space.points(drawn, np.zeros((3, 1)), "base", size=5, color=style.ORANGE, symbol="diamond")
    return drawn


def joint_ranges(robot, reading_sets: Sequence[tuple[str, np.ndarray, str]]) -> go.Figure:
    """Range of each joint in sets of readings (n, R) rad or mm: name, readings and colour; over the stated limits."""
    count = robot.mixing.shape[1]
    slides = (robot.prismatic @ np.abs(robot.mixing)) > 0
    factor = np.where(slides, 1.0, 180 / np.pi)
    names = [f"joint {k + 1}" for k in range(count)]
    drawn = style.figure(80 + 42 * count, "reading (deg, mm for prismatic joints)")
    low, high = factor * robot.limits.T
    if np.isfinite(high - low).any():
        _bars(drawn, "limits", names, low, high, style.GREY, 0.75)
    for number, (name, readings, colour) in enumerate(reading_sets):
        ends = factor * readings.min(0), factor * readings.max(0)
        _bars(drawn, name, names, *ends, colour, 0.5 / (number + 1))
    drawn.update_layout(barmode="overlay")
    drawn.update_yaxes(autorange="reversed")
    return drawn


def _bars(drawn, name, names, low, high, colour, width) -> None:
    opacity = 0.3 if name == "limits" else 0.85
    shown = dict(orientation="h", name=name, marker_color=colour, opacity=opacity, width=width)
    drawn.add_bar(y=names, x=high - low, base=low, **shown)
