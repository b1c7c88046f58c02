"""The app where something is unusual: two pages, small and read-only data."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app_browser import open_page, serve, show_tab, stop, text_of, wait_for_text, wait_until_drawn

pytestmark = pytest.mark.slow


@pytest.fixture
def served(arm_run, tmp_path):
    made = serve(arm_run, tmp_path / "session")
    yield made
    stop(made)


def test_two_pages_show_the_same_edits(browser, served):
    first, second = (open_page(browser, served, "Edit and rerun") for _ in range(2))
    first.get_by_role("checkbox", name="joint-compliance at joint-3").click()
    second.locator("[data-change]", has_text="joint-compliance at joint-3").wait_for()
    second.get_by_role("button", name="Undo").click()
    first.get_by_text("No changes yet.").wait_for()
    first.close()
    second.close()


def _elastic(folder: Path, **changes) -> Path:
    import datasets

    datasets.write(replace(datasets.read("elastic-arm"), **changes), folder)
    return folder


def test_three_samples_are_shown_and_what_cannot_be_calibrated_is_said(browser, tmp_path):
    import datasets

    found = datasets.read("elastic-arm")
    folder = tmp_path / "three"
    datasets.write(found.select(np.arange(found.n) < 3), folder)
    made = serve(folder, tmp_path / "session")
    page = open_page(browser, made)
    assert "Sample 1 (1 of 3)" in wait_for_text(page, "row", "Sample 1")
    for tab in ("Residuals", "Sensor", "Diagnosis", "Edit and rerun"):
        show_tab(page, tab)
        wait_until_drawn(page)
    page.get_by_role("button", name="Calibrate").click()
    wait_for_text(page, "job", "The run failed", 120_000)
    assert "bug" not in text_of(page, "job")
    page.close()
    stop(made)


def test_missing_images_are_named_and_the_rest_works(browser, tmp_path):
    rows = tuple({"image": f"images/{k}.png", "role": "board", "sample": k} for k in (1, 2))
    folder = _elastic(tmp_path / "recording", title="arm")
    import datasets

    found = datasets.read(folder)
    (folder / "images").mkdir()
    lines = ["image,role,sample"] + [f"{row['image']},board,{row['sample']}" for row in rows]
    (folder / "images.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert found.n == 300
    made = serve(folder, tmp_path / "session")
    page = open_page(browser, made)
    wait_for_text(page, "row", "Sample 1")
    if page.locator("[data-text=image]").count():
        wait_for_text(page, "image", "expected a file in the recording's folder")
    page.get_by_role("button", name="Next sample").click()
    wait_for_text(page, "row", "(2 of 300)")
    page.close()
    stop(made)


def test_a_renamed_recording_is_named_and_can_be_given_again(tmp_path, workbench, arm_run):
    folder = _elastic(tmp_path / "recording")
    copy = tmp_path / "run"
    shutil.copytree(arm_run, copy)
    answer = json.loads((copy / "answer.json").read_text())
    (copy / "answer.json").write_text(json.dumps({**answer, "input": str(folder)}))
    folder.rename(tmp_path / "renamed")
    done = workbench("open", copy, "--no-browser")
    assert done.returncode == 2 and "--recording" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written_refuses_edits(browser, arm_run, tmp_path):
    made = serve(arm_run, tmp_path / "session")
    made.folder.chmod(0o500)
    page = open_page(browser, made, "Edit and rerun")
    page.get_by_role("checkbox", name="joint-compliance at joint-3").click()
    page.get_by_text("cannot be written").wait_for()
    page.get_by_text("No changes yet.").wait_for()
    made.folder.chmod(0o700)
    page.close()
    stop(made)


def test_an_edit_that_cannot_be_saved_changes_nothing(arm_run, tmp_path, monkeypatch):
    from workbench.app.data.opened import open_subject
    from workbench.app.workspace import Workspace
    from workbench.core.errors import InputError

    (tmp_path / "file").write_text("no folder")
    work = Workspace(open_subject(str(arm_run)), tmp_path / "file" / "session.toml")
    work.select([1])
    with pytest.raises(InputError, match="can be written"):
        work.exclude_selected()
    assert work.session.changes == () and work.kept.all()
