"""What is left between prediction and measurement: one residual a sample, and how it is spread."""

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from scipy.stats import chi

from workbench.report import style
from workbench.report.text import rounded

_CURVE_POINTS = 800


@dataclass(frozen=True)
class Errors:
    """Residuals (3, n) mm, predicted minus measured, frame of the measurement.

    Held-out where there is one (`held`, (n,) bool), that of the fit elsewhere; `distance` (n,)
    its length; `sigma` mm of one coordinate (root mean square over the samples), None if unknown.
    `parts` of the three are measured: one where a sample is a length.
    """

    residual: np.ndarray
    held: np.ndarray
    sigma: float | None
    parts: int = 3

    @property
    def distance(self) -> np.ndarray:
        return np.linalg.norm(self.residual, axis=0)


def errors_of(calibration) -> Errors:
    """The residuals that every section of the page shows."""
    held_out = calibration.held_out_residual
    held = np.isfinite(held_out).all(0)
    sigma = calibration.recording.sigma
    return Errors(
        np.where(held, held_out, calibration.fit_residual),
        held,
        None if sigma is None else float(np.sqrt(np.mean(sigma**2))),
        int((calibration.fit_residual != 0).any(1).sum()) or 3,  # a length stands beside zeros
    )


def section(calibration, errors: Errors) -> dict:
    """Histogram and cumulative share of the held-out distances."""
    return {
        "histogram": style.packed(histogram(errors, calibration.held_out)),
        "cumulative": style.packed(cumulative(calibration, errors)),
        "noise": noise_sentence(errors.sigma, calibration.held_out, errors.parts),
    }


def noise_sentence(sigma: float | None, held_out: dict, parts: int = 3) -> str:
    """What the instrument's noise alone would leave, beside what is left."""
    if sigma is None:
        return (
            "The recording states no noise of the instrument, so that these errors cannot be "
            "split into noise and what the model lacks."
        )
    floor = np.sqrt(parts) * sigma
    ratio = held_out["rms_mm"] / floor
    return (
        f"The recording states σ = {sigma:.3g} mm a coordinate; noise alone would leave an RMS distance of "
        f"{_root(parts)} = {rounded(floor)} mm. The held-out RMS is {rounded(ratio)} times that."
    )


def _root(parts: int) -> str:
    return "σ" if parts == 1 else f"√{parts} σ"


def histogram(errors: Errors, held_out: dict) -> go.Figure:
    """Counts of held-out distances, with the noise's RMS, the RMS and the 95 % point marked."""
    distance = errors.distance[errors.held]
    counts, edges = np.histogram(distance, bins=_bins(distance))
    figure = style.figure(370, "3-D distance, predicted to measured (mm)", "samples")
    figure.add_bar(
        x=(edges[1:] + edges[:-1]) / 2,
        y=counts,
        width=np.diff(edges),
        name="held-out samples",
        marker=dict(color=style.BLUE, line_width=0),
        showlegend=False,
        hovertemplate="%{x:.4f} mm: %{y} samples<extra></extra>",
    )
    top = float(counts.max(initial=1)) * 1.06
    for name, x, colour, dash in _marks(errors, held_out):
        figure.add_scatter(
            x=[x, x],
            y=[0, top],
            mode="lines",
            name=f"{name} {rounded(x)} mm",
            line=dict(color=colour, width=2, dash=dash),
            hoverinfo="skip",
        )
    figure.update_yaxes(range=[0, top])
    return figure.update_layout(margin_t=84)


def cumulative(calibration, errors: Errors) -> go.Figure:
    """Share of samples that err by less, on a logarithmic axis: nominal, fit, held-out, noise."""
    figure = style.figure(370, "3-D distance, predicted to measured (mm, logarithmic)", "share of samples (%)")
    for name, distance, colour, dash, width in (
        ("nominal geometry", np.linalg.norm(calibration.nominal_residual, axis=0), style.GREY, "dot", 2),
        ("fit", np.linalg.norm(calibration.fit_residual, axis=0), style.GREEN, "dash", 2),
        ("held out", errors.distance[errors.held], style.BLUE, "solid", 3),
    ):
        _add_curve(figure, name, *_ecdf(distance), dict(color=colour, dash=dash, width=width))
    if errors.sigma:
        share = np.linspace(0.005, 0.995, 200)
        _add_curve(
            figure,
            "noise alone",
            chi.ppf(share, errors.parts, scale=errors.sigma),
            100 * share,
            dict(color=style.ORANGE, width=2, dash="dashdot"),
        )
    ends = np.concatenate([trace.x for trace in figure.data])
    figure.update_xaxes(style.log_axis(ends[ends > 0].min() / 1.1, ends.max() * 1.1))
    return figure.update_layout(margin_t=84).update_yaxes(range=[0, 101])


def _marks(errors, held_out):
    """Name, place (mm), colour and dash of the upright lines of the histogram."""
    marks = [("RMS", held_out["rms_mm"], style.ORANGE, "solid"), ("95 %", held_out["p95_mm"], style.VIOLET, "dash")]
    if not errors.sigma:
        return marks
    name = f"noise alone, RMS {_root(errors.parts)}"
    return [*marks, (name, np.sqrt(errors.parts) * errors.sigma, style.GREY, "dot")]


def _bins(distance):
    """Freedman & Diaconis' rule, kept between 10 and 80 bins."""
    return int(np.clip(len(np.histogram_bin_edges(distance, "fd")) - 1, 10, 80)) if distance.size else 10


def _ecdf(distance):
    """Sorted distances and share (%) of samples below, thinned evenly in rank."""
    ordered = np.sort(distance[np.isfinite(distance)])
    rank = np.unique(np.linspace(0, len(ordered) - 1, min(len(ordered), _CURVE_POINTS)).astype(int))
    return ordered[rank], 100 * (rank + 1) / max(len(ordered), 1)


def _add_curve(figure, name, x, y, line):
    figure.add_scatter(
        x=x,
        y=y,
        mode="lines",
        name=name,
        line=line,
        hovertemplate="%{y:.1f} % below %{x:.4f} mm<extra>" + name + "</extra>",
    )
