"""Base of the tabs: the page's state, messages, and figures that are sent when their tab is shown."""

import asyncio
import functools
import importlib
import itertools
import logging
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from trame.app import asynchronous
from trame.widgets import html, plotly
from trame.widgets import vuetify3 as v3

from workbench.app.figures.overlay import Overlay
from workbench.app.figures.still import static_image
from workbench.app.ui.attributes import raw
from workbench.app.ui.mark import build_mark, set_mark
from workbench.app.ui.overlay import build_overlay, set_overlay
from workbench.app.ui.view import PLANE, SPACE, View, buttons, wheel
from workbench.app.workspace import Workspace
from workbench.core.errors import InputError

_log = logging.getLogger(__name__)
_TURN_S = 0.005
_MOST_CONTEXTS = 15
"""WebGL contexts of the tabs that are kept: a browser holds at most 16 at once and takes the oldest away."""
REPORT = "report.html"
_SCENE_PLACE = "position: absolute; width: 100%; height: calc(100% - 64px)"
"""Where the scene of a figure in space lies, above its legend."""
_PIXEL_RATIO = "Math.max(1, Math.min(window.devicePixelRatio, 2))"
"""Pixels of WebGL for each pixel of the page: those of the screen.

plotly always takes 2. On a screen with a ratio of 1 these are four times the pixels, which are drawn, smoothed and
copied in each frame; where WebGL is rendered in software this is most of the time of a frame.
"""


class Page:
    """The server with its state, the workspace (None where nothing is open yet), and the tabs by name."""

    def __init__(self, server, work: Workspace | None):
        self.server, self.state, self.work = server, server.state, work
        self.tabs: dict[str, Tab] = {}
        self._folders: list[Path] = []
        self.has_drawn = False
        self._said = 0
        self._is_warm = False

    def folder_of(self, number: str) -> Path | None:
        """Folder of the run that an address names by its number; None where there is none."""
        return self._folders[int(number)] if int(number) < len(self._folders) else None

    def link_of(self, folder: Path | None, name: str = REPORT) -> str:
        """Address of a file of a run's folder, which stays that of this run; "" where there is no such file."""
        if folder is None or not (folder / name).is_file():
            return ""
        if folder not in self._folders:
            self._folders.append(folder)
        return f"runs/{self._folders.index(folder)}/{name}"

    def check_idle(self) -> None:
        """Raise InputError while a run is in progress."""
        if self.work is not None and self.work.is_busy:
            raise InputError("A run is in progress; wait for it or cancel it")

    def open(self, subject: str) -> None:
        """Open another recording or run, with the edits that were made to it before. Raises InputError."""
        from workbench.app.data.opened import open_subject
        from workbench.app.edits.session import session_path

        self.check_idle()
        opened = open_subject(subject)
        self.work = Workspace(opened, session_path(opened.subject))
        self.opened_changed()

    def show_message(self, text: str, kind: str = "info") -> None:
        """Show a message; kind: info, success or error."""
        self._said += 1
        self.state.message, self.state.message_kind = text, kind

    def go_to_tab(self, name: str) -> None:
        """Show another tab.

        It is sent even where the server knows it as the shown one: a tab that a person has just chosen reaches the
        server only after the request in progress, and the page would stay there.
        """
        self.state.tab = name
        self.server.force_state_push("tab")

    def keep_tabs(self) -> None:
        """Have the browser keep the figures of the tabs that were shown last, so that they are there at once."""
        latest = [name for name in self.state.latest_tabs if name != self.state.tab]
        latest = [self.state.tab, *latest]
        contexts = itertools.accumulate(self.tabs[name].contexts for name in latest)
        self.state.latest_tabs = [
            name for name, count in zip(latest, contexts) if count <= _MOST_CONTEXTS
        ]

    def show(self) -> None:
        """Draw the chosen tab; called once the browser has painted the bar, so that figures do not delay it."""
        self.state.shown = True
        self.keep_tabs()
        self.handler(lambda: None)()
        if self.work is not None and not self._is_warm:
            self._is_warm = True
            shown = self.tabs[self.state.tab]
            shown.queue("other tabs", functools.partial(self._prepare_others, shown))

    def _prepare_others(self, shown: "Tab") -> None:
        """Compute in the background what the first visit of each other tab needs."""
        tabs = list(self.tabs.values())
        steps = [tab.prepare for tab in tabs if tab is not shown]
        steps += [tab.prepare_more for tab in tabs]
        threading.Thread(target=warm_up, args=(self.work.opened, steps), daemon=True).start()

    def show_tab(self) -> None:
        """Draw the tab that was chosen."""
        if self.state.shown:
            self.keep_tabs()
            self.handler(lambda: None)()

    def opened_changed(self) -> None:
        """Show the newest run in the bar."""
        from workbench.app.data.opened import summary

        opened = self.work.opened
        state = self.state
        state.is_open = True
        state.heading, state.summary = opened.title, summary(opened)
        state.stopped_text = self.stopped_text()
        state.report = self.link_of(opened.folder)

    def stopped_text(self) -> str:
        """Message once the server has ended: whether edits are kept, and how to go on."""
        start = "To continue, start `workbench open` again and open the address that it prints."
        if self.work is None:
            return (
                f"This page has lost its connection to `workbench open`, which has ended. {start}"
            )
        return (
            "This page has lost its connection to `workbench open`, which has ended. "
            f"All edits are saved in {self.work.path.resolve()}. {start}"
        )

    def refresh(self) -> None:
        """Send what the shown tab shows."""
        if self.work is not None:
            self.tabs["edit"].show_changes()
        tab = self.tabs.get(self.state.tab)
        if tab is not None and (self.work is not None or not tab.needs_work):
            tab.refresh()

    def handler(self, method: Callable) -> Callable:
        """A method as an event handler: what it refuses is shown as a message, then the tab is drawn.

        A message disappears with the next action that succeeds.
        """

        @functools.wraps(method)
        def handle(*values, **named):
            before = self._said

            def act():
                method(*values, **named)
                if self._said == before:
                    self.show_message("")
                self.refresh()

            self.attempt(act, method.__name__)

        return handle

    def attempt(self, action: Callable, name: str = "a figure") -> None:
        """Do something; what it refuses, and any other failure, is shown as a message.

        name: what a failure is reported of.
        """
        try:
            action()
        except InputError as problem:
            self.show_message(str(problem), "error")
        except Exception:
            _log.exception("the app failed in %s", name)
            self.show_message(f"This is a bug of the app (in {name}); see the terminal", "error")


class Tab:
    """One tab: `name` is its value in the state, `title` what people read.

    `needs_work`: it is shown only once something is open. `contexts`: WebGL contexts of its figures, one for each
    scene and three for a chart of many marks.
    """

    name = ""
    title = ""
    needs_work = True
    contexts = 0

    def __init__(self, page: Page):
        self.page, self.state = page, page.state
        self.figures: dict[str, plotly.Figure] = {}
        self._view_of: dict[str, View] = {}
        self._last_made: dict[str, object] = {}
        self._wanted: dict[str, Callable] = {}
        self._drawn: dict[str, tuple] = {}
        self._prepared: dict[str, tuple] = {}
        self._is_drawing = False

    @property
    def work(self) -> Workspace:
        """The opened run or recording."""
        return self.page.work

    def build(self) -> None:
        """Make the widgets, inside the page's layout."""
        raise NotImplementedError

    def refresh(self) -> None:
        """Send what the tab shows."""
        raise NotImplementedError

    def prepare(self) -> None:
        """Make the first figures; called in the background, for the first tab while the browser starts."""

    def prepare_more(self) -> None:
        """Compute what further interactions need; called in the background after all first figures."""

    def prepare_figure(self, name: str, key: tuple, make: Callable) -> None:
        """Make a figure before it is asked for; `draw_when_changed` sends it where the key is the same."""
        self._prepared[name] = (key, make())

    @property
    def is_shown(self) -> bool:
        """Whether the browser shows this tab."""
        return bool(self.state.shown) and self.state.tab == self.name and self.work is not None

    def figure(
        self, name: str, label: str, height: str = "60vh", view: str = PLANE, **events
    ) -> None:
        """A plotly figure with the buttons of its view; label: what a screen reader says of it.

        events: of plotly, and `brush`, which the browser evaluates where the mouse is pressed over a chart.
        """
        self.state[f"still_{name}"] = ""
        self._view_of[name] = View()
        brush = {"@pointerdown": events.pop("brush")} if "brush" in events else {}
        with html.Div(style=f"position: relative; height: {height}; width: 100%", **raw(**brush)):
            self._plot(name, label, view, events)
            build_overlay(name, self.state)
            if view == SPACE:
                build_mark(name, self.state)
            buttons(name, label, view, functools.partial(self._change_view, name))

    def _plot(self, name: str, label: str, view: str, events: dict) -> None:
        with html.Div(
            style="height: 100%; width: 100%",
            **raw(role="img", aria_label=label, data_figure=name, **wheel(view)),
        ):
            html.Img(
                src=(f"still_{name}",),
                v_if=f"still_{name}",
                style=_SCENE_PLACE,
                **raw(alt="", data_still=name, elementtiming=f"still-{name}"),
            )
            drawn = f"Object.keys(figure_{name}.layout).length"
            _waiting(f"!{drawn} && !still_{name}")
            self.figures[name] = plotly.Figure(
                state_variable_name=f"figure_{name}",
                v_if=drawn,  # no empty axes before its turn
                display_logo=("false",),
                display_mode_bar=("false",),  # its buttons cannot be reached by keyboard
                scroll_zoom=("true",),  # of what `wheel` lets through
                **raw(**{":plot-gl-pixel-ratio": _PIXEL_RATIO}),
                **events,
            )

    def draw(self, name: str, plot) -> None:
        """Send a figure in the view that was chosen for it."""
        self._last_made[name] = plot
        self.figures[name].update(self._view_of[name].applied(plot))

    def overlay(self, name: str, overlay: Overlay) -> None:
        """Draw marks above a figure, in place of those before, without drawing the figure."""
        set_overlay(name, self.state, overlay)

    def mark(self, name: str, place, text: str = "") -> None:
        """Mark a place (3,) mm of a figure in space, without drawing the figure; None removes the mark."""
        set_mark(name, self.state, place, text)

    def _change_view(self, name: str, action, camera=None) -> None:
        """Zoom, rotate or reset a figure that was drawn."""

        def act():
            self._view_of[name].change(action, camera)
            if name in self._last_made:
                self.draw(name, self._last_made[name])

        self.page.attempt(act, "a view")

    def draw_still(self, name: str, make: Callable) -> None:
        """Show a figure in space as an image first, where nothing was drawn yet: the chart library loads later.

        make: the figure, and the marks above it. The chart has a white ground, so that it covers the image.
        """
        if not self.page.has_drawn:
            self.page.has_drawn = True
            key = f"still_{name}"
            self.queue(key, lambda: self.state.update({key: static_image(*make())}))

    def draw_sequentially(self, **makers: Callable) -> None:
        """Make and send figures one after another in the background, in the order given.

        Texts and tables reach the browser first, and clicks are answered between two figures. Of a figure that is
        asked for again before its turn only the newest is made.

        makers: name of the figure -> function that makes it.
        """
        for name, make in makers.items():
            self.queue(name, functools.partial(self._make_and_draw, name, make))

    def _make_and_draw(self, name: str, make: Callable) -> None:
        self.draw(name, make())

    def queue(self, name: str, action: Callable) -> None:
        """Do something in the background; of a name that is queued twice only the newest is done."""
        self._wanted[name] = action
        if not self._is_drawing:
            self._is_drawing = True
            asynchronous.create_task(self._draw_wanted())

    def draw_when_changed(self, name: str, key: tuple, make: Callable) -> None:
        """Make and send a figure in its turn, unless it is already drawn for the same key."""
        if self._drawn.get(name) != key:
            self._drawn[name] = key
            self.draw_sequentially(
                **{name: functools.partial(self._prepared_or_made, name, key, make)}
            )

    def _prepared_or_made(self, name: str, key: tuple, make: Callable):
        known, plot = self._prepared.pop(name, (None, None))
        return plot if known == key else make()

    async def _draw_wanted(self) -> None:
        await asyncio.sleep(_TURN_S)
        while self._wanted:
            name = next(iter(self._wanted))
            action = self._wanted.pop(name)
            with self.state:
                self.page.attempt(action)
            await asyncio.sleep(_TURN_S)
        self._is_drawing = False

    def report_link(self, text: str, key: str) -> None:
        """A link to a report page in a window of its own, shown where the field `key` holds its address."""
        html.A(
            text,
            href=(key,),
            target="_blank",
            rel="noopener",
            v_if=key,
            style="color: #1565a8",
            **raw(**{"data-link": key}),
        )

    def button(self, text: str, action: Callable | str, arguments: str = "[]", **options) -> None:
        """A button that calls a method, or runs an expression of the browser.

        What the method refuses is shown as a message.
        """
        label = options.pop("aria_label", "")
        v3.VBtn(
            text,
            click=action if isinstance(action, str) else (self.page.handler(action), arguments),
            variant=options.pop("variant", "outlined"),
            density="comfortable",
            classes="mr-2 mb-2 text-none",
            **(raw(aria_label=label) if label else {}),
            **options,
        )


def _waiting(is_waiting: str) -> None:
    """Placeholder of a figure until it is there. is_waiting: expression of the browser."""
    with html.Div(v_if=is_waiting, classes="pa-4", style="position: absolute; width: 100%"):
        v3.VProgressLinear(indeterminate=True, color="primary", **raw(aria_label="Drawing"))
        html.Div("Drawing ...", classes="mt-2")


def warm_up(opened, steps: Iterable[Callable]) -> None:
    """Prepare the tabs in some steps, and import what those of a sensor need.

    At the first click it would take more than a second. What fails here is reported when the tab is drawn.
    """
    for step in steps:
        with suppress(Exception):
            step()
    from workbench.app.data.sensor import scans_of

    modules = ["sensors.boards.detection", "sensors.stripe.find"] if opened.recording.images else []
    modules += ["pyvista", "workbench.jobs.sensor.scanner"] if scans_of(opened) else []
    for name in modules:
        importlib.import_module(name)


def points_of(*names: str) -> str:
    """Arguments of a click, for the browser: the custom data of the marks, then the values of the fields `names`.

    While a request is in progress, trame sends a click at once and the fields later. An event therefore carries the
    fields that it depends on.
    """
    script = "typeof value === 'object' && value ? Array.from(value) : value"
    points = "($event && $event.points ? $event.points : [])"
    marks = f"{points}.map((point) => point.customdata).map((value) => {script})"
    return f"[{', '.join([marks, *names])}]"


def whole_number(value: object, low: int, high: int, name: str) -> int:
    """A whole number that came from the browser. Raises InputError."""
    try:
        number = int(value)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected a whole number, found {str(value)[:40]!r}") from None
    if not low <= number <= high:
        raise InputError(f"{name}: expected a number from {low} to {high}, found {number}")
    return number


def number_of(value: object, name: str) -> float:
    """A finite number that came from the browser. Raises InputError."""
    import math

    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected a number, found {str(value)[:40]!r}") from None
    if not math.isfinite(number):
        raise InputError(f"{name}: expected a finite number, found {number}")
    return number
