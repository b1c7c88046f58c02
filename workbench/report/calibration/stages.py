"""From the nominal robot to the result: error reduction by each stage of the calibration."""

import plotly.graph_objects as go

from workbench.report import style
from workbench.report.calibration.errors import POSITION, Kind, kinds_of
from workbench.report.text import counted, rounded, sentence


def section(calibration) -> dict:
    """A step chart for each kind of error, the table of stages, and the sentence on stages that are not retained."""
    kinds = kinds_of(calibration)
    return {
        "charts": [_chart_of_kind(calibration, kind) for kind in kinds],
        "what": " and the ".join(kind.quantity for kind in kinds),
        "rows": [row(stage, kinds) for stage in calibration.stages],
        "left_out": left_out(calibration.stages),
    }


def _chart_of_kind(calibration, kind: Kind) -> dict:
    packed = style.packed(chart(calibration, kind))
    return {"id": kind.prefix, "unit": kind.unit, "figure": packed}


def left_out(stages) -> str:
    """Number of stages that cross-validation does not retain, and the consequence."""
    idle = sum(not stage.earned for stage in stages)
    if not idle:
        return "Every stage lowers the held-out error and is part of the result."
    subject, verb = ("It is", "is") if idle == 1 else ("They are", "are")
    return (
        f"{counted(idle, 'stage')} {verb} not retained: the held-out error does not fall significantly. "
        f"{subject} drawn grey and not part of the result."
    )


def row(stage, kinds=(POSITION,)) -> dict:
    """A row of the table; `errors`: RMS of the fit and held-out RMS, for each kind of error."""
    return {
        "name": stage.name,
        "why": sentence(stage.why),
        "free": stage.free,
        "identifiable": stage.identifiable,
        "errors": [rounded(value) for kind in kinds for value in _rms_of(stage, kind)],
        "earned": stage.earned,
        "sentence": _reduction(stage),
        "outcome": _outcome(stage),
    }


def _reduction(stage) -> str:
    """By how much the stage reduces the error, without its name."""
    reduction = stage.sentence.removeprefix(f"{stage.name}:")
    return sentence(reduction.replace("->", "→"))


def _outcome(stage) -> str:
    """How the fit of the stage ended; "" where it converged."""
    return "" if stage.outcome.startswith("converged") else sentence(stage.outcome)


def _rms_of(stage, kind: Kind) -> tuple[float, float]:
    """RMS of the fit and held-out RMS of a `StageResult`, in the unit of the kind."""
    key = kind.key("rms")
    return getattr(stage, key), getattr(stage, f"held_out_{key}")


def chart(calibration, kind: Kind = POSITION) -> go.Figure:
    """Held-out RMS by stage, from top to bottom: a step line through the retained stages."""
    lines = _lines(calibration, kind)
    unit = kind.unit
    plot = style.figure(92 + 34 * len(lines), f"RMS of the {kind.quantity} ({unit}, logarithmic)")
    retained = [line for line in lines if line[3]]
    plot.add_scatter(
        x=[line[1] for line in retained],
        y=[line[0] for line in retained],
        mode="lines",
        hoverinfo="skip",
        line=dict(color=style.BLUE, width=1.5, shape="hv"),
        showlegend=False,
    )
    _add_held_out(plot, "held out, retained", retained, style.BLUE, unit)
    dropped = [line for line in lines if not line[3]]
    _add_held_out(plot, "held out, not retained", dropped, style.GREY, unit)
    fits = [line for line in lines if line[2] is not None]
    plot.add_scatter(
        x=[line[2] for line in fits],
        y=[line[0] for line in fits],
        mode="markers",
        name="fit",
        marker=dict(symbol="line-ns-open", size=13, color=style.GREEN, line_width=2),
        hovertemplate="fit %{x:.4f} " + unit + "<extra></extra>",
    )
    plot.update_layout(margin_r=64)
    plot.update_yaxes(
        autorange="reversed",
        type="category",
        categoryarray=[line[0] for line in lines],
        automargin=True,
    )
    values = [line[1] for line in lines] + [line[2] for line in fits]
    return plot.update_xaxes(**_log_range(values))


def _lines(calibration, kind: Kind):
    """(name, held-out RMS, RMS of the fit or None, retained) from top to bottom, in the unit of the kind."""
    key = kind.key("rms")
    lines = [("nominal geometry", calibration.nominal[key], None, True)]
    for stage in calibration.stages:
        fit, held_out = _rms_of(stage, kind)
        lines.append((stage.name, held_out, fit, stage.earned))
    return [*lines, ("<b>result</b>", calibration.held_out[key], calibration.fit[key], True)]


def _add_held_out(plot, name, lines, colour, unit):
    if not lines:
        return
    stages, held_out, *_ = zip(*lines)
    plot.add_scatter(
        x=held_out,
        y=stages,
        mode="markers+text",
        name=name,
        marker=dict(size=11, color=colour),
        text=[f"   {rounded(error)} {unit}" for error in held_out],
        textposition="middle right",
        cliponaxis=False,
        hovertemplate="%{y}: held out %{x:.4f} " + unit + "<extra></extra>",
    )


def _log_range(values):
    """A logarithmic axis with room on the right for the label of the last point."""
    low = min(values)
    high = max(values)
    span = max(high / low, 2.0)
    return style.log_axis(low / span**0.06, high * span**0.08)
