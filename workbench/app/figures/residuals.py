"""Residuals: arrows in space, the length over any quantity, and histograms; every mark carries its row."""

import numpy as np
import plotly.graph_objects as go

from workbench.app.data.arm import has_arm, reach
from workbench.app.data.decimate import MOST_ARROWS, MOST_POINTS, Histogram, thinned
from workbench.app.data.residuals import (
    FIT,
    HELD_OUT,
    HELD_OUT_AFTER,
    HELD_OUT_BEFORE,
    NOMINAL,
    ROTATION,
    Residuals,
    unit_of,
)
from workbench.app.figures import robot, style
from workbench.app.figures.arrows import Needles, add_needles, colour_top, rounded
from workbench.app.figures.overlay import Overlay
from workbench.app.workspace import Workspace

_NAMES = {
    FIT: "fit",
    HELD_OUT: "held out",
    NOMINAL: "nominal model",
    "before": "before",
    "after": "after",
    HELD_OUT_BEFORE: "before, held out",
    HELD_OUT_AFTER: "after, held out",
}
_MOST_NAMES = 12
_COVER = 8
"""Width of a white line that covers an arrow, in plotly's units."""
_MARGIN = 0.1
"""Room for the tips of arrows around the points, as a share of the diagonal."""
_COLOURS = {
    FIT: style.GREEN,
    HELD_OUT: style.BLUE,
    NOMINAL: style.GREY,
    "before": style.GREY,
    "after": style.BLUE,
    HELD_OUT_BEFORE: style.GREY,
    HELD_OUT_AFTER: style.BLUE,
}


def arrows(work: Workspace) -> go.Figure:
    """Arrows from the measured points, coloured by length, without what a selection or an edit changes."""
    plot = style.space("arrows")
    residuals = work.opened.residuals
    if residuals is None or residuals.points is None:
        return plot
    drawn = work.drawn(MOST_ARROWS)
    low, high = _box(work)
    scale = _enlargement(work)
    places = residuals.points[:, drawn]
    vectors = scale * residuals.arrows[:, drawn]
    needles = Needles(places, vectors, drawn, work.opened.edit_ids[drawn], residuals.shown[drawn])
    add_needles(plot, needles, float(np.linalg.norm(high - low)), showlegend=True)
    arrow_marks(work).add_legend(plot)
    style.framed(plot, low, high)
    text = f"arrows enlarged {scale:,.0f} times; {len(drawn):,} of {work.count:,} samples drawn"
    plot.update_layout(title=dict(text=text, x=0.01, y=0.99, yanchor="top", font_size=13))
    return plot


def _box(work: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (3,) mm of the scene: of the arm in all its poses, else of the points that are drawn."""
    if has_arm(work.opened):
        return reach(work.opened, False)
    return _box_around(work.opened.residuals.points[:, work.drawn(MOST_ARROWS)])


def _box_around(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (3,) mm of a scene with a margin around places (3, n); of 1 mm where there are none."""
    if not places.size:
        return np.zeros(3), np.ones(3)
    low = places.min(axis=1)
    high = places.max(axis=1)
    margin = _MARGIN * float(np.linalg.norm(high - low))
    return low - margin, high + margin


def _enlargement(work: Workspace) -> float:
    """Factor by which the drawn arrows are enlarged, so that they can be seen in a scene with the arm too."""
    from workbench.report.calibration.scene import arrow_scale

    def compute():
        vectors = work.opened.residuals.arrows[:, work.drawn(MOST_ARROWS)]
        return arrow_scale(np.stack(_box(work), axis=1), vectors) if vectors.size else 1.0

    return work.summaries.memo.get(("enlargement",), compute)


def arrow_marks(work: Workspace) -> Overlay:
    """Above the arrows: the excluded and the selected samples, and the arm at the current one."""
    marks = Overlay()
    residuals = work.opened.residuals
    if residuals is None or residuals.points is None:
        return marks
    if has_arm(work.opened):
        robot.add_arm(marks, work)
    _add_excluded(marks, work)
    _add_selected(marks, residuals.points[:, work.selected_rows[: MOST_ARROWS // 4]])
    return marks


def _add_selected(marks: Overlay, places: np.ndarray) -> None:
    """Rings at places (3, k) mm."""
    x, y, z = places
    ring = dict(size=9, color=style.ORANGE, symbol="diamond-open")
    marks.add_scatter3d(x=x, y=y, z=z, mode="markers", name="selected", marker=ring)


def _add_excluded(marks: Overlay, work: Workspace) -> None:
    """Grey lines with white edges over the drawn arrows of excluded samples, and rings at their measured points."""
    found = work.opened.residuals
    drawn = work.drawn(MOST_ARROWS)
    drawn = drawn[~work.kept[drawn]]
    points = found.points[:, drawn]
    tips = points + _enlargement(work) * found.arrows[:, drawn]
    gap = np.full_like(points, np.nan)
    x, y, z = rounded(np.stack([points, tips, gap], axis=2).reshape(3, -1))
    marks.add_scatter3d(x=x, y=y, z=z, mode="lines", line=dict(color="white", width=_COVER))
    marks.add_scatter3d(x=x, y=y, z=z, mode="lines", line=dict(color=style.GREY, width=1.5))
    x, y, z = rounded(points)
    ring = dict(color="white", size=4, line=dict(color=style.GREY, width=1))
    marks.add_scatter3d(x=x, y=y, z=z, mode="markers", name="excluded", marker=ring)


def chart(work: Workspace, name: str, kind: str) -> go.Figure:
    """Length of the residual over one quantity, without what a selection or an edit changes."""
    label = kind_label(work.opened.residuals, kind)
    unit = unit_of(kind)
    plot = style.plane(style.plain(name), f"residual, {label} ({unit})", f"chart-{name}-{kind}")
    plot.update_layout(clickmode="event", dragmode=False)
    plot.update_layout(xaxis_type="linear", yaxis_type="linear")  # plotly finds out in 14 ms else
    if name not in work.quantities:
        return plot
    rows = work.drawn(MOST_POINTS, kind or "")
    _name_groups(plot, work, name)
    plot.add_scattergl(
        x=work.quantities[name][rows],
        y=np.round(work.lengths(kind)[rows], 6),
        mode="markers",
        name="samples",
        customdata=rows,
        text=work.opened.edit_ids[rows],
        marker=dict(color=style.BLUE, size=5, opacity=0.7),
        hovertemplate="sample %{text}: %{y:.4f} " + unit + "<extra></extra>",
    )
    chart_marks(work, name, kind).add_legend(plot)
    return plot


def chart_marks(work: Workspace, name: str, kind: str) -> Overlay:
    """Above the chart: the excluded samples, the selected ones, and the mean of those that are kept."""
    marks = Overlay()
    if name not in work.quantities:
        return marks
    x = work.quantities[name]
    y = work.lengths(kind)
    drawn = work.drawn(MOST_POINTS, kind or "")
    chosen = np.union1d(drawn[work.selected[drawn]], work.selected_rows[: MOST_POINTS // 4])
    groups = {"excluded": drawn[~work.kept[drawn]], "selected": chosen}
    for label, ring in (
        ("excluded", _ring(style.GREY, "white")),
        ("selected", _ring(style.ORANGE)),
    ):
        rows = groups[label]
        marks.add_scatter(x=x[rows], y=y[rows], mode="markers", name=label, marker=ring)
    centres, means = work.means(name, kind or "")
    line = dict(color=style.INK, width=2)
    marks.add_scatter(x=centres, y=means, mode="lines", name="mean", line=line)
    return marks


def _ring(colour: str, fill: str = "rgba(0,0,0,0)") -> dict:
    """A circle of a colour."""
    return dict(color=fill, size=8, line=dict(color=colour, width=1.5))


def kind_label(residuals: Residuals | None, kind: str) -> str:
    """Words for a kind of residual; "" is the kind that is shown where none is chosen."""
    if kind.endswith(ROTATION):
        return f"{_NAMES[kind.removesuffix(ROTATION)]}, orientation"
    if kind or residuals is None:
        return _NAMES.get(kind, kind)
    if HELD_OUT not in residuals.lengths:
        return _NAMES[FIT if FIT in residuals.lengths else "after"]
    is_complete = bool(np.isfinite(residuals.lengths[HELD_OUT]).all())
    return _NAMES[HELD_OUT] if is_complete else "held out, else fit"


def _name_groups(plot: go.Figure, work: Workspace, name: str) -> None:
    """Names of the recording at the axis, where the groups of a column have names."""
    from workbench.report.calibration.residuals import group_ticks

    names = work.opened.samples.group_names
    known = names.get(name.removesuffix(" (number)"), ())
    if 0 < len(known) <= _MOST_NAMES:
        numbers = np.arange(1.0, len(known) + 1)
        texts = [style.plain(text) for text in group_ticks(name, numbers, names)]
        plot.update_xaxes(tickvals=numbers, ticktext=texts)


def histogram_figure(work: Workspace, threshold: float | None = None, shown: str = "") -> go.Figure:
    """Counts of the lengths of the fit with the held-out ones over them, and the outlier threshold.

    shown: kind of residual that a click on a bin selects by, "" for the held-out one; it decides on mm or degrees.
    """
    unit = unit_of(shown)
    plot = style.plane(f"residual ({unit})", "samples", f"histogram-{unit}")
    plot.update_layout(barmode="overlay", bargap=0.02, clickmode="event", dragmode=False)
    residuals = work.opened.residuals
    if residuals is None:
        return plot
    kinds = _counted_kinds(residuals, ROTATION if unit == "deg" else "")
    counted = work.counts(kinds)
    middle = (counted.edges[:-1] + counted.edges[1:]) / 2
    for kind, counts in counted.counts.items():
        plot.add_bar(
            x=middle,
            y=counts,
            width=np.diff(counted.edges),
            name=_NAMES[kind.removesuffix(ROTATION)],
            marker_color=_COLOURS[kind.removesuffix(ROTATION)],
            opacity=0.55,
            hoverinfo="skip",
        )
    _add_bins(plot, counted, shown if shown in kinds else kinds[-1], unit)
    if threshold is not None:
        plot.add_vline(
            x=threshold,
            line_color=style.ORANGE,
            line_width=3,
            annotation_text=f"threshold {threshold:.4g} mm",
            annotation_position="top left",
        )
    return plot


def _counted_kinds(residuals: Residuals, end: str) -> list[str]:
    """Kinds of residual that a histogram shows over one another; of a diagnosis the held-out ones where it has them."""
    if not end and HELD_OUT_AFTER in residuals.lengths:
        return [HELD_OUT_BEFORE, HELD_OUT_AFTER]
    kinds_needed = [f"{kind}{end}" for kind in (FIT, HELD_OUT, "before", "after")]
    return [kind for kind in kinds_needed if kind in residuals.lengths]


def _add_bins(plot: go.Figure, counted: Histogram, kind: str, unit: str) -> None:
    """Invisible bars of full height, which a click meets: bars overlap, and one of few samples is too low.

    Their custom data are the ends of the bin and the kind of residual that a click selects by.
    """
    all_counts = np.array(list(counted.counts.values()))
    names = [_NAMES[kind_name.removesuffix(ROTATION)] for kind_name in counted.counts]
    lows = counted.edges[:-1].tolist()
    highs = counted.edges[1:].tolist()
    texts = [
        f"{low:.4f} to {high:.4f} {unit}: "
        + ", ".join(f"{name} {count:,}" for name, count in zip(names, counts))
        for low, high, counts in zip(lows, highs, all_counts.T.tolist())
    ]
    plot.add_bar(
        x=(counted.edges[:-1] + counted.edges[1:]) / 2,
        y=np.where(all_counts.any(axis=0), all_counts.max(initial=0), 0),
        width=np.diff(counted.edges),
        name="bins",
        showlegend=False,
        customdata=[[low, high, kind] for low, high in zip(lows, highs)],
        text=texts,
        textposition="none",
        marker_color=style.GREY,
        opacity=0,
        hovertemplate="%{text}<extra></extra>",
    )


def has_side_by_side(work: Workspace) -> bool:
    """Whether the newest run and the one before are calibrations whose residuals have known positions.

    A calibration after a diagnosis is compared with the baseline of the diagnosis, whose arrows are not stored.
    """
    runs = [run.residuals for run in (work.previous, work.opened) if run is not None]
    found = [
        vectors_of_run
        for vectors_of_run in runs
        if vectors_of_run is not None and FIT in vectors_of_run.vectors
    ]
    return sum(vectors_of_run.points is not None for vectors_of_run in found) == 2


def side_by_side(work: Workspace) -> go.Figure:
    """Arrows of the run before and of the newest run, with the same enlargement and the same colours."""
    from workbench.report.calibration.scene import arrow_scale

    pairs = [("before", work.previous), ("after", work.opened)]
    plot = go.Figure(layout=style.space("side-by-side").layout)
    runs = [(name, run.residuals) for name, run in pairs if run is not None]
    runs = [(name, found) for name, found in runs if found is not None and found.points is not None]
    if len(runs) < 2:
        return plot
    top = max(colour_top(found.shown) for _, found in runs)
    first = runs[0][1]
    scale = arrow_scale(first.points, first.arrows)
    ends = [
        vectors_of_run.points + share * vectors_of_run.arrows
        for _, vectors_of_run in runs
        for share in (0, scale)
    ]
    places = np.concatenate(ends, axis=1)
    low = np.nanmin(places, axis=1)
    high = np.nanmax(places, axis=1)
    for k, (name, found) in enumerate(runs):
        drawn = thinned(len(found.shown), MOST_ARROWS // 2, found.shown)
        vectors = scale * found.arrows[:, drawn]
        numbers = found.sample[drawn]
        needles = Needles(found.points[:, drawn], vectors, drawn, numbers, found.shown[drawn])
        scene = dict(name=name, scene=("scene", "scene2")[k], showscale=k == 1)
        add_needles(plot, needles, float(np.linalg.norm(high - low)), cmax=top, **scene)
        plot.add_annotation(
            text=f"<b>{name}</b>",
            x=0.25 + 0.5 * k,
            y=1,
            xref="paper",
            yref="paper",
            showarrow=False,
        )
    style.framed(plot, low, high)
    scene = plot.layout.scene.to_plotly_json()
    for k, key in enumerate(("scene", "scene2")):
        half = [0.5 * k, 0.5 * k + 0.5]
        plot.update_layout({key: {**scene, "domain": {"x": half, "y": [0, 0.95]}}})
    return plot.update_layout(showlegend=False)


def comparison(work: Workspace) -> go.Figure:
    """Share of samples whose residual is shorter, of the newest run and the one before."""
    label = kind_label(work.opened.residuals, "")
    plot = style.plane(f"residual, {label} (mm)", "share of samples", "comparison")
    for run, name, colour in (
        (work.previous, "before", style.GREY),
        (work.opened, "after", style.BLUE),
    ):
        if run is None or run.residuals is None:
            continue
        known = run.residuals.lengths
        is_baseline = name == "before" and "before" in known  # of a diagnosis
        lengths = np.sort(known["before"] if is_baseline else run.residuals.shown)
        lengths = lengths[np.isfinite(lengths)]
        indices = thinned(len(lengths), 500)
        share = (indices + 1) / max(len(lengths), 1)
        plot.add_scatter(
            x=lengths[indices], y=share, mode="lines", name=name, line=dict(color=colour, width=2.5)
        )
    plot.update_yaxes(tickformat=".0%")
    return plot
