"""Convergence of the solver: cost after each step, stage after stage."""

import plotly.graph_objects as go

from workbench.report import style

_COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.VIOLET)
_SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross")


def section(calibration) -> dict:
    """The figure, and the outcome that the solver reports."""
    solved = [stage for stage in calibration.stages if len(stage.history)]
    return {
        "figure": style.packed(figure(solved)) if solved else "",
        "outcome": calibration.solution.outcome,
    }


def figure(stages) -> go.Figure:
    """Cost over step, one line per stage; each stage starts where the previous one ended."""
    plot = style.figure(
        360, "step of the solver, all stages in sequence", "cost (dimensionless, logarithmic)"
    )
    start = 0
    for k, stage in enumerate(stages):
        steps = list(range(start, start + len(stage.history)))
        if stage.earned:
            colour = _COLOURS[k % len(_COLOURS)]
        else:
            colour = style.GREY
        plot.add_scatter(
            x=steps,
            y=list(stage.history),
            mode="lines+markers",
            name=stage.name + ("" if stage.earned else " (not retained)"),
            line=dict(color=colour, width=2, dash="solid" if stage.earned else "dot"),
            marker=dict(size=6, symbol=_SYMBOLS[k % len(_SYMBOLS)]),
            hovertemplate="step %{x}: cost %{y:.6g}<extra>" + stage.name + "</extra>",
        )
        start += len(stage.history)
    plot.update_xaxes(dtick=max(1, start // 12), range=[-0.5, start - 0.5])
    costs = [cost for stage in stages for cost in stage.history if cost > 0]
    return plot.update_yaxes(style.log_axis(min(costs) / 1.3, max(costs) * 1.3))
