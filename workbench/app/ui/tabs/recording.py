"""Tab "Recording": the arm at each pose, coverage, and the images with what was detected in them."""

from collections.abc import Callable

import numpy as np
from trame.widgets import html
from trame.widgets import vuetify3 as v3

from datasets.samples.columns import joint_columns
from workbench.app.data.arm import has_arm
from workbench.app.data.hand_eye import has_flange
from workbench.app.data.recorded_images.images import image_rows
from workbench.app.edits.session import HAND_EYE
from workbench.app.figures import hand_eye, robot
from workbench.app.figures.overlay import Overlay
from workbench.app.figures.residuals import kind_label
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab, points_of, whole_number
from workbench.app.ui.excluded import ExcludedList
from workbench.app.ui.image_panel import ImagePanel
from workbench.app.ui.steps import steps
from workbench.app.ui.view import SPACE
from workbench.core.errors import InputError
from workbench.report.text import covariate_label, joint_label


class RecordingTab(Tab):
    """Robot in 3-D, scrubbing through the samples, coverage, images."""

    name = "recording"
    title = "Recording"
    contexts = 4

    def __init__(self, page):
        super().__init__(page)
        self.panel = ImagePanel(self, "image")
        self.excluded = ExcludedList(self)

    def build(self) -> None:
        state = self.state
        state.row, state.last_row, state.row_text, state.row_table = 0, 0, "", []
        state.has_arm, state.images = False, []
        state.has_joints, state.has_samples = False, False
        state.number_to_show = ""
        state.image, state.image_on, state.image_row = 0, True, -1
        with v3.VRow():
            with v3.VCol(cols=12, lg=7):
                self._scene()
            with v3.VCol(cols=12, lg=5):
                self._details()
        with html.Div(v_if="images.length"):
            self._images()
        self.excluded.build()
        state.change("row")(self._on_row)
        state.change("image")(self._on_image)

    def _scene(self) -> None:
        with html.Div(v_if="has_arm"):
            self.figure(
                "scene",
                "Robot or flange at the current sample",
                "62vh",
                SPACE,
                click=(self.page.handler(self.on_click), points_of()),
            )
        with html.Div(v_if="has_samples"):
            self._scrubber()

    def _scrubber(self) -> None:
        """Buttons, slider and field that choose the current sample."""
        with html.Div(classes="d-flex align-center"):
            previous, following = steps("row", "last_row")
            self.button("Previous", previous, aria_label="Previous sample")
            self.button("Next", following, aria_label="Next sample")
            v3.VSlider(
                v_model=("row",),
                min=0,
                max=("last_row",),
                step=1,
                hide_details=True,
                classes="mx-4",
                **raw(aria_label="Sample in the order of the recording"),
                color="primary",
            )
        html.Div("{{ row_text }}", **raw(data_text="row", role="status"))
        self._sample_field()

    def _sample_field(self) -> None:
        """A field for the number of the sample to show."""
        with html.Div(classes="d-flex flex-wrap align-center mt-2"):
            v3.VTextField(
                v_model=("number_to_show",),
                label="Number of a sample",
                density="compact",
                hide_details=True,
                style="flex: 0 0 220px",
                classes="mr-2 mb-2",
            )
            self.button("Show sample", self.show_sample, "[number_to_show]")

    def _details(self) -> None:
        with html.Div(v_if="has_joints"):
            html.H2("Coverage", classes="text-subtitle-1 font-weight-bold")
            html.P(
                "Number of samples by joint reading; orange lines are the joint limits. The last charts show "
                "the flange in the robot's base frame.",
                classes="text-caption",
            )
            self.figure(
                "coverage", "Readings of each joint between its limits, and the workspace", "52vh"
            )
        self._sample_table()

    def _sample_table(self) -> None:
        with html.Div(v_if="has_samples"):
            html.H2("Current sample", classes="text-subtitle-1 font-weight-bold mt-2")
            label = raw(role="group", aria_label="Columns of the current sample", tabindex="0")
            with v3.VTable(density="compact", height="26vh", **label):
                with html.Tbody():
                    with html.Tr(v_for="one in row_table", key="one.name"):
                        html.Td("{{ one.name }}")
                        html.Td("{{ one.value }}", classes="text-right")

    def _images(self) -> None:
        html.H2("Images", classes="text-subtitle-1 font-weight-bold mt-4")
        with html.Div(classes="d-flex flex-wrap align-center"):
            previous, following = steps("image", "images.length - 1")
            self.button("Previous image", previous)
            self.button("Next image", following)
            v3.VAutocomplete(
                v_model=("image",),
                items=("images",),
                label="Image",
                hide_details=True,
                density="compact",
                classes="mb-2",
                style="flex: 0 1 420px; min-width: 260px",
            )
            v3.VCheckbox(
                label="Use in the calibration",
                model_value=("image_on",),
                update_modelValue=(self.page.handler(self.use_image), "[image, $event]"),
                hide_details=True,
                classes="mx-4",
            )
            self.button(
                "Select its sample",
                self.select_sample,
                "[image]",
                v_if="has_samples",
                disabled=("image_row < 0",),
            )
        self.panel.build("70vh", self.on_image_click, "image")

    def refresh(self) -> None:
        self.state.has_arm = has_arm(self.work.opened) or has_flange(self.work.opened)
        self.state.has_samples = self.work.count > 0
        self.state.has_joints = bool(joint_columns(self.work.opened.samples.columns))
        self.state.images = [
            {"title": f"{row['name']} ({row['role']})", "value": row["index"]}
            for row in image_rows(self.work.opened.recording)
        ]
        self._describe()
        self.excluded.refresh()
        if self.state.has_arm:
            is_still = _is_still(self.work)
            self.overlay("scene", robot.scene_marks(self.work) if is_still else Overlay())
            self.draw_still("scene", self._static_scene)
            self._draw_scene(self.draw_when_changed)
        if self.state.has_joints:
            self._draw_coverage(self.draw_when_changed)
        if self.state.images:
            self._show_image()

    def prepare(self) -> None:
        opened = self.work.opened
        if has_arm(opened) or has_flange(opened):
            self._draw_scene(self.prepare_figure)
        if joint_columns(opened.samples.columns):
            self._draw_coverage(self.prepare_figure)

    def _draw_scene(self, send: Callable) -> None:
        """With an arm, which the page draws above the scene, the scene is the same at each sample."""
        work = self.work
        key = (work.opened, 0 if _is_still(work) else work.current)
        send("scene", key, lambda: _scene(work))

    def _static_scene(self):
        return _scene(self.work), robot.scene_marks(self.work) if _is_still(self.work) else None

    def _draw_coverage(self, send: Callable) -> None:
        """No edit changes it."""
        work = self.work
        send("coverage", (work.opened,), lambda: robot.coverage(work))

    def _describe(self) -> None:
        work = self.work
        row = int(work.opened.rows[work.current]) if work.count else 0
        self.state.last_row = max(work.count - 1, 0)
        self.state.row = work.current
        self.state.row_table = row_table(work) if work.count else []
        number = work.opened.samples.sample_ids[row] if work.count else 0
        phrases = [f"Sample {number} ({work.current + 1:,} of {work.count:,})"]
        time = work.opened.samples.columns.get("time_s")
        if time is not None and work.count:
            phrases.append(f"time {float(time[row]):,.6g} s")
        if (found := work.opened.residuals) is not None:
            kind = kind_label(found, "")
            phrases.append(f"residual ({kind}) {work.lengths()[work.current]:.4f} mm")
        if work.count and not work.kept[work.current]:
            phrases.append("excluded")
        self.state.row_text = ", ".join(phrases)

    def _show_image(self) -> None:
        index = self._image_place(self.state.image)
        name = self.work.opened.recording.images[index]["image"]
        self.state.image_on = name not in self.work.session.excluded("images")
        row = self.work.row_of_image(index)
        self.state.image_row = -1 if row is None else row
        self.panel.show(index)

    def _on_row(self, row, **_) -> None:
        if self.is_shown and row != self.work.current:
            self.page.handler(self.go_to)(row)

    def _on_image(self, image, **_) -> None:
        if self.is_shown and self.state.images and image is not None:
            self.page.handler(self._show_image)()

    def go_to(self, row) -> None:
        """Show one sample."""
        self.work.go_to(whole_number(row, 0, max(self.work.count - 1, 0), "sample"))

    def show_sample(self, number) -> None:
        """Show the sample of a number."""
        number = whole_number(number, -(2**53), 2**53, "Number of a sample")
        opened = self.work.opened
        found = np.flatnonzero(opened.samples.sample_ids[opened.rows] == number)
        if not len(found):
            raise InputError(f"No sample of this run has the number {number}; correct the number")
        self.work.go_to(int(found[0]))

    def use_image(self, image, is_included) -> None:
        """Include or exclude the image at a place of images.csv."""
        self.work.set_image(self._image_place(image), bool(is_included))

    def select_sample(self, image) -> None:
        """Select the sample of an image, and show its pose and row."""
        row = self.work.row_of_image(self._image_place(image))
        if row is not None:
            self.work.select([row])

    def on_image_click(self, _points, image) -> None:
        """Select the sample of the image that was clicked."""
        self.select_sample(image)

    def _image_place(self, image) -> int:
        """A place of images.csv that came from the browser; the nearest one that exists."""
        place = whole_number(image or 0, -1, 2**31, "image")
        return min(max(place, 0), len(self.work.opened.recording.images) - 1)

    def on_click(self, rows) -> None:
        """Go to the sample that was clicked."""
        rows = [row for row in rows if isinstance(row, int)]
        if rows:
            self.go_to(rows[0])


def _is_still(work) -> bool:
    """Whether the scene is that of an arm, which is the same at each sample but for the arm."""
    return work.opened.command != HAND_EYE and has_arm(work.opened)


def _scene(work):
    """Flange, camera and board of a hand-eye run or of flange poses without an arm; else the arm."""
    return robot.scene(work) if _is_still(work) else hand_eye.scene(work)


def row_table(work) -> list[dict]:
    """Name and value of each column of the current sample."""
    row = int(work.opened.rows[work.current])
    columns = work.opened.samples.columns
    return [{"name": _label(name), "value": _text(values[row])} for name, values in columns.items()]


def _label(name: str) -> str:
    """A column of samples.csv as quantity and unit: "q1_deg" -> "joint 1 (deg)", "flange_qw" -> "flange qw"."""
    joint = joint_label(name)
    return joint if joint != name else covariate_label(name)


def _text(value) -> str:
    if isinstance(value, str):
        return value
    return f"{float(value):.6g}"
