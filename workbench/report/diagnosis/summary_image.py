"""`summary.png` of a diagnosis: the chain with the places of the discrepancy, errors, residuals before and after."""

import logging
from pathlib import Path

import numpy as np

from workbench.explanation.result import Diagnosis
from workbench.explanation.sentences import words as said
from workbench.report import style
from workbench.report.diagnosis.chain import places_of, share_at
from workbench.report.diagnosis.figures import (
    SMALLEST_SHARE,
    binned,
    extent,
    fall,
    shown_covariate,
)
from workbench.report.text import rounded

_INK = "#222222"
_log = logging.getLogger(__name__)


def write_summary(diagnosis: Diagnosis, path: Path) -> bool:
    """Write the PNG at `path`. Return False, with a warning in the log, if it cannot be drawn."""
    try:
        draw_summary(diagnosis).savefig(path, dpi=130)
    except (ImportError, OSError, RuntimeError) as error:
        _log.warning(
            "%s was not drawn: %s. The report page is complete without it.", path.name, error
        )
        return False
    return True


def draw_summary(diagnosis: Diagnosis):
    """A matplotlib figure."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(13, 6.2), facecolor="white")
    grid = drawn.add_gridspec(
        2,
        2,
        left=0.06,
        right=0.975,
        bottom=0.1,
        top=0.84,
        hspace=0.42,
        wspace=0.16,
        height_ratios=(1, 1.35),
    )
    _chain(drawn.add_subplot(grid[0, :]), diagnosis)
    _errors(drawn.add_subplot(grid[1, 0]), diagnosis)
    _covariate_panel(drawn.add_subplot(grid[1, 1]), diagnosis)
    proof = diagnosis.proof
    drawn.text(
        0.02,
        0.92,
        f"{diagnosis.verdict}: {rounded(proof.before)} → {rounded(proof.after)} {diagnosis.unit} held out",
        size=19,
        weight="bold",
        color=_INK,
    )
    drawn.text(0.98, 0.93, diagnosis.title, size=11, color=_INK, ha="right")
    return drawn


def _chain(axes, diagnosis):
    places = places_of(diagnosis)
    share = np.array([share_at(diagnosis, where) for where in places])
    x = np.arange(len(places))
    axes.plot(x, 0 * x, color="#999999", lw=4, zorder=1)
    size = 70 + 900 * share / max(share.max(initial=0), 1e-9) * (share > 0)
    axes.scatter(
        x,
        0 * x,
        s=size,
        c=share,
        cmap="OrRd",
        vmin=0,
        vmax=max(share.max(initial=0), 0.01),
        zorder=2,
        edgecolors="#666666",
    )
    for k, where in enumerate(places):
        text = said.place(where).replace("the ", "").replace(" ", "\n")
        axes.annotate(
            text, (k, 0), (0, -34), textcoords="offset points", ha="center", va="top", size=8
        )
    effects_by_place: dict[str, list[str]] = {}
    for term in diagnosis.terms:
        effects_by_place.setdefault(term.finding.where, []).append(term.finding.effect)
    for i, where in enumerate(w for w in places if w in effects_by_place):
        axes.annotate(
            "\n".join(dict.fromkeys(effects_by_place[where])),
            (places.index(where), 0),
            (0, 24 + 16 * (i % 3)),
            ha="center",
            textcoords="offset points",
            size=8.5,
            color=style.BLUE,
            weight="bold",
            arrowprops=dict(arrowstyle="-", color=style.BLUE, lw=0.8),
        )
    axes.set(ylim=(-1.1, 1.3), xlim=(-0.6, len(places) - 0.4))
    axes.axis("off")


def _errors(axes, diagnosis):
    known = [errors[np.isfinite(errors)] for errors in diagnosis.proof.errors]
    for name, errors, colour in zip(("before", "after"), known, (style.GREY, style.BLUE)):
        if len(errors):
            axes.ecdf(errors, label=name, color=colour, lw=2)
    if np.isfinite(diagnosis.proof.noise) and diagnosis.proof.noise > 0:
        axes.axvline(diagnosis.proof.noise, color=style.ORANGE, ls=":", label="noise, RMS")
    axes.set(xlabel=f"held-out error ({diagnosis.unit})", title="cumulative share of samples")
    _logarithmic(axes, np.concatenate(known))
    axes.yaxis.set_major_formatter("{x:.0%}")
    style.legend_above(axes)
    _quiet(axes)


def _logarithmic(axes, errors: np.ndarray):
    """A logarithmic axis over errors, without the smallest; a linear one where none is above zero."""
    positive = errors[errors > 0]
    if not len(positive):
        return
    ticks = style.log_axis(np.quantile(positive, SMALLEST_SHARE), positive.max(), max_ticks=6)
    axes.set_xscale("log")
    axes.set_xlim(*np.power(10.0, ticks["range"]))
    axes.set_xticks(ticks["tickvals"], ticks["ticktext"])
    axes.set_xticks([], minor=True)


def _covariate_panel(axes, diagnosis):
    if diagnosis.views is None or not diagnosis.views.covariates:
        axes.axis("off")
        return
    name = max(diagnosis.views.covariates, key=lambda covariate: fall(diagnosis.views, covariate))
    x, title = shown_covariate(name, diagnosis.views.covariates)
    spreads = [_spread(binned(x, row)[1]) for row in diagnosis.views.before]
    k = int(np.argmax(spreads))
    for stage, part, colour in (
        ("before", diagnosis.views.before, style.GREY),
        ("after", diagnosis.views.after, style.BLUE),
    ):
        axes.plot(x, part[k], ".", ms=2, alpha=0.3, color=colour)
        axes.plot(*binned(x, part[k]), color=colour, lw=2.5, label=stage)
    axes.set(
        xlabel=title,
        title=f"residual in {diagnosis.views.names[k]} ({diagnosis.unit})",
        ylim=extent(diagnosis.views.before[k]),
    )
    style.legend_above(axes)
    _quiet(axes)


def _spread(means: np.ndarray) -> float:
    """Range of the means of bins; 0 where no sample has both the covariate and the residual."""
    return float(np.ptp(means)) if len(means) else 0.0


def _quiet(axes):
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)
    axes.title.set_size(10.5)
