"""Tab "Diagnosis": the measuring chain, what acts at each place with its evidence, terms for the plan."""

import functools

from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.data import diagnosis as data
from workbench.app.data.summaries import quantities_of
from workbench.app.figures import diagnosis
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab, points_of, whole_number
from workbench.app.ui.view import SPACE
from workbench.app.workspace import CALIBRATE
from workbench.report.text import counted

PLAN = "plan.toml"
_HEADING = "text-subtitle-1 font-weight-bold mt-3"
_HEADS = {"where": "Place", "size": "RMS size", "why": "Reason"}


class DiagnosisTab(Tab):
    """Tab of the unmodelled effects that were found, and their places."""

    name = "diagnosis"
    title = "Diagnosis"
    contexts = 4

    def build(self) -> None:
        state = self.state
        state.no_diagnosis, state.has_diagnosis, state.verdict_text = "", False, ""
        state.place, state.places, state.place_text = "", [], ""
        state.candidates, state.evidence, state.terms, state.ticked = [], [], [], []
        state.over, state.overs, state.next_text, state.has_next = "", [], "", False
        state.no_before_after, state.diagnosis_report, state.diagnosis_run = "", "", ""
        state.next_names, state.next_rows, state.next_csv, state.next_file = [], [], "", ""
        v3.VAlert(
            "{{ no_diagnosis }}",
            v_if="no_diagnosis",
            type="info",
            variant="outlined",
            classes="mb-2",
        )
        with html.Div(v_if="has_diagnosis"):
            html.Div(
                "{{ verdict_text }}", **raw(data_text="verdict"), classes="font-weight-bold mb-2"
            )
            html.Div(
                "{{ diagnosis_run }}", **raw(data_text="diagnosis-run"), classes="text-caption"
            )
            self.report_link("Report page of the diagnosis", "diagnosis_report")
            self.figure(
                "chain",
                "Measuring chain with the share of the mismatch at each place",
                "34vh",
                click=(self.page.handler(self.choose), points_of()),
            )
            html.P(
                "Colour, size and percentage: share of the mismatch that an effect at this place can explain. Names "
                "above are the effects that were kept. Click a place for its candidates and evidence.",
                classes="text-caption mb-2",
            )
            with v3.VRow():
                with v3.VCol(cols=12, lg=7):
                    self._place()
                    self._terms()
                with v3.VCol(cols=12, lg=5):
                    self._views()
        for name in ("place", "over"):
            state.change(name)(self._on_choice)

    def _place(self) -> None:
        v3.VSelect(
            v_model=("place",),
            items=("places",),
            label="Place",
            density="compact",
            hide_details=True,
        )
        html.Div("{{ place_text }}", **raw(data_text="place", role="status"), classes="my-1")
        self._table(
            "Candidates at this place",
            "candidates",
            ("effect", "where", "probability", "size", "decision", "why"),
        )
        html.H2("Evidence", v_if="evidence.length", classes=_HEADING)
        with html.Div(**raw(role="group", aria_label="Evidence")):
            with html.Div(v_for="term, k in evidence", key="k", classes="mb-4"):
                html.H3("{{ term.name }}", classes="text-subtitle-2 font-weight-bold")
                html.P("{{ term.statement }}")
                with v3.VTable(density="compact"):
                    with html.Tbody(), html.Tr(v_for="one, j in term.rows", key="j"):
                        html.Td("{{ one.name }}")
                        html.Td("{{ one.value }}")

    def _table(self, label: str, items: str, keys) -> None:
        with v3.VTable(
            density="compact", v_if=f"{items}.length", **raw(role="group", aria_label=label)
        ):
            with html.Thead(), html.Tr():
                for key in keys:
                    html.Th(_HEADS.get(key, key.capitalize()), **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for=f"one, k in {items}", key="k"):
                for key in keys:
                    html.Td("{{ one." + key + " }}")

    def _terms(self) -> None:
        html.H2("Terms for the plan", classes=_HEADING)
        html.Div("The diagnosis has no terms.", v_if="!terms.length")
        with html.Div(v_for="one, k in terms", key="k"):
            v3.VCheckbox(
                v_if="!one.problem",
                v_model=("ticked",),
                value=("k",),
                label=("one.label",),
                density="compact",
                hide_details=True,
            )
            html.Div("{{ one.label }}: {{ one.problem }}.", v_if="one.problem")
        self._term_buttons()

    def _term_buttons(self) -> None:
        self.button(
            "Add ticked terms to the plan", self.apply, "[ticked]", disabled=("!ticked.length",)
        )
        self.button(
            "Add and calibrate",
            self.apply_and_run,
            "[ticked]",
            disabled=("!ticked.length || job_running",),
            color="primary",
        )

    def _views(self) -> None:
        html.H2("Residuals before and after", classes="text-subtitle-1 font-weight-bold")
        v3.VSelect(
            v_if="overs.length",
            v_model=("over",),
            items=("overs",),
            label="Horizontal axis",
            density="compact",
            hide_details=True,
        )
        html.Div("{{ no_before_after }}", v_if="no_before_after")
        with html.Div(v_if="!no_before_after"):
            self.figure("before_after", "Residual before and after the diagnosis", "38vh")
        self._next_experiment()

    def _next_experiment(self) -> None:
        html.H2("Next experiment", classes="text-subtitle-1 font-weight-bold mt-2")
        html.Div("{{ next_text }}", **raw(data_text="next"))
        with html.Div(v_if="has_next"):
            self.figure("next", "Poses of the next experiment", "46vh", SPACE)
            self._next_table()

    def _next_table(self) -> None:
        """Number and joint readings of every pose, to copy or to download."""
        self.button("Copy the poses as CSV", "window.navigator.clipboard.writeText(next_csv)")
        html.A(
            "Download as CSV",
            href=("next_file",),
            download=data.NEXT_POSES,
            v_if="next_file",
            classes="ml-2",
            style="color: #1565a8",
        )
        label = raw(role="group", aria_label="Joint readings of the next poses", tabindex="0")
        with v3.VTable(density="compact", style="max-height: 40vh; overflow: auto", **label):
            with html.Thead(), html.Tr():
                html.Th("Pose", **raw(scope="col"))
                html.Th("{{ one }}", v_for="one, k in next_names", key="k", **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for="one in next_rows", key="one.number"):
                html.Td("{{ one.number }}")
                html.Td("{{ value }}", v_for="value, k in one.readings", key="k")

    def refresh(self) -> None:
        self.work.look_for_diagnosis()
        state = self.state
        opened = self.work.diagnosis
        state.has_diagnosis = opened is not None
        state.no_diagnosis = (
            ""
            if opened is not None
            else (
                "There is no diagnosis yet. Start one in the tab Edit and rerun, or open a run of workbench diagnose."
            )
        )
        if opened is None:
            return
        answer = opened.answer
        found = data.places(answer, 0 if opened.robot is None else opened.robot.joints)
        state.places = [place.name for place in found]
        if state.place not in state.places:
            state.place = max(found, key=lambda place: (bool(place.found), place.share)).name
        state.verdict_text = _verdict(answer)
        state.diagnosis_run = f"Run {opened.folder.name}"
        terms = [*answer["effects"], *answer["refused"]]
        state.terms = [_term_row(term, k < len(answer["effects"])) for k, term in enumerate(terms)]
        self._show_place(found)
        key = (opened, state.place)
        self.draw_when_changed("chain", key, lambda: diagnosis.chain(found, key[1]))
        self._show_before_after(opened)
        state.diagnosis_report = self.page.link_of(opened.folder)
        state.next_text = answer.get("next_experiment", "")
        self._show_next(opened)

    def _show_next(self, opened) -> None:
        """Poses of the next experiment in space and as a table."""
        state = self.state
        poses = data.next_poses(opened.folder, opened.robot)
        state.has_next = poses is not None
        if poses is None:
            return
        state.next_names, state.next_rows = list(poses.names), poses.rows
        state.next_csv = poses.as_csv
        state.next_file = self.page.link_of(opened.folder, data.NEXT_POSES)
        self.draw_when_changed("next", (opened,), lambda: diagnosis.next_poses(opened, poses))

    def _show_before_after(self, opened) -> None:
        """Residuals of an arm over a quantity, or a histogram of those of images."""
        state = self.state
        state.no_before_after = ""
        is_arm = opened.residuals is not None and "before" in opened.residuals.lengths
        state.overs = list(quantities_of(opened)) if is_arm else []
        if state.over not in state.overs:
            state.over = next(iter(state.overs), "")
        pixels = {} if is_arm else data.pixel_residuals(opened.folder)
        if is_arm:
            quantity = state.over
            make = functools.partial(diagnosis.before_after, opened, quantity)
            self.draw_when_changed("before_after", (opened, quantity), make)
        elif pixels:
            make = functools.partial(diagnosis.pixel_histogram, pixels)
            self.draw_when_changed("before_after", (opened,), make)
        else:
            state.no_before_after = "This run has no table of residuals."

    def _show_place(self, found) -> None:
        place = next(candidate for candidate in found if candidate.name == self.state.place)
        self.state.place_text = (
            f"{place.name}: {100 * place.share:.0f} % of the mismatch can be explained by an effect here; "
            "the shares of several places overlap."
        )
        self.state.candidates = data.candidates(place)
        self.state.evidence = [_evidence_of(term) for term in place.found]

    def _on_choice(self, **_) -> None:
        if self.is_shown and self.work.diagnosis is not None:
            self.page.handler(lambda: None)()

    def choose(self, names) -> None:
        """Show a place that was clicked."""
        for name in names:
            if name in self.state.places:
                self.state.place = name

    def apply(self, ticked) -> None:
        """Add the ticked terms to the plan, and write them as plan.toml next to session.toml."""
        ticked = [whole_number(k, 0, 10**6, "term") for k in ticked or ()]
        rows = data.plan_effects(self.work.diagnosis.answer, ticked)
        self.work.add_effects(rows, "ticked in the diagnosis")
        path = self.work.path.with_name(PLAN)
        data.write_plan(rows, path)
        self.state.ticked = []
        self.page.show_message(
            f"Added to the plan and written to {path}: {counted(len(rows), 'effect')}."
        )

    def apply_and_run(self, ticked) -> None:
        """Add the ticked terms and calibrate with them."""
        self.apply(ticked)
        self.page.tabs["edit"].start(CALIBRATE)
        self.page.go_to_tab("edit")


def _verdict(answer) -> str:
    held_out = answer["held_out"]
    unit = "mm" if "before_mm" in held_out else "px"
    before = held_out[f"before_{unit}"]
    after = held_out[f"after_{unit}"]
    return f"{answer['verdict'].capitalize()}: held-out RMS error {before:.4g} {unit} before, {after:.4g} {unit} after"


def _term_row(term, is_retained: bool) -> dict:
    label = data.term_label(term) + ("" if is_retained else " (not kept)")
    return {"label": label, "problem": data.plan_problem(term).rstrip(".")}


def _evidence_of(term) -> dict:
    """Heading, statement and rows of a term that was kept."""
    rows = [{"name": name, "value": value} for name, value in data.evidence(term)]
    return {"name": data.term_label(term), "statement": term.get("statement", ""), "rows": rows}
