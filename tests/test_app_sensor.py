"""The app in a browser on a rendered scanner: images with overlays, light planes, clouds and balls."""

import pytest

from app_browser import (
    chromium,
    open_page,
    plot,
    run_workbench,
    serve,
    show_tab,
    stop,
    text_of,
    trace,
    wait_for_text,
)
from workbench.commands.data.demo import scene

pytestmark = pytest.mark.slow
PLAN = '[[stage]]\nname = "frames"\nwhy = "base and hand-eye"\nfree = ["base.*", "sensor.*"]\nearn = false\n'


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sensor")
    (folder / "plan.toml").write_text(PLAN, encoding="utf-8")
    run_workbench("render", scene(), "--out", folder / "recording", cwd=folder)
    words = [
        "calibrate",
        folder / "recording",
        "--plan",
        folder / "plan.toml",
        "--folds",
        2,
        "--out",
        folder / "run",
    ]
    run_workbench(*words, cwd=folder)
    made = serve(folder / "run", folder / "session")
    yield made
    stop(made)


@pytest.fixture(scope="module")
def page(served):
    started, browser = chromium()
    page = open_page(browser, served, "Recording")
    page.problems = []
    page.on("pageerror", lambda error: page.problems.append(str(error)))
    yield page
    browser.close()
    started.stop()


def _choose_image(page, name: str) -> str:
    show_tab(page, "Recording")
    field = page.get_by_role("combobox", name="Image")
    field.click()
    field.press("Control+a")
    field.press_sequentially(name)
    page.get_by_role("option", name=name).first.click()
    return wait_for_text(page, "image", name)


def test_a_board_image_shows_its_corners_and_reprojection_errors(page):
    assert "54 corners detected" in _choose_image(page, "board-002.png")
    assert len(trace(page, "image", "54 corners")["x"]) == 54
    arrows = trace(page, "image", "reprojection error")
    assert "RMS 0.0" in arrows["name"] and len(arrows["x"]) == 3 * 54


def test_an_image_under_the_laser_shows_its_stripe(page):
    assert "laser stripe detected" in _choose_image(page, "board-001-step-003.png")
    stripe = trace(page, "image", "stripe")
    assert len(stripe["x"]) > 50 and 0 < min(stripe["x"]) and max(stripe["x"]) < 480


def test_the_image_itself_is_drawn_under_its_marks(page):
    _choose_image(page, "board-002.png")
    source = plot(page, "image").evaluate("(element) => element.layout.images[0].source")
    assert source.startswith("data:image/jpeg;base64,")


def test_an_image_is_excluded_and_the_line_is_in_the_session(page, served):
    _choose_image(page, "board-003.png")
    page.get_by_role("checkbox", name="Use in the calibration").click()
    wait_for_text(page, "image", "excluded from the calibration")
    text = served.session.read_text(encoding="utf-8")
    assert 'action = "exclude", kind = "images", items = ["images/board-003.png"]' in text
    page.get_by_role("checkbox", name="Use in the calibration").click()
    page.wait_for_function(
        "() => !document.querySelector('[data-text=image]').innerText.includes('excluded')"
    )


def test_next_and_previous_image_by_keyboard(page):
    _choose_image(page, "board-001.png")
    page.get_by_role("button", name="Next image").press("Enter")
    wait_for_text(page, "image", "board-001-step-000.png")
    page.get_by_role("button", name="Previous image").press("Enter")
    wait_for_text(page, "image", "images/board-001.png")


def test_the_field_of_the_sensor_hangs_on_the_arm(page):
    show_tab(page, "Recording")
    assert trace(page, "scene", "field of the sensor") and trace(
        page, "scene", "balls of the artefact"
    )


def test_light_planes_camera_and_mirror_axis_are_drawn(page):
    show_tab(page, "Sensor")
    for name in ("light planes", "camera", "mirror axis"):
        assert trace(page, "planes", name), name


def test_a_cloud_is_drawn_with_the_ball_fitted_to_it(page):
    show_tab(page, "Sensor")
    points = trace(page, "cloud", "points on balls")
    assert len(points["x"]) > 100 and trace(page, "cloud", "ball ")
    row = page.get_by_role("group", name="Balls of the scan").locator("tbody tr").first.inner_text()
    assert "12.0000" in row


def test_another_scan_is_chosen(page):
    show_tab(page, "Sensor")
    before = text_of(page, "scan")
    page.get_by_role("combobox", name="Scan").press("Enter")
    page.get_by_role("option", name="scan 2 (").click()
    page.wait_for_function(
        "(old) => document.querySelector('[data-text=scan]').innerText !== old", arg=before
    )
    assert "Scan 2" in text_of(page, "scan")


def test_a_residual_leads_to_its_image(page):
    show_tab(page, "Residuals")
    page.get_by_label("Sample number").fill("3")
    page.get_by_role("button", name="Select sample").click()
    table = page.get_by_role("group", name="Selected samples")
    table.wait_for()
    image = table.locator("tbody tr td").last.inner_text()
    assert image.startswith("images/")
    page.get_by_role("button", name="Show in recording").click()
    wait_for_text(page, "image", image)


def test_no_script_error_occurred(page):
    assert page.problems == []
