"""A mark over a figure in space: a ring around one place, with a text.

It is an element of the page above the WebGL image. It appears with the first answer to a click, while the scene itself
is drawn again later, and no other mark hides it. The browser moves it with the camera of the scene.
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

FOLLOW = """(() => {
    const times = (m, v) => [0, 1, 2, 3].map((i) => m[i] * v[0] + m[4 + i] * v[1] + m[8 + i] * v[2] + m[12 + i] * v[3]);
    const seen = (scene, place) => {
        const {model, view, projection} = scene.glplot.cameraParams;
        const point = place.map((value, k) => value * scene.dataScale[k]);
        const [x, y, , w] = [model, view, projection].reduce((v, m) => times(m, v), [...point, 1]);
        return w > 0 && Math.abs(x) <= w && Math.abs(y) <= w ? [0.5 + 0.5 * x / w, 0.5 - 0.5 * y / w] : null;
    };
    const put = (mark) => {
        const plot = mark.parentElement.querySelector('.js-plotly-plot');
        const scene = plot?._fullLayout?.scene?._scene;
        const place = ['x', 'y', 'z'].map((axis) => Number(mark.dataset[axis]));
        const at = scene?.glplot?.cameraParams?.view && scene.dataScale ? seen(scene, place) : null;
        if (at) {
            const box = scene.container.getBoundingClientRect(), frame = mark.parentElement.getBoundingClientRect();
            const left = box.left - frame.left + at[0] * box.width, top = box.top - frame.top + at[1] * box.height;
            mark.style.transform = `translate(${left.toFixed(1)}px, ${top.toFixed(1)}px)`;
        }
        mark.style.visibility = at ? 'visible' : 'hidden';
    };
    const marks = document.getElementsByClassName('mark-in-space');
    const follow = new MutationObserver(() => { for (const mark of marks) put(mark); });
    const attributeFilter = ['viewBox', 'data-x', 'data-y', 'data-z'];
    follow.observe(document.body, {childList: true, subtree: true, attributes: true, attributeFilter});
})()"""
"""Script of the page: places every mark where the camera of its scene sees it, in the frame in which either changes.

plotly sets the viewBox of the axis labels of a scene in each frame that it draws, before the frame is painted. A loop
over all frames would have the browser work while nothing moves.
"""


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
