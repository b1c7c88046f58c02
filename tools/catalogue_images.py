"""Images of the catalogue page: what a fit leaves, on the robot or in the image, and over what it depends on."""

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from catalogue_entries import Entry
from workbench.explanation.final_model import residuals_of
from workbench.explanation.sentences.words import covariate
from workbench.report.diagnosis.figures import binned, shown_covariate

_BLUE, _ORANGE, _INK = "#1f83c4", "#d9730d", "#333333"
_COLOURS, _DOTS = 48, 700
_SKIPPED = ("time_s", "row", "payload_kg")


def draw(entry: Entry, path: Path) -> None:
    """Write the image of an entry."""
    residual = residuals_of(entry.problem)
    made = Figure(figsize=(8.4, 2.35), layout="constrained")
    panels = made.subplots(1, 3, width_ratios=(1, 1.2, 1.2))
    _places(panels[0], entry.points, residual, entry.unit)
    values = np.sqrt(np.nansum(residual**2, 0))[None] if entry.kind.port == "noise" else residual
    for axes, name in zip(panels[1:], _telling(entry.problem, values)):
        _over(axes, entry.problem.covariates, name, values, entry.unit)
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=7)
    drawn = io.BytesIO()
    made.savefig(drawn, dpi=78)
    Image.open(drawn).convert("RGB").quantize(_COLOURS).save(path, optimize=True)


def _telling(problem, residual) -> list[str]:
    """The two covariates whose bins explain most of a component."""
    names, seen = [], []
    for name, x in problem.covariates.items():
        if (
            np.ptp(x) > 0
            and name not in _SKIPPED
            and not any(np.array_equal(x, other) for other in seen)
        ):
            names.append(name)
            seen.append(x)
    return sorted(names, key=lambda name: -_explained(problem.covariates[name], residual))[:2]


def _explained(x, residual) -> float:
    return sum(float(np.var(binned(x, row)[1])) for row in residual)


def _over(axes, covariates, name, residual, unit):
    x, title = shown_covariate(name, covariates)
    k = int(np.argmax([np.var(binned(x, row)[1]) for row in residual]))
    some = slice(None, None, max(1, len(x) // _DOTS))
    axes.plot(x[some], residual[k][some], ".", ms=2, color=_BLUE, alpha=0.45)
    axes.plot(*binned(x, residual[k]), color=_ORANGE, lw=1.8)
    low, high = np.nanpercentile(residual[k], [0.5, 99.5])
    axes.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    axes.set_xlabel(title if len(title) < 45 else covariate(name)[:45], size=7.5)
    axes.set_title(f"residual ({unit})", size=8, color=_INK)


def _places(axes, points, residual, unit):
    """Residuals where the samples are: arrows on the arm seen from the side, or lengths in the image."""
    if len(points) == 2:
        length = np.sqrt(np.nansum(residual**2, 0))
        some = slice(None, None, max(1, len(length) // (2 * _DOTS)))
        axes.scatter(
            *points[:, some], c=length[some], s=2, cmap="viridis", vmax=np.percentile(length, 98)
        )
        axes.invert_yaxis()
        axes.set_title(f"in the image ({unit})", size=8, color=_INK)
        axes.set_aspect("equal")
        return
    across = np.nan_to_num(residual[[0, 2]])
    x, z = points[[0, 2]]
    scale = 0.08 * max(np.ptp(x), np.ptp(z)) / max(np.percentile(np.hypot(*across), 95), 1e-12)
    axes.quiver(
        x, z, *(scale * across), angles="xy", scale_units="xy", scale=1, color=_ORANGE, width=0.006
    )
    axes.set_title("seen from the side (mm)", size=8, color=_INK)
    axes.set_aspect("equal")
