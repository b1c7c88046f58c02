"""Figures over the image field: coverage by corners, residual arrows, and maps of the residuals."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go

from workbench.report import style
from workbench.report.calibration.scene import arrow_step
from workbench.report.text import rounded

_ARROW_SHARE = 0.04
_LEAST_IN_CELL = 3
_MOST_NAMES = 16
"""More names overlap below the bars."""


def field(size: tuple[int, int], width: int = 400) -> go.Figure:
    """An empty image field of `size` (width, height) px with row 0 at the top, drawn about `width` px wide."""
    columns, rows = size
    plot = style.figure(int(width * rows / columns) + 90, "u (px)", "v (px)")
    plot.update_xaxes(range=[-0.5, columns - 0.5], constrain="domain", nticks=7, zeroline=False)
    return plot.update_yaxes(
        range=[rows - 0.5, -0.5], scaleanchor="x", constrain="domain", nticks=6, zeroline=False
    )


def coverage(pixels: np.ndarray, view: np.ndarray, size: tuple[int, int]) -> go.Figure:
    """Every corner (2, n) px, coloured by the number (n,) of its image."""
    plot = field(size)
    drawn = style.thinned(pixels.shape[1])
    u, v = np.round(pixels[:, drawn], 2)
    plot.add_scatter(
        x=u,
        y=v,
        mode="markers",
        customdata=view[drawn] + 1,
        marker=dict(size=3.5, color=view[drawn], colorscale="Viridis", opacity=0.8),
        hovertemplate="image %{customdata}: (%{x:.1f}, %{y:.1f}) px<extra></extra>",
        showlegend=False,
    )
    return plot


def arrows(
    pixels: np.ndarray, residual: np.ndarray, size: tuple[int, int]
) -> tuple[go.Figure, float]:
    """Residuals (2, n) px as enlarged lines from their pixels (2, n), and the enlargement."""
    plot = field(size)
    scale = enlargement(residual, size)
    drawn = style.thinned(pixels.shape[1])
    foot = pixels[:, drawn]
    tip = pixels[:, drawn] + scale * residual[:, drawn]
    path = np.stack([foot, tip, np.full_like(foot, np.nan)], axis=2).reshape(2, -1)
    plot.add_scatter(
        x=np.round(path[0], 2),
        y=np.round(path[1], 2),
        mode="lines",
        hoverinfo="skip",
        line=dict(color=style.ORANGE, width=1.2),
        showlegend=False,
    )
    plot.add_scatter(
        x=np.round(foot[0], 2),
        y=np.round(foot[1], 2),
        mode="markers",
        showlegend=False,
        customdata=np.linalg.norm(residual[:, drawn], axis=0),
        marker=dict(size=2, color=style.BLUE),
        hovertemplate="residual %{customdata:.3f} px<extra></extra>",
    )
    return plot, scale


def rejected(pixels: np.ndarray, wrong: np.ndarray, size: tuple[int, int]) -> go.Figure:
    """Points of the laser line (2, n) px: used ones grey, those left out as wrong (n,) bool orange."""
    plot = field(size)
    for chosen, colour, opacity, name in (
        (~wrong, style.GREY, 0.25, "used"),
        (wrong, style.ORANGE, 0.8, "left out"),
    ):
        places = pixels[:, chosen]
        u, v = np.round(places[:, style.thinned(places.shape[1])], 1)
        marker = dict(size=3, color=colour, opacity=opacity)
        plot.add_scatter(x=u, y=v, mode="markers", name=name, hoverinfo="skip", marker=marker)
    return plot


def enlargement(residual: np.ndarray, size: tuple[int, int]) -> float:
    """Enlargement, 1, 2 or 5 times a power of ten, at which 95 % of the arrows (2, n) px are readable."""
    if residual.size:
        length = float(np.percentile(np.linalg.norm(residual, axis=0), 95))
    else:
        length = 1.0
    wanted = _ARROW_SHARE * np.hypot(*size) / max(length, 1e-12)
    return arrow_step(wanted)


def cells(pixels: np.ndarray, values: np.ndarray, size: tuple[int, int], cell_count: int = 16):
    """Mean of values (n,) in cells of the field: centres u, centres v, means (rows, cell_count), nan in empty cells."""
    down = max(2, round(cell_count * size[1] / size[0]))
    column = np.clip(((pixels[0] + 0.5) / size[0] * cell_count).astype(int), 0, cell_count - 1)
    row = np.clip(((pixels[1] + 0.5) / size[1] * down).astype(int), 0, down - 1)
    place = row * cell_count + column
    cells = cell_count * down
    count = np.bincount(place, minlength=cells)
    mean = np.bincount(place, values, cells) / np.maximum(count, 1)
    mean = np.where(count >= _LEAST_IN_CELL, mean, np.nan).reshape(down, cell_count)
    return (
        (np.arange(cell_count) + 0.5) * size[0] / cell_count - 0.5,
        (np.arange(down) + 0.5) * size[1] / down - 0.5,
        mean,
    )


def residual_map(
    pixels: np.ndarray, values: np.ndarray, size: tuple[int, int], called: str, unit="px"
) -> go.Figure:
    """Mean residual (n,) by cell of the field, on a symmetric colour scale."""
    u, v, mean = cells(pixels, values, size)
    known = np.abs(mean[np.isfinite(mean)])
    top = float(known.max()) if known.size else 1.0
    return heat(u, v, mean, size, called, "RdBu", (-top, top), unit)


def heat(u, v, values, size, called, scale="Viridis", limits=None, unit="px") -> go.Figure:
    """A map of values (rows, columns) at cell centres u and v (px)."""
    plot = field(size)
    plot.add_heatmap(
        x=np.round(u, 2),
        y=np.round(v, 2),
        z=values,
        colorscale=scale,
        zmin=None if limits is None else limits[0],
        zmax=None if limits is None else limits[1],
        hoverongaps=False,
        colorbar=dict(
            title=dict(text=f"{called} ({unit})", side="right"), thickness=12, tickformat=".3~g"
        ),
        hovertemplate="(%{x:.0f}, %{y:.0f}) px: %{z:.3g} " + unit + "<extra></extra>",
    )
    return plot


def bars(
    names: list[str],
    values: np.ndarray,
    y_title: str,
    faulty: np.ndarray | None = None,
    x_title: str = "image",
) -> go.Figure:
    """One bar per image, in recording order, with the median as a line; `faulty` (n,) bars in another colour.

    names: paths as in images.csv, or names of which the last word distinguishes them.
    """
    plot = style.figure(340, x_title, y_title)
    is_faulty = np.zeros(len(names), bool) if faulty is None else faulty
    plot.add_bar(
        x=np.arange(1, len(names) + 1),
        y=values,
        customdata=names,
        showlegend=False,
        marker=dict(color=np.where(is_faulty, style.ORANGE, style.BLUE), line_width=0),
        hovertemplate="%{customdata}: %{y:.3f}<extra></extra>",
    )
    middle = float(np.median(values)) if len(values) else 0.0
    plot.add_scatter(
        x=[0.4, len(names) + 0.6],
        y=[middle, middle],
        mode="lines",
        name=f"median {rounded(middle)}",
        line=dict(color=style.GREY, dash="dot", width=2),
        hoverinfo="skip",
    )
    tick_step = -(-len(names) // _MOST_NAMES) or 1
    short = [Path(name).stem.split()[-1] for name in names]
    plot.update_xaxes(
        range=[0.4, len(names) + 0.6],
        tickvals=np.arange(1, len(names) + 1)[::tick_step],
        ticktext=short[::tick_step],
        automargin=True,
    )
    return plot.update_layout(bargap=0.25)
