"""The app in a browser: what is clicked, brushed, edited and run again on the bundled arm."""

import re
from contextlib import contextmanager

import pytest

from app_browser import (
    WAIT_MS,
    brush_chart,
    choose_option,
    click_at,
    click_bin,
    click_mark,
    click_row,
    drawn_rows,
    emit,
    open_page,
    opened_app,
    painted_marks,
    place_of_needle,
    plot,
    scrub_by_key,
    serve,
    settled_place,
    show_tab,
    stop,
    text_of,
    trace,
    wait_for_text,
    wait_until_drawn,
)
from workbench.app.figures import style

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def shared(browser, arm_run, tmp_path_factory):
    """One page for all tests that follow one another; its problems fail the last test."""
    with opened_app(browser, arm_run, tmp_path_factory.mktemp("session")) as page:
        yield page


@pytest.fixture(scope="module")
def served(shared):
    return shared.served


@pytest.fixture
def page(shared):
    """The shared page without selection and without changes."""
    show_tab(shared, "Edit and rerun")
    undo = shared.get_by_role("button", name="Undo")
    while undo.is_enabled():
        count = shared.locator("[data-change]").count()
        undo.click()
        shared.wait_for_function(
            "(n) => document.querySelectorAll('[data-change]').length < n", arg=count
        )
    show_tab(shared, "Residuals")
    clear = shared.get_by_role("button", name="Clear selection")
    if clear.is_enabled():
        clear.click()
    wait_for_text(shared, "selection", "0 of 300 samples selected; 0 excluded")
    return shared


def test_nothing_is_loaded_from_another_host(browser, served):
    page = browser.new_page()
    page.set_default_timeout(WAIT_MS)
    foreign = []
    page.on("request", lambda request: foreign.append(request.url))
    page.goto(served.address)
    page.get_by_role("tab", name="Recording").wait_for()
    local = (served.origin, "data:", "blob:", served.origin.replace("http", "ws"))
    assert [url for url in foreign if not url.startswith(local)] == []
    page.close()


def test_the_bar_names_recording_and_error(page):
    assert "Elastic arm, four balls" in page.get_by_role("heading", level=1).inner_text()
    assert re.search(
        r"300 samples · held-out RMS 0\.\d+ mm · run of calibrate", page.inner_text("header")
    )


def test_arrows_are_drawn_for_all_samples_with_their_rows(page):
    assert drawn_rows(page) == list(range(300))


def test_arrows_are_coloured_by_the_length_of_the_residual(page):
    colours = plot(page, "arrows").evaluate(
        "(element) => Array.from(element._fullData.find((one) => one.name === 'residuals').intensity)"
    )
    assert len(colours) == 1200 and max(colours) > 2 * min(colours) > 0


def test_a_click_on_an_arrow_selects_its_sample_and_shows_its_row(page):
    click_row(page, 17, 300)
    assert (
        page.get_by_role("group", name="Selected samples").locator("tbody tr td").first.inner_text()
        == "18"
    )


def test_a_real_click_on_a_mark_of_the_chart_selects_it(page):
    place = plot(page, "chart")
    x, y = place.evaluate(
        """(element) => { const one = element._fullData.find((t) => t.name === 'samples'); const layout = element._fullLayout;
            const box = element.getBoundingClientRect(); const y = Array.from(one.y), k = y.indexOf(Math.max(...y));
            return [box.left + layout.xaxis._offset + layout.xaxis.c2p(one.x[k]),
                    box.top + layout.yaxis._offset + layout.yaxis.c2p(one.y[k])]; }"""
    )
    click_at(page, "chart", x, y)
    wait_for_text(page, "selection", "1 of 300 samples selected")


def test_a_recording_without_a_run_shows_a_sentence_and_no_empty_charts(browser, tmp_path):
    with opened_app(browser, "elastic-arm", tmp_path / "session") as page:
        show_tab(page, "Residuals")
        page.get_by_text("This run has no residuals of an arm").wait_for()
        assert page.locator("[data-figure=chart]").count() == 0
        assert page.locator("[data-figure=arrows]").count() == 0
        wait_for_text(page, "selection", "0 of 300")


def test_a_selection_is_marked_in_chart_and_scene_without_drawing_them_again(page):
    kept = "(one) => { window.kept = window.kept || {}; window.kept[%r] = one.data; }"
    for name in ("chart", "arrows"):
        plot(page, name).evaluate(kept % name)
    brush_chart(page)
    wait_for_text(page, "selection", "300 of 300")
    assert [painted_marks(page, name, style.ORANGE) for name in ("chart", "arrows")] == [300, 301]
    page.get_by_role("button", name="Clear selection").click()
    wait_for_text(page, "selection", "0 of 300")
    assert [painted_marks(page, name, style.ORANGE) for name in ("chart", "arrows")] == [0, 1]
    wait_until_drawn(page)
    for name in ("chart", "arrows"):
        assert plot(page, name).evaluate(f"(one) => one.data === window.kept.{name}")


def test_the_escape_key_ends_a_brush_without_a_selection(page):
    box = plot(page, "chart").locator(".nsewdrag").first.bounding_box()
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 80, box["y"] + 60, steps=3)
    page.locator(".brush").wait_for()
    page.keyboard.press("Escape")
    page.locator(".brush").wait_for(state="detached")
    page.mouse.up()
    wait_until_drawn(page)
    assert text_of(page, "selection").startswith("0 of 300")


_LEFTMOST = """(canvas) => {
    const {data, width, height} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    for (let x = 0; x < width; x++) for (let y = 0; y < height; y++)
        if (data[4 * (y * width + x) + 3]) return x;
    return null;
}"""


def test_the_marks_follow_the_zoom_of_a_chart(page):
    click_row(page, 150, 300)
    marks = page.locator("[data-overlay=chart]")
    before = marks.evaluate(_LEFTMOST)
    box = plot(page, "chart").bounding_box()
    page.mouse.move(box["x"] + box["width"] - 30, box["y"] + 0.6 * box["height"])
    page.keyboard.down("Control")
    page.mouse.wheel(0, 300)
    page.keyboard.up("Control")
    page.wait_for_function(
        "([canvas, old]) => (" + _LEFTMOST + ")(canvas) > old + 5",
        arg=[marks.element_handle(), before],
    )
    page.get_by_role("button", name="Reset view: Residual of each sample").press("Enter")
    page.wait_for_function(
        "([canvas, old]) => (" + _LEFTMOST + ")(canvas) === old",
        arg=[marks.element_handle(), before],
    )


def test_a_brush_over_the_whole_chart_selects_every_sample(page):
    brush_chart(page)
    wait_for_text(page, "selection", "300 of 300 samples selected")


def test_a_real_click_on_a_bar_selects_its_samples(page):
    bars = trace(page, "histogram", "held out")
    place = max(range(len(bars["y"])), key=lambda k: bars["y"][k])
    click_bin(page, place)
    wait_for_text(page, "selection", f"{bars['y'][place]} of 300 samples selected")


def test_a_real_click_on_a_low_bar_selects_its_samples(page):
    bars = trace(page, "histogram", "held out")
    place = max(k for k, count in enumerate(bars["y"]) if count)
    assert bars["y"][place] < 0.1 * max(bars["y"])
    click_bin(page, place)
    wait_for_text(page, "selection", f"{bars['y'][place]} of 300 samples selected")


def test_a_real_click_on_a_mark_in_space_selects_its_sample(page):
    click_mark(page, 120)
    wait_for_text(page, "selection", "1 of 300 samples selected")


_RING_AND_NEEDLE = """() => {
    const mark = document.querySelector('[data-mark=arrows]');
    if (!mark || getComputedStyle(mark).visibility !== 'visible') return null;
    const box = mark.getBoundingClientRect();
    return [mark.innerText, box.left, box.top];
}"""


_RING_IS_NEAR = f"""(needle) => {{
    const ring = ({_RING_AND_NEEDLE})();
    return ring && Math.hypot(ring[1] - needle[0], ring[2] - needle[1]) < 12;  // the needle has a width
}}"""


_CAMERA = """() => JSON.stringify(document.querySelector('[data-figure=arrows] .js-plotly-plot')
    ._fullLayout.scene._scene.getCamera().eye)"""


def test_a_ring_marks_the_selected_sample_in_space_and_follows_the_camera(page):
    click_row(page, 120, 300)
    page.wait_for_function(f"() => ({_RING_AND_NEEDLE})()?.[0] === 'sample 121'")
    for _ in range(2):
        needle = settled_place(page, lambda: place_of_needle(page, 120))
        page.wait_for_function(_RING_IS_NEAR, arg=needle)
        _, *ring = page.evaluate(_RING_AND_NEEDLE)
        rotate = page.get_by_role("button", name="Rotate left: Residuals as arrows in space")
        for _ in range(3):
            camera = page.evaluate(_CAMERA)
            rotate.press("Enter")
            page.wait_for_function(f"(old) => ({_CAMERA})() !== old", arg=camera)
        page.wait_for_function(
            f"(old) => Math.hypot(...({_RING_AND_NEEDLE})().slice(1).map((v, k) => v - old[k])) > 15",
            arg=ring,
        )
    page.get_by_role("button", name="Reset view: Residuals as arrows in space").press("Enter")
    page.get_by_role("button", name="Clear selection").click()
    page.locator("[data-mark=arrows]").wait_for(state="detached")


def test_the_histogram_overlays_fit_and_held_out(page):
    fit, held_out = (trace(page, "histogram", name) for name in ("fit", "held out"))
    assert sum(fit["y"]) == sum(held_out["y"]) == 300


def choose_kind(page, kind: str) -> None:
    """Choose a kind of residual, and wait until a click on a bin selects by it."""
    choose_option(page, "Residual", kind)
    key = {"fit": "fit", "held out": "held_out"}[kind]
    plot(page, "histogram").evaluate(
        """async (one, key) => {
            while (one.data.find((found) => found.name === 'bins').customdata[0][2] !== key)
                await new Promise((later) => setTimeout(later, 20));
        }""",
        key,
    )


def test_adding_to_and_removing_from_a_selection(page):
    for mode, row, count in (("replace", 3, 1), ("add", 5, 2), ("remove", 3, 1)):
        choose_option(page, "Selection mode", mode)
        emit(page, "arrows", "plotly_click", {"points": [{"customdata": row}]})
        wait_for_text(page, "selection", f"{count} of 300 samples selected")
    choose_option(page, "Selection mode", "replace")


@contextmanager
def fields_held_back(page):
    """The page busy as with a request in progress: trame then keeps fields back, but sends clicks at once."""
    page.evaluate("() => trame.client.beginBusy()")
    yield
    page.evaluate("() => trame.client.endBusy()")


def test_a_click_carries_the_fields_that_it_depends_on(page):
    page.get_by_label("Sample number").fill("17")
    page.get_by_role("button", name="Select sample").click()
    first = page.get_by_role("group", name="Selected samples").locator("tbody td").first
    first.get_by_text("17", exact=True).wait_for()
    with fields_held_back(page):
        page.get_by_label("Sample number").fill("42")
        page.get_by_role("button", name="Select sample").click()
        first.get_by_text("42", exact=True).wait_for()


def test_a_tab_opened_by_a_button_stays_open_after_a_quick_change_of_tabs(page):
    click_row(page, 100, 300)
    show_tab(page, "Recording")
    wait_for_text(page, "row", "Sample 101 ")
    with fields_held_back(page):
        page.get_by_role("tab", name="Residuals", exact=True).click()
        page.get_by_role("button", name="Show in recording").click()
        page.locator("[data-tab=recording]").wait_for()
    wait_for_text(page, "row", "(101 of 300)")
    page.get_by_role("button", name="Next sample").click()  # answered after all that came before
    wait_for_text(page, "row", "(102 of 300)")
    wait_until_drawn(page)
    assert page.locator("[data-tab=recording]").is_visible()


def test_an_error_message_disappears_with_the_next_success(page):
    page.get_by_label("Sample number").fill("4200")
    page.get_by_role("button", name="Select sample").click()
    message = page.get_by_text("Sample 4200 is not among the residuals")
    message.wait_for()
    page.get_by_label("Sample number").fill("42")
    page.get_by_role("button", name="Select sample").click()
    wait_for_text(page, "selection", "1 of 300 samples selected")
    message.wait_for(state="detached")


def test_a_bar_selects_by_the_chosen_residual(page):
    choose_kind(page, "fit")
    bars = trace(page, "histogram", "fit")
    place = max(range(len(bars["y"])), key=lambda k: bars["y"][k])
    click_bin(page, place)
    wait_for_text(page, "selection", f"{bars['y'][place]} of 300 samples selected")
    choose_kind(page, "held out")


def test_the_chart_can_show_any_covariate(page):
    page.get_by_role("combobox", name="Horizontal axis").focus()
    page.keyboard.type("payload")
    page.wait_for_function(
        "() => document.querySelector('[data-figure=chart] .js-plotly-plot').layout.xaxis.title.text === 'payload (kg)'"
    )
    assert (
        set(trace(page, "chart", "samples")["x"]) == {0, 1, 2}
        or len(trace(page, "chart", "samples")["x"]) == 300
    )


def test_samples_are_selected_by_length_and_number_without_a_mouse(page):
    page.get_by_label("Residual from (mm)").fill("0")
    page.get_by_label("to (mm)").fill("1000")
    page.get_by_role("button", name="Select by length").press("Enter")
    wait_for_text(page, "selection", "300 of 300 samples selected")
    page.get_by_label("Sample number").fill("42")
    page.get_by_role("button", name="Select sample").press("Enter")
    wait_for_text(page, "selection", "1 of 300 samples selected")
    page.get_by_label("Sample number").fill("4200")
    page.get_by_role("button", name="Select sample").press("Enter")
    page.get_by_text("Sample 4200 is not among the residuals").wait_for()


def test_excluding_a_sample_writes_a_line_of_the_session(page, served):
    click_row(page, 6, 300)
    page.get_by_role("button", name="Exclude selected samples").click()
    wait_for_text(page, "selection", "1 excluded")
    assert 'action = "exclude", kind = "samples", items = [7]' in served.session.read_text(
        encoding="utf-8"
    )


def test_excluding_the_poses_of_a_sample(page, served):
    click_row(page, 6, 300)
    page.get_by_role("button", name="Exclude their poses").click()
    page.wait_for_function(
        "() => !document.querySelector('[data-text=selection]').innerText.endsWith(' 0 excluded')"
    )
    assert 'kind = "poses", items = [7]' in served.session.read_text(encoding="utf-8")


def test_a_selected_sample_is_shown_in_the_recording(page):
    page.get_by_role("tab", name="Residuals").click()
    page.get_by_label("Sample number").fill("101")
    page.get_by_label("Sample number").press("Tab")
    page.get_by_role("button", name="Select sample").click()
    wait_for_text(page, "selection", "1 of 300")
    page.evaluate("() => window.scrollTo(0, 300)")
    page.get_by_role("button", name="Show in recording").click()
    assert "Sample 101" in wait_for_text(page, "row", "Sample 101")
    page.wait_for_function("() => window.scrollY === 0")  # another tab begins at its top


def test_scrubbing_moves_the_arm(page):
    scrub_by_key(page, "arm at the current sample")


def test_previous_and_next_sample_by_button(page):
    show_tab(page, "Recording")
    page.get_by_role("slider", name="Sample in the order of the recording").press("Home")
    wait_for_text(page, "row", "(1 of 300)")
    page.get_by_role("button", name="Next sample").press("Enter")
    wait_for_text(page, "row", "(2 of 300)")
    page.get_by_role("button", name="Previous sample").press("Enter")
    wait_for_text(page, "row", "(1 of 300)")


def test_coverage_shows_every_joint_and_the_workspace(page):
    show_tab(page, "Recording")
    titles = plot(page, "coverage").evaluate(
        "(element) => element.layout.annotations.map((one) => one.text)"
    )
    assert [title.partition(":")[0] for title in titles[:6]] == [f"joint {k}" for k in range(1, 7)]
    assert len(titles) == 8


def test_a_stage_is_excluded_and_the_change_undone_and_redone(page, served):
    show_tab(page, "Edit and rerun")
    box = page.get_by_role("checkbox", name=re.compile("^compliance "))
    box.click()
    page.locator("[data-change]", has_text="exclude 1 stage: compliance").wait_for()
    assert 'kind = "stages", items = ["compliance"]' in served.session.read_text(encoding="utf-8")
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("No changes yet.").wait_for()
    assert "compliance" not in served.session.read_text(encoding="utf-8")
    page.get_by_role("button", name="Redo").click()
    page.locator("[data-change]", has_text="compliance").wait_for()


def test_keys_undo_and_redo_a_change_whatever_tab_is_shown(page, served):
    show_tab(page, "Edit and rerun")
    page.get_by_role("checkbox", name=re.compile("^compliance ")).click()
    page.locator("[data-change]", has_text="compliance").wait_for()
    show_tab(page, "Residuals")
    page.keyboard.press("Control+z")
    show_tab(page, "Edit and rerun")
    page.get_by_text("No changes yet.").wait_for()
    page.keyboard.press("Control+Shift+z")
    page.locator("[data-change]", has_text="compliance").wait_for()
    page.keyboard.press("Control+z")
    page.get_by_text("No changes yet.").wait_for()
    page.keyboard.press("Control+y")
    page.locator("[data-change]", has_text="compliance").wait_for()


def test_an_effect_is_excluded(page, served):
    show_tab(page, "Edit and rerun")
    page.get_by_role("checkbox", name="joint-compliance at joint-3").click()
    page.locator("[data-change]", has_text="joint-compliance at joint-3").wait_for()
    assert 'kind = "effects", items = ["joint-compliance at joint-3"]' in served.session.read_text(
        encoding="utf-8"
    )


def test_the_outlier_threshold_is_dragged_and_applied(page):
    show_tab(page, "Edit and rerun")
    wait_for_text(page, "threshold", "0 samples have a residual above")
    slider = page.get_by_role("slider", name="Outlier threshold in mm")
    above = 0
    while above == 0:
        before = text_of(page, "threshold")
        slider.press("PageDown")
        page.wait_for_function(
            "(old) => document.querySelector('[data-text=threshold]').innerText !== old", arg=before
        )
        above = int(text_of(page, "threshold").split()[0])
    assert above < 300
    page.get_by_role("button", name="Exclude samples above").click()
    page.locator("[data-change]", has_text=f"exclude {above} sample").wait_for()


def test_a_recording_alone_is_opened_without_residuals(browser, tmp_path):
    made = serve("elastic-arm", tmp_path / "session")
    try:
        page = open_page(browser, made)
        assert "Sample 1 (1 of 300)" in wait_for_text(page, "row", "Sample 1")
        show_tab(page, "Residuals")
        page.get_by_text("This run has no residuals of an arm").wait_for()
        page.close()
    finally:
        stop(made)


def test_text_of_the_data_is_shown_and_never_run(browser, tmp_path):
    from dataclasses import replace

    import datasets

    title = "<img src=x onerror=window.pwned=1>{{ constructor.constructor('window.pwned=1')() }}"
    found = datasets.read("elastic-arm")
    datasets.write(replace(found, title=title), tmp_path / "recording")
    made = serve(tmp_path / "recording", tmp_path / "session")
    try:
        page = open_page(browser, made)
        wait_for_text(page, "row", "Sample 1")
        assert page.get_by_role("heading", level=1).inner_text() == title
        assert page.evaluate("() => window.pwned") is None
        page.close()
    finally:
        stop(made)


def test_the_sensor_tab_of_an_arm_without_a_sensor_says_what_to_open(page):
    show_tab(page, "Sensor")
    page.get_by_text("This run has no camera and no scanner. Open a run of").wait_for()
    assert page.locator("[data-tab=sensor] [data-figure]").count() == 0


def test_no_script_error_occurred(shared):
    assert shared.problems == []
