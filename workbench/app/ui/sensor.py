"""Tab "Sensor": light planes and mirror axis in space, clouds with fitted balls, images with overlays."""

from trame.widgets import html
from trame.widgets import vuetify3 as v3

from workbench.app.data.images import image_rows
from workbench.app.data.sensor import camera_of, scanner_of, scans_of
from workbench.app.figures import sensor
from workbench.app.ui.attributes import raw
from workbench.app.ui.base import Tab
from workbench.app.ui.image_panel import ImagePanel
from workbench.app.ui.view import SPACE
from workbench.report.text import counted

_CAMERA = {
    "fx": "focal length fx",
    "fy": "focal length fy",
    "cx": "principal point cx",
    "cy": "principal point cy",
}
_LENS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Coefficients in the order of OpenCV."""


class SensorTab(Tab):
    """What the run says of the sensor."""

    name, title = "sensor", "Sensor"
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
                with html.Tbody(), html.Tr(v_for="one in camera_table", key="one.name"):
                    html.Td("{{ one.name }}")
                    html.Td("{{ one.value }}", classes="text-right")

    def _images(self) -> None:
        html.H2(
            "Corners, stripes and reprojection errors",
            classes="text-subtitle-1 font-weight-bold mt-3",
        )
        v3.VAutocomplete(
            v_model=("sensor_image",),
            items=("sensor_images",),
            label="Image of the sensor",
            density="compact",
            hide_details=True,
            style="max-width: 600px",
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
        state, opened = self.state, self.work.opened
        scanner, camera = scanner_of(opened), camera_of(opened)
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
        state.sensor_images = [
            {"title": f"{row['name']} ({row['role']})", "value": row["index"]}
            for row in image_rows(opened.recording)
        ]
        if state.sensor_images:
            self._show_image()
        state.camera_table = [] if camera is None else _camera_rows(camera)
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
        last = len(self.work.opened.recording.images) - 1
        self.panel.show(min(max(int(self.state.sensor_image or 0), 0), last))

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


def _camera_rows(camera) -> list[dict]:
    rows = [(label, f"{getattr(camera, name):.3f} px") for name, label in _CAMERA.items()]
    rows += [
        (f"distortion {name}", f"{value:.5f}") for name, value in zip(_LENS, camera.distortion)
    ]
    rows.append(("image size", f"{camera.size[0]} × {camera.size[1]} px"))
    return [{"name": name, "value": value} for name, value in rows]
