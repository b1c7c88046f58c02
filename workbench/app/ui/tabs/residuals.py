"""Tab "Residuals": arrows in space, a chart over any quantity, a histogram; click or brush to select."""

from collections.abc import Callable

import numpy as np
from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.data.hand_eye import error_of_row
from workbench.app.data.residuals import FIT, HELD_OUT, HELD_OUT_AFTER
from workbench.app.edits.session import CAMERA
from workbench.app.figures import residuals
from workbench.app.figures.robot import has_points
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab, number_of, points_of, whole_number
from workbench.app.ui.excluded import ExcludedList
from workbench.app.ui.image_panel import ImagePanel
from workbench.app.ui.overlay import brush_of
from workbench.app.ui.pose_errors import PoseErrors
from workbench.app.ui.tabs.recording import row_table
from workbench.app.ui.view import SPACE
from workbench.app.workspace import EXTEND, REMOVE, REPLACE

_MODES = [
    {"title": "replace", "value": REPLACE},
    {"title": "add", "value": EXTEND},
    {"title": "remove", "value": REMOVE},
]
_MOST_PREPARED = 24
"""Quantities whose means are prepared in the background."""


_HINT = (
    "An arrow leads from the measured position (wide end) to the predicted one (tip). Click an arrow, a point or a "
    "bar, or drag over a chart, to select samples. Then exclude them here, and calibrate again in the tab Edit and "
    "rerun."
)


class ResidualsTab(Tab):
    """Tab of the residuals and the samples that they belong to."""

    name = "residuals"
    title = "Residuals"
    contexts = 4

    def __init__(self, page):
        super().__init__(page)
        self.panel = ImagePanel(self, "picked")
        self.excluded = ExcludedList(self)
        self.errors = PoseErrors(self)

    def build(self) -> None:
        state = self.state
        state.quantity, state.quantities = "", []
        state.kind, state.kinds = "", []
        state.select_mode, state.selection_text, state.selected_table = REPLACE, "", []
        state.select_modes = _MODES
        state.length_from, state.length_to, state.wanted_sample = "", "", ""
        state.no_residuals, state.no_arrows = "", ""
        state.selected_count, state.residual_unit = 0, "mm"
        state.has_rows, state.selected_heads = False, []
        state.picked_title, state.picked_image, state.picked_row = "", -1, []
        v3.VAlert(
            "{{ no_residuals }}",
            v_if="no_residuals && !pose_errors.length",
            type="info",
            variant="outlined",
            classes="mb-2",
        )
        self.errors.build()
        with html.Div(v_if="has_rows"):
            self._build_parts()
        self.excluded.build()
        for name in ("quantity", "kind"):
            state.change(name)(self._on_choice)

    def _build_parts(self) -> None:
        """Figures, selection, and the sample that was selected last."""
        with v3.VRow(v_if="!no_residuals"):
            with v3.VCol(cols=12, lg=6):
                html.Div("{{ no_arrows }}", v_if="no_arrows", **raw(data_text="no-arrows"))
                with html.Div(v_if="!no_arrows"):
                    self.figure(
                        "arrows",
                        "Residuals as arrows in space",
                        "64vh",
                        SPACE,
                        click=(self.page.handler(self.on_click), points_of("select_mode")),
                    )
            with v3.VCol(cols=12, lg=6):
                self._charts()
        self._selection()
        self._picked()

    def _charts(self) -> None:
        with html.Div(classes="d-flex"):
            v3.VSelect(
                v_model=("quantity",),
                items=("quantities",),
                label="Horizontal axis",
                density="compact",
                hide_details=True,
            )
            v3.VSelect(
                v_model=("kind",),
                items=("kinds",),
                label="Residual",
                density="compact",
                hide_details=True,
                classes="ml-2",
            )
            v3.VSelect(
                v_model=("select_mode",),
                items=("select_modes",),
                label="Selection mode",
                density="compact",
                hide_details=True,
                classes="ml-2",
            )
        handler = self.page.handler
        self.figure(
            "chart",
            "Residual of each sample over the chosen quantity",
            "32vh",
            click=(handler(self.on_click), points_of("select_mode")),
            brush=self._brush(self.on_brush, "select_mode", "quantity", "kind"),
        )
        self.figure(
            "histogram",
            "Histogram of the residuals of the fit and held out",
            "30vh",
            click=(handler(self.on_bar), points_of("select_mode")),
            brush=self._brush(self.on_brush_lengths, "select_mode", "kind"),
        )

    def _brush(self, method, *names: str) -> str:
        return brush_of(self.page.handler(method), self.page.server, *names)

    def _selection(self) -> None:
        html.Div(_HINT, v_if="!no_residuals", classes="text-caption")
        html.Div(
            "{{ selection_text }}", **raw(data_text="selection", role="status"), classes="mb-2"
        )
        with html.Div(classes="d-flex flex-wrap align-center"):
            with html.Div(v_if="!no_residuals", classes="d-flex flex-wrap align-center"):
                self._field("length_from", "Residual from (mm)")
                self._field("length_to", "to (mm)")
                self.button(
                    "Select by length", self.select_lengths, "[length_from, length_to, select_mode]"
                )
            self._field("wanted_sample", "Sample number")
            self.button("Select sample", self.select_sample, "[wanted_sample, select_mode]")
        with html.Div(classes="d-flex flex-wrap align-center"):
            when_selected = {"disabled": ("!selected_count",)}
            main = {"color": "primary", "variant": "flat"}
            self.button("Clear selection", self.clear, **when_selected)
            self.button("Exclude selected samples", self.exclude, **main, **when_selected)
            self.button("Exclude their poses", self.exclude_poses, **when_selected)
            self.button("Include selected samples", self.include, **when_selected)
            self.button("Show in recording", self.show_in_recording, **when_selected)
        with v3.VTable(
            density="compact",
            v_if="selected_table.length",
            **raw(role="group", aria_label="Selected samples"),
        ):
            with html.Thead(), html.Tr():
                html.Th("{{ head.title }}", v_for="head in selected_heads", **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for="one in selected_table", key="one.row"):
                html.Td("{{ one[head.key] }}", v_for="head in selected_heads")

    def _field(self, key: str, label: str) -> None:
        v3.VTextField(
            v_model=(key,),
            label=label,
            density="compact",
            hide_details=True,
            style="flex: 0 0 190px",
            classes="mr-2 mb-2",
        )

    def _picked(self) -> None:
        """Image, pose and row of the sample that was selected last."""
        with html.Div(v_if="picked_title", classes="mt-3"):
            html.H2("{{ picked_title }}", classes="text-subtitle-1 font-weight-bold")
            with v3.VRow():
                with v3.VCol(cols=12, lg=8, v_if="picked_image >= 0"):
                    self.panel.build("56vh")
                with v3.VCol(cols=12, lg=4):
                    label = raw(role="group", aria_label="Row of the sample", tabindex="0")
                    with v3.VTable(density="compact", height="52vh", **label):
                        with html.Tbody(), html.Tr(v_for="one in picked_row", key="one.name"):
                            html.Td("{{ one.name }}")
                            html.Td("{{ one.value }}", classes="text-right")

    def refresh(self) -> None:
        work = self.work
        state = self.state
        has = work.opened.residuals is not None
        state.residual_unit = state.pose_error_unit if self.errors.refresh() else "mm"
        state.has_rows = work.count > 0
        state.no_residuals = "" if has else _no_residuals(work)
        state.quantities = list(work.quantities)
        if state.quantity not in work.quantities:
            state.quantity = next(iter(work.quantities), "")
        state.kinds = _kind_items(work.opened.residuals)
        if state.kind not in [kind["value"] for kind in state.kinds]:
            state.kind = ""
        state.no_arrows = (
            "The positions of the residuals of this diagnosis are not known; those of a calibration are."
            if has and work.opened.residuals.points is None
            else ""
        )
        self._describe()
        self.excluded.refresh()
        if not has:
            return
        self._show_marks()
        if not state.no_arrows:
            self.draw_still("arrows", self._static_scene)
        self._draw_histogram(self.draw_when_changed)
        self._draw_chart(self.draw_when_changed)
        self._draw_arrows(self.draw_when_changed)

    def prepare(self) -> None:
        work = self.work
        if work.opened.residuals is None:
            return
        self._draw_arrows(self.prepare_figure)
        self._draw_histogram(self.prepare_figure)
        self._draw_chart(self.prepare_figure)

    def prepare_more(self) -> None:
        work = self.work
        for name in list(work.quantities)[:_MOST_PREPARED]:
            work.means(name)
        _ = work.opened.recording.poses  # so that poses can be excluded at once

    def _draw_arrows(self, send: Callable) -> None:
        send("arrows", (self.work.opened,), lambda: residuals.arrows(self.work))

    def _show_marks(self) -> None:
        """Show what a selection changes above chart and scene, which are not drawn again."""
        work = self.work
        state = self.state
        self.overlay("chart", residuals.chart_marks(work, state.quantity, state.kind or ""))
        self.overlay("arrows", residuals.arrow_marks(work))

    def _static_scene(self):
        return residuals.arrows(self.work), residuals.arrow_marks(self.work)

    def _draw_chart(self, send: Callable) -> None:
        name = self.state.quantity or next(iter(self.work.quantities), "")
        kind = self.state.kind or ""
        key = (self.work.opened, name, kind)
        send("chart", key, lambda: residuals.chart(self.work, name, kind))

    def _draw_histogram(self, send: Callable) -> None:
        """It needs no WebGL and is drawn soonest; a selection does not change it."""
        kind = self.state.kind or ""
        send(
            "histogram",
            (self.work.opened, self.work.session.changes, kind),
            lambda: residuals.histogram_figure(self.work, shown=kind),
        )

    def _describe(self) -> None:
        work = self.work
        rows = work.selected_rows
        self.state.selected_count = len(rows)
        excluded = int((~work.kept).sum()) + work.excluded_outside_run
        not_in_run = (
            f" ({work.excluded_outside_run:,} of them not in this run)"
            if work.excluded_outside_run
            else ""
        )
        self.state.selection_text = (
            f"{len(rows):,} of {work.count:,} samples selected; {excluded:,} excluded{not_in_run}"
        )
        self.state.selected_table = [self._row(int(row)) for row in rows[:50]]
        self.state.selected_heads = _heads(self.state.selected_table, self.state.residual_unit)
        self._describe_picked()

    def _describe_picked(self) -> None:
        work = self.work
        state = self.state
        if not work.count or not work.selected[work.current]:
            state.picked_title, state.picked_image, state.picked_row = "", -1, []
            self.mark("arrows", None)
            return
        shown = self._row(work.current)
        state.picked_title = _picked_title(shown, state.residual_unit)
        state.picked_row = row_table(work)
        if has_points(work):
            place = work.opened.residuals.points[:, work.current]
            self.mark("arrows", place, f"sample {shown['sample']}")
        index = work.image_index_of(shown["sample"])
        state.picked_image = -1 if index is None else index
        if index is not None:
            self.panel.show(index)

    def _row(self, row: int) -> dict:
        work = self.work
        found = self.work.opened.residuals
        pose = work.pose_of(row)
        number = int(work.opened.edit_ids[row])
        lengths = {} if found is None else found.lengths
        fit = lengths.get(FIT, lengths.get("after"))
        held_out = lengths.get(HELD_OUT, lengths.get(HELD_OUT_AFTER))
        angles = {} if found is None else found.angles
        angle = angles.get("held_out", angles.get("fit", angles.get("after")))
        return {
            "row": row,
            "angle": _shown(angle, row),
            "sample": number,
            "pose": "–" if pose is None else pose,
            "fit": _shown(fit, row),
            "held_out": _shown(held_out, row),
            "image": work.image_of(number),
            **_of_pose(work.opened, row),
        }

    def _on_choice(self, **_) -> None:
        if self.is_shown and not self.state.no_residuals:
            self._show_marks()
            self._draw_chart(self.draw_when_changed)
            self._draw_histogram(self.draw_when_changed)

    def select_rows(self, rows, mode=REPLACE) -> None:
        """Select some rows, as the chosen mode says."""
        self.work.select(rows, _checked_mode(mode))

    def on_click(self, rows, mode=REPLACE) -> None:
        """Select the sample of a mark or an arrow."""
        rows = [row for row in rows if isinstance(row, int)]
        if rows:
            self.work.select(rows[:1], _checked_mode(mode))

    def on_bar(self, bins, mode=REPLACE) -> None:
        """Select the samples of a bar of the histogram: (low mm, high mm, kind of residual)."""
        found = [
            selected_bin
            for selected_bin in bins
            if isinstance(selected_bin, list | tuple) and len(selected_bin) == 3
        ]
        if found:
            low, high = (number_of(end, "bin") for end in found[0][:2])
            self.work.select_lengths(low, high, str(found[0][2]), _checked_mode(mode))

    def on_brush(self, box, mode=REPLACE, quantity="", kind="") -> None:
        """Select the samples in a rectangle of the chart of the residual `kind` over `quantity`."""
        if box and quantity in self.work.quantities:
            x, y = ([number_of(end, "brush") for end in box[axis]] for axis in ("x", "y"))
            self.work.select_box(quantity, x, y, str(kind or ""), _checked_mode(mode))

    def on_brush_lengths(self, box, mode=REPLACE, kind="") -> None:
        """Select the samples in a range of the histogram, of the residual `kind`."""
        if box:
            low, high = sorted(number_of(end, "brush") for end in box["x"])
            self.work.select_lengths(low, high, str(kind or ""), _checked_mode(mode))

    def select_lengths(self, low, high, mode=REPLACE) -> None:
        """Select by the two fields; an empty one sets no limit."""
        low = number_of(low or 0, "Residual from")
        high = number_of(high or 1e9, "to")
        self.work.select_lengths(low, high, mode=_checked_mode(mode))

    def select_sample(self, number, mode=REPLACE) -> None:
        """Select a sample by its number."""
        number = whole_number(number, -(2**53), 2**53, "Sample number")
        self.work.select_sample(number, _checked_mode(mode))

    def clear(self) -> None:
        """Select nothing."""
        self.work.clear_selection()

    def exclude(self) -> None:
        """Exclude the selected samples."""
        self.work.exclude_selected()
        self.page.show_message("The samples are excluded; rerun to see the effect.")

    def exclude_poses(self) -> None:
        """Exclude the poses of the selected samples."""
        self.work.exclude_poses()
        self.page.show_message("The poses are excluded; rerun to see the effect.")

    def include(self) -> None:
        """Include what is excluded of the selected samples."""
        self.work.include_selected()
        self.page.show_message("The samples are included again; rerun to see the effect.")

    def show_in_recording(self) -> None:
        """Show the first selected sample in the recording, with its pose, its row and its image."""
        rows = self.work.selected_rows
        if len(rows):
            self.work.go_to(int(rows[0]))
            index = self.work.image_index_of(int(self.work.opened.edit_ids[rows[0]]))
            if index is not None:
                self.state.image = index
        self.page.go_to_tab("recording")


def _no_residuals(work) -> str:
    """Why there is nothing to show here, and what to do."""
    if work.session.command == CAMERA:
        return (
            "A calibration of a camera has no residuals of an arm. The reprojection error of each image is in the tab "
            "Sensor. Residuals of a hand-eye calibration are here once its run is open."
        )
    return "This run has no residuals of an arm. Calibrate one in the tab Edit and rerun."


def _shown(values, row: int) -> str:
    """A value of a quantity for people; "–" where there is none."""
    is_known = values is not None and np.isfinite(values[row])
    return f"{values[row]:.4f}" if is_known else "–"


def _heads(rows: list[dict], unit: str) -> list[dict]:
    """Columns of the selected samples as key and title; a quantity that none of them has is left out."""
    titles = {
        "sample": "Sample",
        "pose": "Pose",
        "fit": f"Fit ({unit})",
        "held_out": f"Held out ({unit})",
        "angle": "Orientation (deg)",
        "image": "Image",
    }
    has_any = {key: any(row[key] != "–" for row in rows) for key in titles}
    return [{"key": key, "title": title} for key, title in titles.items() if has_any[key]]


def _picked_title(row: dict, unit: str) -> str:
    """Sample, pose and residuals of a row of the table."""
    pose = "" if row["pose"] == "–" else f", pose {row['pose']}"
    kinds = {"fit": "fit", "held_out": "held out"}
    known = [f"{row[key]} {unit} ({name})" for key, name in kinds.items() if row[key] != "–"]
    residual = f": residual {', '.join(known)}" if known else ""
    return f"Sample {row['sample']}{pose}{residual}"


def _of_pose(opened, row: int) -> dict:
    """Residuals of the image or pose of a row of a hand-eye run; {} of any other run."""
    error = error_of_row(opened, row)
    if error is None:
        return {}
    values = {"fit": error.residual, "held_out": error.held_out}
    return {key: "–" if value is None else f"{value:.4f}" for key, value in values.items()}


def _checked_mode(mode: object) -> str:
    """Mode of a click on the selection; "replace" where the browser sent something else."""
    return mode if mode in (REPLACE, EXTEND, REMOVE) else REPLACE


def _kind_items(found) -> list[dict]:
    """Kinds of residual to choose from, the shown one first."""
    if found is None:
        return []
    shown = residuals.kind_label(found, "")
    others = [(residuals.kind_label(found, kind), kind) for kind in found.lengths]
    items = [(shown, ""), *(item for item in others if item[0] != shown)]
    return [{"title": title, "value": kind} for title, kind in items]
