"""Figures of a study page: outcome over parameters, by load and incidence, sensitivity indices, coverage."""

import re

import numpy as np
import plotly.graph_objects as go

from workbench.report import style
from workbench.report.text import axis_label, column_label, rounded
from workbench.studies.spec import Axis

_COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.VIOLET, style.GREY)
_BINS = 12
_RUNS_OF_BIN = 12


def scatter_of_runs(
    axis: Axis, x: np.ndarray, y: np.ndarray, name: str, groups: np.ndarray | None = None
) -> go.Figure:
    """One dot per run, medians and the 90 % band in bins of the parameter; separately for each of `groups`."""
    plot = style.figure(340, axis_label(axis), column_label(name))
    for k, group in enumerate([None] if groups is None else list(dict.fromkeys(groups.tolist()))):
        chosen = np.isfinite(y) & (True if group is None else groups == group)
        colour = _COLOURS[k % len(_COLOURS)]
        places, low, middle, high = _binned(axis, x[chosen], y[chosen])
        _band(plot, places, low, high, colour)
        drawn = style.thinned(int(chosen.sum()))
        plot.add_scatter(
            x=x[chosen][drawn],
            y=y[chosen][drawn],
            mode="markers",
            showlegend=False,
            hoverinfo="skip",
            marker=dict(size=4, color=colour, opacity=0.35),
        )
        plot.add_scatter(
            x=places,
            y=middle,
            mode="lines+markers",
            line=dict(color=colour, width=3),
            marker=dict(size=6),
            name=str(group or "median"),
            showlegend=group is not None,
        )
    if axis.scale == "log" and axis.values is None:
        plot.update_xaxes(style.log_axis(axis.low, axis.high))
    _upwards(plot, y)
    return plot


def _upwards(plot, values):
    """From zero, or logarithmic if the values span more than a factor of fifty."""
    finite = values[np.isfinite(values)]
    low = finite.min(initial=np.inf)
    high = finite.max(initial=0.0)
    if low > 0 and high > 50 * low:
        plot.update_yaxes(style.log_axis(low / 1.1, high * 1.1))
    else:
        plot.update_yaxes(rangemode="tozero")


def _binned(axis, x, y):
    """Position and the 5 %, 50 % and 95 % quantiles of the runs in each bin; each listed value is a bin."""
    values = np.unique(x)
    bins = int(np.clip(len(x) // _RUNS_OF_BIN, 3, _BINS))
    if len(values) > _BINS:
        scale = np.log if axis.scale == "log" else np.asarray
        inverse_scale = np.exp if axis.scale == "log" else np.asarray
        edges = np.linspace(scale(values[0]), scale(values[-1]), bins + 1)
        index = np.clip(np.searchsorted(edges, scale(x), side="right") - 1, 0, bins - 1)
        places = inverse_scale((edges[1:] + edges[:-1]) / 2)
    else:
        places = values
        index = np.searchsorted(values, x)
    full = [k for k in range(len(places)) if (index == k).any()]
    quantiles = np.array([np.percentile(y[index == k], (5, 50, 95)) for k in full]).reshape(-1, 3)
    return (places[full], *quantiles.T)


def _band(plot, places, low, high, colour):
    plot.add_scatter(
        x=np.concatenate([places, places[::-1]]),
        y=np.concatenate([high, low[::-1]]),
        fill="toself",
        mode="lines",
        line=dict(width=0),
        fillcolor=colour,
        opacity=0.15,
        showlegend=False,
        hoverinfo="skip",
    )


def spread(values: np.ndarray, name: str) -> go.Figure:
    """Histogram of the outcome."""
    finite = values[np.isfinite(values)]
    bins = int(np.clip(len(np.histogram_bin_edges(finite, "fd")) - 1, 10, 60))
    counts, edges = np.histogram(finite, bins)
    plot = style.figure(300, column_label(name), "runs")
    plot.add_bar(
        x=(edges[1:] + edges[:-1]) / 2,
        y=counts,
        width=np.diff(edges),
        marker=dict(color=style.BLUE, line_width=0),
        showlegend=False,
    )
    return plot


def stiffen(rows: list[dict]) -> go.Figure:
    """Remaining error, in per cent, if one joint is twice as stiff."""
    plot = style.figure(60 + 46 * len(rows) + 60, "remaining error (%)")
    share_left = np.array([100 * row["error_left"] for row in rows])
    low, high = (
        np.array([100 * row[f"error_left_{end}"] for row in rows]) for end in ("p5", "p95")
    )
    best = share_left.argmin()
    color = [style.ORANGE if k == best else style.GREY for k in range(len(rows))]
    plot.add_bar(
        y=[row["joint"].replace("-", " ") for row in rows],
        x=share_left,
        orientation="h",
        showlegend=False,
        marker=dict(
            color=color,
            line_width=0,
        ),
        error_x=dict(
            type="data",
            symmetric=False,
            array=high - share_left,
            arrayminus=share_left - low,
            thickness=1.5,
        ),
        hovertemplate="%{y}: %{x:.0f} %<extra></extra>",
    )
    plot.update_layout(bargap=0.35, margin_l=80)
    return plot.update_yaxes(autorange="reversed")


def by_load(columns: list[dict]) -> go.Figure | None:
    """Error over payload for each model, from columns `<model>_test_<load>kg_mm`; None for a single load."""
    found: dict[str, list] = {}
    for row in columns:
        match = re.fullmatch(r"(.+)_test_([0-9.]+)kg(?:_[0-9.-]+c)?_mm", row["column"])
        if match and "twice" not in match[1]:
            found.setdefault(match[1], []).append((float(match[2]), row))
    if not any(len(rows) > 1 for rows in found.values()):
        return None
    plot = style.figure(400, "payload (kg)", "RMS error (mm, logarithmic)")
    bounds = []
    for k, (model, rows) in enumerate(found.items()):
        loads = np.array([load for load, _ in rows])
        low, middle, high = (
            np.array([row[key] for _, row in rows]) for key in ("p5", "median", "p95")
        )
        _band(plot, loads, low, high, _COLOURS[k % len(_COLOURS)])
        plot.add_scatter(
            x=loads,
            y=middle,
            name=model,
            mode="lines+markers",
            line=dict(color=_COLOURS[k % len(_COLOURS)], width=3),
            marker=dict(size=7),
        )
        bounds += [low.min(), high.max()]
    return plot.update_yaxes(style.log_axis(min(bounds) / 1.2, max(bounds) * 1.2)).update_layout(
        margin_t=70
    )


def by_incidence(columns: list[dict]) -> go.Figure | None:
    """Form error by band of incidence angle; None without such columns."""
    bands = [(re.fullmatch(r"form_(\d+)_(\d+)deg_mm", row["column"]), row) for row in columns]
    bands = [(match, row) for match, row in bands if match]
    if not bands:
        return None
    plot = style.figure(
        340, "angle between surface and line of sight (deg)", "RMS distance from the sphere (mm)"
    )
    middle = np.array([(int(match[1]) + int(match[2])) / 2 for match, _ in bands])
    low, median, high = (
        np.array([row[key] for _, row in bands]) for key in ("p5", "median", "p95")
    )
    _band(plot, middle, low, high, style.BLUE)
    plot.add_scatter(
        x=middle,
        y=median,
        mode="lines+markers",
        line=dict(color=style.BLUE, width=3),
        marker=dict(size=8),
        showlegend=False,
    )
    return plot.update_yaxes(rangemode="tozero").update_xaxes(range=[0, middle[-1] * 1.15])


def stated(sigma: np.ndarray, error: np.ndarray) -> go.Figure:
    """Error over stated sigma, one dot per run, and the line of equality."""
    fine = np.isfinite(sigma) & np.isfinite(error) & (sigma > 0) & (error > 0)
    plot = style.figure(360, "stated σ (mm)", "error of the centre (mm)")
    if fine.any():
        low = min(sigma[fine].min(), error[fine].min())
        high = max(sigma[fine].max(), error[fine].max())
        plot.add_scatter(
            x=sigma[fine],
            y=error[fine],
            mode="markers",
            showlegend=False,
            marker=dict(size=5, color=style.BLUE, opacity=0.6),
        )
        plot.add_scatter(
            x=[low, high],
            y=[low, high],
            mode="lines",
            line=dict(color=style.GREY, dash="dash"),
            name="error = σ",
        )
        plot.update_xaxes(style.log_axis(low / 1.1, high * 1.1)).update_yaxes(
            style.log_axis(low / 1.1, high * 1.1)
        )
    return plot


def indices(rows: list[dict]) -> go.Figure:
    """Bars of first-order and total sensitivity indices."""
    plot = style.figure(90 + 52 * len(rows), "share of the variance")
    for key, colour, name in (("total", style.GREY, "total"), ("first", style.BLUE, "first")):
        if key in rows[0]:
            array = [row[f"{key}_95"] for row in rows]
            whiskers = dict(type="data", array=array, thickness=1.5)
            plot.add_bar(
                y=[row["parameter"] for row in rows],
                x=[row[key] for row in rows],
                orientation="h",
                name=name,
                marker=dict(color=colour, line_width=0),
                error_x=whiskers,
            )
    plot.update_layout(barmode="group", bargap=0.3, margin_l=130, legend_traceorder="reversed")
    return plot.update_yaxes(autorange="reversed")


def coverage(rows: list[dict]) -> go.Figure:
    """Coverage of 95 % intervals, or the ratio of spread to sigma, one dot per parameter."""
    known = "within_2" in rows[0]
    names = [row["parameter"].partition(":")[2] for row in rows]
    plot = style.figure(
        120 + 17 * len(rows), "runs within 1.96 stated σ (%)" if known else "spread over stated σ"
    )
    values = [100 * row["within_2"] if known else row["ratio"] for row in rows]
    if known:
        half = 100 * 1.96 * np.sqrt(0.95 * 0.05 / np.median([row["n"] for row in rows]))
        plot.add_vrect(
            x0=95 - half, x1=min(95 + half, 100), fillcolor=style.GREEN, opacity=0.2, line_width=0
        )
    plot.add_vline(x=95 if known else 1, line=dict(color=style.GREY, dash="dash"))
    plot.add_scatter(
        x=values,
        y=names,
        mode="markers",
        marker=dict(size=9, color=style.BLUE),
        showlegend=False,
        hovertemplate="%{y}: %{x:.3g}<extra></extra>",
    )
    plot.update_yaxes(autorange="reversed", tickfont_size=10, dtick=1)
    if known:
        plot.update_xaxes(range=[min(min(values), 95 - half) - 5, 100.5])
    else:
        plot.update_xaxes(rangemode="tozero")
    return plot.update_layout(margin_l=250)


def grid_map(axes: list[Axis], columns: dict, name: str) -> go.Figure:
    """Median outcome over a grid of two parameters, as a labelled heat map."""
    x = columns[axes[0].name]
    y = columns[axes[1].name]
    outcome = columns[name]
    first = np.unique(x)
    second = np.unique(y)
    cells = [[np.nanmedian(outcome[(x == a) & (y == b)]) for a in first] for b in second]
    plot = style.figure(400, *(axis_label(axis) for axis in axes[:2]))
    plot.add_heatmap(
        x=[f"{a:g}" for a in first],
        y=[f"{b:g}" for b in second],
        z=cells,
        colorscale="Viridis",
        text=[[rounded(v, 2) for v in row] for row in cells],
        texttemplate="%{text}",
        colorbar=dict(title=dict(text=column_label(name), side="right"), thickness=12),
    )
    return plot.update_xaxes(type="category").update_yaxes(type="category")
