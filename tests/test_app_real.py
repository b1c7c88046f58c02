"""The app in a browser on a real arm that a laser tracker measured (irb120_faro); skipped where it is absent."""

import pytest

from app_browser import (
    brush_chart,
    calibrate_arm,
    click_bin,
    click_row,
    drawn_rows,
    opened_app,
    run_workbench,
    scrub_by_key,
    show_tab,
    text_of,
    trace,
    wait_for_text,
)

pytestmark = pytest.mark.slow
NAME = "irb120_faro"
PLAN = """
[[stage]]
name = "geometry"
why = "base, reflectors, and lengths and angles of the arm"
free = ["base.*", "tool.*", "joint-*.theta*", "joint-*.a*"]
earn = false
"""


@pytest.fixture(scope="module")
def page(browser, real, tmp_path_factory):
    real(NAME)
    run = calibrate_arm(NAME, tmp_path_factory.mktemp("real"), PLAN)
    with opened_app(browser, run, tmp_path_factory.mktemp("session")) as page:
        yield page


@pytest.fixture(scope="module")
def served(page):
    return page.served


def count_of(page) -> int:
    """Number of samples that the status line of the selection names."""
    return int(text_of(page, "selection").partition(" of ")[2].split()[0].replace(",", ""))


def test_arrows_clicks_and_brushes_select_samples(page):
    show_tab(page, "Residuals")
    wait_for_text(page, "selection", "0 of")
    samples = count_of(page)
    drawn = drawn_rows(page)
    assert 1000 < len(drawn) <= min(samples, 1500) and len(set(drawn)) == len(drawn)
    click_row(page, 7, samples)
    brush_chart(page)
    wait_for_text(page, "selection", f"{samples:,} of {samples:,} samples selected")
    bars = trace(page, "histogram", "held out")
    place = max(k for k, count in enumerate(bars["y"]) if count)  # of one or few samples
    click_bin(page, place)
    wait_for_text(page, "selection", f"{bars['y'][place]:,} of {samples:,} samples selected")
    page.get_by_role("heading", name="Sample").wait_for()
    pose = page.get_by_role("group", name="Selected samples").locator("tbody td").nth(1)
    row = page.get_by_role("group", name="Row of the sample").locator("tr", has_text="pose")
    assert row.locator("td").nth(1).inner_text() == pose.inner_text()


def test_arm_reflectors_and_instrument_are_drawn_and_move(page):
    show_tab(page, "Recording")
    for name in ("arm at the current sample", "reflectors", "frame of the instrument"):
        assert trace(page, "scene", name), name
    scrub_by_key(page, "current sample")  # the first samples share one pose


def test_a_session_is_repeated_from_the_command_line(page, served, tmp_path):
    show_tab(page, "Residuals")
    page.get_by_label("Sample number").fill("1")
    page.get_by_role("button", name="Select sample").click()
    wait_for_text(page, "selection", "1 of")
    page.get_by_role("button", name="Exclude selected samples").click()
    wait_for_text(page, "selection", "1 excluded")
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate").click()
    wait_for_text(page, "job", "Finished after", 300_000)
    table = page.get_by_role("group", name="Before and after").inner_text()
    assert "held-out RMS (mm)" in table
    words = ["--session", served.session, "--out", tmp_path / "again", "--no-report"]
    run_workbench("calibrate", *words, cwd=tmp_path)
    (newest,) = served.folder.glob("calibrate-*")
    for name in ("residuals.csv", "parameters.toml", "residual-arrows.parquet"):
        assert (newest / name).read_bytes() == (tmp_path / "again" / name).read_bytes(), name


def test_no_script_error_occurred(page):
    assert page.problems == []
