"""Figures of the page of the blind benchmark, and its summary image."""

import numpy as np
import plotly.graph_objects as go

from workbench.proving import figures
from workbench.proving.board import Board
from workbench.report import style
from workbench.report.sections import figure


def detection(board: Board) -> dict:
    """Share detected and share identified over the effect size orthogonal to the baseline."""
    plot = style.figure(
        380, "effect size orthogonal to the baseline, σ per coordinate", "share of cases"
    )
    rows = figures.detection(board.rows)
    for key, words, colour in (
        ("detected", "detected", style.BLUE),
        ("named", "correct name or group", style.GREEN),
    ):
        plot.add_trace(
            _with_interval(
                [r["middle_sigma"] for r in rows],
                [r[key] for r in rows],
                [r[f"{key}_interval"] for r in rows],
                words,
                colour,
            )
        )
    plot.update_xaxes(**style.log_axis(0.08, 12))
    plot.update_yaxes(range=[-0.02, 1.04], tickformat=".0%")
    return figure(
        "detection", plot, "Detection curve over the cases of suite library, with 95 % intervals."
    )


def reliability(board: Board) -> dict:
    """Share of correct claims over the stated probability."""
    plot = style.figure(380, "stated probability", "share of correct claims")
    rows = figures.reliability(board.rows)
    plot.add_trace(_dotted([0, 1], "as stated"))
    stated, right, intervals = ([r[key] for r in rows] for key in ("stated", "right", "interval"))
    text = [f"{r['claims']} claims" for r in rows]
    plot.add_trace(_with_interval(stated, right, intervals, "claims", style.ORANGE, text))
    plot.update_xaxes(range=[-0.02, 1.04], tickformat=".0%")
    plot.update_yaxes(range=[-0.02, 1.04], tickformat=".0%")
    return figure(
        "reliability",
        plot,
        "Reliability diagram: all claims of all cases, by stated probability.",
    )


def gain(board: Board) -> dict:
    """Held-out error after the diagnosis over that of the oracle."""
    plot = style.figure(
        380, "held-out RMS of the oracle, mm", "held-out RMS after the diagnosis, mm"
    )
    rows = [r for r in board.rows if r.get("oracle_after_mm") and r.get("after_mm")]
    oracle, diagnosed = ([r[key] for r in rows] for key in ("oracle_after_mm", "after_mm"))
    plot.add_trace(_cases(oracle, diagnosed, rows, style.BLUE, "case"))
    ends = _ends(oracle + diagnosed)
    plot.add_trace(_dotted(ends, "equal"))
    plot.update_xaxes(**style.log_axis(*ends))
    plot.update_yaxes(**style.log_axis(*ends))
    return figure(
        "gain", plot, "Diagnosis against the oracle, a fit with the true model. One point per case."
    )


def runtimes(board: Board) -> dict:
    """Processor time of a diagnosis over the number of samples."""
    plot = style.figure(380, "samples", "processor time, s")
    rows = [r for r in board.rows if r.get("cpu_s") and r["samples"]]
    plot.add_trace(
        _cases([r["samples"] for r in rows], [r["cpu_s"] for r in rows], rows, style.VIOLET, "case")
    )
    plot.update_xaxes(**style.log_axis(*_ends([r["samples"] for r in rows])))
    plot.update_yaxes(**style.log_axis(*_ends([r["cpu_s"] for r in rows])))
    return figure("runtimes", plot, "Processor time of a diagnosis, one process with one thread.")


def confusion(board: Board, key: str) -> dict:
    """Confusion matrix (counts) of true and stated; key: "effect" or "where"."""
    truths, claims, counts = figures.confusion(board.rows, key)
    plot = style.figure(140 + 22 * max(len(truths), 6), "first statement", "truth")
    plot.add_trace(
        go.Heatmap(
            z=np.sqrt(counts),
            x=claims,
            y=truths,
            text=np.where(counts > 0, counts.astype(str), ""),
            texttemplate="%{text}",
            colorscale=[[0, "rgba(31,131,196,0)"], [1, style.BLUE]],
            showscale=False,
            customdata=counts,
            hovertemplate="truth %{y}, stated %{x}: %{customdata}<extra></extra>",
        )
    )
    plot.update_yaxes(autorange="reversed", automargin=True, title=None)
    plot.update_xaxes(automargin=True, tickangle=-40)
    name = {"effect": "effect", "where": "place"}[key]
    return figure(
        f"confusion-{key}",
        plot,
        f"Confusion matrix by {name}, cases with one effect. A truth inside a declared group counts as stated.",
    )


def before_after(board: Board) -> dict:
    """Held-out RMS before and after, and the noise, for every case, largest reduction first."""
    rows = sorted(
        (r for r in board.rows if r.get("before_mm") and r.get("after_mm")),
        key=lambda r: r["after_mm"] / r["before_mm"],
    )
    plot = style.figure(420, "cases, largest reduction first", "held-out RMS of 3-D distances, mm")
    place = list(range(1, len(rows) + 1))
    for key, words, colour in (
        ("before_mm", "before", style.ORANGE),
        ("after_mm", "after", style.BLUE),
        ("noise_mm", "noise", style.GREY),
    ):
        trace = _cases(place, [r.get(key) for r in rows], rows, colour, words)
        plot.add_trace(trace)
    plot.update_yaxes(
        **style.log_axis(
            *_ends([r[k] for r in rows for k in ("before_mm", "after_mm") if r.get(k)])
        )
    )
    return figure(
        "before-after", plot, "Held-out errors of all cases. Hover over a point for its case."
    )


def _dotted(ends, name) -> go.Scatter:
    return go.Scatter(
        x=ends, y=ends, mode="lines", line=dict(color=style.GREY, dash="dot"), name=name
    )


def _with_interval(x, y, intervals, name, colour, text=None) -> go.Scatter:
    up = [max(high - v, 0) for v, (_, high) in zip(y, intervals)]
    down = [max(v - low, 0) for v, (low, _) in zip(y, intervals)]
    return go.Scatter(
        x=x,
        y=y,
        name=name,
        mode="lines+markers",
        line=dict(color=colour),
        text=text,
        error_y=dict(type="data", symmetric=False, array=up, arrayminus=down, thickness=1),
    )


def _cases(x, y, rows, colour, name) -> go.Scatter:
    text = [
        f"{r['suite']} {r['index']}: {'; '.join(r['concealed']) or 'nothing'}, {r['outcome']}"
        for r in rows
    ]
    return go.Scatter(
        x=x,
        y=y,
        mode="markers",
        marker=dict(color=colour, size=5, opacity=0.7),
        name=name,
        text=text,
        hovertemplate="%{text}<br>%{x:.4g}, %{y:.4g}<extra></extra>",
    )


def _ends(values) -> tuple[float, float]:
    """Ends of a logarithmic axis that holds all values."""
    values = [v for v in values if v and v > 0] or [1.0]
    return 0.8 * min(values), 1.25 * max(values)


def summary(board: Board):
    """A matplotlib figure: every acceptance criterion with its value, interval and limit."""
    from matplotlib.figure import Figure

    asked = [f for f in board.figures if f.reached is not None and f.value is not None][::-1]
    plot = Figure(
        figsize=(10, 1.2 + 0.3 * max(len(asked), 4)), facecolor="white", layout="constrained"
    )
    axes = plot.subplots()
    for k, f in enumerate(asked):
        colour = style.GREEN if f.reached else style.ORANGE
        if f.low is not None:
            axes.plot([f.low, f.high], [k, k], color=colour, lw=2, alpha=0.5, solid_capstyle="butt")
        axes.plot(f.value, k, "o", color=colour, ms=6)
        if f.hits is None and "limit" not in f.name:
            text = f"{f.value:.2f}"
        else:
            text = f"{f.value:.1%}"
        axes.annotate(
            f"{text}  (criterion {f.asked})", (1.06, k), va="center", size=8, annotation_clip=False
        )
    axes.set(
        yticks=range(len(asked)),
        yticklabels=[f"{f.suite}: {f.name}" for f in asked],
        xlim=(-0.02, 1.05),
    )
    axes.tick_params(axis="y", labelsize=8)
    axes.xaxis.set_major_formatter("{x:.0%}")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, axis="x")
    axes.set_title(f"{len(board.rows)} blind cases, seed {board.seed}", size=11)
    return plot
