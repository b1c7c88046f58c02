"""Figures of a diagnosis: evidence, the three shares, held-out errors, residuals on robot, image and covariates."""

from collections.abc import Iterator, Mapping

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from workbench.core.vocabulary import Covariate
from workbench.explanation.result import Diagnosis
from workbench.explanation.sentences import words as said
from workbench.report import style
from workbench.report.calibration.scene import arrow_scale, axes

_COLOURS = {"before": style.GREY, "after": style.BLUE}
_MOST_PANELS = 6
_BINS = 20
_LOOKED = 5000
_FEW_VALUES = 4
SMALLEST_SHARE = 0.005  # of held-out errors, which the logarithmic axis leaves out
_SAME_CORRELATION = 0.999


def evidence(plot: Diagnosis) -> go.Figure:
    """Bars of the chi-square that each term explains: retained terms blue, rejected terms grey, largest on top."""
    terms = sorted(with_evidence(plot), key=lambda term: term.finding.gain)
    drawn = style.figure(120 + 34 * len(terms), "reduction of chi-square by the term (logarithmic)")
    drawn.add_bar(
        y=[term.title for term in terms],
        x=[max(term.finding.gain, 1e-3) for term in terms],
        orientation="h",
        marker=dict(color=[style.BLUE if term.kept else style.GREY for term in terms]),
        showlegend=False,
        text=[_bar_text(term, plot.unit) for term in terms],
        textposition="auto",
        hovertemplate="%{y}: %{x:.0f}<extra></extra>",
    )
    gains = [max(term.finding.gain, 1e-2) for term in terms] or [1.0]
    drawn.update_xaxes(style.log_axis(min(gains) / 3, max(gains) * 2))
    drawn.update_yaxes(automargin=True)
    return drawn.update_layout(bargap=0.3, margin_l=230)


def with_evidence(diagnosis: Diagnosis) -> list:
    """The terms, retained and rejected, that explain a part of the chi-square.

    A finding on the data (outliers, heteroscedastic noise) explains none and has no bar.
    """
    all_terms = (*diagnosis.terms, *diagnosis.refused)
    return [term for term in all_terms if np.isfinite(term.finding.gain) and term.finding.gain > 0]


def _bar_text(term, unit):
    size = "" if term.size is None else f"{term.size:.2g} {unit}"
    t = "" if term.t is None else f"t = {term.t:.1f}"
    return ", ".join(filter(None, (size, t)))


def shares(found) -> go.Figure:
    """Bars of the mean squared distance: parameters (base and tool separately), noise, unmodelled structure."""
    rows = (
        ("values not calibrated: base and tool", found.placing_mm2, style.GREY),
        ("values not calibrated: others", found.parameters_mm2 - found.placing_mm2, style.GREEN),
        ("noise", found.noise_mm2, style.BLUE),
        ("structure: unmodelled effects", found.structure_mm2, style.ORANGE),
    )
    rows = [row for row in rows[::-1] if row[1] > 0]
    drawn = style.figure(260, "mean squared distance (mm², logarithmic)")
    drawn.add_bar(
        y=[r[0] for r in rows],
        x=[r[1] for r in rows],
        orientation="h",
        showlegend=False,
        marker=dict(color=[r[2] for r in rows]),
        text=[f"{r[1]:.3g} mm²" for r in rows],
    )
    values = [r[1] for r in rows] or [1.0]
    drawn.update_xaxes(style.log_axis(min(values) / 5, max(values) * 5, max_ticks=9))
    return drawn.update_layout(bargap=0.3, margin_l=250)


def held_out(plot: Diagnosis) -> go.Figure:
    """Cumulative distribution of the held-out errors, before and after, and the noise."""
    drawn = _shares_of_samples(plot.proof.errors, plot.unit)
    drawn.add_scatter(
        x=[plot.proof.noise] * 2,
        y=[0, 100],
        mode="lines",
        name="noise, RMS",
        line=dict(color=style.ORANGE, dash="dot", width=2),
    )
    return _fitted_to_traces(drawn)


def held_out_rotation(plot: Diagnosis) -> go.Figure:
    """Cumulative distribution of the held-out rotation errors, before and after."""
    return _fitted_to_traces(_shares_of_samples(plot.proof.angles, "deg"))


def _shares_of_samples(lengths_by_stage, unit: str) -> go.Figure:
    """Share of samples over errors (2, n) before and after."""
    drawn = style.figure(360, f"held-out error ({unit}, logarithmic)", "share of samples (%)")
    for name, errors in zip(("before", "after"), lengths_by_stage):
        ordered = np.sort(errors[np.isfinite(errors)])
        if not len(ordered):
            continue
        rank = np.unique(np.linspace(0, len(ordered) - 1, min(len(ordered), 800)).astype(int))
        drawn.add_scatter(
            x=ordered[rank],
            y=100 * (rank + 1) / len(ordered),
            mode="lines",
            name=name,
            line=dict(color=_COLOURS[name], width=3),
        )
    return drawn


def _fitted_to_traces(drawn: go.Figure) -> go.Figure:
    """The figure with a logarithmic axis to its largest value.

    The smallest errors are many decades below the others and would take the width of the figure: the axis begins at
    the quantile `SMALLEST_SHARE`.
    """
    errors = _positive_errors(drawn)
    if len(errors):
        low = np.quantile(errors, SMALLEST_SHARE)
        drawn.update_xaxes(style.log_axis(low / 1.1, errors.max() * 1.1))
    return drawn.update_yaxes(range=[0, 101])


def _positive_errors(drawn: go.Figure) -> np.ndarray:
    """(n,) finite errors above zero of all traces."""
    errors = np.concatenate([[], *(np.asarray(trace.x, float) for trace in drawn.data)])
    return errors[np.isfinite(errors) & (errors > 0)]


def space(plot: Diagnosis, stage: str) -> go.Figure:
    """Residuals as lines at the measured points, coloured by length, with the arm; both figures share one scale.

    Residuals without a direction are colours alone.
    """
    views = plot.views
    shown = style.thinned(views.points.shape[1])
    residual = np.nan_to_num((views.before if stage == "before" else views.after)[:3, shown])
    before = np.nan_to_num(views.before[:3, shown])
    feet = views.points[:, shown]
    scale = arrow_scale(np.hstack([feet, views.links]), before)
    length = np.linalg.norm(residual, axis=0)
    top = float(np.percentile(np.linalg.norm(before, axis=0), 98))
    drawn = go.Figure(
        layout=dict(
            template="none",
            height=520,
            margin=dict(l=0, r=0, t=8, b=0),
            scene=axes(),
            legend=dict(orientation="h", x=0, y=0, yanchor="top"),
        )
    )
    if views.has_direction:
        _add_arrows(drawn, feet, residual, scale)
    drawn.add_scatter3d(
        **_xyz(feet),
        mode="markers",
        name="samples",
        customdata=np.round(length, 5),
        marker=dict(size=2.2, color=np.round(length, 5), colorscale="Viridis", cmin=0, cmax=top),
        hovertemplate="%{customdata:.4f} mm<extra></extra>",
    )
    drawn.add_scatter3d(
        **_xyz(views.links),
        mode="lines+markers",
        name="arm in one pose",
        hoverinfo="skip",
        meta="ink",
        line=dict(color=style.GREY, width=10),
        marker=dict(size=5, color=style.GREY),
    )
    return drawn


def _add_arrows(drawn: go.Figure, feet: np.ndarray, residual: np.ndarray, scale: float) -> None:
    path = np.stack([feet, feet + scale * residual, np.full_like(feet, np.nan)], axis=2)
    drawn.add_scatter3d(
        **_xyz(path.reshape(3, -1)),
        mode="lines",
        name=f"residual, enlarged {scale:,.0f} times",
        hoverinfo="skip",
        line=dict(color=style.ORANGE, width=2),
        connectgaps=False,
    )


def _xyz(points) -> dict:
    return dict(zip("xyz", np.round(points, 3)))


def image(plot: Diagnosis, stage: str) -> go.Figure:
    """Length of the residual over the position in the image."""
    views = plot.views
    shown = style.thinned(views.points.shape[1])
    lengths = {
        name: np.sqrt(np.nansum(part[:, shown] ** 2, 0))
        for name, part in (("before", views.before), ("after", views.after))
    }
    drawn = style.figure(400, "u (px)", "v (px)")
    drawn.add_scatter(
        x=views.points[0, shown],
        y=views.points[1, shown],
        mode="markers",
        showlegend=False,
        marker=dict(
            size=3,
            color=lengths[stage],
            colorscale="Viridis",
            cmin=0,
            cmax=float(np.percentile(lengths["before"], 98)),
            showscale=True,
            colorbar=dict(title=dict(text="residual (px)", side="right"), thickness=12),
        ),
    )
    return drawn.update_yaxes(autorange="reversed", scaleanchor="x", constrain="domain")


def residual_panels(plot: Diagnosis) -> Iterator[tuple[str, go.Figure]]:
    """(covariate, figure) of the residual components over the relevant covariates, then over time."""
    views = plot.views
    low, high = extent(np.concatenate([*views.before, *views.after]))
    for name in relevant_covariates(plot):
        x, title = shown_covariate(name, views.covariates)
        shown = style.thinned(len(x))
        titles = [f"{n} ({plot.unit})" for n in views.names[: len(views.before)]]
        drawn = make_subplots(
            1, len(views.before), shared_yaxes=True, horizontal_spacing=0.03, subplot_titles=titles
        )
        drawn.update_layout(template="none", height=300, margin=dict(l=64, r=18, t=40, b=48))
        for stage, part in (("before", views.before), ("after", views.after)):
            for k, row in enumerate(part, 1):
                _panel(drawn, k, x, row, shown, stage)
        middle = (
            len(views.before) + 1
        ) // 2  # once: a long title under every panel runs into the next
        drawn.update_xaxes(title=dict(text=title, standoff=8), col=middle)
        drawn.update_yaxes(range=[low, high])
        drawn.update_xaxes(nticks=4)  # more of them run into those of the next panel
        yield name, drawn


def extent(values) -> tuple[float, float]:
    """Range of the central 99 % of all values, widened by a tenth at each end."""
    known = values[np.isfinite(values)]
    if not len(known) or not np.ptp(known) > 0:
        middle = float(known[0]) if len(known) else 0.0
        return middle - 1.0, middle + 1.0
    low, high = np.percentile(known, [0.5, 99.5])
    return low - 0.1 * (high - low), high + 0.1 * (high - low)


_UNITS = {
    "tau": "N m",
    "moment": "N m",
    "temperature": "°C",
    "sight_range": "m",
    "range": "mm",
    "along": "mm",
    "u": "px",
    "v": "px",
}
_ANGLES = ("sight_azimuth", "sight_elevation", "incidence", "mirror")
_SHOWN_UNITS = ("mm", "kg", "deg", "s")


def covariate_name(name: str) -> str:
    """A covariate in words; the direction of a last move, too."""
    known = Covariate.of(name)
    if known.kind == "move" and known.unit == "side":
        return f"the direction of the last move of joint {known.place.number}"
    return said.covariate(name)


def shown_covariate(name: str, covariates: Mapping[str, np.ndarray]) -> tuple[np.ndarray, str]:
    """Values of a covariate in the unit of display, and the title of the axis."""
    x = covariates[name]
    words = covariate_name(name)
    if name in ("time", "time_s"):
        return x, "time (s)" if "time_s" in covariates else "row number"
    known = Covariate.of(name)
    is_angle = known.kind in ("q", "move") and known.place and not known.unit
    if is_angle or known.kind in _ANGLES:
        return np.rad2deg(x), f"{words} (°)"
    unit = _UNITS.get(known.kind, known.unit if known.unit in _SHOWN_UNITS else "")
    return x, f"{words} ({unit})" if unit else words


def _panel(drawn, k, x, row, shown, stage):
    size = 2.5
    drawn.add_scatter(
        x=x[shown],
        y=row[shown],
        mode="markers",
        showlegend=False,
        hoverinfo="skip",
        row=1,
        col=k,
        marker=dict(size=size, color=_COLOURS[stage], opacity=0.25),
    )
    centres, means = binned(x, row)
    drawn.add_scatter(
        x=centres,
        y=means,
        mode="lines",
        name=stage,
        showlegend=k == 1,
        row=1,
        col=k,
        line=dict(color=_COLOURS[stage], width=3),
    )


def binned(x: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres and means of bins of equal count; if there are few values, each is a bin."""
    is_finite = np.isfinite(row) & np.isfinite(x)
    x, row = x[is_finite], row[is_finite]
    values, place = np.unique(x, return_inverse=True)
    if len(values) <= _FEW_VALUES:
        return values, np.bincount(place, row) / np.bincount(place)
    bins = np.array_split(np.argsort(x, kind="stable"), min(_BINS, max(len(x) // 8, 1)))
    return np.array([x[p].mean() for p in bins if len(p)]), np.array(
        [row[p].mean() for p in bins if len(p)]
    )


def relevant_covariates(diagnosis: Diagnosis) -> list[str]:
    """At most six covariates: those whose bins explain most of the reduction by the findings, and time."""
    views = diagnosis.views
    wide = [
        name
        for name, x in views.covariates.items()
        if len(np.unique(x[np.isfinite(x)][:_LOOKED])) > 2 or Covariate.of(name).is_signed
    ]
    removed = {name: fall(views, name) for name in wide if name not in ("time", "time_s")}
    best: list[str] = []
    for name in sorted(removed, key=lambda name: -removed[name]):
        if len(best) < _MOST_PANELS - 1 and not any(
            _same(views.covariates[name], views.covariates[b]) for b in best
        ):
            best.append(name)
    return [*best, *(name for name in ("time",) if name in views.covariates)]


def _same(x: np.ndarray, y: np.ndarray) -> bool:
    """True if two covariates differ in unit or sign only, such as a torque and the moment about the same axis."""
    is_known = np.isfinite(x) & np.isfinite(y)
    known = np.stack([x, y])[:, is_known]
    if not known.size or not np.ptp(known, axis=1).all():
        return False
    correlation = float(np.corrcoef(known)[0, 1])
    return abs(correlation) > _SAME_CORRELATION


def fall(views, name: str) -> float:
    """Reduction of the variance of the bin means of a covariate, summed over the components."""
    x = views.covariates[name]
    before, after = (
        sum(_variance(binned(x, row)[1]) for row in part) for part in (views.before, views.after)
    )
    return before - after


def _variance(means: np.ndarray) -> float:
    """Variance of the bin means; 0 without bins."""
    if len(means):
        return float(np.var(means))
    return 0.0
