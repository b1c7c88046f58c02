"""Tab "Diagnosis": the measuring chain, what acts at each place with its evidence, terms for the plan."""

from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.data import diagnosis as data
from workbench.app.figures import diagnosis
from workbench.app.ui.base import Tab, points_of, raw, whole_number
from workbench.app.workspace import CALIBRATE, quantities_of

PLAN = "plan.toml"


class DiagnosisTab(Tab):
    """Which unmodelled effects were found, and where."""

    name, title = "diagnosis", "Diagnosis"

    def build(self) -> None:
        state = self.state
        state.no_diagnosis, state.has_diagnosis, state.verdict_text = "", False, ""
        state.place, state.places, state.place_text = "", [], ""
        state.candidates, state.evidence, state.terms, state.ticked = [], [], [], []
        state.over, state.overs, state.next_text, state.has_next = "", [], "", False
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
            self.figure(
                "chain",
                "Measuring chain with the share of the mismatch at each place",
                "34vh",
                click=(self.page.handler(self.choose), points_of()),
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
        with v3.VTable(
            density="compact", v_if="evidence.length", **raw(role="group", aria_label="Evidence")
        ):
            with html.Tbody(), html.Tr(v_for="one, k in evidence", key="k"):
                html.Td("{{ one.name }}", style="white-space: nowrap")
                html.Td("{{ one.value }}")

    def _table(self, label: str, items: str, keys) -> None:
        with v3.VTable(
            density="compact", v_if=f"{items}.length", **raw(role="group", aria_label=label)
        ):
            with html.Thead(), html.Tr():
                for key in keys:
                    html.Th(key, **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for=f"one, k in {items}", key="k"):
                for key in keys:
                    html.Td("{{ one." + key + " }}")

    def _terms(self) -> None:
        html.H2("Terms for the plan", classes="text-subtitle-1 font-weight-bold mt-3")
        with html.Div(v_for="one, k in terms", key="k"):
            v3.VCheckbox(
                v_model=("ticked",),
                value=("k",),
                label=("one",),
                density="compact",
                hide_details=True,
            )
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
        v3.VSelect(
            v_model=("over",), items=("overs",), label="Over", density="compact", hide_details=True
        )
        self.figure("before_after", "Residual before and after the diagnosis", "38vh")
        html.H2("Next experiment", classes="text-subtitle-1 font-weight-bold mt-2")
        html.Div("{{ next_text }}", **raw(data_text="next"))
        with html.Div(v_if="has_next"):
            self.figure("next", "Poses of the next experiment", "46vh")

    def refresh(self) -> None:
        state, made = self.state, self.work.diagnosis
        state.has_diagnosis = made is not None
        state.no_diagnosis = (
            ""
            if made is not None
            else (
                "There is no diagnosis yet. Start one in the tab Edit and rerun, or open a run of workbench diagnose."
            )
        )
        if made is None:
            return
        answer = made.answer
        found = data.places(answer, 0 if made.robot is None else made.robot.joints)
        state.places = [place.name for place in found]
        if state.place not in state.places:
            state.place = max(found, key=lambda place: (bool(place.found), place.share)).name
        state.verdict_text = _verdict(answer)
        terms = [*answer["effects"], *answer["refused"]]
        state.terms = [
            _term_label(term, k < len(answer["effects"])) for k, term in enumerate(terms)
        ]
        state.overs = list(quantities_of(made))
        if state.over not in state.overs:
            state.over = next(iter(state.overs), "")
        self._show_place(found)
        self.draw("chain", diagnosis.chain(found, state.place))
        self.draw("before_after", diagnosis.before_after(made, state.over))
        readings = data.next_poses(made.folder)
        state.next_text, state.has_next = answer.get("next_experiment", ""), bool(readings)
        if readings:
            self.draw("next", diagnosis.next_poses(made, readings))

    def _show_place(self, found) -> None:
        place = next(one for one in found if one.name == self.state.place)
        self.state.place_text = f"{place.name}: {100 * place.share:.0f} % of the mismatch acts here"
        self.state.candidates = data.candidates(place)
        rows = [pair for term in place.found for pair in data.evidence(term)]
        self.state.evidence = [{"name": name, "value": value} for name, value in rows]

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
        rows, problems = data.plan_effects(self.work.diagnosis.answer, ticked)
        self.work.add_effects(rows, "ticked in the diagnosis")
        path = self.work.path.with_name(PLAN)
        data.write_plan(rows, path)
        self.state.ticked = []
        self.page.say(
            " ".join(
                [f"{len(rows)} effects were added to the plan and written to {path}.", *problems]
            )
        )

    def apply_and_run(self, ticked) -> None:
        """Add the ticked terms and calibrate with them."""
        self.apply(ticked)
        self.page.tabs["edit"].start(CALIBRATE)
        self.page.go_to_tab("edit")


def _verdict(answer) -> str:
    held_out = answer["held_out"]
    unit = "mm" if "before_mm" in held_out else "px"
    before, after = held_out[f"before_{unit}"], held_out[f"after_{unit}"]
    return f"{answer['verdict']}: held-out RMS error {before:.4g} {unit} before, {after:.4g} {unit} after"


def _term_label(term, kept: bool) -> str:
    variant = f" ({term['variant']})" if term.get("variant") else ""
    return f"{term['effect']}{variant} at {term['where']}" + ("" if kept else " (not kept)")
