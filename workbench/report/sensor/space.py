"""3-D figures: cameras as pyramids, boards, light planes, mirror axis and point clouds, in mm."""

import numpy as np
import plotly.graph_objects as go

from workbench.report import style
from workbench.report.calibration.scene import axes

_MOST_PLANES = 16


def space(height: int = 600, eye: tuple[float, float, float] = (1.2, -1.4, 0.7)) -> go.Figure:
    """An empty scene with equal axes in mm."""
    scene = axes()
    scene["camera"] = dict(eye=dict(zip("xyz", eye)))
    return go.Figure(
        layout=dict(
            template="none",
            height=height,
            margin=dict(l=0, r=0, t=8, b=0),
            scene=scene,
            legend=dict(orientation="h", x=0, y=0, yanchor="top"),
        )
    )


def lines(
    plot: go.Figure, paths: np.ndarray, name: str, colour: str, width: float = 2, ink: bool = False
) -> None:
    """Add paths (k, p, 3) mm as one trace with gaps between them."""
    paths = np.asarray(paths, float)
    gap = np.full((len(paths), 1, 3), np.nan)
    x, y, z = np.round(np.concatenate([paths, gap], axis=1).reshape(-1, 3).T, 3)
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="lines",
        name=name,
        hoverinfo="skip",
        line=dict(color=colour, width=width),
        connectgaps=False,
        meta="ink" if ink else None,
    )


def points(
    plot: go.Figure,
    places: np.ndarray,
    name: str,
    values=None,
    unit: str = "",
    size: float = 2.0,
    **marker,
):
    """Add points (3, n) mm, coloured by values (n,) where they are given."""
    x, y, z = np.round(places, 3)
    if values is None:
        shown = {}
    else:
        shown = dict(color=values, colorscale="Viridis", showscale=True, colorbar=_bar(unit))
    text = "" if values is None else "%{customdata:.4g} " + unit + "<br>"
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers",
        name=name,
        customdata=None if values is None else np.asarray(values),
        marker={"size": size, **shown, **marker},
        hovertemplate=text + "(%{x:.2f}, %{y:.2f}, %{z:.2f}) mm<extra>" + name + "</extra>",
    )


def _bar(unit: str) -> dict:
    return dict(
        title=dict(text=unit, side="right"),
        thickness=12,
        len=0.6,
        x=1.0,
        xanchor="right",
        tickformat=",.3~r",
    )


def moved(poses: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(k, p, 3) places of a shape (p, 3) mm under poses (k, 4, 4)."""
    return np.einsum("kij,pj->kpi", poses[:, :3, :3], shape) + poses[:, None, :3, 3]


def pyramid(camera, depth: float) -> np.ndarray:
    """(p, 3) mm: line path of the field of view of a camera up to `depth` mm."""
    width, height = camera.size
    u = np.array([0, width, width, 0]) - 0.5
    v = np.array([0, 0, height, height]) - 0.5
    corners = (
        np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(4)], 1) * depth
    )
    eye = np.zeros(3)
    return np.stack(
        [
            eye,
            corners[0],
            corners[1],
            eye,
            corners[2],
            corners[3],
            eye,
            corners[0],
            corners[3],
            corners[2],
            corners[1],
        ]
    )


def patches(planes: np.ndarray, camera, near_mm: float, far_mm: float) -> np.ndarray:
    """(k, 4, 3) mm: corners of light planes (4, k), cut to the camera's field from `near_mm` to `far_mm` mm."""
    plane_axis = int(
        np.abs(planes[:2]).mean(1).argmax()
    )  # the image axis normal to the light planes
    other = 1 - plane_axis
    size = camera.size[1 - plane_axis]
    if other == 0:
        focal, middle = camera.fx, camera.cx
    else:
        focal, middle = camera.fy, camera.cy
    corners = np.empty((planes.shape[1], 4, 3))
    for k, (depth, pixel) in enumerate(
        [(near_mm, 0), (near_mm, size), (far_mm, size), (far_mm, 0)]
    ):
        side = (pixel - middle) / focal * depth
        corners[:, k, 2], corners[:, k, other] = depth, side
        corners[:, k, plane_axis] = (
            -(planes[other] * side + planes[2] * depth + planes[3]) / planes[plane_axis]
        )
    return corners


def light_planes(plot: go.Figure, corners: np.ndarray, name: str) -> None:
    """Add at most a few of the quadrilaterals (k, 4, 3) mm as translucent surfaces."""
    shown = np.unique(np.linspace(0, len(corners) - 1, min(len(corners), _MOST_PLANES)).astype(int))
    if len(shown) == len(corners):
        label = name
    else:
        label = f"{name}, {len(shown)} of {len(corners)} drawn"
    corners = corners[shown]
    x, y, z = np.round(corners.reshape(-1, 3).T, 3)
    first = 4 * np.arange(len(corners))
    triangles = np.concatenate(
        [[first, first + 1, first + 2], [first, first + 2, first + 3]], axis=1
    )
    i, j, k = triangles
    plot.add_mesh3d(
        x=x,
        y=y,
        z=z,
        i=i,
        j=j,
        k=k,
        color=style.ORANGE,
        opacity=0.18,
        name=label,
        showlegend=True,
        hoverinfo="skip",
    )
    lines(
        plot,
        np.concatenate([corners, corners[:, :1]], axis=1),
        "edges of the light planes",
        style.ORANGE,
        1.5,
    )


def ball(
    plot: go.Figure, centre: np.ndarray, radius: float, name: str, colour: str = style.ORANGE
) -> None:
    """Add a ball (centre (3,), radius, mm) as a translucent surface."""
    longitude, latitude = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    x, y, z = np.round(
        np.stack(
            [
                np.cos(longitude) * np.sin(latitude),
                np.sin(longitude) * np.sin(latitude),
                np.cos(latitude),
            ]
        )
        * radius
        + np.reshape(centre, (3, 1, 1)),
        3,
    )
    plot.add_surface(
        x=x,
        y=y,
        z=z,
        showscale=False,
        opacity=0.35,
        name=name,
        showlegend=True,
        hoverinfo="skip",
        colorscale=[[0, colour], [1, colour]],
    )
