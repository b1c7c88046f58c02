"""List of excluded samples and poses, each with a button that includes it again."""

from collections.abc import Mapping

from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.edits.changes import POSES
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import whole_number
from workbench.app.workspace import MOST_LISTED
from workbench.report.text import counted

_HEADS = {"label": "Excluded", "why": "Why", "length": "Residual (mm)"}
_NOTE = (
    "The residual of a sample that is no part of this run is predicted by the model of the run; "
    "of a pose the largest residual of its samples is shown."
)
_NOTE_OF_SCANS = (
    "A scan that is no part of this run has no residual: its ball centres were not determined."
)


class ExcludedList:
    """The same list in several tabs: its rows are those of the session, whatever the shown run holds."""

    def __init__(self, tab):
        self.tab, self.page, self.state = tab, tab.page, tab.state

    def build(self) -> None:
        """Make the widgets, inside a tab."""
        state = self.state
        state.excluded, state.excluded_text, state.wanted_excluded = [], "", ""
        state.excluded_note = ""
        with html.Div(v_if="excluded_text", classes="mt-4"):
            html.H2("Excluded samples", classes="text-subtitle-1 font-weight-bold")
            html.Div("{{ excluded_text }}", **raw(data_text="excluded", role="status"))
            html.Div("{{ excluded_note }}", classes="text-caption", style="color: #3f4650")
            with html.Div(classes="d-flex flex-wrap align-center mt-2"):
                v3.VTextField(
                    v_model=("wanted_excluded",),
                    label="Number to include",
                    density="compact",
                    hide_details=True,
                    style="flex: 0 0 220px",
                    classes="mr-2 mb-2",
                )
                self.tab.button("Include sample", self.include_sample, "[wanted_excluded]")
                self.tab.button("Include all", self.include_all)
            self._table()

    def _table(self) -> None:
        label = raw(role="group", aria_label="Excluded samples", tabindex="0")
        with v3.VTable(density="compact", style="max-height: 40vh; overflow: auto", **label):
            with html.Thead(), html.Tr():
                for head in _HEADS.values():
                    html.Th(head, **raw(scope="col"))
                html.Th("Include", **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for="one in excluded", key="one.label"):
                for key in _HEADS:
                    html.Td("{{ one." + key + " }}")
                with html.Td():
                    # a plain button: a hundred of Vuetify's take longer to make than all else that an exclusion changes
                    html.Button(
                        "Include",
                        click=(self.page.handler(self.include), "[one.kind, one.number]"),
                        type="button",
                        style="border: 1px solid; border-radius: 4px; padding: 0 12px; color: #1565a8",
                        **raw(**{":aria-label": "'Include ' + one.label"}),
                    )

    def refresh(self) -> None:
        """Send the list; residuals are predicted after the texts of the tab have been sent."""
        work = self.tab.work
        counts = work.excluded_counts
        self.state.excluded_text = _text(counts)
        opened = work.opened
        self.state.excluded_note = _NOTE if opened.samples is opened.recording else _NOTE_OF_SCANS
        if any(counts.values()):
            self.tab.queue("excluded", self._send)
        else:
            self.state.excluded = []

    def _send(self) -> None:
        items = self.tab.work.first_excluded
        lengths = self.tab.work.lengths_of(items)
        self.state.excluded = [_row(item, length) for item, length in zip(items, lengths)]

    def include(self, kind, number) -> None:
        """Include one item of the list."""
        self.tab.work.include_item(str(kind), whole_number(number, -(2**53), 2**53, "number"))
        self._show_counts()

    def include_sample(self, number) -> None:
        """Include a sample by its number, and its pose where that is excluded."""
        number = whole_number(number, -(2**53), 2**53, "Number to include")
        self.tab.work.include_sample(number)
        self._show_counts()

    def include_all(self) -> None:
        """Include everything that is excluded."""
        self.tab.work.include_all()
        self._show_counts()

    def _show_counts(self) -> None:
        self.page.show_message("Included again; calibrate to see the effect.")


def _text(counts: Mapping[str, int]) -> str:
    """State how many samples and poses are excluded, "" for none."""
    phrases = [counted(count, kind.removesuffix("s")) for kind, count in counts.items() if count]
    if not phrases:
        return ""
    text = f"{' and '.join(phrases)} excluded"
    if sum(counts.values()) > MOST_LISTED:
        text += f"; the first {MOST_LISTED} are listed"
    return text


def _row(item, length: float | None) -> dict:
    name = f"sample {item.number}"
    if item.kind == POSES:
        name = f"pose of sample {item.number} ({counted(len(item.samples), 'sample')})"
    return {
        "kind": item.kind,
        "number": item.number,
        "label": name,
        "why": item.why or "–",
        "length": "–" if length is None else f"{length:.4f}",
    }
