"""`summary.png`: the result of a calibration in one image."""

import logging
import textwrap
from pathlib import Path

import numpy as np

from workbench.report import style
from workbench.report.calibration import scene as space
from workbench.report.calibration.errors import ROTATION, Errors
from workbench.report.text import rounded

_INK = "#222222"
_STAGE_NAME = 18  # characters of a stage's name on one line: what the left margin holds
_log = logging.getLogger(__name__)


def write_summary(calibration, errors: Errors, path: Path) -> bool:
    """Write the PNG at `path`. Return False, with a warning in the log, if it cannot be drawn.

    matplotlib comes with PyVista and needs neither a screen nor a GPU.
    """
    try:
        draw_summary(calibration, errors).savefig(path, dpi=150)
    except (ImportError, OSError, RuntimeError) as error:
        _log.warning(
            "%s was not drawn: %s. The report page is complete without it.", path.name, error
        )
        return False
    return True


def draw_summary(calibration, errors: Errors):
    """A matplotlib figure: stages, distribution of the errors, and residuals in space."""
    from matplotlib.figure import Figure

    plot = Figure(figsize=(13, 4.9), facecolor="white")
    grid = plot.add_gridspec(
        1, 3, left=0.125, right=0.965, bottom=0.14, top=0.78, wspace=0.22, width_ratios=(1, 1, 1.25)
    )
    _stages(plot.add_subplot(grid[0]), calibration)
    _spread(plot.add_subplot(grid[1]), calibration, errors)
    _space(plot.add_subplot(grid[2], projection="3d"), calibration)
    held_out = calibration.held_out
    words = f"{rounded(held_out['rms_mm'])} mm"
    if ROTATION.key("rms") in held_out:
        words += f", {rounded(held_out[ROTATION.key('rms')])} deg"
    plot.text(0.015, 0.9, f"{words} held-out RMS", size=21, weight="bold", color=_INK)
    plot.text(
        0.985,
        0.905,
        calibration.recording.title or calibration.recording.name,
        size=11,
        color=_INK,
        ha="right",
    )
    return plot


def _stages(axes, calibration):
    names = ["nominal", *(s.name for s in calibration.stages), "result"]
    lines = [textwrap.fill(name, _STAGE_NAME) for name in names]
    values = [
        calibration.nominal["rms_mm"],
        *(s.held_out_rms_mm for s in calibration.stages),
        calibration.held_out["rms_mm"],
    ]
    is_retained = [True, *(s.earned for s in calibration.stages), True]
    rows = np.arange(len(names))
    axes.step(
        np.array(values)[is_retained], rows[is_retained], where="post", color=style.BLUE, lw=1
    )
    axes.scatter(
        values, rows, color=[style.BLUE if k else style.GREY for k in is_retained], zorder=3
    )
    for value, y in zip(values, rows):
        axes.annotate(
            rounded(value), (value, y), (8, 0), textcoords="offset points", va="center", size=8.5
        )
    axes.set(
        yticks=rows,
        yticklabels=lines,
        xscale="log",
        xlabel="RMS of the 3-D distance (mm)",
        title="held-out error by stage",
    )
    axes.set(ylim=(len(names) - 0.5, -0.5))
    _quiet(axes, min(values) / 1.25, max(values) * 1.6)


def _spread(axes, calibration, errors):
    nominal = np.linalg.norm(calibration.nominal_residual, axis=0)
    for name, distance, colour in (
        ("nominal", nominal, style.GREY),
        ("held out", errors.distance[errors.is_held_out], style.BLUE),
    ):
        axes.ecdf(distance[np.isfinite(distance)], label=name, color=colour, lw=2)
    axes.set(xscale="log", xlabel="3-D distance (mm)", title="cumulative share of samples")
    axes.yaxis.set_major_formatter("{x:.0%}")
    style.legend_above(axes)
    all_errors = np.concatenate([nominal, errors.distance[errors.is_held_out]])
    _quiet(axes, all_errors[all_errors > 0].min(), np.nanmax(all_errors))


def _space(axes, calibration):
    scene = space.scene_of(calibration)
    rows = style.thinned(scene.feet.shape[1])[:: max(1, scene.feet.shape[1] // 600)]
    feet = scene.feet[:, rows]
    tips = scene.tips[:, rows]
    axes.quiver(*feet, *(tips - feet), color=style.ORANGE, lw=0.8, arrow_length_ratio=0.25)
    axes.plot(*scene.links, color="#666666", lw=4, marker="o", ms=5)
    axes.set(
        xlabel="x (mm)",
        ylabel="y (mm)",
        zlabel="z (mm)",
        title=f"residuals, enlarged {scene.scale:,.0f} times",
    )
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    axes.locator_params(nbins=4)
    axes.view_init(elev=18, azim=-50)
    axes.title.set_size(10.5)


def _quiet(axes, low, high):
    """Logarithmic axis from `low` to `high` with plain tick labels, a light grid, two spines."""
    ticks = style.log_axis(low, high, max_ticks=6)
    axes.set_xlim(low, high)
    axes.set_xticks(ticks["tickvals"], ticks["ticktext"])
    axes.set_xticks([], minor=True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, which="major")
    axes.title.set_size(10.5)
