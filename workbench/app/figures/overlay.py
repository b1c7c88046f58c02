"""Marks above a figure that the browser draws itself: what a click changes, without drawing the figure again.

plotly computes all marks of a figure again where one of them changes, and WebGL draws all of them again. Of a million
samples a figure shows some thousands, of which a selection changes a few.
"""

import json
from base64 import b64encode
from collections.abc import Iterable, Mapping

import numpy as np
import plotly.graph_objects as go

_LINE = 0.6
"""Width of a line in px for each unit of plotly's width of a line in space."""
_THIN = 1.5


class Overlay:
    """Traces that are drawn above a figure, in order: scatter3d above a scene, scatter above a chart.

    A figure of plotly takes 3 ms to check each trace, this one takes them as they are.
    """

    def __init__(self):
        self.traces: list[dict] = []

    def add_scatter3d(self, **trace) -> None:
        """Add a trace in space, in mm."""
        self.traces.append(trace)

    def add_scatter(self, **trace) -> None:
        """Add a trace in the plane, in the units of the axes."""
        self.traces.append(trace)

    def encoded(self) -> str:
        """Layers for `overlay.js`, as JSON."""
        return json.dumps([layer for trace in self.traces for layer in _layers(trace)])

    def add_legend(self, plot: go.Figure) -> None:
        """Name the marks in the legend of the figure below, by traces without points."""
        keys = ("name", "mode", "marker", "line")
        for trace in self.traces:
            if trace.get("name"):
                shown = {key: trace[key] for key in keys if key in trace}
                axes = {axis: [None] for axis in "xyz" if axis in trace}
                add = plot.add_scatter3d if "z" in axes else plot.add_scatter
                add(**shown, **axes, hoverinfo="skip", showlegend=True)
        plot.update_layout(legend=dict(itemclick=False, itemdoubleclick=False))


def _layers(trace: Mapping) -> Iterable[dict]:
    """Line, then marks of a trace."""
    places = [_encoded(trace[axis]) for axis in "xyz" if axis in trace]
    line = trace.get("line", {})
    marker = trace.get("marker", {})
    name = trace.get("name", "")
    if "lines" in trace["mode"]:
        width = _LINE * line.get("width", 2) if "z" in trace else line.get("width", 2)
        yield {
            "kind": "line",
            "name": name,
            "places": places,
            "colour": line["color"],
            "width": width,
        }
    if "markers" in trace["mode"]:
        shape, _, opened = marker.get("symbol", "circle").partition("-")
        edge = marker.get("line", {})
        yield {
            "kind": "marks",
            "name": name,
            "places": places,
            "shape": shape,
            "size": marker["size"],
            "fill": "" if opened else marker["color"],
            "colour": edge.get("color", marker["color"]),
            "width": edge.get("width", _THIN if opened else 0),
        }


def _encoded(values) -> str:
    """Numbers in double precision, as base64: a time in seconds since 1970 needs them."""
    return b64encode(np.asarray(values, "<f8").tobytes()).decode()
