"""Marks above a figure, which `overlay.js` draws and moves with it, and the brush over a chart."""

from collections.abc import Callable
from importlib.resources import files

from trame.widgets import html

from workbench.app.figures.overlay import Overlay
from workbench.app.ui.attributes import raw

SCRIPT = files("workbench.app.ui").joinpath("overlay.js").read_text(encoding="utf-8")
STYLE = """
.marks-over-figure { position: absolute; inset: 0; width: 100%; height: 100%; pointer-events: none; }
[data-figure=threshold] .nsewdrag { cursor: ew-resize; }
.brush { position: fixed; z-index: 3; pointer-events: none; border: 1px solid #1b1f24; background: #1565a833; }
"""


def build_overlay(name: str, state) -> None:
    """The canvas of the figure `name`, inside the element around it; empty until `set_overlay`."""
    state[_key(name)] = "[]"
    html.Canvas(
        classes="marks-over-figure",
        **raw(aria_hidden="true", data_overlay=name, **{":data-layers": _key(name)}),
    )


def set_overlay(name: str, state, overlay: Overlay) -> None:
    """Draw marks above the figure `name`, in place of those before."""
    state[_key(name)] = overlay.encoded()


def brush_of(handle: Callable, server, *names: str) -> str:
    """Script of the browser for a mouse press over a chart: a brush, which ends in a call of `handle`.

    `handle` gets the rectangle and the values of the fields `names`. plotly's own brush would compute the state of all
    marks and draw them again with each movement of the mouse.
    """
    call = f"trigger('{server.trigger_name(handle)}', [{', '.join(['range', *names])}])"
    return f"window.brushFigure($event, (range) => {call})"


def _key(name: str) -> str:
    return f"overlay_{name}"
