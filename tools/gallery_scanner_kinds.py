"""docs/how-to/scanner-kinds.png: joined clouds of two moving scanners, and the angle error of a turntable.

`python tools/gallery_scanner_kinds.py` renders the examples of `workbench new` and draws them (about two minutes).
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
IMAGE = ROOT / "docs" / "how-to" / "scanner-kinds.png"


def main() -> None:
    """Draw the image."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.4), facecolor="white")
    grid = figure.add_gridspec(
        1, 4, width_ratios=(1, 1, 0.14, 0.9), left=0.02, right=0.98, bottom=0.14, top=0.9
    )
    for place, kind in enumerate(("fixed-plane", "turntable")):
        with TemporaryDirectory() as folder:
            scans, calibration = _scanned(kind, Path(folder))
        axes = figure.add_subplot(grid[place], projection="3d")
        _cloud(axes, scans, kind)
    _angles(figure.add_subplot(grid[3]), calibration)
    figure.savefig(IMAGE, dpi=110)


def _scanned(kind: str, folder: Path):
    from workbench.jobs.sensor.scan import scan
    from workbench.recordings.templates.scanner_kinds import example

    made = example(kind, folder / "recording", lambda text: None)
    (folder / "run").mkdir()
    scans = scan(made.recording, None, folder / "run", lambda text: None)
    return list(scans.scans), scans.calibration.turntable


def _cloud(axes, scans, kind: str) -> None:
    points = np.concatenate([one.drawn for one in scans], axis=1)
    axes.scatter(*points, s=1.5, c=points[2], cmap="viridis", lw=0)
    axes.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
    axes.set_title(f"{kind}: images joined in the {scans[0].frame} frame", size=10.5)
    axes.set_aspect("equal")


def _angles(axes, made) -> None:
    error = np.rad2deg(made.measured - made.commanded)
    angle = np.rad2deg(made.commanded)
    fine = np.linspace(0, 360, 361)
    law = np.rad2deg(made.table.angles(np.deg2rad(fine))) - fine
    axes.errorbar(
        angle, error, np.rad2deg(made.sigma), fmt="o", ms=4, label="measured with a board"
    )
    axes.plot(fine, law - law.mean() + error.mean(), label="angle law")
    axes.set(xlabel="commanded angle (deg)", ylabel="angle error (deg)")
    axes.set_title("turntable: step errors", size=10.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)


if __name__ == "__main__":
    main()
