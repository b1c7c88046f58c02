"""View of a figure: buttons that zoom, rotate and reset it, and the action of the mouse wheel.

plotly's own wheel zoom of a scene depends on the time between two frames: where drawing is slow, one notch shrinks the
scene to a dot. The wheel therefore scrolls the page; with Ctrl it zooms a chart.
"""

import math
from collections.abc import Mapping

from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.core.errors import InputError

PLANE = "plane"
SPACE = "space"
RESET = "reset"
ZOOM_IN = "zoom in"
ZOOM_OUT = "zoom out"
LEFT = "left"
RIGHT = "right"
_BUTTONS = {
    ZOOM_IN: ("Zoom in", "mdi-magnify-plus-outline"),
    ZOOM_OUT: ("Zoom out", "mdi-magnify-minus-outline"),
    LEFT: ("Rotate left", "mdi-rotate-left"),
    RIGHT: ("Rotate right", "mdi-rotate-right"),
    RESET: ("Reset view", "mdi-fit-to-page-outline"),
}
_ZOOM = 1.25
_STEP_RAD = math.radians(15)
_NEAREST, _FARTHEST = 0.2, 8.0
"""Distance of the camera from the centre of a scene, in plotly's units: a scene has a diagonal of 1.6."""


class View:
    """The view of one figure: plotly's camera of its scenes, None for the default, and how often it was changed."""

    def __init__(self):
        self.camera: dict | None = None
        self._changes = 0

    def change(self, action: str, camera: object) -> None:
        """Do what a button says; camera: as the browser shows the scene now, anything for "reset". InputError."""
        if action not in _BUTTONS:
            raise InputError(
                f"view: expected one of {', '.join(_BUTTONS)}, found {str(action)[:40]!r}"
            )
        self._changes += 1
        self.camera = None if action == RESET else moved_camera(camera, action)

    def applied(self, plot) -> "Seen":
        """The figure in this view."""
        return Seen(plot, self.camera, self._changes)


class Seen:
    """A plotly figure in a view that a person chose."""

    def __init__(self, plot, camera: dict | None, changes: int):
        self._made, self._camera, self._changes = plot, camera, changes

    def to_plotly_json(self) -> dict:
        """Figure as JSON for the browser. Another `uirevision` makes it forget rotation and zoom by mouse."""
        found = self._made.to_plotly_json()
        layout = found["layout"]
        if self._changes:
            layout["uirevision"] = f"{layout.get('uirevision', '')} {self._changes}"
        if self._camera is not None:
            for name in [name for name in layout if name.startswith("scene")]:
                layout[name] = {**layout[name], "camera": self._camera}
        return found


def moved_camera(camera: object, action: str) -> dict:
    """plotly's camera after a step: nearer, farther, or rotated about the vertical axis. Raises InputError."""
    eye = _vector(camera, "eye")
    centre = _vector(camera, "center")
    x, y, z = (a - b for a, b in zip(eye, centre))
    if action in (LEFT, RIGHT):
        angle = _STEP_RAD if action == RIGHT else -_STEP_RAD
        x, y = (
            math.cos(angle) * x - math.sin(angle) * y,
            math.sin(angle) * x + math.cos(angle) * y,
        )
    distance = math.hypot(x, y, z) or 1.0
    new_distance = distance * {ZOOM_IN: 1 / _ZOOM, ZOOM_OUT: _ZOOM}.get(action, 1.0)
    factor = min(max(new_distance, _NEAREST), _FARTHEST) / distance
    moved = [b + factor * a for a, b in zip((x, y, z), centre)]
    return {"eye": dict(zip("xyz", moved)), "center": dict(zip("xyz", centre))}


def _vector(camera: object, key: str) -> list[float]:
    """Three finite numbers of a camera that came from the browser."""
    found = camera.get(key) if isinstance(camera, Mapping) else None
    values = [found.get(axis) for axis in "xyz"] if isinstance(found, Mapping) else []
    if len(values) != 3 or not all(isinstance(v, int | float) and math.isfinite(v) for v in values):
        raise InputError(f"view: expected a camera with three numbers as {key}; reset the view")
    return [float(value) for value in values]


def buttons(name: str, label: str, kind: str, change) -> None:
    """Buttons over the corner of a figure. change: called with the action and the camera of the browser."""
    plot = f"window.document.querySelector('[data-figure={name}] .js-plotly-plot')"
    camera = f"{plot}?.layout?.scene?.camera" if kind == SPACE else "null"
    actions = list(_BUTTONS) if kind == SPACE else [RESET]
    with html.Div(style="position: absolute; top: 0; right: 0; z-index: 2"):
        for action in actions:
            text, icon = _BUTTONS[action]
            v3.VBtn(
                icon=icon,
                click=(change, f"['{action}', {camera}]"),
                variant="text",
                density="comfortable",
                size="small",
                title=text,
                raw_attrs=[f'aria-label="{text}: {label}"'],
            )


def wheel(kind: str) -> dict[str, str]:
    """Attributes of the element around a figure: the wheel reaches a chart with Ctrl alone, and a scene never."""
    is_kept = "" if kind == SPACE else "$event.ctrlKey || "
    return {"@wheel.capture": f"{is_kept}$event.stopPropagation()"}
