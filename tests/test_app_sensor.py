"""The app in a browser on a rendered scanner: images with overlays, light planes, clouds and balls."""

import re

import pytest

from app_browser import (
    brush_chart,
    cancel_run,
    choose_option,
    clearest_needle,
    click_bin,
    click_mark,
    click_option,
    click_row,
    opened_app,
    place_of_needle,
    plot,
    run_workbench,
    scrub_by_key,
    settled_place,
    show_tab,
    text_of,
    trace,
    wait_for_text,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(browser, scanner_run, tmp_path_factory):
    with opened_app(browser, scanner_run, tmp_path_factory.mktemp("session"), "Recording") as page:
        yield page


@pytest.fixture(scope="module")
def served(page):
    return page.served


def _choose_image(page, name: str) -> str:
    show_tab(page, "Recording")
    field = page.get_by_role("combobox", name="Image")
    field.click()
    field.press("Control+a")
    field.press_sequentially(name)
    click_option(page.get_by_role("option", name=name).first)
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
    choose_option(page, "Scan", re.compile(r"^scan 2 \("))
    page.wait_for_function(
        "(old) => document.querySelector('[data-text=scan]').innerText !== old", arg=before
    )
    assert "Scan 2" in text_of(page, "scan")


def test_images_with_reprojection_errors_stand_in_the_sensor_tab_too(page):
    show_tab(page, "Sensor")
    wait_for_text(page, "overlay", "54 corners detected")
    assert trace(page, "overlay", "reprojection error")


def test_the_map_of_a_ball_shows_the_points_of_the_cloud(page):
    show_tab(page, "Sensor")
    points, mapped = trace(page, "cloud", "points on balls"), trace(page, "ball_map", "ball ")
    assert 0.5 * len(points["x"]) < len(mapped["x"]) <= len(points["x"])


def test_scrubbing_moves_arm_and_sensor(page):
    scrub_by_key(page, "field of the sensor")
    wait_for_text(page, "row", "(2 of 30)")


def test_coverage_shows_every_joint(page):
    show_tab(page, "Recording")
    titles = plot(page, "coverage").evaluate(
        "(element) => element.layout.annotations.map((one) => one.text)"
    )
    assert len(titles) == 8


def test_a_click_on_an_image_selects_its_sample(page):
    _choose_image(page, "scan-004-step-005.png")
    plot(page, "image").locator(".nsewdrag").first.click()
    wait_for_text(page, "row", "Sample 3 (4 of 30)")
    page.get_by_role("button", name="Select its sample").press("Enter")
    wait_for_text(page, "row", "Sample 3 (4 of 30)")


def test_a_click_on_an_arrow_shows_image_with_overlay_pose_and_row(page):
    show_tab(page, "Residuals")
    click_row(page, 5, 30)
    page.get_by_role("heading", name="Sample 5, pose").wait_for()
    wait_for_text(page, "picked", "images/scan-006-step-001.png, scan; laser stripe detected")
    plot(page, "picked")
    page.wait_for_function(
        "() => document.querySelector('[data-mark=arrows]')?.style.visibility === 'inherit'"
    )
    assert "joint 1 (deg)" in page.get_by_role("group", name="Row of the sample").inner_text()


_ALONG = 0.7
"""Needles of the balls of one artefact start at the same few places and part towards their tips."""
_IS_MARKED = """(text) => {
    const mark = document.querySelector('[data-mark=arrows]');
    return mark?.style.visibility === 'inherit' && mark.innerText === text;
}"""


def test_a_real_click_in_space_shows_image_with_overlay_pose_and_row(page):
    show_tab(page, "Residuals")
    page.get_by_role("button", name="Clear selection").click()
    wait_for_text(page, "selection", "0 of 30 samples selected")
    settled_place(page, lambda: place_of_needle(page, 0))
    row = clearest_needle(page, _ALONG)
    click_mark(page, row, _ALONG)
    wait_for_text(page, "selection", "1 of 30 samples selected")
    page.get_by_role("heading", name=f"Sample {row}, pose").wait_for()
    wait_for_text(page, "picked", ", scan; laser stripe detected")
    assert len(trace(page, "picked", "stripe")["x"]) > 50
    cells = page.get_by_role("group", name="Selected samples").locator("tbody tr td")
    assert cells.first.inner_text() == str(row) and "scan-" in cells.last.inner_text()
    assert "joint 1 (deg)" in page.get_by_role("group", name="Row of the sample").inner_text()
    page.wait_for_function(_IS_MARKED, arg=f"sample {row}")


def test_the_chart_can_show_any_quantity(page):
    show_tab(page, "Residuals")
    choose_option(page, "Horizontal axis", "joint 2 (deg)")
    page.wait_for_function(
        "() => document.querySelector('[data-figure=chart] .js-plotly-plot').layout.xaxis.title.text"
        " === 'joint 2 (deg)'"
    )
    assert len(trace(page, "chart", "samples")["x"]) == 30


def test_a_stage_is_excluded_and_the_change_undone(page):
    show_tab(page, "Edit and rerun")
    page.get_by_role("checkbox", name=re.compile("^frames ")).click()
    page.locator("[data-change]", has_text="exclude 1 stage: frames").wait_for()
    page.get_by_role("button", name="Undo").click()
    page.locator("[data-change]", has_text="exclude 1 stage: frames").wait_for(state="detached")


def test_every_sample_has_the_image_of_the_light_plane_nearest_to_its_ball(scanner_run):
    from workbench.app.data.opened import open_subject
    from workbench.app.data.recorded_images.images import overlay
    from workbench.app.data.recorded_images.sample_images import sample_images

    opened = open_subject(str(scanner_run))
    places = sample_images(opened)
    assert list(places) == list(range(30))
    for number in (0, 7, 21):
        assert overlay(opened.recording, places[number]).stripe.shape[1] > 100


def test_a_bar_and_a_brush_select(page):
    show_tab(page, "Residuals")
    bars = trace(page, "histogram", "held out")
    place = max(range(len(bars["y"])), key=lambda k: bars["y"][k])
    click_bin(page, place)
    wait_for_text(page, "selection", f"{bars['y'][place]} of 30 samples selected")
    wait_for_text(page, "picked", ", scan; ")  # image with overlay, pose and row of the first
    assert plot(page, "picked").evaluate("(one) => one.layout.images.length") == 1
    page.get_by_role("heading", name="Sample").wait_for()
    assert "joint 1 (deg)" in page.get_by_role("group", name="Row of the sample").inner_text()
    brush_chart(page)
    wait_for_text(page, "selection", "30 of 30 samples selected")
    page.get_by_role("button", name="Clear selection").click()


def test_excluded_samples_are_included_again(page, served):
    show_tab(page, "Residuals")
    click_row(page, 5, 30)
    page.get_by_role("button", name="Exclude their poses").click()
    wait_for_text(page, "selection", "1 excluded")
    page.get_by_label("Sample number").fill("5")
    page.get_by_role("button", name="Select sample").click()
    wait_for_text(page, "selection", "1 of 30 samples selected")
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Undo").click()
    page.get_by_role("button", name="Redo").click()
    page.locator("[data-change]", has_text="exclude 1 pose").wait_for()
    page.get_by_role("button", name="Undo").click()
    show_tab(page, "Residuals")
    page.get_by_role("button", name="Exclude selected samples").click()
    wait_for_text(page, "selection", "1 excluded")
    page.get_by_role("button", name="Select sample").click()
    wait_for_text(page, "selection", "1 of 30 samples selected")
    page.get_by_role("button", name="Include selected samples").click()
    wait_for_text(page, "selection", "0 excluded")


def test_a_residual_leads_to_its_image(page):
    show_tab(page, "Residuals")
    page.get_by_label("Sample number").fill("3")
    page.get_by_role("button", name="Select sample").click()
    cells = page.get_by_role("group", name="Selected samples").locator("tbody tr td")
    cells.first.get_by_text("3", exact=True).wait_for()
    image = cells.last.inner_text()
    assert image.startswith("images/scan-004-")
    page.get_by_role("button", name="Show in recording").click()
    wait_for_text(page, "image", image)


_ABOVE = """() => {
    const edges = document.querySelector('[data-figure=threshold] .js-plotly-plot')?.layout.shapes;
    const slider = document.querySelector('[data-tab=edit] [role=slider]');
    const line = document.querySelector('[data-text=threshold]').innerText;
    const value = Number(slider.getAttribute('aria-valuenow')), shown = Number(/above ([0-9.e+-]+)/.exec(line)[1]);
    return !trame.state.state.trame__busy && edges && Math.abs(edges[0].x0 - value) < 1e-9
        && Math.abs(shown - value) < 1e-3 * value && !line.startsWith('0 ') ? line : null;
}"""
"""The sentence on the threshold once it and the histogram are those of the place of the slider."""


def _without_date(path) -> list[str]:
    """Lines of a file without the time at which it was written."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if not line.startswith("date = ")]


def test_the_outlier_threshold_is_dragged_with_the_mouse(page):
    show_tab(page, "Edit and rerun")
    wait_for_text(page, "threshold", "0 samples have a residual above")
    thumb = page.locator(".v-slider", has=page.get_by_role("slider", name="Outlier threshold"))
    box = page.locator("[data-tab=edit] .v-slider-thumb").bounding_box()
    track = thumb.first.bounding_box() if thumb.count() else box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 0.5 * max(track["width"], 200), y, steps=8)
    page.mouse.up()
    above = int(page.wait_for_function(_ABOVE).json_value().split()[0])
    page.get_by_role("button", name="Exclude samples above").click()
    page.locator("[data-change]", has_text=f"exclude {above} sample").wait_for()


def test_the_line_of_the_outlier_threshold_is_dragged_in_the_histogram(page):
    show_tab(page, "Edit and rerun")
    figure = plot(page, "threshold")
    settled_place(page, lambda: figure.evaluate(_PLACE, 0.9))
    x, y = figure.evaluate(_PLACE, 0.9)
    page.mouse.move(x, y)
    page.mouse.down()
    x, _ = figure.evaluate(_PLACE, 0.5)
    page.mouse.move(x, y, steps=6)
    page.mouse.up()
    limit = figure.evaluate(
        "(one) => one._fullLayout.xaxis.p2c(0.5 * one._fullLayout.xaxis._length)"
    )
    page.wait_for_function(
        "(limit) => Math.abs(trame.state.state.threshold - limit) < 0.01 * limit", arg=limit
    )
    value = page.evaluate("trame.state.state.threshold")
    wait_for_text(page, "threshold", f"above {value:.4g} mm")


_PLACE = """(element, share) => {
    const {xaxis, yaxis} = element._fullLayout, box = element.getBoundingClientRect();
    return [box.left + xaxis._offset + share * xaxis._length, box.top + yaxis._offset + 0.5 * yaxis._length];
}"""
"""A place in the window at a share of the width of the axes."""


def test_a_rerun_of_the_scanner_shows_before_and_after_and_is_repeated(page, served, tmp_path):
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate").click()
    wait_for_text(page, "job", "Finished after", 400_000)
    assert trace(page, "side_by_side", "before") and trace(page, "side_by_side", "after")
    link = page.get_by_role("link", name="Report page of this run").get_attribute("href")
    assert page.request.get(f"{served.origin}/{link}").status == 200
    words = ["--session", served.session, "--out", tmp_path / "again", "--no-report"]
    # without the images that other tests exclude, the result may be in doubt (status 1)
    run_workbench("calibrate", *words, cwd=tmp_path, expected=(0, 1))
    newest = max(served.folder.glob("calibrate-*"), key=lambda path: path.stat().st_mtime)
    for name in ("residuals.csv", "parameters.toml", "scanner.toml"):
        assert _without_date(newest / name) == _without_date(tmp_path / "again" / name), name


def test_a_diagnosis_of_the_scanner_is_cancelled(page, served):
    cancel_run(page, "Diagnose")
    assert not list(served.folder.glob("diagnose-*"))


def test_passing_many_images_ends_with_the_last_one(page):
    _choose_image(page, "board-001.png")
    following = page.get_by_role("button", name="Next image")
    for _ in range(6):
        following.click()
    wait_for_text(page, "image", "board-001-step-005.png")
    source = plot(page, "image").evaluate("(one) => one.layout.uirevision")
    assert source == "image-images/board-001-step-005.png"


def test_every_one_of_many_quick_clicks_counts(page):
    show_tab(page, "Recording")
    page.get_by_role("slider", name="Sample in the order of the recording").press("Home")
    wait_for_text(page, "row", "(1 of ")  # of those that tests before this one have left
    following = page.get_by_role("button", name="Next sample")
    for _ in range(8):
        following.click()
    wait_for_text(page, "row", "(9 of ")


def test_no_script_error_occurred(page):
    assert page.problems == []
