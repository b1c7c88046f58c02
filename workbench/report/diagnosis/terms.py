"""Before and after, term by term: residuals of the simulation, the baseline and the model with one more term each."""

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from workbench.explanation.result import Diagnosis, Step
from workbench.report import style
from workbench.report.calibration.scene import axes
from workbench.report.diagnosis.figures import binned, shown_covariate
from workbench.report.sections import figure, table, words
from workbench.report.text import rounded

_COLOURS = (style.GREY, style.ORANGE, style.VIOLET, style.GREEN, "#5b5bd6", "#806000")
_COLUMNS = 3


def before_and_after(diagnosis: Diagnosis):
    """Blocks of the section; none where there is nothing to compare."""
    steps = diagnosis.views.steps
    yield words(
        f"{_error_name(diagnosis)} between model and recording, all samples, fitted. The base and the "
        "tool are fitted in "
        "every row, the geometry from the baseline on; each further row has one more term."
    )
    yield table(
        ["model", f"RMS ({diagnosis.unit})", f"change ({diagnosis.unit})"], list(_rows(steps))
    )
    yield figure(
        "terms-sizes", sizes(diagnosis), "Bars: RMS distance of each model. Dotted: noise."
    )
    yield figure(
        "terms-over",
        over_covariates(diagnosis),
        "RMS distance over time and over the joint readings, in bins of equal count.",
    )
    yield figure(
        "terms-space",
        in_space(diagnosis),
        "Length of the residual in the workspace. The menu chooses the model; the colour scale stays.",
    )


def _error_name(diagnosis: Diagnosis) -> str:
    if diagnosis.measures == "ball-surface":
        return "RMS radial distance of the points of a scan"
    return "RMS 3-D distance" if diagnosis.views.has_direction else "RMS residual"


def _rows(steps: tuple[Step, ...]):
    last = None
    for step in steps:
        yield step.name, rounded(step.rms), "" if last is None else _signed(step.rms - last)
        last = step.rms


def _signed(value: float) -> str:
    return ("+" if value > 0 else "") + rounded(value)


def sizes(plot: Diagnosis) -> go.Figure:
    """Bars of the RMS distance of each model, the first on top, and the noise."""
    steps = plot.views.steps[::-1]
    values = [max(step.rms, 1e-9) for step in steps]
    drawn = style.figure(110 + 30 * len(steps), f"{_error_name(plot)} ({plot.unit}, logarithmic)")
    drawn.add_bar(
        y=[step.name for step in steps],
        x=values,
        orientation="h",
        showlegend=False,
        marker=dict(color=[colour(plot, step) for step in steps]),
        text=[f"{step.rms:.4g} {plot.unit}" for step in steps],
        textposition="auto",
    )
    drawn.add_vline(x=plot.proof.noise, line=dict(color=style.GREY, dash="dot", width=2))
    noise = plot.proof.noise
    ends = [*values, *([noise] if np.isfinite(noise) and noise > 0 else [])]
    drawn.update_xaxes(style.log_axis(min(ends) / 1.5, max(ends) * 1.5))
    drawn.update_yaxes(automargin=True)
    return drawn.update_layout(bargap=0.3)


def colour(diagnosis: Diagnosis, step: Step) -> str:
    """Colour of a model in all figures; the last is blue."""
    steps = diagnosis.views.steps
    if step is steps[-1]:
        return style.BLUE
    place = next(k for k, candidate in enumerate(steps) if candidate is step)
    return _COLOURS[place % len(_COLOURS)]


def over_covariates(plot: Diagnosis) -> go.Figure:
    """RMS distance in bins, a panel for time and for every joint reading, a line a model."""
    names = [
        name for name in plot.views.covariates if name in ("time", "time_s") or _is_joint(name)
    ]
    names = sorted(dict.fromkeys(names), key=lambda name: not name.startswith("time"))
    rows = max(-(-len(names) // _COLUMNS), 1)
    drawn = make_subplots(rows, _COLUMNS, shared_yaxes=True, vertical_spacing=0.45 / rows)
    drawn.update_layout(
        template="none", height=70 + 230 * rows, margin=dict(l=64, r=18, t=50, b=54)
    )
    for k, name in enumerate(names):
        row = k // _COLUMNS + 1
        column = k % _COLUMNS + 1
        x, title = shown_covariate(name, plot.views.covariates)
        for step in plot.views.steps:
            _line(drawn, plot, step, x, (row, column))
        drawn.update_xaxes(title=dict(text=title, standoff=6), row=row, col=column)
    drawn.update_yaxes(title=dict(text=f"RMS distance ({plot.unit})"), col=1)
    drawn.update_yaxes(rangemode="tozero")
    return drawn.update_layout(legend=dict(orientation="h", x=0, y=1.02, yanchor="bottom"))


def _is_joint(name: str) -> bool:
    return name[:1] == "q" and name[1:].removesuffix("_mm").isdigit()


def _line(drawn: go.Figure, plot: Diagnosis, step: Step, x, place) -> None:
    centres, means = binned(x, (step.residual**2).sum(0))
    drawn.add_scatter(
        x=centres,
        y=np.sqrt(means),
        mode="lines",
        name=step.name,
        legendgroup=step.name,
        showlegend=place == (1, 1),
        line=dict(color=colour(plot, step), width=2),
        row=place[0],
        col=place[1],
    )


def in_space(plot: Diagnosis) -> go.Figure:
    """The measured points coloured by the residual of the model that a menu chooses, on one colour scale."""
    steps = plot.views.steps
    views = plot.views
    shown = style.thinned(views.points.shape[1])
    lengths = [np.linalg.norm(np.nan_to_num(step.residual[:, shown]), axis=0) for step in steps]
    if lengths[0].size:
        top = float(np.percentile(lengths[0], 98))
    else:
        top = 1.0
    drawn = go.Figure(layout=dict(template="none", height=540, scene=axes()))
    for k, (step, length) in enumerate(zip(steps, lengths)):
        drawn.add_scatter3d(
            **dict(zip("xyz", np.round(views.points[:, shown], 3))),
            mode="markers",
            name=step.name,
            visible=k == len(steps) - 1,
            showlegend=False,
            customdata=np.round(length, 5),
            marker=dict(
                size=3.5,
                color=np.round(length, 5),
                colorscale="Viridis",
                cmin=0,
                cmax=top,
                colorbar=dict(
                    title=dict(text=f"residual ({plot.unit})", side="right"), thickness=12
                ),
            ),
            hovertemplate="%{customdata:.4f} " + plot.unit + "<extra></extra>",
        )
    return drawn.update_layout(margin=dict(l=0, r=0, t=44, b=0), updatemenus=[_menu(steps)])


def _menu(steps: tuple[Step, ...]) -> dict:
    """A drop-down list that shows the trace of one model."""
    buttons = [
        dict(
            label=step.name,
            method="update",
            args=[{"visible": [k == j for j in range(len(steps))]}],
        )
        for k, step in enumerate(steps)
    ]
    return dict(buttons=buttons, active=len(steps) - 1, x=0, y=1.08, xanchor="left", yanchor="top")


__all__ = ["before_and_after", "in_space", "over_covariates", "sizes"]
