"""The measuring chain as a row of places, residuals before and after, and the next experiment's poses in space."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from robot_model.chain import forward
from workbench.app.data.decimate import MOST_POINTS, bin_means, histogram, thinned
from workbench.app.data.diagnosis import NextPoses, Place
from workbench.app.data.opened import Opened
from workbench.app.data.summaries import quantities_of
from workbench.app.figures import style
from workbench.report.diagnosis.chain import side

_MARGIN = 0.05
"""Room around the poses of the next experiment for their numbers, as a share of the diagonal."""
_SHORT = {"joint": "J", "link": "L"}


def chain(places: Sequence[Place], chosen: str) -> go.Figure:
    """Joints as discs and links as squares; area and colour show the share of the mismatch."""
    plot = style.plane("", "", "chain")
    x = np.arange(len(places))
    share = np.array([place.share for place in places])
    relative = share / max(share.max(initial=0), 1e-9)
    plot.add_scatter(
        x=x, y=0 * x, mode="lines", hoverinfo="skip", line=dict(color=style.GREY, width=4)
    )
    plot.add_scatter(
        x=x,
        y=0 * x,
        mode="markers+text",
        customdata=[place.name for place in places],
        text=[_short(place) for place in places],
        textposition="bottom center",
        marker=dict(
            size=18 + 34 * np.sqrt(relative) * (share > 0),
            color=100 * share,
            colorscale=[[0, "#e5e7eb"], [0.05, "#fcd9a8"], [1, "#c2410c"]],
            cmin=0,
            cmax=max(100 * float(share.max(initial=0)), 1.0),
            symbol=["square" if place.name.startswith("link") else "circle" for place in places],
            line=dict(
                color=[style.BLUE if place.name == chosen else style.GREY for place in places],
                width=[4 if place.name == chosen else 1 for place in places],
            ),
        ),
        hovertemplate="%{customdata}<extra></extra>",
    )
    for k, place in enumerate(places):
        if place.found:
            _label(plot, k, place, side(k, 0, len(places) - 1))
    plot.update_xaxes(visible=False, range=[-0.7, len(places) - 0.3])
    plot.update_yaxes(visible=False, range=[-1.2, 1.6])
    return plot.update_layout(showlegend=False, margin=dict(l=4, r=4, t=4, b=4), dragmode=False)


def _short(place: Place) -> str:
    kind, dash, number = place.name.rpartition("-")
    name = f"{_SHORT.get(kind, kind + ' ')}{number}" if dash else place.name
    return f"{name}<br>{100 * place.share:.0f} %"


def _label(plot, k: int, place: Place, anchor: str) -> None:
    names = "<br>".join(dict.fromkeys(term["effect"] for term in place.found))
    plot.add_annotation(
        x=k,
        y=0.25,
        text=f"<b>{names}</b>",
        showarrow=True,
        ax=0,
        xanchor=anchor,
        ay=-30 - 26 * (k % 3),
        font=dict(color=style.BLUE, size=12),
        arrowcolor=style.BLUE,
    )


def before_after(opened: Opened, name: str) -> go.Figure:
    """Length of the residual over one quantity, with the baseline and with what was found."""
    plot = style.plane(style.plain(name), "residual (mm)", f"before-after-{name}")
    residuals = opened.residuals
    quantities = quantities_of(opened)
    if residuals is None or "before" not in residuals.lengths or name not in quantities:
        return plot
    x = quantities[name]
    for kind, colour in (("before", style.GREY), ("after", style.BLUE)):
        y = residuals.lengths[kind]
        drawn = thinned(len(y), MOST_POINTS, y)
        marker = dict(size=4, color=colour, opacity=0.5)
        plot.add_scattergl(
            x=x[drawn], y=np.round(y[drawn], 6), mode="markers", name=kind, marker=marker
        )
        centres, means = bin_means(x, y)
        plot.add_scatter(
            x=centres, y=means, mode="lines", name=f"mean {kind}", line=dict(color=colour, width=3)
        )
    return plot


def pixel_histogram(lengths: Mapping[str, np.ndarray]) -> go.Figure:
    """Counts of the residuals of images, with the baseline and with what was found."""
    plot = style.plane("residual in the image (px)", "residuals", "before-after-px")
    plot.update_layout(barmode="overlay", bargap=0.02)
    counted = histogram(dict(lengths))
    middle = (counted.edges[:-1] + counted.edges[1:]) / 2
    for kind, counts in counted.counts.items():
        colour = style.GREY if kind == "before" else style.BLUE
        plot.add_bar(x=middle, y=counts, name=kind, marker_color=colour, opacity=0.55)
    return plot


def next_poses(opened: Opened, poses: NextPoses | None) -> go.Figure:
    """The arm at the poses of the next experiment, each with its number at the flange."""
    plot = style.space("next")
    robot = opened.robot
    if robot is None or poses is None:
        return plot
    links = _links(robot, poses.readings)
    _add_arms(plot, links)
    _add_numbers(plot, links[-1], poses)
    return style.framed(plot, *_box_around(links))


def _box_around(links: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (3,) mm of a scene with a margin around the ends of links (k, 3, n)."""
    low = links.min(axis=(0, 2))
    high = links.max(axis=(0, 2))
    margin = _MARGIN * float(np.linalg.norm(high - low))
    return low - margin, high + margin


def _links(robot, readings: np.ndarray) -> np.ndarray:
    """(L, 3, k) mm: origins of the links of the nominal arm from root to flange, at k poses."""
    scale = np.where(robot.prismatic[: readings.shape[1]], 1.0, np.pi / 180)
    frames = forward(robot, robot.mixing @ (readings * scale).T, links=True)
    return np.concatenate([frames.pivot[:1], frames.origin, frames.end_origin[None]])


def _add_arms(plot: go.Figure, links: np.ndarray) -> None:
    gap = np.full((1, *links.shape[1:]), np.nan)
    x, y, z = np.concatenate([links, gap]).transpose(1, 2, 0).reshape(3, -1).round(2)
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="lines",
        name=f"{links.shape[2]} poses to measure",
        connectgaps=False,
        hoverinfo="skip",
        line=dict(color=style.ORANGE, width=2),
    )


def _add_numbers(plot: go.Figure, flange: np.ndarray, poses: NextPoses) -> None:
    """A mark with its number at the flange (3, k) mm of every pose; the hover text states the joint readings."""
    names = [style.plain(name) for name in poses.names]
    texts = [
        "<br>".join(f"{name}: {value}" for name, value in zip(names, row["readings"]))
        for row in poses.rows
    ]
    x, y, z = flange.round(2)
    plot.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode="markers+text",
        name="flange with the number of the pose",
        text=[f"<b>{row['number']}</b>" for row in poses.rows],
        textposition="top center",
        textfont=dict(size=13, color=style.INK),
        customdata=texts,
        marker=dict(size=6, color=style.BLUE),
        hovertemplate="pose %{text}<br>%{customdata}<extra></extra>",
    )
