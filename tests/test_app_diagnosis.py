"""The tab Diagnosis in a browser: of an arm, and of the images of a scanner."""

import pytest

from app_browser import (
    emit,
    opened_app,
    plot,
    show_tab,
    text_of,
    trace,
    wait_for_text,
    wait_until_drawn,
)
from app_diagnosis import write_diagnosis, write_image_diagnosis

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def diagnosis(browser, tmp_path_factory):
    folder = tmp_path_factory.mktemp("diagnosis")
    run = write_diagnosis(folder / "run")
    with opened_app(browser, run, folder / "session", "Diagnosis") as page:
        yield page


def test_the_chain_shows_the_share_of_the_mismatch_at_each_place(diagnosis):
    assert "Explained: held-out RMS error 0.117 mm before, 0.039 mm after" in text_of(
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


def test_poses_of_the_next_experiment_are_numbered_listed_and_downloaded(diagnosis):
    show_tab(diagnosis, "Diagnosis")
    texts = plot(diagnosis, "next").evaluate("(one) => Array.from(one._fullData[1].text)")
    assert texts == ["<b>1</b>", "<b>2</b>"]
    table = diagnosis.get_by_role("group", name="Joint readings of the next poses")
    assert "joint 1 (deg)" in table.inner_text()
    assert table.locator("tbody tr").nth(1).inner_text().split()[:3] == ["2", "-30.00", "10.00"]
    with diagnosis.expect_download() as download:
        diagnosis.get_by_role("link", name="Download as CSV").click()
    text = download.value.path().read_text(encoding="utf-8")
    assert text.splitlines()[2] == "-30,10,-20,15,-70,40"


def test_poses_of_the_next_experiment_are_copied(diagnosis):
    show_tab(diagnosis, "Diagnosis")
    diagnosis.context.grant_permissions(["clipboard-read", "clipboard-write"])
    diagnosis.get_by_role("button", name="Copy the poses as CSV").press("Enter")
    copied = diagnosis.evaluate("() => navigator.clipboard.readText()")
    assert copied.splitlines()[1] == "1,10,20,-10,5,-60,0"


def test_ticked_terms_join_the_plan(diagnosis):
    diagnosis.get_by_role("checkbox", name="joint-compliance at joint-2").click()
    diagnosis.get_by_role("button", name="Add ticked terms to the plan").click()
    diagnosis.get_by_text("Added to the plan").wait_for()
    assert (
        '{ effect = "joint-compliance", where = "joint-2" }'
        in diagnosis.served.session.read_text(encoding="utf-8")
    )
    assert "joint-compliance" in (diagnosis.served.folder / "plan.toml").read_text(encoding="utf-8")


def test_all_tabs_are_drawn_with_terms_in_the_plan(diagnosis):
    for tab in ("Residuals", "Edit and rerun", "Recording"):
        show_tab(diagnosis, tab)
        wait_until_drawn(diagnosis)
        assert diagnosis.get_by_text("This is a bug").count() == 0
    show_tab(diagnosis, "Residuals")
    assert sum(trace(diagnosis, "histogram", "after")["y"]) == 300
    show_tab(diagnosis, "Diagnosis")


@pytest.fixture(scope="module")
def of_images(browser, scanner_run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    run = write_image_diagnosis(folder / "run", scanner_run)
    with opened_app(browser, run, folder / "session", "Diagnosis") as page:
        yield page


def test_the_chain_of_a_scanner_holds_no_part_of_the_arm(of_images):
    names = plot(of_images, "chain").evaluate("(one) => Array.from(one._fullData[1].customdata)")
    assert names == ["artefact", "camera", "laser"]
    assert "artefact: 70 %" in text_of(of_images, "place")
    assert "held-out RMS 0.0154 px" in of_images.inner_text("header")


def test_residuals_of_images_are_counted_before_and_after(of_images):
    before, after = (trace(of_images, "before_after", name) for name in ("before", "after"))
    assert sum(before["y"]) == sum(after["y"]) == 400
    assert of_images.get_by_role("combobox", name="Horizontal axis").count() == 0


def test_a_click_on_a_place_of_the_scanner_shows_its_candidates_and_evidence(of_images):
    emit(of_images, "chain", "plotly_click", {"points": [{"customdata": "camera"}]})
    wait_for_text(of_images, "place", "camera: 8 %")
    emit(of_images, "chain", "plotly_click", {"points": [{"customdata": "artefact"}]})
    wait_for_text(of_images, "place", "artefact: 70 %")
    of_images.get_by_role("group", name="Candidates at this place").get_by_text("kept").wait_for()
    assert "< 1e-6" in of_images.get_by_role("group", name="Evidence").inner_text()


def test_a_diagnosis_of_a_scanner_without_a_next_experiment_shows_no_empty_table(of_images):
    assert of_images.locator("[data-figure=next]").count() == 0
    assert of_images.get_by_role("group", name="Joint readings of the next poses").count() == 0


def test_a_term_that_no_plan_can_hold_is_named_and_cannot_be_ticked(of_images):
    of_images.get_by_text(
        "board-bow at artefact: the plan of a calibration holds effects"
    ).wait_for()
    assert of_images.get_by_role("checkbox").count() == 0
