"""Excluded samples: listed with why and residual, also those that a rerun left out, and included again."""

from dataclasses import replace

import numpy as np
import pytest

import datasets
from app_browser import opened_app, show_tab, wait_for_text
from workbench.app.data.opened import open_subject
from workbench.app.data.prediction import lengths_by_number, predicted_lengths
from workbench.app.edits.changes import EXCLUDE, INCLUDE, POSES, SAMPLES, Change
from workbench.app.edits.excluded import excluded_items
from workbench.app.edits.session import Session, read_session
from workbench.app.workspace import Workspace
from workbench.core.errors import InputError
from workbench.core.solution import Stage

LEFT_OUT = (7, 42)
STAGES = (Stage("frames", "base and tool", free=("base.*", "sensor.*"), earn=False),)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of the bundled arm that two samples are excluded from, with its session."""
    from workbench.commands.robot.calibration_run import solve_into

    folder = tmp_path_factory.mktemp("run")
    whole = datasets.read("elastic-arm")
    kept = whole.select(~np.isin(whole.sample_ids, LEFT_OUT))
    options = {"plan": STAGES, "folds": 3}
    solve_into(folder, folder, kept, "elastic-arm", options, lambda text: None, False)
    change = Change(EXCLUDE, SAMPLES, LEFT_OUT, "residual above 0.2 mm")
    Session("elastic-arm", changes=(change,)).save(folder / "session.toml")
    return folder


@pytest.fixture
def work(folder, tmp_path):
    return Workspace(open_subject(str(folder)), tmp_path / "session" / "session.toml")


def test_samples_that_a_rerun_left_out_are_listed_with_the_reason(work):
    assert work.count == 298 and work.excluded_outside_run == 2
    assert [(one.kind, one.number, one.why) for one in work.excluded_items] == [
        (SAMPLES, 7, "residual above 0.2 mm"),
        (SAMPLES, 42, "residual above 0.2 mm"),
    ]


def test_the_model_of_the_run_predicts_their_residuals(work):
    whole = predicted_lengths(work.opened)
    assert len(whole) == 300
    fitted = [whole[number] for number in work.opened.residuals.sample]
    assert np.allclose(fitted, work.opened.residuals.lengths["fit"], atol=1e-4)
    assert work.lengths_of(work.excluded_items) == [whole[7], whole[42]]


def test_residuals_of_samples_of_the_run_need_no_prediction(work):
    row = int(np.argmax(work.lengths()))
    number = int(work.opened.edit_ids[row])
    assert lengths_by_number(work.opened, [number, 7]) == {number: work.lengths()[row]}


def test_a_run_without_a_model_predicts_nothing(work):
    assert predicted_lengths(replace(work.opened, answer={"command": "diagnose"})) == {}
    assert predicted_lengths(open_subject("elastic-arm")) == {}


def test_a_sample_of_the_list_is_included_and_the_change_undone(work):
    work.include_item(SAMPLES, 7)
    assert work.session.excluded(SAMPLES) == {42}
    assert read_session(work.path).changes[-1] == Change(INCLUDE, SAMPLES, (7,))
    work.undo()
    assert [one.number for one in work.excluded_items] == [7, 42]
    work.include_sample(42)
    work.include_all()
    assert work.excluded_items == [] and work.excluded_outside_run == 0
    for act in (work.include_all, lambda: work.include_sample(42)):
        with pytest.raises(InputError, match="nothing to include"):
            act()


def test_selecting_a_sample_that_was_left_out_says_what_to_do(work):
    with pytest.raises(InputError, match="Sample 42 is excluded .* include it"):
        work.select_sample(42)
    with pytest.raises(InputError, match="correct the number"):
        work.select_sample(4200)


def test_a_pose_is_one_item_whichever_of_its_samples_name_it():
    recording = _recording(ids=[1, 2, 3, 4, 5], poses=[10, 10, 10, 11, 11])
    changes = (
        Change(EXCLUDE, POSES, (3,), "first"),
        Change(EXCLUDE, POSES, (1, 5), "second"),
        Change(EXCLUDE, SAMPLES, (4,), "third"),
    )
    found = excluded_items(Session("any", changes=changes), recording)
    assert [(one.kind, one.numbers, one.samples, one.why) for one in found] == [
        (SAMPLES, (4,), (4,), "third"),
        (POSES, (1, 3), (1, 2, 3), "second"),
        (POSES, (5,), (4, 5), "second"),
    ]


def _recording(ids, poses):
    class Recording:
        sample_ids, poses = np.array([1]), np.array([1])

    found = Recording()
    found.sample_ids, found.poses = np.array(ids), np.array(poses)
    return found


def test_selected_samples_are_included_with_their_excluded_poses(work):
    number = int(work.opened.edit_ids[10])
    work.select([10])
    work.exclude_poses()
    assert not work.kept[10]
    work.select([10])
    work.include_selected()
    assert work.kept[10] and work.session.excluded(POSES) == frozenset()
    assert work.session.changes[-1] == Change(INCLUDE, POSES, (number,))
    work.select([10])
    with pytest.raises(InputError, match="nothing to include"):
        work.include_selected()


@pytest.fixture(scope="module")
def page(browser, folder, tmp_path_factory):
    with opened_app(browser, folder, tmp_path_factory.mktemp("session")) as page:
        yield page


@pytest.mark.slow
@pytest.mark.parametrize("tab", ["Residuals", "Recording"])
def test_the_page_lists_excluded_samples_and_includes_one(page, tab):
    show_tab(page, tab)
    wait_for_text(page, "excluded", "2 samples excluded")
    table = page.get_by_role("group", name="Excluded samples")
    row = table.locator("tbody tr", has_text="sample 42")
    row.wait_for()
    assert "residual above 0.2 mm" in row.inner_text()
    assert float(row.locator("td").nth(2).inner_text()) > 0
    row.get_by_role("button", name="Include sample 42").press("Enter")
    wait_for_text(page, "excluded", "1 sample excluded")
    assert 'action = "include", kind = "samples", items = [42]' in page.served.session.read_text(
        encoding="utf-8"
    )
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Undo").click()
    page.locator("[data-change]", has_text="include").wait_for(state="detached")
    show_tab(page, tab)
    wait_for_text(page, "excluded", "2 samples excluded")


@pytest.mark.slow
def test_an_excluded_sample_is_included_by_its_number(page):
    show_tab(page, "Residuals")
    page.get_by_role("textbox", name="Number to include").fill("8")
    page.get_by_role("button", name="Include sample", exact=True).click()
    page.get_by_text("there is nothing to include").wait_for()
    page.get_by_role("textbox", name="Number to include").fill("7")
    page.get_by_role("button", name="Include sample", exact=True).click()
    wait_for_text(page, "excluded", "1 sample excluded")
    page.get_by_role("button", name="Include all").click()
    page.locator("[data-tab=residuals] [data-text=excluded]").wait_for(state="detached")
    wait_for_text(page, "selection", "; 0 excluded")
    assert page.problems == []
