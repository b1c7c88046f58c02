"""The app on a calibration of a camera: reprojection error of each image, images to exclude, no empty controls."""

import csv
import json
import shutil

import numpy as np
import pytest

import app_browser
from app_browser import click_at, opened_app, plot, settled_place, show_tab, wait_for_text
from workbench.app.data.opened import open_subject, summary
from workbench.app.data.recorded_images.image_errors import camera_deviations, image_errors
from workbench.app.figures import sensor

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def camera_run(hand_eye_run, tmp_path_factory):
    """Run of `workbench camera` on images of a board without flange poses."""
    folder = tmp_path_factory.mktemp("camera")
    recording = folder / "recording"
    shutil.copytree(hand_eye_run.parent / "recording", recording)
    (recording / "samples.csv").unlink()
    keys = (recording / "recording.toml").read_text(encoding="utf-8")
    samples = '[samples]\nfile = "samples.csv"\n'
    assert samples in keys
    (recording / "recording.toml").write_text(keys.replace(samples, ""), encoding="utf-8")
    with (recording / "images.csv").open(encoding="utf-8", newline="") as file:
        rows = [
            {key: value for key, value in row.items() if key != "sample"}
            for row in csv.DictReader(file)
        ]
    with (recording / "images.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    app_browser.run_workbench("camera", recording, "--out", folder / "run", cwd=folder)
    return folder / "run"


@pytest.fixture(scope="module")
def page(browser, camera_run, tmp_path_factory):
    with opened_app(browser, camera_run, tmp_path_factory.mktemp("session")) as page:
        yield page


def test_errors_and_deviations_are_those_of_the_answer(camera_run):
    opened = open_subject(str(camera_run))
    answer = json.loads((camera_run / "answer.json").read_text(encoding="utf-8"))
    stated = {row["image"]: row["rms_px"] for row in answer["images"]}
    errors = image_errors(opened)
    assert {one.name: one.rms for one in errors} == stated and len(stated) == 14
    assert [opened.recording.images[one.place]["image"] for one in errors] == [
        one.name for one in errors
    ]
    deviations = camera_deviations(opened)
    assert deviations["fx"] == answer["std"]["fx_px"] and deviations["k1"] == answer["std"]["k1"]
    held_out = f"held-out RMS reprojection error {answer['held_out']['rms_px']:.4g} px"
    assert summary(opened) == f"board-images · 14 images · {held_out} · run of camera"


def test_bars_of_excluded_images_are_grey_and_the_line_is_the_rms_of_all(camera_run):
    errors = image_errors(open_subject(str(camera_run)))
    made = sensor.error_bars(errors, errors[3].place, {errors[1].name})
    bars = made.data[0]
    assert [k for k, colour in enumerate(bars.marker.color) if colour != bars.marker.color[0]] == [
        1
    ]
    assert np.flatnonzero(bars.marker.line.width).tolist() == [3]
    together = np.sqrt(np.mean(np.square(bars.y)))
    assert made.layout.shapes[0].y0 == pytest.approx(together)


def test_a_run_without_samples_shows_no_controls_of_samples(page):
    show_tab(page, "Recording")
    page.get_by_role("button", name="Next image", exact=True).wait_for()
    assert page.get_by_role("button", name="Next sample").count() == 0
    assert page.get_by_role("heading", name="Current sample").count() == 0
    show_tab(page, "Residuals")
    page.get_by_text("The reprojection error of each image is in the tab Sensor.").wait_for()
    for name in ("Select sample", "Exclude selected samples"):
        assert page.get_by_role("button", name=name).count() == 0, name


_MIDDLE_OF_BAR = """(element, place) => {
    const {xaxis, yaxis} = element._fullLayout, box = element.getBoundingClientRect();
    return [box.left + xaxis._offset + xaxis.c2p(place),
            box.top + yaxis._offset + yaxis.c2p(element._fullData[0].y[place] / 2)];
}"""


def test_a_click_on_a_bar_shows_its_image_which_is_excluded_and_left_out_by_a_rerun(page):
    show_tab(page, "Sensor")
    figure = plot(page, "image_errors")
    figure.scroll_into_view_if_needed()
    assert len(figure.evaluate("(one) => one._fullData[0].y")) == 14
    x, y = settled_place(page, lambda: figure.evaluate(_MIDDLE_OF_BAR, 8))
    click_at(page, "image_errors", x, y)
    wait_for_text(page, "overlay", "images/board-009.png")
    page.get_by_role("group", name="Camera").get_by_text("1 sigma").wait_for()
    page.get_by_role("button", name="Next image of the sensor").press("Enter")
    wait_for_text(page, "overlay", "images/board-010.png")
    page.get_by_role("button", name="Previous image of the sensor").press("Enter")
    wait_for_text(page, "overlay", "images/board-009.png")
    page.get_by_role("checkbox", name="Use this image in the calibration").press("Space")
    wait_for_text(page, "overlay", "excluded from the calibration")
    assert '"images/board-009.png"' in page.served.session.read_text(encoding="utf-8")
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate the camera").click()
    wait_for_text(page, "job", "Finished after")
    table = page.get_by_role("group", name="Before and after").inner_text()
    assert "14" in table and "13" in table
    show_tab(page, "Sensor")
    page.wait_for_function(
        "() => document.querySelector('[data-figure=image_errors] .js-plotly-plot')._fullData[0].y.length === 13"
    )
    assert page.problems == []
