"""Images with what was detected, light planes and mirror axis in space, clouds with the balls fitted to them."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from workbench.app.data.opened import Opened
from workbench.app.data.recorded_images.image_errors import ImageError
from workbench.app.data.recorded_images.images import Overlay
from workbench.app.data.sensor import cloud_of, scanner_of
from workbench.app.figures import style
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.report.calibration.scene import arrow_step
from workbench.report.sensor import space

_NEAR_MM = 1.0
_NAMED = 24
"""More names of images overlap below the bars."""
_SIGNED = [[0, style.BLUE], [0.5, "#c3c7cd"], [1, "#b3261e"]]
"""Colours from negative to positive deviations; zero is grey, so that it stands out on white."""
_FROM_SENSOR = dict(
    eye=dict(x=0.95, y=-0.5, z=-2.1), up=dict(x=0, y=-1, z=0), center=dict(x=0, y=0.12, z=0)
)
"""The view from the sensor, whose z axis points to the object; low enough for the title of the lowest axis."""
_OVERVIEW = dict(eye=dict(x=1.8, y=-1.9, z=0.8), center=dict(x=0, y=0, z=-0.1))


def image(shown: Overlay, residual: np.ndarray | None = None) -> go.Figure:
    """The image with corners, stripe and, where known, arrows from detected to predicted corners."""
    width, height = shown.size
    plot = style.plane("x (px)", "y (px)", f"image-{shown.name}")
    plot.add_layout_image(
        source=shown.source,
        x=-0.5,
        y=-0.5,
        sizex=width,
        sizey=height,
        xref="x",
        yref="y",
        sizing="stretch",
        layer="below",
    )
    plot.update_xaxes(range=[-0.5, width - 0.5], showgrid=False, zeroline=False, constrain="domain")
    plot.update_yaxes(
        range=[height - 0.5, -0.5],
        showgrid=False,
        zeroline=False,
        scaleanchor="x",
        constrain="domain",
    )
    _ground(plot, width, height)
    _marks(plot, shown.corners, f"{shown.corners.shape[1]} corners", "#ff7f0e", "circle-open", 9)
    _marks(
        plot, shown.stripe, f"stripe, {shown.stripe.shape[1]} points drawn", "#00e5ff", "circle", 3
    )
    if residual is not None and residual.size:
        _reprojection(plot, shown.corners, residual)
    return plot


def error_bars(errors: Sequence[ImageError], chosen: int, excluded: Collection[str]) -> go.Figure:
    """RMS reprojection error of each board image, and that of all; a click gives the place in images.csv."""
    plot = style.plane("image", "RMS reprojection error (px)", "image errors")
    places = list(range(len(errors)))
    colours = [style.GREY if error.name in excluded else style.BLUE for error in errors]
    plot.add_bar(
        x=places,
        y=[error.rms for error in errors],
        customdata=[error.place for error in errors],
        text=[style.plain(error.name) for error in errors],
        textposition="none",
        marker=dict(
            color=colours,
            line=dict(color=style.INK, width=[3 * (error.place == chosen) for error in errors]),
        ),
        hovertemplate="%{text}: %{y:.4f} px<extra></extra>",
    )
    overall = float(np.sqrt(np.mean([error.rms**2 for error in errors])))
    plot.add_hline(
        y=overall,
        line=dict(color=style.ORANGE, width=2, dash="dash"),
        annotation_text=f"all images: {overall:.4g} px",
        annotation_position="top right",
    )
    tick_step = -(-len(errors) // _NAMED) or 1
    names = [style.plain(Path(error.name).stem) for error in errors]
    plot.update_xaxes(tickvals=places[::tick_step], ticktext=names[::tick_step])
    return plot.update_layout(showlegend=False, bargap=0.25)


def _ground(plot, width: int, height: int) -> None:
    """An invisible mark, and the nearest mark at any distance, so that a click anywhere in the image counts."""
    plot.add_scatter(
        x=[(width - 1) / 2],
        y=[(height - 1) / 2],
        mode="markers",
        marker=dict(size=1, opacity=0),
        hoverinfo="none",
        showlegend=False,
    )
    plot.update_layout(hoverdistance=-1)


def _marks(plot, pixels: np.ndarray, name: str, colour: str, symbol: str, size: float) -> None:
    if pixels.shape[1]:
        x, y = np.round(pixels, 2)
        line = dict(width=2 if symbol.endswith("open") else 0)  # an outline hides small discs
        marker = dict(color=colour, symbol=symbol, size=size, line=line)
        plot.add_scattergl(x=x, y=y, mode="markers", name=name, marker=marker)


def _reprojection(plot, corners: np.ndarray, residual: np.ndarray) -> None:
    length = float(np.percentile(np.sqrt((residual**2).sum(0)), 95))
    scale = arrow_step(20 / max(length, 1e-9))
    rms = float(np.sqrt((residual**2).sum(0).mean()))
    gap = np.full_like(corners, np.nan)
    x, y = np.stack([corners, corners + scale * residual, gap], axis=2).reshape(2, -1).round(2)
    name = f"reprojection error, RMS {rms:.3f} px, enlarged {scale:,.0f} times"
    plot.add_scatter(
        x=x, y=y, mode="lines", name=name, line=dict(color="#ff2fd0", width=2), connectgaps=False
    )


def planes(opened: Opened) -> go.Figure:
    """Light planes within the camera's field, the camera as a pyramid, and the mirror's axis."""
    plot = style.space("planes")
    plot.update_layout(scene_camera=_OVERVIEW)
    scanner = scanner_of(opened)
    if scanner is None:
        return plot
    near_limit, far_limit = scanner.volume if scanner.volume is not None else (100.0, 200.0)
    space.light_planes(
        plot, space.patches(scanner.planes, scanner.camera, near_limit, far_limit), "light planes"
    )
    space.lines(plot, space.pyramid(scanner.camera, near_limit)[None], "camera", style.INK, 3)
    if scanner.mirror is not None:
        axis = np.asarray(scanner.mirror.axis)
        point = np.asarray(scanner.mirror.point)
        ends = np.stack([point - 25 * axis, point + 25 * axis])
        space.lines(plot, ends[None], "mirror axis", style.VIOLET, 7)
    return plot


def cloud(opened: Opened, place: int) -> go.Figure:
    """A cloud coloured by its distance from the fitted balls; the balls are translucent."""
    plot = style.space("cloud")
    plot.update_layout(scene_camera=_FROM_SENSOR)
    found = cloud_of(opened, place)
    if found is None:
        return plot
    is_on_ball = np.isfinite(found.deviation)
    if (~is_on_ball).any():
        space.points(
            plot, found.points[:, ~is_on_ball], "not on a ball", size=1.6, color=style.GREY
        )
    if is_on_ball.any():
        _deviations(plot, found.points[:, is_on_ball], 1000 * found.deviation[is_on_ball])
    for ball in found.balls:
        centre = np.array([ball["x_mm"], ball["y_mm"], ball["z_mm"]])
        space.ball(plot, centre, ball["radius_mm"], ball_name(ball))
    return plot


def _deviations(plot, points: np.ndarray, deviation: np.ndarray) -> None:
    top = _colour_range(deviation)
    x, y, z = np.round(points, 3)
    bar = dict(title=dict(text="from the fitted ball (µm)", side="right"), thickness=14, len=0.7)
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        name="points on balls",
        marker=dict(
            size=2.6, color=deviation, colorscale=_SIGNED, cmin=-top, cmax=top, colorbar=bar
        ),
        customdata=np.round(deviation, 2),
        hovertemplate="%{customdata} µm<extra></extra>",
    )


def ball_map(opened: Opened, place: int) -> go.Figure:
    """Distance from the fitted balls by direction from their centres, seen from the sensor.

    Both angles in degrees are zero towards the sensor: the first is counted along x, the second along y.
    """
    plot = style.plane("direction along x (deg)", "direction along y (deg)", "ball-map")
    found = cloud_of(opened, place)
    if found is None:
        return plot
    is_on_ball = np.isfinite(found.deviation)
    points = found.points[:, is_on_ball]
    deviation = 1000 * found.deviation[is_on_ball]
    top = _colour_range(deviation)
    for ball in found.balls:
        angles, is_near = _directions(points, ball)
        plot.add_scattergl(
            x=np.round(angles[0], 2),
            y=np.round(angles[1], 2),
            mode="markers",
            name=ball_name(ball),
            customdata=np.round(deviation[is_near], 2),
            hovertemplate="%{customdata} µm<extra></extra>",
            marker=dict(
                size=6,
                color=deviation[is_near],
                colorscale=_SIGNED,
                cmin=-top,
                cmax=top,
                colorbar=dict(title=dict(text="from the ball (µm)", side="right"), thickness=14),
            ),
        )
    return plot.update_yaxes(scaleanchor="x")


def _directions(points: np.ndarray, ball: Mapping) -> tuple[np.ndarray, np.ndarray]:
    """(2, k) deg directions of the points near a ball from its centre, and (n,) bool which points these are."""
    displacement = points - _centre_of(ball)
    length = np.linalg.norm(displacement, axis=0)
    is_near = np.abs(length - ball["radius_mm"]) < _NEAR_MM
    unit = displacement[:, is_near] / length[is_near]
    return np.rad2deg(np.arctan2(unit[:2], -unit[2])), is_near


def _centre_of(ball: Mapping) -> np.ndarray:
    """(3, 1) mm."""
    return np.array([[ball["x_mm"]], [ball["y_mm"]], [ball["z_mm"]]])


def _colour_range(deviation: np.ndarray) -> float:
    """Five robust standard deviations."""
    if not deviation.size:
        return 1.0
    return max(5 * MEDIAN_TO_SIGMA * float(np.median(np.abs(deviation))), 1e-6)


def ball_name(ball: Mapping) -> str:
    """Number and RMS of a fitted ball."""
    number = "ball" if ball.get("ball") is None else f"ball {ball['ball']}"
    return f"{number}, RMS {1000 * ball['rms_mm']:.1f} µm"
