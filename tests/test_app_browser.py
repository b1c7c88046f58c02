"""The app in a browser: what is clicked, brushed, edited and run again on the bundled arm."""

import re

import pytest

from app_browser import (
    PLAN,
    chromium,
    emit,
    open_page,
    plot,
    run_workbench,
    serve,
    show_tab,
    stop,
    text_of,
    trace,
    wait_for_text,
    write_diagnosis,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser():
    started, browser = chromium()
    yield browser
    browser.close()
    started.stop()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    folder = tmp_path_factory.mktemp("app")
    (folder / "plan.toml").write_text(PLAN, encoding="utf-8")
    run_workbench(
        "calibrate",
        "elastic-arm",
        "--plan",
        folder / "plan.toml",
        "--folds",
        3,
        "--out",
        folder / "run",
        cwd=folder,
    )
    made = serve(folder / "run", folder / "session")
    yield made
    stop(made)


@pytest.fixture(scope="module")
def shared(browser, served):
    """One page for all tests that follow one another; its problems fail the last test."""
    page = open_page(browser, served)
    page.problems = []
    page.on("pageerror", lambda error: page.problems.append(str(error)))
    yield page
    page.close()


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
    shared.get_by_role("button", name="Clear selection").click()
    wait_for_text(shared, "selection", "0 of 300 samples selected; 0 excluded")
    return shared


def test_nothing_is_loaded_from_another_host(browser, served):
    page = browser.new_page()
    foreign = []
    page.on("request", lambda request: foreign.append(request.url))
    page.goto(served.address)
    page.get_by_role("tab", name="Recording").wait_for(timeout=90_000)
    local = (served.origin, "data:", "blob:", served.origin.replace("http", "ws"))
    assert [url for url in foreign if not url.startswith(local)] == []
    page.close()


def test_the_bar_names_recording_and_error(page):
    assert "Elastic arm, four balls" in page.get_by_role("heading", level=1).inner_text()
    assert re.search(
        r"300 samples · held-out RMS 0\.\d+ mm · run of calibrate", page.inner_text("header")
    )


def test_arrows_are_drawn_for_all_samples_with_their_rows(page):
    marks = trace(page, "arrows", "measured points")
    assert marks["customdata"] == list(range(300))


def test_arrows_are_coloured_by_the_length_of_the_residual(page):
    colours = plot(page, "arrows").evaluate(
        "(element) => Array.from(element._fullData.find((one) => one.name === 'residual').line.color)"
    )
    assert len(colours) == 900 and max(colours) > 2 * min(colours) > 0


def test_a_click_on_an_arrow_selects_its_sample_and_shows_its_row(page):
    emit(page, "arrows", "plotly_click", {"points": [{"customdata": 17}]})
    wait_for_text(page, "selection", "1 of 300 samples selected")
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
    page.mouse.move(x, y, steps=4)
    page.wait_for_timeout(300)
    page.mouse.click(x, y)
    wait_for_text(page, "selection", "1 of 300 samples selected")


def test_a_brush_over_the_whole_chart_selects_every_sample(page):
    box = plot(page, "chart").locator(".nsewdrag").first.bounding_box()
    page.mouse.move(box["x"] + 2, box["y"] + 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] - 2, box["y"] + box["height"] - 2, steps=6)
    page.mouse.up()
    wait_for_text(page, "selection", "300 of 300 samples selected")


def test_a_real_click_on_a_bar_selects_its_samples(page):
    bars = trace(page, "histogram", "held out")
    place = max(range(len(bars["y"])), key=lambda k: bars["y"][k])
    x, y = plot(page, "histogram").evaluate(
        """(element, [x, y]) => { const layout = element._fullLayout, box = element.getBoundingClientRect();
            return [box.left + layout.xaxis._offset + layout.xaxis.c2p(x), box.top + layout.yaxis._offset + layout.yaxis.c2p(y / 2)]; }""",
        [bars["x"][place], bars["y"][place]],
    )
    page.mouse.move(x, y, steps=4)
    page.wait_for_timeout(300)
    page.mouse.click(x, y)
    wait_for_text(page, "selection", f"{bars['y'][place]} of 300 samples selected")


def test_the_histogram_overlays_fit_and_held_out(page):
    fit, held_out = (trace(page, "histogram", name) for name in ("fit", "held out"))
    assert sum(fit["y"]) == sum(held_out["y"]) == 300


def test_extending_and_removing_from_a_selection(page):
    for mode, count in (("replace", 1), ("extend", 2), ("remove", 1)):
        page.get_by_label("Clicks and brushes").press("Enter")
        page.get_by_role("option", name=mode).click()
        row = {"replace": 3, "extend": 5, "remove": 3}[mode]
        emit(page, "arrows", "plotly_click", {"points": [{"customdata": row}]})
        wait_for_text(page, "selection", f"{count} of 300 samples selected")
    page.get_by_label("Clicks and brushes").press("Enter")
    page.get_by_role("option", name="replace").click()


def test_the_chart_can_show_any_covariate(page):
    page.get_by_role("combobox", name="Over").focus()
    page.keyboard.type("payload")
    page.wait_for_function(
        "() => document.querySelector('[data-figure=chart] .js-plotly-plot').layout.xaxis.title.text === 'payload_kg'"
    )
    assert (
        set(trace(page, "chart", "samples")["x"]) == {0, 1, 2}
        or len(trace(page, "chart", "samples")["x"]) == 300
    )


def test_samples_are_selected_by_length_and_number_without_a_mouse(page):
    page.get_by_label("Residual from (mm)").fill("0")
    page.get_by_label("to (mm)").fill("1000")
    page.get_by_role("button", name="Select lengths").press("Enter")
    wait_for_text(page, "selection", "300 of 300 samples selected")
    page.get_by_label("Sample number").fill("42")
    page.get_by_role("button", name="Select sample").press("Enter")
    wait_for_text(page, "selection", "1 of 300 samples selected")
    page.get_by_label("Sample number").fill("4200")
    page.get_by_role("button", name="Select sample").press("Enter")
    page.get_by_text("Sample 4200 is not among the residuals").wait_for()


def test_excluding_a_sample_writes_a_line_of_the_session(page, served):
    emit(page, "arrows", "plotly_click", {"points": [{"customdata": 6}]})
    wait_for_text(page, "selection", "1 of 300")
    page.get_by_role("button", name="Exclude selected samples").click()
    wait_for_text(page, "selection", "1 excluded")
    assert 'action = "exclude", kind = "samples", items = [7]' in served.session.read_text(
        encoding="utf-8"
    )


def test_excluding_the_poses_of_a_sample(page, served):
    emit(page, "arrows", "plotly_click", {"points": [{"customdata": 6}]})
    wait_for_text(page, "selection", "1 of 300")
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
    page.get_by_role("button", name="Show in recording").click()
    assert "Sample 101" in wait_for_text(page, "row", "Sample 101")


def test_scrubbing_moves_the_arm(page):
    show_tab(page, "Recording")
    before = trace(page, "scene", "arm at the current sample")
    text = text_of(page, "row")
    page.get_by_role("slider", name="Sample in the order of the recording").press("ArrowRight")
    page.wait_for_function(
        "(old) => document.querySelector('[data-text=row]').innerText !== old", arg=text
    )
    page.wait_for_function(
        """(old) => JSON.stringify(Array.from(document.querySelector('[data-figure=scene] .js-plotly-plot')._fullData
            .find((one) => one.name === 'arm at the current sample').x)) !== JSON.stringify(old)""",
        arg=before["x"],
    )


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


TABS = ["Recording", "Residuals", "Edit and rerun", "Sensor", "Diagnosis", "Import"]


@pytest.mark.parametrize("tab", TABS)
def test_every_control_is_reached_by_the_tabulator_key(page, tab):
    show_tab(page, tab)
    page.wait_for_timeout(1500)
    wanted = page.evaluate(
        """() => Array.from(document.querySelectorAll('button, input, a, [role=tab], [role=slider], [tabindex="0"]'))
            .filter((one) => one.offsetParent && !one.disabled && one.getAttribute('aria-hidden') !== 'true'
                && getComputedStyle(one).visibility !== 'hidden')
            .map((one, k) => { one.dataset.control = k; return k; })"""
    )
    page.evaluate("() => { document.activeElement.blur(); document.body.focus(); }")
    reached = set()
    for _ in range(4 * len(wanted) + 20):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("() => document.activeElement.dataset.control"))
        if len(reached) > len(wanted):
            break
    # Of a group of tabs the chosen one takes the focus; arrow keys move it to the others.
    tabs = page.evaluate(
        "() => Array.from(document.querySelectorAll('[role=tab]')).map((one) => one.dataset.control)"
    )
    missed = {str(k) for k in wanted} - reached - set(tabs)
    names = page.evaluate(
        "(keys) => keys.map((k) => document.querySelector(`[data-control='${k}']`).outerHTML.slice(0, 200))",
        sorted(missed),
    )
    assert not missed, names
    assert reached & set(tabs)


CONTRAST = """() => {
    const channel = (v) => (v / 255 <= 0.04045 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4);
    const luminance = (c) => 0.2126 * channel(c[0]) + 0.7152 * channel(c[1]) + 0.0722 * channel(c[2]);
    const parse = (text) => { const n = (text.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number); return n.length < 4 ? [...n, 1] : n; };
    const over = (top, under) => [0, 1, 2].map((k) => top[k] * top[3] + under[k] * (1 - top[3]));
    const ground = (element) => {
        const layers = [];
        for (let e = element; e; e = e.parentElement) layers.push(parse(getComputedStyle(e).backgroundColor));
        return layers.reverse().reduce((under, top) => over(top, under), [255, 255, 255]);
    };
    const opacity = (element) => { let o = 1; for (let e = element; e; e = e.parentElement) o *= getComputedStyle(e).opacity; return o; };
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    for (let node = walker.nextNode(); node; node = walker.nextNode()) {
        const element = node.parentElement;
        if (!node.textContent.trim() || !element.offsetParent || element.closest('[disabled], .v-btn--disabled, .js-plotly-plot, style, script')) continue;
        const style = getComputedStyle(element);
        if (style.visibility === 'hidden' || style.display === 'none' || opacity(element) < 0.05) continue;
        const colour = parse(style.color), back = ground(element);
        const ink = over([colour[0], colour[1], colour[2], colour[3] * opacity(element)], back);
        const [a, b] = [luminance(ink), luminance(back)].sort((x, y) => y - x);
        const ratio = (a + 0.05) / (b + 0.05);
        if (ratio < 4.5) found.push(`${node.textContent.trim().slice(0, 40)}: ${ratio.toFixed(2)}`);
    }
    return found;
}"""


@pytest.mark.parametrize("tab", TABS)
def test_text_has_a_contrast_of_at_least_4_5(page, tab):
    show_tab(page, tab)
    page.wait_for_timeout(800)
    assert page.evaluate(CONTRAST) == []


def test_text_in_figures_has_a_contrast_of_at_least_4_5(page):
    colours = plot(page, "chart").evaluate(
        "(element) => Array.from(element.querySelectorAll('text')).map((one) => getComputedStyle(one).fill)"
    )
    assert colours and set(colours) <= {"rgb(27, 31, 36)"}


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


def test_a_rerun_shows_before_and_after_and_the_command_line_repeats_it(page, served, tmp_path):
    import json

    show_tab(page, "Edit and rerun")
    page.get_by_role("checkbox", name="joint-compliance at joint-3").click()
    page.locator("[data-change]", has_text="joint-compliance at joint-3").wait_for()
    page.get_by_role("button", name="Calibrate").click()
    wait_for_text(page, "job", "Finished after", 300_000)
    page.get_by_role("group", name="Before and after").wait_for()
    run_workbench(
        "calibrate",
        "--session",
        served.session,
        "--out",
        tmp_path / "again",
        "--no-report",
        cwd=tmp_path,
    )
    newest = max(served.folder.glob("calibrate-*"), key=lambda path: path.stat().st_mtime)
    for name in ("residuals.csv", "parameters.toml", "residual-arrows.parquet"):
        assert (newest / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name
    answers = [
        json.loads((folder / "answer.json").read_text()) for folder in (newest, tmp_path / "again")
    ]
    for answer in answers:
        answer.pop("run")
        answer["provenance"].pop("date")
    assert answers[0] == answers[1]


def test_a_rerun_can_be_cancelled_and_leaves_nothing(page, served):
    show_tab(page, "Edit and rerun")
    before = set(served.folder.iterdir())
    page.get_by_role("button", name="Calibrate").click()
    page.get_by_role("button", name="Cancel").click()
    wait_for_text(page, "job", "Cancelled", 60_000)
    assert set(served.folder.iterdir()) == before


def test_a_refused_rerun_says_why(page, served):
    page.get_by_label("Residual from (mm)").fill("0")
    page.get_by_label("to (mm)").fill("1000")
    page.get_by_role("button", name="Select lengths").click()
    wait_for_text(page, "selection", "300 of 300")
    page.get_by_role("button", name="Exclude selected samples").click()
    wait_for_text(page, "selection", "300 excluded")
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate").click()
    assert "all 300 samples are excluded" in wait_for_text(page, "job", "The run failed", 120_000)


def test_no_script_error_occurred(shared):
    assert shared.problems == []


@pytest.fixture(scope="module")
def diagnosis(browser, tmp_path_factory):
    folder = tmp_path_factory.mktemp("diagnosis")
    made = serve(write_diagnosis(folder / "run"), folder / "session")
    page = open_page(browser, made, "Diagnosis")
    page.served = made
    yield page
    page.close()
    stop(made)


def test_the_chain_shows_the_share_of_the_mismatch_at_each_place(diagnosis):
    assert "explained: held-out RMS error 0.117 mm before, 0.039 mm after" in text_of(
        diagnosis, "verdict"
    )
    names = plot(diagnosis, "chain").evaluate(
        "(element) => Array.from(element._fullData[1].customdata)"
    )
    assert names[:3] == ["base", "joint-1", "link-1"]
    assert "joint-2: 59 %" in text_of(diagnosis, "place")


def test_a_click_on_a_place_shows_its_candidates_and_evidence(diagnosis):
    emit(diagnosis, "chain", "plotly_click", {"points": [{"customdata": "joint-5"}]})
    wait_for_text(diagnosis, "place", "joint-5")
    table = diagnosis.get_by_role("group", name="Candidates at this place")
    table.get_by_text("the held-out error does not fall").wait_for()
    emit(diagnosis, "chain", "plotly_click", {"points": [{"customdata": "joint-2"}]})
    wait_for_text(diagnosis, "place", "joint-2")
    table.get_by_text("link-compliance").wait_for()
    evidence = diagnosis.get_by_role("group", name="Evidence").inner_text()
    assert "< 1e-6" in evidence and "9 of 9" in evidence


def test_residuals_before_and_after_and_the_next_poses_are_drawn(diagnosis):
    assert len(trace(diagnosis, "before_after", "after")["x"]) == 300
    assert trace(diagnosis, "next", "2 poses to measure")


def test_ticked_terms_join_the_plan(diagnosis):
    diagnosis.get_by_role("checkbox", name="joint-compliance at joint-2").click()
    diagnosis.get_by_role("button", name="Add ticked terms to the plan").click()
    diagnosis.get_by_text("1 effects were added to the plan").wait_for()
    assert (
        '{ effect = "joint-compliance", where = "joint-2" }'
        in diagnosis.served.session.read_text(encoding="utf-8")
    )
    assert "joint-compliance" in (diagnosis.served.folder / "plan.toml").read_text(encoding="utf-8")
