"""Error over the workspace as an interpolated volume, cut open around the arm: an image and a file for ParaView."""

import logging
import os
from pathlib import Path

import numpy as np

_CELLS = 48  # along the longest side
_MAX_SPACINGS = (
    2.5  # a point farther than this from every pose, in spacings of the poses, has no value
)
_SIZE = (1100, 820)
_log = logging.getLogger(__name__)


def volume(places: np.ndarray, error: np.ndarray):
    """A PyVista grid with `error_mm`, a Gaussian-weighted mean over the nearest poses; nan far from all poses.

    places: (3, n) flange of each pose, root frame, mm; error: (n,) mm.
    """
    import pyvista

    low = places.min(1)
    high = places.max(1)
    step = float((high - low).max()) / _CELLS
    counts = np.ceil((high - low) / step).astype(int) + 1
    grid = pyvista.ImageData(dimensions=counts, spacing=(step,) * 3, origin=low)
    cloud = pyvista.PolyData(np.ascontiguousarray(places.T))
    cloud["error_mm"] = error
    radius = _MAX_SPACINGS * float(np.prod(high - low) / places.shape[1]) ** (1 / 3)
    return grid.interpolate(
        cloud, radius=radius, sharpness=3.0, strategy="null_value", null_value=np.nan
    )


def write_volume(
    places: np.ndarray, error: np.ndarray, arm: np.ndarray, folder: Path, name: str
) -> Path | None:
    """Write `name`.vti and `name`.png into the folder. Returns the path of the PNG, None if drawing fails.

    places (3, n), error (n,): as in `volume`; arm: (3, k) origins of base, joints and flange, mm.
    """
    mesh = volume(places, error)
    mesh.save(folder / f"{name}.vti")
    try:
        _drawn(mesh, arm, folder / f"{name}.png")
    except (ImportError, OSError, RuntimeError) as wrong:
        _log.warning(
            "%s.png was not drawn: %s. The maps of points are complete without it.",
            name,
            wrong,
        )
        return None
    return folder / f"{name}.png"


def _drawn(grid, arm: np.ndarray, path: Path):
    """Draw the volume with the quarter towards the viewer cut away, and the arm in it."""
    import pyvista

    if not os.environ.get("DISPLAY"):  # else VTK looks for a screen first and warns
        os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    finite = grid["error_mm"][np.isfinite(grid["error_mm"])]
    limits = (0.0, float(np.percentile(finite, 99)))
    scale = dict(cmap="viridis", clim=limits, scalar_bar_args=_BAR)
    base = arm[:, 0]
    solid = grid.threshold(
        -1.0, scalars="error_mm", all_scalars=True
    )  # drops cells without a value
    (_, right), (front_y, _), upright = np.asarray(solid.bounds).reshape(3, 2)
    front = [base[0], right, front_y, base[1], *upright]
    plotter = pyvista.Plotter(off_screen=True, window_size=list(_SIZE))
    plotter.set_background("white")
    plotter.add_mesh(
        solid.clip_box(front, invert=True), scalars="error_mm", ambient=0.7, diffuse=0.3, **scale
    )
    plotter.add_mesh(
        pyvista.lines_from_points(arm.T).tube(radius=0.012 * grid.length), color="#d9480f"
    )
    plotter.show_bounds(
        color="#444444",
        grid=False,
        location="outer",
        font_size=11,
        n_xlabels=3,
        n_ylabels=3,
        n_zlabels=3,
        fmt="%.0f",
        xtitle="x (mm)",
        ytitle="y (mm)",
        ztitle="z (mm)",
    )
    plotter.camera_position = "iso"
    plotter.camera.azimuth = -90
    plotter.camera.zoom(0.88)
    plotter.screenshot(str(path))
    plotter.close()


_BAR = dict(
    title="error (mm)",
    color="#222222",
    vertical=True,
    n_labels=5,
    fmt="%.3g",
    title_font_size=18,
    label_font_size=15,
    width=0.06,
    height=0.6,
    position_x=0.9,
    position_y=0.2,
)
