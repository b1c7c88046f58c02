"""Residuals between prediction and measurement: one per sample, and their distribution."""

from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from robot_model.measurements import ball_scan
from workbench.core.distributions import chi2
from workbench.report import style
from workbench.report.text import rounded

_CURVE_POINTS = 800


@dataclass(frozen=True)
class Kind:
    """Kind of error: `quantity` in words, its `unit`, and the `prefix` of its keys in an error block."""

    quantity: str
    unit: str
    prefix: str
    name: str

    def key(self, figure: str) -> str:
        """Key of `rms`, `mean`, `p95` or `max` in an error block of the JSON contract."""
        return f"{self.prefix}{figure}_{self.unit}"


POSITION = Kind("3-D distance", "mm", "", "position")
ROTATION = Kind("rotation angle", "deg", "rotation_", "orientation")
_FROM_BALL = "radial distance of the points"
_SINGLE_NUMBERS = {
    ball_scan.FILE_KIND: _FROM_BALL,
    ball_scan.KIND: _FROM_BALL,
    "plane-touch": "distance of the tip from the plane",
    "distance": "error of the length",
}


def position_kind(measures: str) -> Kind:
    """The kind of the position error of a recording, which may be one number for each sample."""
    return replace(POSITION, quantity=_SINGLE_NUMBERS.get(measures, POSITION.quantity))


def kinds_of(calibration) -> list[Kind]:
    """The kinds of error that a calibration has."""
    kinds = (position_kind(calibration.recording.measures), ROTATION)
    return [kind for kind in kinds if kind.key("rms") in calibration.held_out]


@dataclass(frozen=True)
class Errors:
    """Residuals (k, n) in the unit of their `kind`, predicted minus measured, frame of the measurement.

    The residual is the held-out one where it exists (`is_held_out`, (n,) bool), else that of the fit. `distance` (n,)
    is its length. `sigma`: standard deviation of one coordinate (root mean square over the samples), None if
    unknown. `coordinates`: measured components of the k; 1 if a sample is a length. `axes`: names of the components,
    empty if their frame changes from sample to sample. `fit`, `nominal` (n,): lengths of the residuals of the
    fit and of the nominal geometry.
    """

    residual: np.ndarray
    is_held_out: np.ndarray
    sigma: float | None
    coordinates: int = 3
    kind: Kind = POSITION
    axes: tuple[str, ...] = ("x", "y", "z")
    fit: np.ndarray | None = None
    nominal: np.ndarray | None = None

    @property
    def distance(self) -> np.ndarray:
        return np.linalg.norm(self.residual, axis=0)

    @property
    def rows(self) -> dict[str, np.ndarray]:
        """Name -> (n,): every component, then the length of the residual."""
        return dict(zip(self.axes, self.residual)) | {self.kind.quantity: self.distance}


def errors_of(calibration) -> Errors:
    """The position residuals of the page, mm."""
    held_out = calibration.held_out_residual
    fit = calibration.fit_residual
    is_judged = np.isfinite(held_out).all(0)
    measured_components = (fit != 0).any(1).sum()  # a length has two zero components
    return Errors(
        np.where(is_judged, held_out, fit),
        is_judged,
        _root_mean_square(calibration.recording.sigma),
        int(measured_components) or 3,
        position_kind(calibration.recording.measures),
        fit=np.linalg.norm(fit, axis=0),
        nominal=np.linalg.norm(calibration.nominal_residual, axis=0),
    )


def rotation_errors_of(calibration) -> Errors | None:
    """The orientation residuals in degrees; None if the recording measures no orientation."""
    residuals = {name: np.rad2deg(rows) for name, rows in calibration.rotation.items()}
    if not residuals or not len(residuals["fit"]):
        return None
    is_judged = np.isfinite(residuals["held_out"]).all(0)
    coordinates = len(residuals["fit"])
    return Errors(
        np.where(is_judged, residuals["held_out"], residuals["fit"]),
        is_judged,
        _root_mean_square(calibration.recording.columns.get("sigma_deg")),
        coordinates,
        ROTATION,
        ("rx", "ry", "rz") if coordinates == 3 else (),
        np.linalg.norm(residuals["fit"], axis=0),
        np.linalg.norm(residuals["nominal"], axis=0),
    )


def _root_mean_square(sigma):
    if sigma is None:
        return None
    return float(np.sqrt(np.mean(np.square(sigma))))


def section(calibration, errors: Errors, rotation: Errors | None = None) -> dict:
    """Histogram and cumulative distribution of the held-out errors, for each measured kind."""
    kinds = [
        _spread(calibration, errors_of_kind)
        for errors_of_kind in (errors, rotation)
        if errors_of_kind is not None
    ]
    return {
        "kinds": kinds,
        "figures": list(FIGURES.values()),
        "table": error_rows(calibration, [errors, rotation]),
    }


def _spread(calibration, errors: Errors) -> dict:
    kind = errors.kind
    return {
        "id": kind.prefix,
        "title": kind.name,
        "what": kind.quantity,
        "histogram": style.packed(histogram(errors, calibration.held_out)),
        "cumulative": style.packed(cumulative(errors)),
        "noise": noise_sentence(errors.sigma, calibration.held_out, errors.coordinates, kind),
    }


FIGURES = {"rms": "RMS", "mean": "mean", "p95": "95 % below", "max": "max"}
_BLOCKS = {"nominal": "nominal geometry, held out", "fit": "fit", "held_out": "held out"}


def error_rows(calibration, all_errors) -> list[tuple[str, ...]]:
    """Rows of the table of errors: block, kind with unit, and the four figures as text."""
    kinds = [errors.kind for errors in all_errors if errors is not None]
    rows = []
    for block, name in _BLOCKS.items():
        figures = getattr(calibration, block)
        rows += [(name, *_error_row(figures, kind)) for kind in kinds]
    return rows


def _error_row(figures, kind) -> tuple[str, ...]:
    """Kind with unit, and the four figures as text."""
    values = [rounded(figures.get(kind.key(figure))) for figure in FIGURES]
    return (f"{kind.quantity} ({kind.unit})", *values)


def noise_sentence(
    sigma: float | None, held_out: dict, coordinates: int = 3, kind: Kind = POSITION
) -> str:
    """Compares the held-out error with the error that the stated instrument noise alone would cause."""
    if sigma is None:
        return (
            f"The recording states no noise of the measured {kind.name}. These errors can therefore not be "
            "split into noise and model discrepancy."
        )
    floor = np.sqrt(coordinates) * sigma
    ratio = held_out[kind.key("rms")] / floor
    coordinate = "per axis" if kind is ROTATION else "per coordinate"
    quantity = "distance" if coordinates == 1 else kind.quantity
    return (
        f"The recording states σ = {sigma:.3g} {kind.unit} {coordinate}. Noise alone causes an RMS "
        f"{quantity} of {_root(coordinates)} = {rounded(floor)} {kind.unit}. "
        f"The held-out RMS is {rounded(ratio)} times that."
    )


def _root(coordinates: int) -> str:
    return "σ" if coordinates == 1 else f"√{coordinates} σ"


def histogram(errors: Errors, held_out: dict) -> go.Figure:
    """Histogram of held-out errors, with the RMS of the noise, the RMS and the 95th percentile."""
    distance = errors.distance[errors.is_held_out]
    unit = errors.kind.unit
    counts, edges = np.histogram(distance, bins=_bins(distance))
    figure = style.figure(370, f"{errors.kind.quantity}, predicted to measured ({unit})", "samples")
    figure.add_bar(
        x=(edges[1:] + edges[:-1]) / 2,
        y=counts,
        width=np.diff(edges),
        name="held-out samples",
        marker=dict(color=style.BLUE, line_width=0),
        showlegend=False,
        hovertemplate="%{x:.4f} " + unit + ": %{y} samples<extra></extra>",
    )
    top = float(counts.max(initial=1)) * 1.06
    for name, x, colour, dash in _marks(errors, held_out):
        figure.add_scatter(
            x=[x, x],
            y=[0, top],
            mode="lines",
            name=f"{name} {rounded(x)} {unit}",
            line=dict(color=colour, width=2, dash=dash),
            hoverinfo="skip",
        )
    figure.update_yaxes(range=[0, top])
    return figure.update_layout(margin_t=84)


def cumulative(errors: Errors) -> go.Figure:
    """Cumulative distribution of the errors, logarithmic axis: nominal, fit, held-out, noise."""
    x_title = f"{errors.kind.quantity}, predicted to measured ({errors.kind.unit}, logarithmic)"
    figure = style.figure(370, x_title, "share of samples (%)")
    for name, distance, colour, dash, width in (
        ("nominal geometry", errors.nominal, style.GREY, "dot", 2),
        ("fit", errors.fit, style.GREEN, "dash", 2),
        ("held out", errors.distance[errors.is_held_out], style.BLUE, "solid", 3),
    ):
        line = dict(color=colour, dash=dash, width=width)
        _add_curve(figure, name, *_ecdf(distance), line, errors.kind.unit)
    if errors.sigma:
        share = np.linspace(0.005, 0.995, 200)
        noise = errors.sigma * np.sqrt(chi2.ppf(share, errors.coordinates))
        line = dict(color=style.ORANGE, width=2, dash="dashdot")
        _add_curve(figure, "noise alone", noise, 100 * share, line, errors.kind.unit)
    ends = np.concatenate([trace.x for trace in figure.data])
    low = ends[ends > 0].min() / 1.1
    figure.update_xaxes(style.log_axis(low, ends.max() * 1.1))
    return figure.update_layout(margin_t=84).update_yaxes(range=[0, 101])


def _marks(errors, held_out):
    """Name, position, colour and dash of the vertical lines of the histogram."""
    key = errors.kind.key
    marks = [
        ("RMS", held_out[key("rms")], style.ORANGE, "solid"),
        ("95 %", held_out[key("p95")], style.VIOLET, "dash"),
    ]
    if not errors.sigma:
        return marks
    name = f"noise alone, RMS {_root(errors.coordinates)}"
    return [*marks, (name, np.sqrt(errors.coordinates) * errors.sigma, style.GREY, "dot")]


def _bins(distance):
    """Number of bins by the rule of Freedman and Diaconis, limited to 10 to 80."""
    if distance.size:
        return int(np.clip(len(np.histogram_bin_edges(distance, "fd")) - 1, 10, 80))
    return 10


def _ecdf(distance):
    """Sorted distances and share (%) of samples below, thinned evenly in rank."""
    ordered = np.sort(distance[np.isfinite(distance)])
    count = len(ordered)
    even_ranks = np.linspace(0, count - 1, min(count, _CURVE_POINTS))
    rank = np.unique(even_ranks.astype(int))
    return ordered[rank], 100 * (rank + 1) / max(count, 1)


def _add_curve(figure, name, x, y, line, unit):
    figure.add_scatter(
        x=x,
        y=y,
        mode="lines",
        name=name,
        line=line,
        hovertemplate="%{y:.1f} % below %{x:.4f} " + unit + "<extra>" + name + "</extra>",
    )
