"""Residual over every recorded quantity: a dependence that remains is not noise."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from datasets.samples.columns import joint_columns
from workbench.report import style
from workbench.report.calibration.errors import Errors
from workbench.report.text import covariate_label, listed

_PANELS_ACROSS = 4


@dataclass(frozen=True)
class ResidualDependence:
    """The residual over one quantity.

    `x` (n,): its values; `centres` (B,) and `means` (k, B) of the bins, in the unit of the errors and in the
    order of `Errors.rows`; `share`: share of the variance of the components that the bin means explain.
    """

    label: str
    x: np.ndarray
    centres: np.ndarray
    means: np.ndarray
    share: float


def section(calibration, errors: Errors, rotation: Errors | None = None) -> dict:
    """For each kind of error: an overview of all quantities, a large figure, and the data of its menu.

    errors: of the position; rotation: of the orientation, if it is measured.
    """
    found = quantities(calibration.recording)
    names = calibration.recording.group_names
    constant = [
        covariate_label(name)
        for name, x in calibration.recording.covariates.items()
        if not _varies(x)
    ]
    return {
        "kinds": [
            _of_kind(found, errors_of_kind, names)
            for errors_of_kind in (errors, rotation)
            if errors_of_kind is not None
        ],
        "menu": [label for label, _ in found],
        "thinned": style.thinned_sentence(len(errors.is_held_out)),
        "constant": constant,
        "held": int(errors.is_held_out.sum()),
        "n": len(errors.is_held_out),
    }


def _of_kind(found: list[tuple[str, np.ndarray]], errors: Errors, names: Mapping) -> dict:
    dependences = [bin_residuals(label, x, errors) for label, x in found]
    shown = int(np.argmax([dependence.share for dependence in dependences]))
    drawn = style.thinned(len(errors.is_held_out))
    return {
        "id": errors.kind.prefix,
        "title": errors.kind.name,
        "overview": style.packed(overview(dependences, errors, names)),
        "detail": style.packed(detail(dependences[shown], errors, drawn)),
        "shown": shown,
        "data": menu_data(dependences, drawn),
        "most": f"{dependences[shown].label} ({_percent(dependences[shown].share)})",
        "rows": listed(list(errors.rows)),
    }


def quantities(recording) -> list[tuple[str, np.ndarray]]:
    """Label with unit and values (n,): joints, time or row order, covariates, number of the target."""
    found = [
        (_joint_label(name), recording.columns[name]) for name in joint_columns(recording.columns)
    ]
    found.append(("row order (row number)", np.arange(1, recording.n + 1)))
    covariates = sorted(recording.covariates.items(), key=lambda pair: pair[0] != "time_s")
    found += [(covariate_label(name), x) for name, x in covariates]
    found += [(f"{word} (number)", getattr(recording, word)) for word in ("ball", "reflector")]
    return [(label, np.asarray(x, float)) for label, x in found if _varies(x)]


def bin_residuals(label: str, x: np.ndarray, errors: Errors) -> ResidualDependence:
    """Means over bins of equal count, and the share of variance that they explain.

    Share: adjusted R^2 of the bin means, 1 - (1 - R^2)(n - 1)/(n - B), pooled over the components. Without
    components in a common frame, it is that of the length.
    """
    rows = np.stack(list(errors.rows.values()))
    bins = _bins_of(x)
    count = np.bincount(bins)
    means = np.stack([np.bincount(bins, row) / count for row in rows])
    axis_count = max(len(errors.axes), 1)
    residual = rows[:axis_count]
    remaining_squares = ((residual - means[:axis_count, bins]) ** 2).sum()
    total = ((residual - residual.mean(1, keepdims=True)) ** 2).sum()
    adjusted = 1 - remaining_squares / max(total, 1e-300) * (len(x) - 1) / max(
        len(x) - len(count), 1
    )
    return ResidualDependence(
        label, x, np.bincount(bins, x) / count, means, max(float(adjusted), 0.0)
    )


def overview(
    dependences: list[ResidualDependence], errors: Errors, names: Mapping = MappingProxyType({})
) -> go.Figure:
    """Small multiples: mean residual of each bin, on a common scale.

    names: column of groups -> their names in the recording, which then stand at the axis instead of numbers.
    """
    rows = -(-len(dependences) // _PANELS_ACROSS)
    titles = [
        f"{dependence.label.split(' (row')[0].removesuffix(' (number)')} · {_percent(dependence.share)}"
        for dependence in dependences
    ]
    lines = list(zip(errors.rows, _colours(errors)))[: max(len(errors.axes), 1)]
    plot = make_subplots(
        rows,
        _PANELS_ACROSS,
        shared_yaxes="all",
        subplot_titles=titles,
        horizontal_spacing=0.025,
        vertical_spacing=min(0.36 / rows, 0.3),
    )
    for k, dependence in enumerate(dependences):
        for (name, colour), mean in zip(lines, dependence.means):
            plot.add_scatter(
                x=dependence.centres,
                y=mean,
                mode="lines",
                name=f"mean {name}",
                legendgroup=name,
                showlegend=k == 0,
                line=dict(color=colour, width=1.7),
                row=k // _PANELS_ACROSS + 1,
                col=k % _PANELS_ACROSS + 1,
                hovertemplate="%{x:.3f}: mean "
                + name
                + " %{y:.4f} "
                + errors.kind.unit
                + "<extra></extra>",
            )
    plot.update_annotations(font_size=11.5)
    plot.update_layout(
        template="none",
        height=60 + 168 * rows,
        margin=dict(l=64, r=8, t=56, b=36),
        legend=dict(orientation="h", x=0, y=1, yref="container", yanchor="top"),
    )
    plot.update_yaxes(col=1, title_text=f"mean ({errors.kind.unit})", title_font_size=11.5)
    plot.update_xaxes(nticks=5, tickfont_size=10.5)
    for k, dependence in enumerate(dependences):
        if dependence.label.endswith("(number)") and len(dependence.centres) <= 8:
            ticks = dict(
                tickvals=dependence.centres,
                ticktext=group_ticks(dependence.label, dependence.centres, names),
            )
            plot.update_xaxes(**ticks, row=k // _PANELS_ACROSS + 1, col=k % _PANELS_ACROSS + 1)
    return plot


def group_ticks(label: str, numbers: np.ndarray, names: Mapping) -> list[str]:
    """Names of the groups `numbers` of the quantity "reflector (number)", the number where it has no name."""
    known = names.get(label.removesuffix(" (number)"), ())
    ticks = []
    for k in numbers:
        ticks.append(known[int(k) - 1] if 0 < k <= len(known) else f"{k:g}")
    return ticks


def detail(dependence: ResidualDependence, errors: Errors, drawn: np.ndarray) -> go.Figure:
    """Components and length of the residual of the drawn samples over one quantity, in stacked panels."""
    panels = len(errors.rows)
    unit = errors.kind.unit
    plot = make_subplots(panels, 1, shared_xaxes=True, vertical_spacing=0.025)
    for k, ((name, row), colour) in enumerate(zip(errors.rows.items(), _colours(errors))):
        plot.add_scatter(
            x=dependence.x[drawn],
            y=np.round(row[drawn], 6),
            mode="markers",
            showlegend=False,
            row=k + 1,
            col=1,
            marker=dict(size=3.5, color=colour, opacity=0.45 if len(drawn) > 1000 else 0.75),
            hovertemplate="%{x}: " + name + " %{y:.4f} " + unit + "<extra></extra>",
        )
        short = name.removeprefix("3-D ").removeprefix("rotation ")
        plot.update_yaxes(title_text=f"{short} ({unit})", title_standoff=6, row=k + 1, col=1)
    for k in range(panels):
        plot.add_scatter(
            x=dependence.centres,
            y=dependence.means[k],
            mode="lines+markers",
            showlegend=False,
            row=k + 1,
            col=1,
            meta="ink",
            line_width=1.8,
            marker_size=4,
            hovertemplate="mean of the bin %{y:.4f} " + unit + "<extra></extra>",
        )
    plot.update_layout(
        template="none", height=60 + 145 * panels, margin=dict(l=70, r=14, t=8, b=52)
    )
    return plot.update_xaxes(title_text=dependence.label, row=panels, col=1)


def _colours(errors: Errors) -> tuple[str, ...]:
    """One colour for each of `Errors.rows`."""
    return (*list(style.COMPONENTS.values())[: len(errors.axes)], style.DISTANCE)


def menu_data(dependences: list[ResidualDependence], drawn: np.ndarray) -> str:
    """JSON: label, values, bin centres and bin means for each entry of the menu."""
    return style.safe(
        json.dumps(
            [
                {
                    "label": dependence.label,
                    "x": np.round(dependence.x[drawn], 5).tolist(),
                    "centres": np.round(dependence.centres, 5).tolist(),
                    "means": np.round(dependence.means, 6).tolist(),
                }
                for dependence in dependences
            ]
        )
    )


def _bins_of(x):
    """(n,) index of the bin: one bin per value if there are few, else about twelve of equal count."""
    values, index = np.unique(x, return_inverse=True)
    max_bins = int(np.clip(len(x) // 10, 2, 12))
    return index if len(values) <= max_bins else _equal_count_bins(x, max_bins)


def _equal_count_bins(x, max_bins: int):
    """(n,) index of bins between quantiles; bins that equal values leave empty are not counted."""
    inner_shares = np.linspace(0, 1, max_bins + 1)[1:-1]
    edges = np.unique(np.quantile(x, inner_shares))
    return np.unique(np.searchsorted(edges, x, side="right"), return_inverse=True)[1]


def _joint_label(column):
    """'q3_deg' -> 'joint 3 (deg)'."""
    name, unit = column.split("_")
    return f"joint {name[1:]} ({unit})"


def _varies(x):
    return bool(np.isfinite(x).all() and np.ptp(x) > 0)


def _percent(share):
    if share < 0.01:
        return "below 1 %"
    return f"{100 * share:.0f} %"
