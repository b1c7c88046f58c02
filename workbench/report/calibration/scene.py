"""Measured points in space with their residuals as arrows, and the arm in one pose."""

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from robot_model.chain import forward
from workbench.report import style
from workbench.report.calibration.errors import Errors

_ARROW_SHARE = 0.07
"""95th percentile of the arrow lengths, as a share of the scene's diagonal."""


@dataclass(frozen=True)
class Scene:
    """Scene in the robot's root frame, mm.

    `feet` and `tips` (3, n): start and end of the arrows; `links` (3, J+2): joint origins and flange of the
    nominal arm at the pose of sample `row`; `held_points` (3, k): points measured in that pose;
    `scale`: drawn length over true length; `anchor`: description of the feet.
    """

    feet: np.ndarray
    tips: np.ndarray
    links: np.ndarray
    held_points: np.ndarray
    row: int
    scale: float
    anchor: str


def section(calibration, errors: Errors) -> dict:
    """The 3-D figure, and the sentences on its content and scale."""
    scene = scene_of(calibration)
    sample = int(calibration.recording.sample_ids[scene.row])
    return {
        "figure": style.packed(figure(scene, errors)),
        "scale": f"{scene.scale:,.0f}",
        "anchor": scene.anchor,
        "sample": sample,
        "thinned": style.thinned_sentence(len(errors.is_held_out)),
    }


def scene_of(calibration) -> Scene:
    """Feet, arrows and arm. If all points coincide, the arrows start at the flange."""
    flange, links, middle_sample = arm(calibration)
    points = calibration.points
    residual = calibration.residual_in_root
    is_one_point = _diagonal(points) < 0.05 * _diagonal(np.hstack([flange, links]))
    feet, anchor = (
        (flange, "the nominal flange of its pose")
        if is_one_point
        else (points, "its measured point")
    )
    scale = arrow_scale(np.hstack([feet, links]), residual)
    same = calibration.recording.poses == calibration.recording.poses[middle_sample]
    return Scene(
        feet, feet + scale * residual, links, points[:, same], middle_sample, scale, anchor
    )


def arm(calibration) -> tuple[np.ndarray, np.ndarray, int]:
    """Flange origins (3, n), links (3, J+2) of the pose nearest to the median pose, and its row."""
    recording = calibration.recording
    robot = calibration.robot
    variables = robot.mixing @ recording.joints.T
    middle = np.median(variables, axis=1, keepdims=True)
    spread = np.maximum(variables.std(1, keepdims=True), 1e-9)
    middle_sample = int(np.argmin((((variables - middle) / spread) ** 2).sum(0)))
    frames = forward(robot, variables, links=True)
    links = np.vstack(
        [
            frames.pivot[:1, :, middle_sample],
            frames.origin[:, :, middle_sample],
            frames.end_origin[None, :, middle_sample],
        ]
    )
    return frames.end_origin, links.T, middle_sample


def arrow_scale(places: np.ndarray, residual: np.ndarray) -> float:
    """Enlargement, 1, 2 or 5 times a power of ten, at which 95 % of the arrows are readable."""
    length = max(float(np.percentile(np.linalg.norm(residual, axis=0), 95)), 1e-12)
    return arrow_step(_ARROW_SHARE * _diagonal(places) / length)


def arrow_step(wanted: float) -> float:
    """The largest of 1, 2 or 5 times a power of ten up to `wanted`, and no less than 1."""
    wanted = max(wanted, 1.0)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9)))


def figure(scene: Scene, errors: Errors) -> go.Figure:
    """Arrows as lines from a coloured point; the arm as a thick line with its joints."""
    drawn = style.thinned(len(errors.is_held_out))
    feet = scene.feet[:, drawn]
    tips = scene.tips[:, drawn]
    distance = errors.distance[drawn]
    plot = go.Figure(
        layout=dict(
            template="none",
            height=660,
            margin=dict(l=0, r=0, t=8, b=0),
            scene=axes(),
            legend=dict(orientation="h", x=0, y=0, yanchor="top"),
        )
    )
    _add_arrows(plot, feet, tips, distance)
    _add_points(plot, feet, distance)
    _add_arm(plot, scene)
    return plot


def _add_arrows(plot, feet, tips, distance):
    """One trace with gaps: three places and three colours per arrow (foot, tip, gap)."""
    path = np.stack([feet, tips, np.full_like(feet, np.nan)], axis=2).reshape(3, -1)
    x, y, z = np.round(path, 3)
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="lines",
        name="residual",
        showlegend=False,  # the legend shows one colour only
        hoverinfo="skip",
        line=dict(color=np.repeat(np.round(distance, 5), 3), width=3, **_colours(distance)),
        connectgaps=False,
    )


def _colours(distance) -> dict:
    """The same colours for arrows and points, clipped at the 98th percentile."""
    return dict(colorscale=style.LENGTHS, cmin=0, cmax=float(np.percentile(distance, 98)))


def _add_points(plot, feet, distance):
    x, y, z = np.round(feet, 3)
    bar = dict(
        title=dict(text="residual (mm)", side="right"),
        thickness=12,
        len=0.6,
        x=1.0,
        xanchor="right",
    )
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        name="samples",
        customdata=np.round(distance, 5),
        marker=dict(
            size=2.2,
            opacity=0.75,
            color=np.round(distance, 5),
            colorbar=bar,
            **_colours(distance),
        ),
        hovertemplate="residual %{customdata:.4f} mm<br>(%{x:.1f}, %{y:.1f}, %{z:.1f}) mm<extra></extra>",
    )


def _add_arm(plot, scene):
    x, y, z = scene.links
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="lines+markers",
        name="nominal arm in one pose",
        hoverinfo="skip",
        meta="ink",
        line=dict(color=style.GREY, width=12),
        marker=dict(size=6, color=style.GREY),
    )
    flange = scene.links[:, -1]
    stalks = [np.stack([flange, point, np.full(3, np.nan)]) for point in scene.held_points.T]
    x, y, z = np.concatenate(stalks).T
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="lines",
        name="flange to measured point",
        hoverinfo="skip",
        meta="ink",
        line=dict(color=style.GREY, width=4),
    )


def axes() -> dict:
    """Equal axes in mm, and the viewpoint."""
    axis = dict(showbackground=False, showspikes=False, nticks=6)
    return dict(
        aspectmode="data",
        camera=dict(eye=dict(x=1.15, y=-1.3, z=0.55), center=dict(x=0, y=0, z=-0.08)),
        **{f"{a}axis": dict(title=dict(text=f"{a} (mm)"), **axis) for a in "xyz"},
    )


def _diagonal(places):
    return float(np.linalg.norm(np.ptp(places, axis=1)))
