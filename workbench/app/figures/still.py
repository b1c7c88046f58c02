"""A figure in space as an SVG image: shown until the chart library has been loaded and draws the figure itself."""

from base64 import b64encode
from html import escape
from itertools import product

import numpy as np
import plotly.graph_objects as go

from workbench.app.figures.arrows import CORNERS, shafts
from workbench.app.figures.overlay import Overlay
from workbench.app.figures.style import INK

WIDTH = 600
HEIGHT = 512
_CLASSES = 12
_SHAFT = 1.8
"""Width of the shaft of a needle in px."""
_FIELD_RAD = np.pi / 4
"""Vertical field of the camera of plotly.js."""
_GREY = "#d4d4d8"


def static_image(plot: go.Figure, overlay: Overlay | None = None) -> str:
    """Address (data:) of an SVG image of the lines and marks of a framed scene, seen from its camera."""
    view = _View(plot.layout.scene)
    elements = [_box(view)]
    overlay_traces = [] if overlay is None else [go.Scatter3d(**trace) for trace in overlay.traces]
    for trace in [*plot.data, *overlay_traces]:
        if len(trace.x):
            elements += _needles(view, trace) if trace.type == "mesh3d" else _marks(view, trace)
    title = escape(plot.layout.title.text or "")
    elements.append(
        f'<text x="{8 - WIDTH / 2}" y="{16 - HEIGHT / 2}" font-size="12" fill="{INK}">{title}</text>'
    )
    frame = f"{-WIDTH / 2} {-HEIGHT / 2} {WIDTH} {HEIGHT}"
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{frame}" font-family="Arial, sans-serif" '
        f'fill="none" stroke-linecap="round">{"".join(elements)}</svg>'
    )
    return "data:image/svg+xml;base64," + b64encode(text.encode()).decode()


class _View:
    """Projects points of a scene as plotly.js does: perspective, z axis up, equal scales."""

    def __init__(self, scene):
        axes = (scene.xaxis, scene.yaxis, scene.zaxis)
        self.low, self.high = np.array([axis.range for axis in axes], float).T
        self.ratio = _vector(scene.aspectratio)
        self.eye = _vector(scene.camera.eye)
        self.rotation = _rotation_towards(self.eye - _vector(scene.camera.center))

    def project(self, points: np.ndarray) -> np.ndarray:
        """(2, n) positions in the image of points (3, n) mm; y points down."""
        share = (points - self.low[:, None]) / (self.high - self.low)[:, None]
        seen = self.rotation @ ((share - 0.5) * self.ratio[:, None] - self.eye[:, None])
        scale = HEIGHT / 2 / np.tan(_FIELD_RAD / 2)
        return scale * np.stack([seen[0], -seen[1]]) / -seen[2]


def _vector(values) -> np.ndarray:
    return np.array([values.x, values.y, values.z], float)


def _box(view: _View) -> str:
    """Edges of the box that the axes span."""
    corners = np.array(list(product((0, 1), repeat=3)))
    pairs = [(a, b) for a, b in product(corners, corners) if a.sum() < b.sum()]
    edges = [pair for pair in pairs if np.abs(pair[0] - pair[1]).sum() == 1]
    size = (view.high - view.low)[:, None]
    paths = [view.low[:, None] + size * np.stack(pair, axis=1) for pair in edges]
    return "".join(f'<path d="{_path(view.project(path))}" stroke="{_GREY}"/>' for path in paths)


def _needles(view: _View, trace) -> list[str]:
    """Shafts of the needles of a residual, in few colours so that few elements are drawn."""
    places = view.project(shafts(trace.x, trace.y, trace.z))
    lengths = np.repeat(np.asarray(trace.intensity)[::CORNERS], 3)
    classes = _colours(lengths, trace.cmax, trace.colorscale)
    return [_element(_path(places[:, chosen]), colour, _SHAFT) for colour, chosen in classes]


def _marks(view: _View, trace) -> list[str]:
    """Lines and discs of one trace, in few colours so that few elements are drawn."""
    places = view.project(np.array([trace.x, trace.y, trace.z], float))
    elements = []
    if "lines" in trace.mode:
        width = 0.6 * (trace.line.width or 2)
        for colour, chosen in _classes(trace.line, len(places[0])):
            elements.append(_element(_path(places[:, chosen]), colour, width))
    if "markers" in trace.mode:
        size = trace.marker.size or 4
        for colour, chosen in _classes(trace.marker, len(places[0])):
            dots = np.repeat(places[:, chosen], 3, axis=1)
            dots[:, 2::3] = np.nan
            elements.append(_element(_path(dots), colour, size))
    return elements


def _element(path: str, colour: str, width: float) -> str:
    return f'<path d="{path}" stroke="{colour}" stroke-width="{width:.1f}"/>' if path else ""


def _path(places: np.ndarray) -> str:
    """SVG path through places (2, n); nan lifts the pen."""
    commands = []
    pen = "M"
    for x, y in places.T.tolist():
        if x != x:
            pen = "M"
            continue
        commands.append(f"{pen}{x:.1f} {y:.1f}")
        pen = "L"
    return "".join(commands)


def _classes(style, n: int):
    """Colour and (n,) bool of each class of points; one class where all have the same colour."""
    if style.color is None or isinstance(style.color, str):
        return [(style.color or "#000000", np.ones(n, bool))]
    return _colours(style.color, style.cmax, style.colorscale)


def _colours(values, top: float | None, scale):
    """Colour and (n,) bool of each class of `values` (n,), from 0 to `top`, in a colour scale."""
    shares = np.clip(np.asarray(values, float) / (top or 1.0), 0, 1)
    classes = np.minimum((shares * _CLASSES).astype(int), _CLASSES - 1)
    for number in np.unique(classes):
        yield _mixed(scale, (number + 0.5) / _CLASSES), classes == number


def _rotation_towards(direction: np.ndarray) -> np.ndarray:
    """(3, 3) whose rows are right, up and backward of a camera that looks against a direction (3,), z upwards."""
    backward = direction / np.linalg.norm(direction)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(backward, right), backward])


def _mixed(scale, share: float) -> str:
    """Colour of a scale at a share from 0 to 1."""
    stops = [stop for stop, _ in scale]
    channels = np.array([[int(text[k : k + 2], 16) for k in (1, 3, 5)] for _, text in scale])
    red, green, blue = (int(np.interp(share, stops, row)) for row in channels.T)
    return f"#{red:02x}{green:02x}{blue:02x}"
