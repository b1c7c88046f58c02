"""Tab "Sensor": light planes and mirror axis in space, clouds with fitted balls, images with overlays."""

import functools
from collections.abc import Mapping

from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.data.recorded_images.image_errors import camera_deviations, image_errors
from workbench.app.data.recorded_images.images import image_rows
from workbench.app.data.sensor import camera_of, scanner_of, scans_of
from workbench.app.edits.changes import IMAGES
from workbench.app.figures import sensor
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab, points_of, whole_number
from workbench.app.ui.image_panel import ImagePanel
from workbench.app.ui.steps import steps
from workbench.app.ui.view import SPACE
from workbench.report.text import counted

_CAMERA = {
    "fx": "focal length fx",
    "fy": "focal length fy",
    "cx": "principal point cx",
    "cy": "principal point cy",
}
"""Coefficients in the order of OpenCV."""


class SensorTab(Tab):
    """Tab of the sensor's results."""

    name = "sensor"
    title = "Sensor"
    contexts = 5

    def __init__(self, page):
        super().__init__(page)
        self.panel = ImagePanel(self, "overlay")

    def build(self) -> None:
        state = self.state
        state.no_sensor, state.has_scanner = "", False
        state.scan, state.scans, state.ball_table, state.camera_table = 0, [], [], []
        state.scan_text = ""
        state.sensor_image, state.sensor_images = 0, []
        state.sensor_image_on, state.has_image_errors = True, False
        v3.VAlert(
            "{{ no_sensor }}", v_if="no_sensor", type="info", variant="outlined", classes="mb-2"
        )
        with v3.VRow():
            with v3.VCol(cols=12, lg=6, v_if="has_scanner || camera_table.length"):
                with html.Div(v_if="has_scanner"):
                    self._planes()
                self._camera()
            with v3.VCol(cols=12, lg=6, v_if="scans.length"):
                self._clouds()
        with html.Div(v_if="sensor_images.length"):
            self._images()
        state.change("scan")(self._on_scan)
        state.change("sensor_image")(self._on_image)

    def _planes(self) -> None:
        html.H2("Light planes and mirror axis", classes="text-subtitle-1 font-weight-bold")
        self.figure("planes", "Light planes and mirror axis in space", "58vh", SPACE)

    def _camera(self) -> None:
        with html.Div(v_if="camera_table.length", style="max-width: 640px"):
            html.H2("Camera", classes="text-subtitle-1 font-weight-bold mt-3")
            with v3.VTable(density="compact", **raw(role="group", aria_label="Camera")):
                with html.Thead(), html.Tr():
                    for head in ("Parameter", "Value", "1 sigma"):
                        side = {} if head == "Parameter" else {"classes": "text-right"}
                        html.Th(head, **side, **raw(scope="col"))
                with html.Tbody(), html.Tr(v_for="one in camera_table", key="one.name"):
                    html.Td("{{ one.name }}")
                    html.Td("{{ one.value }}", classes="text-right")
                    html.Td("{{ one.sigma }}", classes="text-right")

    def _images(self) -> None:
        html.H2(
            "Corners, stripes and reprojection errors",
            classes="text-subtitle-1 font-weight-bold mt-3",
        )
        with html.Div(v_if="has_image_errors"):
            html.P(
                "RMS distance of detected and predicted corners of each image; the dashed line is that of all images. "
                "Click a bar to see its image. Grey images are excluded. The arrows in the image are those of a flat "
                "board whose pose is fitted to this image alone.",
                classes="text-caption",
            )
            self.figure(
                "image_errors",
                "RMS reprojection error of each board image",
                "34vh",
                click=(self.page.handler(self.on_bar), points_of()),
            )
        with html.Div(classes="d-flex flex-wrap align-center"):
            previous, following = steps("sensor_image", "sensor_images.length - 1")
            self.button("Previous", previous, aria_label="Previous image of the sensor")
            self.button("Next", following, aria_label="Next image of the sensor")
            v3.VAutocomplete(
                v_model=("sensor_image",),
                items=("sensor_images",),
                label="Image of the sensor",
                density="compact",
                hide_details=True,
                classes="mb-2",
                style="flex: 0 1 520px; min-width: 260px",
            )
            v3.VCheckbox(
                label="Use this image in the calibration",
                model_value=("sensor_image_on",),
                update_modelValue=(self.page.handler(self.use_image), "[sensor_image, $event]"),
                hide_details=True,
                classes="mx-4",
            )
        self.panel.build("66vh")

    def _clouds(self) -> None:
        html.H2("Clouds and balls", classes="text-subtitle-1 font-weight-bold")
        v3.VSelect(
            v_model=("scan",), items=("scans",), label="Scan", density="compact", hide_details=True
        )
        html.Div(
            "{{ scan_text }}",
            **raw(data_text="scan", role="status"),
        )
        self.figure(
            "cloud",
            "Cloud of the chosen scan, coloured by the distance from the fitted ball",
            "52vh",
            SPACE,
        )
        html.P(
            "Distance of the points from the fitted ball, by their direction from its centre; 0 deg is towards the "
            "sensor.",
            classes="text-caption",
        )
        self.figure("ball_map", "Map of the distances from the fitted balls by direction", "44vh")
        with v3.VTable(density="compact", **raw(role="group", aria_label="Balls of the scan")):
            with html.Thead(), html.Tr():
                for head in ("Ball", "x (mm)", "y (mm)", "z (mm)", "Radius (mm)", "Form RMS (µm)"):
                    html.Th(head, **raw(scope="col"))
            with html.Tbody(), html.Tr(v_for="one, k in ball_table", key="k"):
                for key in ("ball", "x", "y", "z", "radius", "rms"):
                    html.Td("{{ one." + key + " }}")

    def refresh(self) -> None:
        state = self.state
        opened = self.work.opened
        scanner = scanner_of(opened)
        camera = camera_of(opened)
        state.has_scanner = scanner is not None
        state.scans = [
            {"title": _scan_title(row), "value": k} for k, row in enumerate(scans_of(opened))
        ]
        state.no_sensor = (
            ""
            if camera is not None or state.scans or opened.recording.images
            else (
                "This run has no camera and no scanner. Open a run of workbench camera, scanner or scan, or of "
                "calibrate from images."
            )
        )
        state.sensor_images = _image_items(opened)
        state.has_image_errors = bool(image_errors(opened))
        if state.sensor_images:
            self._show_image()
        deviations = camera_deviations(opened)
        state.camera_table = [] if camera is None else _camera_rows(camera, deviations)
        if scanner is not None:
            self.draw_when_changed("planes", (opened,), lambda: sensor.planes(opened))
        if state.scans:
            self._show_scan()

    def _show_scan(self) -> None:
        opened = self.work.opened
        place = min(max(int(self.state.scan or 0), 0), len(self.state.scans) - 1)
        row = scans_of(opened)[place]
        key = (opened, place)
        self.draw_when_changed("cloud", key, lambda: sensor.cloud(opened, place))
        self.draw_when_changed("ball_map", key, lambda: sensor.ball_map(opened, place))
        self.state.ball_table = [_ball_row(ball) for ball in row["balls"]]
        self.state.scan_text = f"Scan {row['scan']}: {row['points']} points. {row['outcome']}"

    def _show_image(self) -> None:
        opened = self.work.opened
        place = self._image_place(self.state.sensor_image)
        excluded = self.work.session.excluded(IMAGES)
        self.state.sensor_image_on = opened.recording.images[place]["image"] not in excluded
        self.panel.show(place)
        if errors := image_errors(opened):
            key = (opened, place, excluded)
            make = functools.partial(sensor.error_bars, errors, place, excluded)
            self.draw_when_changed("image_errors", key, make)

    def _image_place(self, place) -> int:
        """A place of images.csv that came from the browser; the nearest one that exists."""
        place = whole_number(place or 0, -1, 2**31, "image")
        return min(max(place, 0), len(self.work.opened.recording.images) - 1)

    def on_bar(self, places) -> None:
        """Show the image of a bar."""
        if places and self.state.sensor_images:
            self.state.sensor_image = self._image_place(places[0])

    def use_image(self, place, is_included) -> None:
        """Include or exclude the image at a place of images.csv."""
        self.work.set_image(self._image_place(place), bool(is_included))

    def _on_image(self, **_) -> None:
        if self.is_shown and self.state.sensor_images:
            self.page.handler(self._show_image)()

    def _on_scan(self, **_) -> None:
        if self.is_shown and self.state.scans:
            self.page.handler(self._show_scan)()


def _scan_title(row) -> str:
    found = f"{counted(row['points'], 'point')}, {counted(len(row['balls']), 'ball')}"
    return f"scan {row['scan']} ({found})"


def _ball_row(ball) -> dict:
    places = {axis: f"{ball[f'{axis}_mm']:.4f}" for axis in "xyz"}
    name = "–" if ball.get("ball") is None else str(ball["ball"])
    return {
        "ball": name,
        **places,
        "radius": f"{ball['radius_mm']:.4f}",
        "rms": f"{1000 * ball['rms_mm']:.2f}",
    }


def _image_items(opened) -> list[dict]:
    """Images to choose from, with their reprojection error where the run states it."""
    rms = {error.place: f", RMS {error.rms:.4g} px" for error in image_errors(opened)}
    return [
        {
            "title": f"{row['name']} ({row['role']}){rms.get(row['index'], '')}",
            "value": row["index"],
        }
        for row in image_rows(opened.recording)
    ]


def _camera_rows(camera, deviations: Mapping[str, float]) -> list[dict]:
    """Rows of the table: name, value and standard deviation, "" where the run states none."""
    rows = [
        (label, f"{getattr(camera, name):.3f} px", _sigma(deviations, name, " px"))
        for name, label in _CAMERA.items()
    ]
    rows += [
        (f"distortion {name}", f"{value:.5f}", _sigma(deviations, name))
        for name, value in zip(camera.names[4:], camera.distortion)
    ]
    rows.append(("image size", f"{camera.size[0]} × {camera.size[1]} px", ""))
    return [{"name": name, "value": value, "sigma": sigma} for name, value, sigma in rows]


def _sigma(deviations: Mapping[str, float], name: str, unit: str = "") -> str:
    return f"{deviations[name]:.2g}{unit}" if name in deviations else ""
