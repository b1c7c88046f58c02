"""Tab "Import": drop files, map their columns, see what they become, and open the recording."""

import asyncio
from pathlib import Path

from trame.app import asynchronous
from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab, whole_number
from workbench.app.wizard.draft import Draft, folder_of
from workbench.app.wizard.form import form_rows, kinds, other_rows
from workbench.core.errors import InputError

_PAUSE_S = 0.4
_HEADING = "text-subtitle-1 font-weight-bold mt-3"
_DENSE = {"density": "compact", "hide_details": True}
_TEXTS = (
    ("board", "Board, such as chessboard 11x8 5mm"),
    ("ball_radius", "Ball radius (mm), for clouds"),
    ("sigma", "Noise σ of a coordinate (mm)"),
)


class ImportTab(Tab):
    """The importer of `workbench import`, with a preview that follows every change."""

    name = "import"
    title = "Import"
    needs_work = False

    def __init__(self, page):
        super().__init__(page)
        self.draft = Draft()
        self._lock = asyncio.Lock()

    def build(self) -> None:
        state = self.state
        state.import_files, state.import_names = [], []
        state.import_rows, state.import_others, state.import_columns = [], [], []
        state.import_kind, state.import_kinds = "", kinds()
        state.import_robot, state.import_robots = "", []
        state.import_artefact, state.import_artefacts = "", []
        state.import_trust, state.import_folder = False, "my-recording"
        state.import_text, state.import_busy, state.import_ready = "", False, False
        state.import_fits, state.import_samples = [], []
        state.import_warnings, state.import_question, state.import_answers = [], "", []
        for key, _ in _TEXTS:
            state[f"import_{key}"] = ""
        dropped = "import_files = Array.from($event.dataTransfer.files)"
        drag_events = ("dragover", "dragover.prevent")
        with html.Div(
            drop=dropped,
            dragover="",
            __events=[("drop", "drop.prevent"), drag_events],
            style="min-height: 80vh",
            **raw(data_drop=True),
        ):
            self._files()
            self._steps()
        state.change("import_files")(self._on_files)

    def _steps(self) -> None:
        with html.Div(v_if="import_names.length"):
            with v3.VRow():
                with v3.VCol(cols=12, lg=7):
                    self._mapping()
                with v3.VCol(cols=12, lg=5):
                    self._preview()

    def _files(self) -> None:
        html.H2("1. Files", classes="text-subtitle-1 font-weight-bold")
        html.P(
            "Drop tables, logs, robot programs, bags, clouds, or images with a table of poses here; a robot.toml or "
            "URDF and an artefact.csv too. The files stay on this machine."
        )
        with html.Div(classes="d-flex align-center"):
            v3.VFileInput(
                v_model=("import_files",),
                label="Drop files here or press Enter to choose",
                multiple=True,
                chips=True,
                clearable=False,
                **_DENSE,
            )
            html.Div(style="width: 12px")
            self.button("Remove all files", self.clear, disabled=("!import_names.length",))
        html.Div(
            "{{ import_names.length ? 'Files: ' + import_names.join(', ') : 'No files yet.' }}",
            **raw(data_text="import-files", role="status"),
        )

    def _mapping(self) -> None:
        html.H2("2. Robot and measurement", classes=_HEADING)
        with html.Div(classes="d-flex flex-wrap"):
            self._select("import_robot", "Robot", "robot")
            self._choice(
                "import_kind",
                "import_kinds",
                "Kind of measurement",
                self.set_cell,
                "['', 'measures', $event]",
            )
            self._select("import_artefact", "Artefact (balls)", "artefact")
            for key, label in _TEXTS:
                v3.VTextField(
                    model_value=(f"import_{key}",),
                    change=(self.page.handler(self.choose), f"['{key}', $event.target.value]"),
                    label=label,
                    style="flex: 0 0 320px",
                    classes="mr-2 mb-2",
                    **_DENSE,
                )
        html.H2("3. Columns", classes=_HEADING)
        with html.Div(v_if="import_columns.length"):
            self._groups()
            self._others()

    def _select(self, key: str, label: str, name: str) -> None:
        self._choice(key, f"{key}s", label, self.choose, f"['{name}', $event]")

    def _choice(self, key: str, items: str, label: str, method, arguments: str) -> None:
        v3.VSelect(
            model_value=(key,),
            items=(items,),
            label=label,
            update_modelValue=(self.page.handler(method), arguments),
            style="flex: 0 0 320px",
            classes="mr-2 mb-2",
            **_DENSE,
        )

    def _groups(self) -> None:
        edit = self.page.handler(self.set_cell)
        with html.Div(
            v_for="one in import_rows",
            key="one.name",
            classes="mb-3",
            **raw(data_quantity=True, **{":data-name": "one.name"}),
        ):
            with html.Div(classes="d-flex flex-wrap align-center"):
                v3.VAutocomplete(
                    model_value=("one.columns",),
                    items=("import_columns",),
                    label=("one.title",),
                    multiple=True,
                    chips=True,
                    update_modelValue=(edit, "[one.name, 'columns', $event]"),
                    style="flex: 1 1 300px",
                    classes="mr-2",
                    **_DENSE,
                )
                for key, label in (("unit", "Unit"), ("convention", "Convention")):
                    v3.VSelect(
                        v_if=f"one.columns.length && one.{key}s.length",
                        model_value=(f"one.{key}",),
                        items=(f"one.{key}s",),
                        label=(f"'{label} of ' + one.title.toLowerCase()",),
                        update_modelValue=(edit, f"[one.name, '{key}', $event]"),
                        style="flex: 0 0 220px",
                        classes="mr-2",
                        **_DENSE,
                    )
                v3.VCheckbox(
                    v_if="one.columns.length && one.conventions.length",
                    label="inverse",
                    model_value=("one.inverse",),
                    update_modelValue=(edit, "[one.name, 'inverse', $event]"),
                    **_DENSE,
                )
            html.Div("First rows: {{ one.cells }}", v_if="one.cells", classes="text-caption")

    def _others(self) -> None:
        html.H2("Further columns", v_if="import_others.length", classes=_HEADING)
        with html.Div(
            v_for="one in import_others", key="one.name", classes="d-flex align-center mb-1"
        ):
            v3.VTextField(
                model_value=("one.target",),
                label=("one.name + ' is recorded as'",),
                placeholder=("one.unnamed",),
                persistent_placeholder=True,
                change=(
                    self.page.handler(self.set_cell),
                    "['columns', one.name, $event.target.value]",
                ),
                style="flex: 0 0 320px",
                classes="mr-2",
                **_DENSE,
            )
            html.Span("{{ one.cells }}", classes="text-caption")

    def _preview(self) -> None:
        html.H2("4. What they become", classes=_HEADING)
        v3.VProgressLinear(
            v_if="import_busy",
            indeterminate=True,
            color="primary",
            **raw(aria_label="Testing the mapping"),
        )
        html.Div(
            "{{ import_text }}",
            style="overflow-wrap: anywhere",
            **raw(data_text="import", role="status"),
        )
        html.Div(
            "Options such as --robot and lines of a mapping file are the fields of steps 2 and 3.",
            v_if="import_text.includes('--')",
            classes="text-caption",
        )
        with html.Div(v_if="import_question", **raw(role="group", aria_label="Open question")):
            html.P("{{ import_question }}", classes="font-weight-bold")
            with html.Div(v_for="one, k in import_answers", key="k"):
                self.button("{{ one }}", self.answer, "[k]")
        with html.Ul(v_if="import_warnings.length", classes="pl-6"):
            html.Li("{{ one }}", v_for="one, k in import_warnings", key="k")
        self._table(
            "Fit with plausible geometry errors", "import_fits", ("name", "rms_mm", "rms_deg")
        )
        self._first_samples()
        html.H2("5. Recording", classes=_HEADING)
        v3.VCheckbox(
            label="Import although the fit is bad",
            model_value=("import_trust",),
            update_modelValue=(self.page.handler(self.choose), "['trust_data', $event]"),
            **_DENSE,
        )
        v3.VTextField(
            v_model=("import_folder",), label="Name of the recording", classes="mb-2", **_DENSE
        )
        self.button(
            "Import and open",
            self.finish,
            "[import_folder]",
            color="primary",
            variant="flat",
            disabled=("!import_ready || import_busy",),
        )

    def _table(self, label: str, items: str, keys) -> None:
        heads = {"name": "Reading", "rms_mm": "RMS (mm)", "rms_deg": "RMS (deg)"}
        with v3.VTable(
            density="compact", v_if=f"{items}.length", **raw(role="group", aria_label=label)
        ):
            with html.Thead(), html.Tr():
                for key in keys:
                    html.Th(heads[key], **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for=f"one, k in {items}", key="k"):
                for key in keys:
                    html.Td("{{ one." + key + " }}")

    def _first_samples(self) -> None:
        label = raw(role="group", aria_label="First samples of the recording", tabindex="0")
        with v3.VTable(density="compact", v_if="import_samples.length", height="34vh", **label):
            with html.Tbody(), html.Tr(v_for="one, k in import_samples", key="k"):
                html.Td("{{ cell }}", v_for="cell, j in one", key="j")

    # What the page shows

    def refresh(self) -> None:
        from robot_model import builtin_robots

        state = self.state
        draft = self.draft
        state.import_names = list(draft.dropped.names)
        robots = [*draft.dropped.robots, *builtin_robots()]
        state.import_robots = [
            {"title": "found by the fit", "value": ""},
            *({"title": name, "value": name} for name in robots),
        ]
        tables = [{"title": name, "value": name} for name in draft.dropped.tables]
        state.import_artefacts = [{"title": "none", "value": ""}, *tables]
        for key in ("robot", "artefact", "board", "sigma", "ball_radius"):
            state[f"import_{key}"] = getattr(draft, key)
        state.import_trust = draft.trust_data
        state.import_kind = draft.keys.get("measures", "")
        state.import_columns = [] if draft.table is None else list(draft.table.columns)
        state.import_rows = form_rows(draft.keys, draft.table)
        state.import_others = other_rows(draft.keys, draft.table)
        self._show_trial()
        if draft.trial is None and draft.sources:
            asynchronous.create_task(self._test())

    def _show_trial(self) -> None:
        state = self.state
        trial = self.draft.trial
        state.import_ready = trial is not None and trial.result is not None
        state.import_question, state.import_answers = "", []
        if trial is None:
            state.import_text = "Testing the mapping on the robot …" if self.draft.sources else ""
            return
        state.import_fits, state.import_samples = trial.fits, trial.samples
        state.import_warnings = [] if trial.result is None else list(trial.result.warnings)
        state.import_text = trial.problem
        if trial.question is not None:
            state.import_question = trial.question.sentence
            state.import_answers = list(trial.question.options)
        if trial.result is not None:
            found = trial.result.recording
            images = f", {len(found.images)} images" if found.images else ""
            state.import_text = f"Ready: {found.measures}, {found.n:,} samples{images}"

    async def _test(self) -> None:
        """Test the newest mapping in the background; what was changed meanwhile is tested by a later task."""
        latest_changes = self.draft.changes
        await asyncio.sleep(_PAUSE_S)
        if latest_changes != self.draft.changes:
            return
        async with self._lock:
            if latest_changes != self.draft.changes or self.draft.trial is not None:
                return
            with self.state:
                self.state.import_busy = True
            trial = await asyncio.get_running_loop().run_in_executor(None, self._tested)
            with self.state:
                self.state.import_busy = False
                if latest_changes == self.draft.changes:
                    self.draft.trial = trial
                    self._show_trial()

    def _tested(self):
        """The trial; a failure of the importer is a sentence too, so that the page never waits for ever."""
        from workbench.app.wizard.trial import Trial

        try:
            return self.draft.test()
        except Exception as problem:
            import logging

            logging.getLogger(__name__).exception("the importer failed")
            return Trial(problem=f"This is a bug of the importer ({problem}); see the terminal")

    # What the user does

    def _on_files(self, import_files, **_) -> None:
        if import_files:
            self.page.handler(self.add)(import_files)

    def add(self, files) -> None:
        """Take dropped files up."""
        files = files if isinstance(files, list | tuple) else [files]
        self.state.import_files = []
        self.page.show_message("")
        try:
            self.draft.add([file for file in files if isinstance(file, dict)])
        except InputError:
            self.refresh()
            raise

    def clear(self) -> None:
        """Forget all files."""
        self.draft.clear()

    def set_cell(self, name, key, value) -> None:
        """Change a cell of the mapping."""
        self.draft.edit(str(name), str(key), value)

    def choose(self, key, value) -> None:
        """Set the robot, the artefact or an option."""
        if key == "trust_data":
            value = bool(value)
        elif key in ("robot", "artefact", *(name for name, _ in _TEXTS)):
            value = str(value or "")
        else:
            raise InputError(f"Import: expected an option, found {str(key)[:40]!r}")
        self.draft.choose(key, value)

    def answer(self, choice) -> None:
        """Answer the open question."""
        self.draft.answer(whole_number(choice, 0, 10**3, "answer"))

    def finish(self, name) -> None:
        """Write the recording to a new folder and open it."""
        if self.draft.trial is None:
            raise InputError("The mapping is not tested yet; wait a moment")
        folder = folder_of(name, Path.cwd())
        self.page.check_idle()
        self.draft.trial.keep(folder)
        self.page.open(str(folder))
        self.draft.clear()
        self.page.show_message(f"The recording is in {folder}.", "success")
        self.page.go_to_tab("recording")
