"""Errors of a hand-eye run by image or pose: bars, a table, and a click that selects."""

from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.data.hand_eye import pose_errors
from workbench.app.figures import hand_eye
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import points_of, whole_number

_HEADS = ("name", "residual", "held_out", "note")


class PoseErrors:
    """Part of the tab Residuals, shown for a hand-eye run."""

    def __init__(self, tab):
        self.tab, self.page, self.state = tab, tab.page, tab.state

    def build(self) -> None:
        """Make the widgets, inside a tab."""
        self.state.pose_errors, self.state.pose_error_unit = [], ""
        with v3.VRow(v_if="pose_errors.length"):
            with v3.VCol(cols=12, lg=7):
                self._bars()
            with v3.VCol(cols=12, lg=5):
                self._table()

    def _bars(self) -> None:
        """The figure with what a click in it does."""
        self.tab.figure(
            "pose_errors",
            "Residual of each image or pose, fit and held out",
            "48vh",
            click=(self.page.handler(self.on_click), points_of("select_mode")),
        )
        html.Div(
            "Click a bar, or a name in the table, to select its sample. Orange: left out by the run.",
            classes="text-caption",
        )

    def _table(self) -> None:
        label = raw(role="group", aria_label="Errors by image or pose", tabindex="0")
        with v3.VTable(density="compact", height="48vh", **label):
            with html.Thead(), html.Tr():
                html.Th("Image or pose", **raw(scope="col"))
                html.Th("Fit ({{ pose_error_unit }})", **raw(scope="col"))
                html.Th("Held out ({{ pose_error_unit }})", **raw(scope="col"))
                html.Th("Left out", **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for="one, k in pose_errors", key="k"):
                with html.Td():
                    v3.VBtn(
                        "{{ one.name }}",
                        click=(self.page.handler(self.on_click), "[[k], select_mode]"),
                        variant="text",
                        density="compact",
                        classes="text-none",
                    )
                for key in _HEADS[1:]:
                    html.Td("{{ one." + key + " }}")

    def refresh(self) -> bool:
        """Send bars and table; whether the run has such errors."""
        errors = pose_errors(self.tab.work.opened)
        self.state.pose_errors = [_row(error) for error in errors]
        self.state.pose_error_unit = errors[0].unit if errors else ""
        if errors:
            self.tab.draw_sequentially(pose_errors=lambda: hand_eye.bars(self.tab.work))
        return bool(errors)

    def on_click(self, places, mode) -> None:
        """Select the samples of an image or a pose by its place in the list."""
        errors = pose_errors(self.tab.work.opened)
        if places and errors:
            place = whole_number(places[0], 0, len(errors) - 1, "image or pose")
            self.tab.select_rows(errors[place].rows, mode)


def _row(error) -> dict:
    fit, held_out = (
        "–" if value is None else f"{value:.4f}" for value in (error.residual, error.held_out)
    )
    note = error.why or ("yes" if error.is_outlier else "")
    return {"name": error.name, "residual": fit, "held_out": held_out, "note": note}
