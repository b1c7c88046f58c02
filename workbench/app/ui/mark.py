"""A mark over a figure in space: a ring around one place, with a text.

It is an element of the page above the WebGL image. It appears with the first answer to a click, and no other mark
hides it. `overlay.js` moves it with the camera of the scene.
"""

from trame.widgets import html

from workbench.app.ui.attributes import raw

_CLASS = "mark-in-space"
_RING = (
    "position: absolute; left: -10px; top: -10px; width: 20px; height: 20px; border-radius: 50%; "
    "border: 3px solid #b45309; box-shadow: 0 0 0 1.5px white, inset 0 0 0 1.5px white"
)
_TEXT = (
    "position: absolute; left: 15px; top: -11px; padding: 0 5px; white-space: nowrap; font-size: 13px; "
    "line-height: 20px; border-radius: 4px; background: white; color: #1b1f24"
)


def build_mark(name: str, state) -> None:
    """The mark of the figure `name`, inside the element around it; hidden until `set_mark`."""
    key = _key(name)
    state[key] = None
    places = {f":data-{axis}": f"{key}.{axis}" for axis in "xyz"}
    with html.Div(
        v_if=key,
        classes=_CLASS,
        style="position: absolute; left: 0; top: 0; z-index: 1; pointer-events: none; visibility: hidden",
        **raw(aria_hidden="true", data_mark=name, **places),
    ):
        html.Div(style=_RING)
        html.Div("{{ " + key + ".text }}", style=_TEXT)


def set_mark(name: str, state, place, text: str) -> None:
    """Mark a place (3,) mm of the figure `name`; None removes the mark."""
    if place is None:
        state[_key(name)] = None
        return
    x, y, z = (round(float(value), 2) for value in place)
    state[_key(name)] = {"x": x, "y": y, "z": z, "text": text}


def _key(name: str) -> str:
    return f"mark_{name}"
