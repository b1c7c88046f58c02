"""Static images of the scoreboard: small PNG files, drawn from the board."""

from pathlib import Path
from textwrap import fill

import numpy as np

from workbench.proving import figures
from workbench.proving.board import Board
from workbench.report import style
from workbench.report.scoreboard.figures import summary

_DPI = 80


def write_images(board: Board, maps, folder: Path) -> dict[str, str]:
    """Write every image that has cases into an existing folder. Returns file name -> caption."""
    images = {
        "figures.png": (summary(board), "Every acceptance criterion with its 95 % interval."),
        "seen.png": (
            _seen(board),
            "Detection over the effect size orthogonal to the baseline (suites library and sensor), and share of "
            "correct claims over their stated probability; 95 % intervals.",
        ),
        "gain.png": (
            _gain(board),
            "Held-out error after the diagnosis over that of the oracle (a fit with the true model), and "
            "processor time of a diagnosis over the number of samples; one point per case.",
        ),
        "effects.png": (
            _confusion(board, "effect"),
            "True effect (row) and first stated effect (column), cases with one effect. A truth inside a "
            "declared group counts as stated.",
        ),
        "places.png": (
            _confusion(board, "where"),
            "True place (row) and stated place (column).",
        ),
        "before-after.png": (
            _before_after(board),
            "Held-out error before and after, and the noise, for every case, largest reduction first.",
        ),
    }
    if maps:
        images["maps.png"] = (
            _maps(maps),
            "Held-out error of every sample at its measured position, before and after: for each suite, the "
            "case of median effect size among the correctly identified ones.",
        )
    for name, (image, _) in images.items():
        image.savefig(folder / name, dpi=_DPI)
    return {name: words for name, (_, words) in images.items()}


def _figure(width, height, columns=1, rows=1):
    from matplotlib.figure import Figure

    plot = Figure(figsize=(width, height), facecolor="white", layout="constrained")
    return plot, np.atleast_1d(plot.subplots(rows, columns)).ravel()


def _seen(board):
    plot, (curve, sure) = _figure(11, 3.8, 2)
    rows = figures.detection(board.rows)
    for key, words, colour in (
        ("detected", "detected", style.BLUE),
        ("named", "correct name or group", style.GREEN),
    ):
        _with_interval(
            curve, [r["middle_sigma"] for r in rows], rows, key, f"{key}_interval", words, colour
        )
    curve.set(
        xscale="log",
        xlabel="effect size orthogonal to the baseline, σ",
        ylabel="share of cases",
        ylim=(-0.03, 1.05),
    )
    curve.set_xticks(
        [0.15, 0.3, 0.6, 1, 2, 4, 8], ["0.15", "0.3", "0.6", "1", "2", "4", "8"], minor=False
    )
    curve.minorticks_off()
    rows = figures.reliability(board.rows)
    sure.plot([0, 1], [0, 1], ":", color=style.GREY)
    _with_interval(
        sure, [r["stated"] for r in rows], rows, "right", "interval", "claims", style.ORANGE
    )
    for r in rows:
        sure.annotate(
            str(r["claims"]),
            (r["stated"], r["right"]),
            (5, -11),
            textcoords="offset points",
            size=8,
        )
    sure.set(
        xlabel="stated probability",
        ylabel="share of correct claims",
        ylim=(-0.03, 1.05),
        xlim=(-0.03, 1.05),
    )
    return _quiet(plot)


def _with_interval(axes, x, rows, key, interval, words, colour):
    y = np.array([r[key] for r in rows])
    ends = np.array([r[interval] for r in rows]).reshape(-1, 2).T
    if len(y):
        error_bars = np.maximum([y - ends[0], ends[1] - y], 0)
    else:
        error_bars = None
    axes.errorbar(x, y, yerr=error_bars, fmt="o-", color=colour, label=words, capsize=2, ms=4)
    axes.legend(frameon=False, loc="lower right", fontsize=9)


def _gain(board):
    plot, (reached, time) = _figure(11, 3.8, 2)
    rows = [r for r in board.rows if r.get("oracle_after_mm") and r.get("after_mm")]
    best, after = ([r[key] for r in rows] for key in ("oracle_after_mm", "after_mm"))
    reached.loglog(best, after, "o", color=style.BLUE, ms=3, alpha=0.6)
    ends = [min(best + after, default=0.01), max(best + after, default=1.0)]
    reached.plot(ends, ends, ":", color=style.GREY)
    reached.set(xlabel="held-out RMS of the oracle, mm", ylabel="after the diagnosis, mm")
    timed = [r for r in board.rows if r.get("cpu_s") and r.get("samples")]
    time.loglog(
        [r["samples"] for r in timed],
        [r["cpu_s"] for r in timed],
        "o",
        color=style.VIOLET,
        ms=3,
        alpha=0.6,
    )
    time.set(xlabel="samples", ylabel="processor time, s")
    return _quiet(plot)


def _confusion(board, key):
    truths, claims, counts = figures.confusion(board.rows, key)
    plot, (axes,) = _figure(3 + 0.28 * max(len(claims), 6), 2 + 0.24 * max(len(truths), 6))
    if truths:
        axes.imshow(np.sqrt(counts), cmap="Blues", aspect="auto", vmax=1.3 * np.sqrt(counts.max()))
    axes.set_xticks(range(len(claims)), claims, rotation=60, ha="right", size=8)
    axes.set_yticks(range(len(truths)), truths, size=8)
    for i, j in np.argwhere(counts):
        axes.text(j, i, counts[i, j], ha="center", va="center", size=8)
    axes.set(xlabel="stated", ylabel="truth")
    return plot


def _before_after(board):
    plot, (axes,) = _figure(11, 3.6)
    rows = sorted(
        (r for r in board.rows if r.get("before_mm") and r.get("after_mm")),
        key=lambda r: r["after_mm"] / r["before_mm"],
    )
    for key, words, colour in (
        ("before_mm", "before", style.ORANGE),
        ("after_mm", "after", style.BLUE),
        ("noise_mm", "noise", style.GREY),
    ):
        values = [r.get(key) or np.nan for r in rows]
        axes.semilogy(
            range(1, len(rows) + 1), values, "o", color=colour, ms=3, alpha=0.7, label=words
        )
    axes.set(xlabel="cases, largest reduction first", ylabel="held-out RMS, mm")
    axes.legend(frameon=False, fontsize=9)
    return _quiet(plot)


def _maps(maps):
    plot, axes = _figure(3.2 * len(maps), 5.6, len(maps), 2)
    for k, error_map in enumerate(maps):
        upper = np.nanquantile(error_map.before, 0.98)
        spread = np.ptp(error_map.points, axis=1)
        i, j = sorted(np.argsort(spread)[-2:])
        for row, (errors, words) in enumerate(
            ((error_map.before, "before"), (error_map.after, "after"))
        ):
            panel = axes[row * len(maps) + k]
            shown = panel.scatter(
                error_map.points[i],
                error_map.points[j],
                c=errors,
                s=6,
                cmap="viridis",
                vmin=0,
                vmax=upper,
            )
            rms = np.sqrt(np.nanmean(errors**2))
            title = f"{fill(error_map.title, 34)}\n" if row == 0 else ""
            panel.set_title(f"{title}{words}: {rms:.3f} mm", size=7.5)
            panel.set(xlabel=f"{'xyz'[i]}, mm", ylabel=f"{'xyz'[j]}, mm", aspect="equal")
            panel.tick_params(labelsize=7)
            plot.colorbar(shown, ax=panel, shrink=0.7, label="mm").ax.tick_params(labelsize=7)
    return plot


def _quiet(plot):
    for axes in plot.axes:
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
    return plot
