"""Colours and layout of all figures; the script of the page adds the light or dark theme."""

import numpy as np
import plotly.graph_objects as go

# Okabe & Ito's colours (Color Universal Design, 2008), blue and green a little lighter so that
# they stand on white and on near-black alike.
BLUE, ORANGE, GREEN, VIOLET, GREY = "#1f83c4", "#d9730d", "#12957a", "#b8649f", "#8c8c8c"
COMPONENTS = {"x": BLUE, "y": ORANGE, "z": GREEN}
DISTANCE = VIOLET
LENGTHS = [[0, "#7fb2dd"], [0.4, BLUE], [0.7, ORANGE], [1, "#c0392b"]]
"""Colours of small to large residuals; the largest stand out on white and on near-black."""
MOST_POINTS = 5000
_SMALLEST_LOG = (
    1e-100  # ends of a logarithmic axis beyond this and its reciprocal count as zero and infinity
)
_IN_VIEW = 1.45
"""Length of a scene's diagonal that fits into the default view, in plotly's units."""


def figure(height: int, x_title: str = "", y_title: str = "") -> go.Figure:
    """An empty figure of `height` px, its axes titled with their units."""
    plot = go.Figure()
    plot.update_layout(
        template="none",
        height=height,
        margin=dict(l=64, r=18, t=30, b=54),
        bargap=0,
        legend=dict(orientation="h", x=0, y=1.02, yanchor="bottom", xanchor="left"),
    )
    plot.update_xaxes(title=dict(text=x_title, standoff=10))
    return plot.update_yaxes(title=dict(text=y_title, standoff=8))


def log_axis(low: float, high: float, max_ticks: int = 7) -> dict:
    """A logarithmic axis from `low` to `high` with at most about `max_ticks` tick labels.

    Ends without a logarithm (zero, negative, infinite, nan) and equal ends are replaced. A figure without
    data is then drawn empty.
    """
    low, high = _log_ends(low, high)
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    for steps in ((1, 1.5, 2, 3, 4, 5, 6, 8), (1, 2, 3, 5), (1, 2, 5), (1,)):
        ticks = [step * 10.0**power for power in powers for step in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) <= max_ticks:
            break
    if ticks:
        ticks = ticks[:: -(-len(ticks) // max_ticks)]
    else:
        ticks = [low, high]
    return dict(
        type="log",
        range=[np.log10(low), np.log10(high)],
        tickvals=ticks,
        ticktext=[plain(t) for t in ticks],
    )


def _log_ends(low: float, high: float) -> tuple[float, float]:
    """Finite positive ends with low < high: the given ends if usable, else a decade around the usable one."""
    usable = [
        float(end)
        for end in (low, high)
        if np.isfinite(end) and _SMALLEST_LOG <= end <= 1 / _SMALLEST_LOG
    ]
    if not usable:
        return 0.1, 10.0
    low = min(usable)
    high = max(usable)
    if high > low * (1 + 1e-9):
        return (low, high)
    return (low / 10**0.5, high * 10**0.5)


def plain(tick: float) -> str:
    """Label of a tick, without an exponent for values from 1e-5 to 1e7."""
    if 1e-5 <= tick < 1e7:
        return f"{tick:,.10f}".rstrip("0").rstrip(".")
    return f"{tick:.0e}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


def packed(plot: go.Figure) -> str:
    """The figure as JSON, safe inside a script element."""
    _framed(plot)
    return safe(plot.to_json())


def _framed(plot: go.Figure) -> None:
    """Size a 3-D scene so that all of it is in view, with the same scale on all axes.

    plotly's aspect mode "data" keeps the volume of the box; a long scene would leave the view.
    """
    places = [
        [np.ravel(getattr(trace, axis)) for axis in "xyz"]
        for trace in plot.data
        if trace.type in ("scatter3d", "mesh3d", "surface")
    ]
    if not places:
        return
    spans = [
        np.ptp(coordinates[np.isfinite(coordinates)])
        for coordinates in (
            np.concatenate([trace[k] for trace in places]).astype(float) for k in range(3)
        )
    ]
    length = float(np.linalg.norm(spans)) or 1.0
    ratio = {axis: max(_IN_VIEW * span / length, 0.05) for axis, span in zip("xyz", spans)}
    plot.update_layout(scene=dict(aspectmode="manual", aspectratio=ratio))


def safe(json_text: str) -> str:
    """JSON text in which no character sequence ends the enclosing script element."""
    return json_text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def thinned(n: int, seed: int = 0) -> np.ndarray:
    """Indices, in order, of at most MOST_POINTS of n samples, drawn evenly at random."""
    if n <= MOST_POINTS:
        return np.arange(n)
    return np.sort(np.random.default_rng(seed).choice(n, MOST_POINTS, replace=False))


def thinned_sentence(n: int) -> str:
    """States that only a part of the samples is drawn; empty if all are drawn."""
    if n <= MOST_POINTS:
        return ""
    return f"{MOST_POINTS:,} of {n:,} samples are drawn, chosen at random; all numbers use all samples."


def legend_above(axes, columns: int = 3, size: float = 8.5) -> None:
    """The legend of a matplotlib plot between its title and its frame, where no curve can be."""
    entries = len(axes.get_legend_handles_labels()[1])
    lines = -(-entries // columns)
    axes.set_title(axes.get_title(), pad=8 + lines * (size + 6))
    axes.legend(
        frameon=False,
        loc="lower left",
        bbox_to_anchor=(0, 1),
        borderaxespad=0.2,
        ncols=columns,
        fontsize=size,
    )
