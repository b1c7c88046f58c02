"""Residuals as needles in space: wide at the measured point, pointed at the predicted one.

All needles of a figure are one mesh of flat triangles. Lines with a width and round marks consist of many more
triangles, and where WebGL is rendered in software the time of a frame is that of its triangles.
"""

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go

from workbench.app.figures import style

NAME = "residuals"
CORNERS = 4
"""Vertices of a needle: three around the measured point, and the tip."""
_RADIUS = 0.004
"""Radius at the measured point, as a share of the diagonal of the scene."""
_FACES = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
_UNLIT = dict(ambient=1.0, diffuse=0.0, specular=0.0, fresnel=0.0)
"""Every needle has exactly the colour of its length, from whichever side it is seen."""


@dataclass(frozen=True)
class Needles:
    """k arrows.

    points: (3, k) mm; vectors: (3, k) mm as drawn; rows: (k,) of the residuals; numbers: (k,) of the samples;
    lengths: (k,) mm of the residuals.
    """

    points: np.ndarray
    vectors: np.ndarray
    rows: np.ndarray
    numbers: np.ndarray
    lengths: np.ndarray


def colour_top(lengths: np.ndarray) -> float:
    """Length in mm from which all needles have the darkest colour."""
    return float(np.percentile(lengths, 98)) if lengths.size else 1.0


def add_needles(plot: go.Figure, needles: Needles, diagonal: float, **options) -> None:
    """Add the needles to a scene.

    diagonal: of the scene, mm; options: of plotly's mesh3d, such as the colour of the largest length `cmax`.
    """
    x, y, z = rounded(corners(needles.points, needles.vectors, _RADIUS * diagonal))
    first = CORNERS * np.arange(len(needles.rows))[:, None]
    a, b, c = (first + face for face in _FACES.T.astype(np.int32))
    settings = dict(
        name=NAME,
        cmax=colour_top(needles.lengths),
        colorbar=dict(title=dict(text="residual (mm)", side="right"), thickness=14, len=0.7),
        hovertemplate="sample %{text}: %{intensity:.4f} mm<extra></extra>",
    )
    plot.add_mesh3d(
        x=x,
        y=y,
        z=z,
        i=a.ravel().astype(np.int32),
        j=b.ravel().astype(np.int32),
        k=c.ravel().astype(np.int32),
        intensity=np.repeat(needles.lengths, CORNERS).astype(np.float32),
        customdata=np.repeat(needles.rows, CORNERS).astype(np.int32),
        text=np.repeat(needles.numbers, CORNERS),
        colorscale=style.LENGTHS,
        cmin=0,
        flatshading=True,
        lighting=_UNLIT,
        **{**settings, **options},
    )


def corners(points: np.ndarray, vectors: np.ndarray, radius: float) -> np.ndarray:
    """(3, 4 k) mm: three corners around each measured point (3, k), across its vector (3, k), and the tip."""
    smallest_axis = np.argmin(np.abs(vectors), axis=0)
    perpendicular = _unit(np.cross(vectors.T, np.eye(3)[smallest_axis]).T, fallback=(1.0, 0.0, 0.0))
    other = _unit(np.cross(vectors.T, perpendicular.T).T, fallback=(0.0, 1.0, 0.0))
    ring = []
    for angle in 2 * np.pi * np.arange(3) / 3:
        ring.append(points + radius * (np.cos(angle) * perpendicular + np.sin(angle) * other))
    return np.stack([*ring, points + vectors], axis=2).reshape(3, -1)


def _unit(vectors: np.ndarray, fallback) -> np.ndarray:
    """Vectors (3, k) of length one; `fallback` in place of those of length zero."""
    lengths = np.linalg.norm(vectors, axis=0)
    found = np.where(lengths > 0, vectors, np.array(fallback)[:, None])
    return found / np.where(lengths > 0, lengths, 1.0)


def rounded(places: np.ndarray) -> np.ndarray:
    """Places in mm in single precision, 0.001 mm at 10 m: half as much to send, and more than a screen shows."""
    return np.round(places, 2).astype(np.float32)


def shafts(x, y, z) -> np.ndarray:
    """(3, 3 k) mm: from the vertices of needles, the measured point, the tip and a gap (nan) of each."""
    found = np.array([x, y, z], float).reshape(3, -1, CORNERS)
    base = found[:, :, :3].mean(axis=2)
    tip = found[:, :, 3]
    return np.stack([base, tip, np.full_like(tip, np.nan)], axis=2).reshape(3, -1)
