"""Reruns of the app on the bundled arm: progress, end, cancelling, refusals, and the same by the command line."""

import json
import signal
import time
from pathlib import Path

import pytest

from app_browser import (
    cancel_run,
    open_page,
    opened_app,
    run_workbench,
    serve,
    show_tab,
    wait_for_text,
)

pytestmark = pytest.mark.slow


@pytest.fixture
def served(page):
    return page.served


@pytest.fixture
def page(browser, arm_run, tmp_path):
    with opened_app(browser, arm_run, tmp_path / "session") as page:
        yield page


def test_a_rerun_shows_before_and_after_and_the_command_line_repeats_it(page, served, tmp_path):
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


@pytest.mark.parametrize("command", ["Calibrate", "Diagnose"])
def test_a_run_can_be_cancelled_and_leaves_nothing(page, served, command):
    before = set(served.folder.iterdir())
    cancel_run(page, command)
    assert set(served.folder.iterdir()) == {*before, served.session}


def test_the_progress_of_a_diagnosis_is_shown_and_no_other_run_starts(page):
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_role("progressbar", name="Run in progress").wait_for()
    assert page.get_by_role("button", name="Calibrate").is_disabled()
    page.wait_for_function(
        "() => /\\d+ s: \\S/.test(document.querySelector('[data-text=job]').innerText)",
        timeout=120_000,
    )
    page.get_by_role("button", name="Cancel").click()
    wait_for_text(page, "job", "Cancelled", 60_000)


def test_a_refused_rerun_says_why(page):
    show_tab(page, "Residuals")
    page.get_by_label("Residual from (mm)").fill("0")
    page.get_by_label("to (mm)").fill("1000")
    page.get_by_role("button", name="Select by length").click()
    wait_for_text(page, "selection", "300 of 300")
    page.get_by_role("button", name="Exclude selected samples").click()
    wait_for_text(page, "selection", "300 excluded")
    show_tab(page, "Edit and rerun")
    page.get_by_role("button", name="Calibrate").click()
    assert "all 300 samples are excluded" in wait_for_text(page, "job", "The run failed", 120_000)


def test_a_reload_during_a_rerun_shows_its_progress_and_its_end(browser, served):
    page = open_page(browser, served, "Edit and rerun")
    progress = page.get_by_role("progressbar", name="Run in progress")
    page.get_by_role("button", name="Diagnose").click()
    progress.wait_for()
    page.reload()
    page.locator("[data-tab=edit]").wait_for()
    progress.wait_for()  # a diagnosis takes longer than the page needs to be painted; a calibration may not
    wait_for_text(page, "job", "Finished after", 300_000)
    page.get_by_role("link", name="Report page of this run").wait_for()
    page.close()


def test_the_end_of_the_app_ends_the_rerun(browser, arm_run, tmp_path):
    made = serve(arm_run, tmp_path / "session", is_forked=False)
    page = open_page(browser, made, "Edit and rerun")
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_role("progressbar", name="Run in progress").wait_for()
    children = _children(made.process.pid)
    assert children
    made.process.send_signal(signal.SIGTERM)
    made.process.wait(30)
    page.close()
    until = time.monotonic() + 30
    while any(map(_is_alive, children)) and time.monotonic() < until:
        time.sleep(0.2)
    assert [pid for pid in children if _is_alive(pid)] == []
    assert not list(made.folder.glob("diagnose-*"))


def _children(pid: int) -> list[int]:
    """Processes that a process started, on Linux."""
    place = Path(f"/proc/{pid}/task/{pid}/children")
    if not place.exists():
        pytest.skip("no /proc on this system")
    found: list[int] = []
    for task in place.parent.parent.iterdir():
        found += [int(word) for word in (task / "children").read_text().split()]
    return found


def _is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"
