"""The app on a hand-eye run: residuals by image, edits, and a session that the command line repeats."""

import json

import pytest

import app_browser
from app_browser import (
    click_at,
    opened_app,
    plot,
    scrub_by_key,
    settled_place,
    show_tab,
    trace,
    wait_for_text,
)
from workbench.app.data.opened import open_subject
from workbench.app.workspace import Workspace
from workbench.core.errors import InputError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(browser, hand_eye_run, tmp_path_factory):
    with opened_app(browser, hand_eye_run, tmp_path_factory.mktemp("session")) as page:
        yield page


def _without_date(path) -> list[str]:
    """Lines of a file without the time at which it was written."""
    lines = path.read_bytes().splitlines()
    return [line for line in lines if not line.startswith(b"date = ")]


def _answer(folder) -> dict:
    """What a run says, without its place and the time at which it was made."""
    answer = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    answer.pop("run")
    answer["provenance"].pop("date")
    return answer


@pytest.mark.parametrize(
    "held",
    [
        pytest.param(False, id="camera calibrated", marks=pytest.mark.long),
        pytest.param(True, id="camera held"),
    ],
)
def test_edits_of_a_hand_eye_run_are_repeated_from_the_command_line(hand_eye_run, tmp_path, held):
    run = hand_eye_run
    if held:  # the session holds the options of the run
        recording, run = hand_eye_run.parent / "recording", tmp_path / "held"
        app_browser.run_workbench("camera", recording, "--out", tmp_path / "camera", cwd=tmp_path)
        words = ["handeye", recording, "--camera", "camera/camera.toml", "--kind", "in-hand"]
        app_browser.run_workbench(*words, "--out", run, cwd=tmp_path)
    work = Workspace(open_subject(str(run)), tmp_path / "session" / "session.toml")
    work.select([2])
    work.exclude_selected()
    work.set_image(5, False)
    job = work.start()
    assert job.wait(200) == "done", list(job.lines)
    words = ["--session", work.path, "--out", tmp_path / "again", "--no-report"]
    app_browser.run_workbench("handeye", *words, cwd=tmp_path)
    first, again = _answer(job.out), _answer(tmp_path / "again")
    assert first == again
    assert _without_date(job.out / "hand-eye.toml") == _without_date(
        tmp_path / "again/hand-eye.toml"
    )
    assert (first["options"]["camera"] is not None) == held
    left_out = {"images/board-003.png", "images/board-006.png"}
    before = {row["name"] for row in work.opened.answer["errors"]}
    assert before - {row["name"] for row in first["errors"]} == left_out
    work.finish()
    held_out = [row for row in work.comparison() if row["name"] == "held-out RMS (px)"]
    assert held_out and held_out[0]["before"] != held_out[0]["after"]


def test_a_session_of_the_camera_does_not_edit_a_hand_eye_run(hand_eye_run, tmp_path):
    opened = open_subject(str(hand_eye_run))
    path = tmp_path / "session.toml"
    text = f'format = "session/1"\ncommand = "camera"\nrecording = {json.dumps(opened.subject)}\n'
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="key command: expected .*'handeye', found 'camera'"):
        Workspace(opened, path)


def test_a_rerun_in_the_app_shows_before_and_after(page):
    show_tab(page, "Recording")
    page.get_by_role("checkbox", name="Use in the calibration").click()
    wait_for_text(page, "image", "excluded from the calibration")
    show_tab(page, "Edit and rerun")
    page.get_by_text("workbench handeye --session").wait_for()
    page.get_by_role("button", name="Calibrate the hand-eye transform").click()
    wait_for_text(page, "job", "Finished after", 120_000)
    table = page.get_by_role("group", name="Before and after").inner_text()
    assert "held-out RMS (px)" in table and "14" in table and "13" in table


_MIDDLE_OF_BAR = """(element, place) => {
    const {xaxis, yaxis} = element._fullLayout, box = element.getBoundingClientRect();
    const bar = element._fullData.find((one) => one.name === 'held out');
    return [box.left + xaxis._offset + xaxis.c2p(place + 0.2),
            box.top + yaxis._offset + yaxis.c2p(bar.y[place] / 2)];
}"""


def test_a_real_click_on_a_bar_shows_image_with_overlay_pose_and_row(
    browser, hand_eye_run, tmp_path
):
    with opened_app(browser, hand_eye_run, tmp_path / "session", "Residuals") as page:
        wait_for_text(page, "selection", "0 of 14")
        errors = open_subject(str(hand_eye_run)).answer["errors"]
        bars = trace(page, "pose_errors", "held out")
        assert bars["y"] == pytest.approx([one["held_out"] for one in errors])
        figure = plot(page, "pose_errors")
        x, y = settled_place(page, lambda: figure.evaluate(_MIDDLE_OF_BAR, 4))
        click_at(page, "pose_errors", x, y)
        wait_for_text(page, "selection", "1 of 14 samples selected")
        page.get_by_role(
            "heading", name=f"Sample 5: residual {errors[4]['residual']:.4f} px (fit)"
        ).wait_for()
        wait_for_text(page, "picked", "images/board-005.png")
        wait_for_text(page, "picked", "54 corners detected")
        row = page.get_by_role("group", name="Row of the sample")
        row.get_by_text("flange x (mm)").wait_for()
        page.get_by_role("button", name="images/board-009.png").press("Enter")
        page.get_by_role("heading", name="Sample 9").wait_for()
        page.get_by_role("button", name="Exclude selected samples").click()
        wait_for_text(page, "selection", "1 excluded")
        assert page.problems == []


def test_flange_camera_and_board_are_drawn_and_move(page):
    for name in ("flange of all samples", "camera of each pose", "board"):
        show_tab(page, "Recording")
        assert trace(page, "scene", name), name
    scrub_by_key(page, "flange x at the current sample")
    scrub_by_key(page, "camera at the current sample")
