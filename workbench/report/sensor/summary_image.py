"""`summary.png` of the sensor commands: the numbers of the page's headline and two graphs."""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np

from workbench.report import style
from workbench.report.page import IMAGE
from workbench.report.sections import Page

_INK = "#222222"
_MAX_POINTS = 5000
_NAMED = 40  # largest number of bars that carry their names
_SCANS = 60  # largest number of bars that stay distinguishable
_log = logging.getLogger(__name__)
Panel = Callable[[object], None]


def write_summary(page: Page, panels: tuple[Panel, ...], folder: Path) -> bool:
    """Write `summary.png` into a folder. Return False, with a warning in the log, if it cannot be drawn."""
    try:
        summary(page, panels).savefig(Path(folder) / IMAGE, dpi=150)
    except (ImportError, OSError, RuntimeError) as error:
        _log.warning("%s was not drawn: %s. The report page is complete without it.", IMAGE, error)
        return False
    return True


def summary(page: Page, panels: tuple[Panel, ...]):
    """A matplotlib figure: the numbers of the page on top, and one axes object per panel."""
    from matplotlib.figure import Figure

    plot = Figure(figsize=(13, 4.9), facecolor="white")
    grid = plot.add_gridspec(
        1, len(panels), left=0.06, right=0.98, bottom=0.17, top=0.68, wspace=0.2
    )
    for k, panel in enumerate(panels):
        axes = plot.add_subplot(grid[k])
        panel(axes)
        axes.spines[["top", "right"]].set_visible(False)
        axes.title.set_size(10.5)
    plot.text(0.015, 0.94, page.over, size=11, color=_INK, va="center")
    plot.text(0.985, 0.94, page.title, size=11, color=_INK, ha="right", va="center")
    for k, (name, value, unit) in enumerate(page.numbers[:4]):
        plot.text(
            0.015 + 0.245 * k,
            0.855,
            f"{value} {unit}",
            size=18,
            weight="bold",
            color=_INK,
            va="center",
        )
        plot.text(0.015 + 0.245 * k, 0.795, name, size=9, color=_INK, va="center")
    return plot


def camera(run) -> tuple[Panel, ...]:
    """RMS by image, and all residuals."""
    calibration = run.calibration

    def images(axes):
        axes.bar(
            np.arange(1, len(calibration.views) + 1), calibration.view_rms_px, color=style.BLUE
        )
        axes.set(xlabel="image", ylabel="RMS distance (px)", title="error of each image")

    def residuals(axes):
        x, y = calibration.residual[:, :: max(1, calibration.residual.shape[1] // _MAX_POINTS)]
        axes.scatter(x, y, s=3, lw=0, alpha=0.4, color=style.ORANGE)
        axes.set(xlabel="x (px)", ylabel="y (px)", title="residuals of the corners")
        axes.set_aspect("equal", adjustable="datalim")

    return images, residuals


def scanner(run) -> tuple[Panel, ...]:
    """RMS by mirror step, and distances of the points from their planes."""
    calibration = run.calibration

    def steps(axes):
        steps = calibration.scanner.steps
        axes.plot(
            steps, calibration.rms_mm, ".-", color=style.BLUE, label="points from their plane, RMS"
        )
        axes.plot(
            steps,
            calibration.sigma_stated_mm,
            ".-",
            color=style.ORANGE,
            label="1 sigma of the plane",
        )
        axes.set(
            xlabel="mirror step", ylabel="mm", title="light plane by light plane", ylim=(0, None)
        )
        style.legend_above(axes)

    def spread(axes):
        _ecdf(axes, np.abs(calibration.residual_mm[~calibration.wrong]), "fit", style.GREEN)
        if calibration.left_out is not None:
            _ecdf(axes, np.abs(calibration.left_out.residual_mm), "board pose left out", style.BLUE)
        axes.set(xlabel="distance from the plane (mm)", title="cumulative share of stripe points")
        style.legend_above(axes)

    return steps, spread


def scan(run) -> tuple[Panel, ...]:
    """Form error of the balls and uncertainty of their centres; for a long session, of evenly spaced scans."""
    drawn_scans = np.linspace(0, len(run.scans) - 1, min(len(run.scans), _SCANS)).astype(int)
    balls = [
        (scan.name, ball)
        for scan in map(run.scans.__getitem__, drawn_scans)
        for ball in scan.balls
        if ball.fit
    ]
    if len(drawn_scans) < len(run.scans):
        count_note = f", {len(drawn_scans)} of {len(run.scans):,} scans"
    else:
        count_note = ", scan by scan"

    def form(axes):
        for name, ball in balls[:12]:
            _ecdf(axes, 1000 * np.abs(ball.fit.residual[ball.fit.inliers]), name, None)
        axes.set(
            xlabel="distance from the ball (µm)",
            title="cumulative share of points, by ball",
        )
        if 0 < len(balls) <= 12:
            style.legend_above(axes, 6, 7)

    def centres(axes):
        place = np.arange(1, len(balls) + 1)
        for k, (axis, colour) in enumerate(zip("xyz", (style.BLUE, style.ORANGE, style.GREEN))):
            axes.bar(
                place + 0.27 * (k - 1),
                [1000 * b.fit.std[k] for _, b in balls],
                0.26,
                color=colour,
                label=axis,
            )
        axes.set(
            xlabel=f"ball{count_note}", ylabel="1 sigma (µm)", title="uncertainty of the centres"
        )
        style.legend_above(axes)

    return form, centres


def handeye(run) -> tuple[Panel, ...]:
    """Errors by pose, and the estimated errors of the flange poses, or of measured rotations of a target."""
    rows = run.made.poses
    unit = run.made.unit
    place = np.arange(1, len(rows) + 1)

    def errors(axes):
        axes.bar(place - 0.2, [row.residual for row in rows], 0.38, color=style.GREEN, label="fit")
        axes.bar(
            place + 0.2, [row.held_out for row in rows], 0.38, color=style.BLUE, label="held out"
        )
        axes.set(ylabel=f"RMS ({unit})", title="error by pose, recorded flange poses")
        _label_poses(axes, run.names)
        style.legend_above(axes)

    def rotated(axes):
        axes.bar(place, [row.rotation_deg for row in rows], color=style.ORANGE)
        axes.set(ylabel="deg", title="rotation error by pose")
        _label_poses(axes, run.names)

    def moved(axes):
        axes.bar(place, [row.moved_mm for row in rows], color=style.ORANGE)
        axes.set(ylabel="mm", title="estimated errors of the flange poses")
        _label_poses(axes, run.names)

    return errors, rotated if run.is_of_target_poses else moved


def _label_poses(axes, names) -> None:
    """Names of images or poses under the bars; the number of the pose where they are too many."""
    if len(names) > _NAMED:
        axes.set_xlabel("pose")
        return
    short = [Path(name).stem for name in names]
    axes.set_xticks(np.arange(1, len(names) + 1), short, rotation=60, ha="right", size=7)


def _ecdf(axes, values, label, colour):
    values = values[np.isfinite(values)]
    if values.size:
        axes.ecdf(values, label=label, color=colour, lw=1.8)
        axes.set_xlim(0, 1.05 * float(np.quantile(values, 0.998)))
        axes.yaxis.set_major_formatter("{x:.0%}")
