"""Keyboard and contrast of every tab of the app, on runs of an arm, of a scanner, of a diagnosis and of a hand-eye calibration."""

import pytest

from app_access import CONTRAST, KINDS_OF_BUTTONS, missed_controls
from app_browser import (
    TABS,
    click_row,
    emit,
    opened_app,
    plot,
    show_tab,
    wait_for_text,
    wait_until_drawn,
)
from app_diagnosis import write_diagnosis

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["arm", "scanner", "diagnosis", "hand_eye"])
def page(request, browser, tmp_path_factory):
    """A page of each kind of run with a selected sample, so that no control is disabled for want of one."""
    folder = tmp_path_factory.mktemp(request.param)
    run = (
        write_diagnosis(folder / "run")
        if request.param == "diagnosis"
        else request.getfixturevalue(f"{request.param}_run")
    )
    with opened_app(browser, run, folder / "session", "Residuals") as page:
        if request.param == "hand_eye":
            emit(page, "pose_errors", "plotly_click", {"points": [{"customdata": 1}]})
            wait_for_text(page, "selection", "1 of 14 samples selected")
        elif request.param != "diagnosis":  # it does not hold the positions of its residuals
            click_row(page, 1, 30 if request.param == "scanner" else 300)
        page.chart = "pose_errors" if request.param == "hand_eye" else "chart"
        yield page


@pytest.mark.parametrize("tab", TABS)
def test_every_control_is_reached_by_the_tabulator_key(page, tab):
    show_tab(page, tab)
    wait_until_drawn(page)
    assert missed_controls(page) == []


def test_the_arrow_keys_open_every_tab(page):
    show_tab(page, TABS[0])
    page.get_by_role("tab", name=TABS[0], exact=True).focus()
    for tab in TABS[1:]:
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
        page.locator(f"[data-tab={tab.partition(' ')[0].lower()}]").wait_for()


@pytest.mark.parametrize("tab", TABS)
def test_text_has_a_contrast_of_at_least_4_5(page, tab):
    show_tab(page, tab)
    wait_until_drawn(page)
    assert page.evaluate(CONTRAST) == []


def test_text_below_the_mouse_has_a_contrast_of_at_least_4_5(page):
    """One enabled control of each kind: the mouse lays a veil over it."""
    show_tab(page, "Residuals")
    wait_until_drawn(page)
    kinds = page.evaluate(KINDS_OF_BUTTONS)
    assert len(kinds) >= 3
    for kind in kinds:
        button = page.locator(f"[data-kind='{kind}']")
        button.hover()
        page.wait_for_function(
            "(kind) => document.querySelector(`[data-kind='${kind}']`).matches(':hover')", arg=kind
        )
        assert page.evaluate(CONTRAST) == [], kind


def test_disabled_controls_are_readable_too(page):
    show_tab(page, "Edit and rerun")
    wait_until_drawn(page)
    assert page.locator("button[disabled]:visible").count() >= 2  # Redo and Cancel
    assert page.evaluate(CONTRAST) == []


def test_text_in_figures_has_a_contrast_of_at_least_4_5(page):
    show_tab(page, "Residuals")
    colours = plot(page, page.chart).evaluate(
        "(one) => Array.from(one.querySelectorAll('text')).map((text) => getComputedStyle(text).fill)"
    )
    assert colours and set(colours) <= {"rgb(27, 31, 36)"}


@pytest.mark.parametrize("tab", TABS)
def test_nothing_is_cut_off_in_a_window_of_800_px(page, tab):
    page.set_viewport_size({"width": 800, "height": 900})
    show_tab(page, tab)
    wait_until_drawn(page)
    widest = page.evaluate("() => document.documentElement.scrollWidth")
    last = page.get_by_role("tab", name=TABS[-1], exact=True).bounding_box()
    page.set_viewport_size({"width": 1400, "height": 900})
    assert widest <= 800 and last["x"] + last["width"] <= 800
