"""Tab "Edit and rerun": excluded data, the outlier threshold, the rerun with progress, before and after."""

import asyncio
import functools
from collections.abc import Callable

import numpy as np
from trame.app import asynchronous
from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.data.effect_titles import Units, change_sentence, effect_title
from workbench.app.data.plan import DIAGNOSE, plan_sentence, stage_items
from workbench.app.data.residuals import updated_threshold
from workbench.app.edits.changes import EFFECTS, STAGES
from workbench.app.edits.session import CAMERA, HAND_EYE
from workbench.app.figures import residuals
from workbench.app.jobs import CANCELLED, DONE, RUNNING
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab, number_of
from workbench.app.ui.view import SPACE
from workbench.app.workspace import CALIBRATE
from workbench.report.text import counted

_POLL_S = 0.3
_NOT_YET = "No effects are listed before the first calibration."
_NO_EFFECTS = "The model of this run has no effects."
_LABELS = {CAMERA: "Calibrate the camera", HAND_EYE: "Calibrate the hand-eye transform"}


class EditTab(Tab):
    """Every change is an entry of session.toml."""

    name = "edit"
    title = "Edit and rerun"
    contexts = 2

    def build(self) -> None:
        state = self.state
        state.stages, state.effects, state.changes = [], [], []
        state.has_plan = False
        state.threshold, state.threshold_top, state.threshold_text = 0.0, 1.0, ""
        state.can_undo, state.can_redo = False, False
        state.job_running, state.job_text = False, ""
        state.calibrate_label = "Calibrate"
        state.comparison, state.session_file, state.job_report = [], "", ""
        state.has_residuals = False
        state.has_side_by_side, state.plan_text, state.no_effects = False, "", ""
        with v3.VRow():
            with v3.VCol(cols=12, lg=4, v_if="has_plan"):
                self._plan()
            with v3.VCol(cols=12, lg=4):
                with html.Div(v_if="has_residuals"):
                    self._threshold()
                self._history()
            with v3.VCol(cols=12, lg=4):
                self._rerun()
        with html.Div(v_if="has_side_by_side"):
            html.H2(
                "Residuals before and after, side by side",
                classes="text-subtitle-1 font-weight-bold mt-3",
            )
            self.figure(
                "side_by_side",
                "Residuals as arrows in space, before and after the rerun",
                "60vh",
                SPACE,
            )
        state.change("threshold")(self._on_threshold)

    def _plan(self) -> None:
        html.H2("Stages", classes="text-subtitle-1 font-weight-bold")
        html.Div("The run has no stages; rerun to see them.", v_if="!stages.length")
        self._checks("stages", self.set_stage)
        html.H2("Effects in the model", classes="text-subtitle-1 font-weight-bold mt-2")
        html.Div("{{ no_effects }}", v_if="!effects.length", **raw(data_text="no-effects"))
        with html.Div(style="max-height: 50vh; overflow-y: auto"):
            self._checks("effects", self.set_effect)

    def _checks(self, items: str, method) -> None:
        with html.Div(v_for=f"one in {items}", key="one.name"):
            v3.VCheckbox(
                label=("one.label",),
                model_value=("one.on",),
                update_modelValue=(self.page.handler(method), "[one.name, $event]"),
                density="compact",
                hide_details=True,
            )

    def _threshold(self) -> None:
        html.H2("Outlier threshold", classes="text-subtitle-1 font-weight-bold")
        v3.VSlider(
            v_model=("threshold",),
            min=0,
            max=("threshold_top",),
            step=("threshold_top / 200",),
            hide_details=True,
            color="primary",
            classes="mx-4",  # the halo of its thumb reaches beyond its end
            **raw(aria_label="Outlier threshold in mm"),
        )
        html.Div(
            "{{ threshold_text }}",
            **raw(data_text="threshold", role="status"),
        )
        self.button("Exclude samples above the threshold", self.exclude_above, "[threshold]")
        html.Div("Drag the line in the histogram, or the slider.", classes="text-caption")
        self._threshold_figure()

    def _threshold_figure(self) -> None:
        self.figure(
            "threshold",
            "Histogram of the residuals with the threshold",
            "34vh",
            brush="window.dragLine($event, (mm) => { threshold = Math.min(Math.max(mm, 0), threshold_top) })",
        )

    def _history(self) -> None:
        html.H2("Changes", classes="text-subtitle-1 font-weight-bold")
        self.button("Undo", self.undo, disabled=("!can_undo",))
        self.button("Redo", self.redo, disabled=("!can_redo",))
        with html.Ol(classes="pl-6", **raw(aria_label="Changes of the session")):
            html.Li("{{ one }}", v_for="one, k in changes", key="k", **raw(data_change=True))
        html.Div("No changes yet.", v_if="!changes.length")
        html.Div(
            "{{ session_file }}",
            classes="text-caption mt-1",
            style="color: #3f4650; overflow-wrap: anywhere",
        )

    def _rerun(self) -> None:
        html.H2("Rerun", classes="text-subtitle-1 font-weight-bold")
        html.Div(
            "{{ plan_text }}",
            v_if="has_plan",
            **raw(data_text="plan"),
            classes="mb-2",
            style="overflow-wrap: anywhere",
        )
        self.button(
            "{{ calibrate_label }}",
            self.start,
            f"['{CALIBRATE}']",
            color="primary",
            variant="flat",
            disabled=("job_running",),
        )
        self.button("Diagnose", self.start, f"['{DIAGNOSE}']", disabled=("job_running",))
        self.button("Cancel", self.cancel, disabled=("!job_running",))
        v3.VProgressLinear(
            v_if="job_running",
            indeterminate=True,
            color="primary",
            **raw(aria_label="Run in progress"),
        )
        html.Div(
            "{{ job_text }}",
            **raw(data_text="job", role="status"),
            classes="my-2",
            style="overflow-wrap: anywhere",
        )
        self.report_link("Report page of this run", "job_report")
        html.H2("Before and after", classes="text-subtitle-1 font-weight-bold")
        html.Div("Shown after a rerun.", v_if="!comparison.length")
        with v3.VTable(
            density="compact",
            v_if="comparison.length",
            **raw(role="group", aria_label="Before and after"),
        ):
            with html.Thead(), html.Tr():
                for head in ("", "before", "after"):
                    html.Th(head, **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for="one in comparison", key="one.name"):
                for key in ("name", "before", "after"):
                    html.Td("{{ one." + key + " }}")
        with html.Div(v_if="has_residuals"):
            html.H2(
                "Cumulative distribution of the residuals",
                classes="text-subtitle-1 font-weight-bold mt-2",
            )
            self.figure("comparison", "Share of samples by residual, before and after", "38vh")

    def refresh(self) -> None:
        work = self.work
        state = self.state
        stages, effects = stage_items(work.opened, work.session, work.runs[:-1])
        units = Units.of(work.opened.samples)
        for stage in stages:
            stage["label"] = f"{stage['name']} ({stage['state']})"
        for stage in effects:
            stage["label"] = effect_title(stage["name"], units)
        state.stages, state.effects = stages, effects
        state.has_plan = work.session.command == CALIBRATE
        state.plan_text = plan_sentence(work.session)
        state.no_effects = _NO_EFFECTS if work.opened.answer else _NOT_YET
        self.show_changes()
        state.comparison = work.comparison()
        command = work.session.command
        state.calibrate_label = _LABELS.get(command, "Calibrate")
        state.session_file = f"Repeat without the app: workbench {command} --session {work.path}"
        top = float(np.max(work.lengths(), where=work.kept, initial=0)) or 1.0
        state.threshold = updated_threshold(float(state.threshold), state.threshold_top, top)
        state.threshold_top = top
        state.has_residuals = work.opened.residuals is not None
        if state.has_residuals:
            self._show_threshold()
            self._draw_comparison(self.draw_when_changed)
        state.has_side_by_side = residuals.has_side_by_side(work)
        if state.has_side_by_side:
            key = (work.previous, work.opened)
            self.draw_when_changed("side_by_side", key, lambda: residuals.side_by_side(self.work))

    def prepare(self) -> None:
        if self.work.opened.residuals is not None:
            self._draw_comparison(self.prepare_figure)

    def _draw_comparison(self, send: Callable) -> None:
        work = self.work
        send("comparison", (work.previous, work.opened), lambda: residuals.comparison(work))

    def show_changes(self) -> None:
        """Send the list of changes; also called while another tab is shown, so that it never lags behind."""
        history = self.work.history
        units = Units.of(self.work.opened.samples)
        self.state.changes = [change_sentence(change, units) for change in history.session.changes]
        self.state.can_undo, self.state.can_redo = history.can_undo, history.can_redo

    def _show_threshold(self) -> None:
        value = number_of(self.state.threshold, "threshold")
        self.state.threshold_text = self._threshold_text(value)
        key = (self.work.opened, self.work.session.changes, value)
        make = functools.partial(residuals.histogram_figure, self.work, value)
        self.draw_when_changed("threshold", key, make)

    def _threshold_text(self, value: float) -> str:
        """How many samples that are not excluded have a residual above a value, mm."""
        count_above = int((self.work.kept & (self.work.lengths() > value)).sum())
        verb = "has" if count_above == 1 else "have"
        return f"{counted(count_above, 'sample')} {verb} a residual above {value:.4g} mm"

    def _on_threshold(self, **_) -> None:
        if self.is_shown:
            self._show_threshold()

    def set_stage(self, name, is_included) -> None:
        """Include or exclude a stage."""
        self.work.set_items(STAGES, [str(name)], bool(is_included))

    def set_effect(self, name, is_included) -> None:
        """Include or exclude an effect."""
        self.work.set_items(EFFECTS, [str(name)], bool(is_included))

    def exclude_above(self, threshold) -> None:
        """Exclude the samples whose residual is longer than a threshold, mm."""
        count = self.work.exclude_above(number_of(threshold, "threshold"))
        verb = "is" if count == 1 else "are"
        self.page.show_message(
            f"{counted(count, 'sample')} {verb} excluded; rerun to see the effect."
        )

    def undo(self) -> None:
        """Take the last change back."""
        self.work.undo()

    def redo(self) -> None:
        """Make it again."""
        self.work.redo()

    def start(self, command) -> None:
        """Start a run in the background."""
        self.work.start(DIAGNOSE if command == DIAGNOSE else CALIBRATE)
        self.state.job_running = True
        self.state.job_text, self.state.job_report = "starting", ""
        asynchronous.create_task(self._watch(self.work.job))

    def cancel(self) -> None:
        """Stop the run; nothing of it is kept."""
        if self.work.job is not None:
            self.state.job_text = "Cancelling ..."
            asynchronous.create_task(self._cancel(self.work.job))

    async def _cancel(self, job) -> None:
        """Stop a job in the background: its end takes up to some seconds, in which the page stays in use."""
        await asyncio.get_running_loop().run_in_executor(None, job.cancel)

    async def _watch(self, job) -> None:
        """Show the progress of a job until it ends, then what it made."""
        while job.state == RUNNING:
            if not job.is_cancelled:
                with self.state:
                    self.state.job_text = f"{job.seconds:.0f} s: {job.last_line}"
            await asyncio.sleep(_POLL_S)
        with self.state:
            self.page.handler(self._ended)(job)

    def _ended(self, job) -> None:
        ending = job.wait(5)
        self.state.job_running = False
        if ending == DONE:
            seconds = job.seconds
            self.work.finish()
            self.state.job_text = f"Finished after {seconds:.0f} s: {job.out}"
            self.state.job_report = self.page.link_of(job.out)
            self.page.opened_changed()
        elif ending == CANCELLED:
            self.state.job_text = "Cancelled; nothing was written."
        else:
            self.state.job_text = f"The run failed: {job.last_line}"
            self.page.show_message(f"The run failed: {job.last_line}", "error")
