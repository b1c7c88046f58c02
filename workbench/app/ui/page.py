"""The page as a whole: bar with tabs, messages, and the tab that is chosen."""

from contextlib import suppress
from pathlib import Path
from threading import Thread

from trame.ui.vuetify3 import VAppLayout
from trame.widgets import client, html
from trame.widgets import vuetify3 as v3

from workbench.app.data.opened import Opened
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Page
from workbench.app.ui.library import defer_charts
from workbench.app.ui.overlay import SCRIPT, STYLE
from workbench.app.ui.shortcuts import undo_keys
from workbench.app.ui.tabs.diagnosis import DiagnosisTab
from workbench.app.ui.tabs.edit import EditTab
from workbench.app.ui.tabs.importing import ImportTab
from workbench.app.ui.tabs.recording import RecordingTab
from workbench.app.ui.tabs.residuals import ResidualsTab
from workbench.app.ui.tabs.sensor import SensorTab
from workbench.app.workspace import Workspace

_STYLE = """
:focus-visible { outline: 3px solid #1565a8 !important; outline-offset: 2px; }
.v-field__outline, .v-selection-control .v-icon { --v-medium-emphasis-opacity: 0.8; }
.v-field input::placeholder { color: #4b5563 !important; opacity: 1 !important; }
.v-label { opacity: 1 !important; color: #1b1f24; }
.v-tab { opacity: 1 !important; }
.v-btn--disabled { opacity: 1 !important; color: #5b6470 !important; }
.v-btn--disabled:not(.v-tab) { background: white !important; border: 1px dashed #5b6470 !important; }
.v-btn--disabled .v-btn__overlay { opacity: 0 !important; }
.v-selection-control--disabled, .v-input--disabled .v-label { opacity: 1 !important; color: #5b6470 !important; }
.hidden-tab { position: fixed; top: 0; left: 0; width: 100%; visibility: hidden; pointer-events: none; z-index: -1; }
"""
_STOPPED = """
<v-app style="background: white"><v-main><div class="pa-6" role="alert" data-stopped>
<h1 class="text-h6 font-weight-bold">The app is stopped</h1>
<p>{{ stopped_text }}</p>
</div></v-main></v-app>
"""
"""What trame shows in place of the page once the connection to the server is lost."""
_THEME = {
    "theme": {
        "defaultTheme": "light",
        "themes": {
            "light": {
                "colors": {
                    "primary": "#1565a8",
                    "error": "#b3261e",
                    "info": "#0b4a7a",
                    "success": "#0b6b3a",
                }
            }
        },
    }
}


def build(server, opened: Opened | None, session: Path | None) -> Page:
    """Fill the server's page for what is opened, with the import wizard alone where that is None.

    session: where edits are kept. Raises InputError.
    """
    page = Page(server, None if opened is None else Workspace(opened, session))
    state = server.state
    state.trame__title = "workbench"
    state.message, state.message_kind = "", "info"
    state.shown, state.latest_tabs = False, []
    state.is_open, state.report = False, ""
    state.heading, state.summary = "workbench", "Nothing is open yet: import a recording"
    state.stopped_text, state.trame__template_error = page.stopped_text(), _STOPPED
    state.tab = "import"
    if opened is not None:
        page.opened_changed()
        state.tab = "residuals" if opened.residuals is not None else "recording"
    tabs = [
        RecordingTab(page),
        ResidualsTab(page),
        EditTab(page),
        SensorTab(page),
        DiagnosisTab(page),
        ImportTab(page),
    ]
    page.tabs = {tab.name: tab for tab in tabs}
    _layout(server, page, tabs)
    defer_charts(state)
    state.change("tab")(lambda **_: page.show_tab())
    if opened is not None:
        Thread(target=_prepare, args=(page.tabs[state.tab],), daemon=True).start()
    return page


def _prepare(tab) -> None:
    """Compute what the first figures need; what fails here is reported when the tab is drawn."""
    with suppress(Exception):
        tab.prepare()


def _bar(tabs) -> None:
    """Title and report link, and the tabs in a row of their own, so that both fit a narrow window."""
    with v3.VAppBar(density="comfortable", flat=True, border=True, extension_height=40):
        with html.Div(classes="px-4 flex-grow-1", style="min-width: 0"):
            html.H1("{{ heading }}", classes="text-subtitle-1 font-weight-bold text-truncate")
            html.Div("{{ summary }}", classes="text-caption text-truncate", style="color: #3f4650")
        html.A(
            "Report page",
            href=("report",),
            target="_blank",
            rel="noopener",
            v_if="report",
            classes="mx-4",
            style="color: #1565a8; white-space: nowrap",
        )
        with v3.Template(v_slot_extension=True):
            with v3.VTabs(
                v_model=("tab",),
                color="primary",
                height=40,
                show_arrows=True,
                **raw(aria_label="Views"),
            ):
                for tab in tabs:
                    closed = {"disabled": ("!is_open",)} if tab.needs_work else {}
                    v3.VTab(tab.title, value=tab.name, classes="text-none", **closed)


def _tab(tab) -> None:
    """A tab, which exists while it is shown or is one of those that were shown last.

    A hidden one keeps its size, so that its figures need not be drawn again.
    """
    is_shown = f"tab === '{tab.name}'"
    is_there = f"shown && ({is_shown} || latest_tabs.includes('{tab.name}'))"
    hidden = {":class": f"{{'hidden-tab': tab !== '{tab.name}'}}"}
    with html.Div(v_if=is_there, classes="pa-3", **raw(data_tab=tab.name, **hidden)):
        tab.build()


def _layout(server, page: Page, tabs) -> None:
    with VAppLayout(server, vuetify_config=_THEME) as layout:
        layout.root.style = "background: white"
        client.Style(_STYLE + STYLE)
        client.Script(SCRIPT)
        edit = page.tabs["edit"]
        client.Script(undo_keys(server, page.handler(edit.undo), page.handler(edit.redo)))
        client.ClientTriggers(mounted=page.show)
        client.ClientStateChange(value="tab", change="window.scrollTo(0, 0)")
        _bar(tabs)
        with v3.VMain():
            v3.VAlert(
                "{{ message }}",
                v_if="message",
                type=("message_kind",),
                variant="outlined",
                density="compact",
                closable=True,
                **raw(role="status"),
                click_close="message = ''",
                classes="ma-2",
                style=("message_kind === 'error' ? 'color: #b3261e' : 'color: #0b4a7a'",),
            )
            for tab in tabs:
                _tab(tab)
