"""The progress line of long commands: text, elapsed time, number of the step and remaining time."""

import os
import pty
import re
import select
import subprocess
import sys

import pytest

from conftest import ROOT
from workbench.machine.progress import at_most_every, counted, elapsed, paced, staged

SCRIPT = """
import time
from workbench.commands.shared import answer
with answer.progress("reading") as say:
    time.sleep(1.3)
    say("fitting [a/b]")
    time.sleep(1.0)
"""


def in_terminal(script: str) -> str:
    """What a Python script writes to standard error where that is a terminal."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm", "COLUMNS": "80"}
    words = [sys.executable, "-c", script]
    process = subprocess.Popen(words, stderr=theirs, stdout=subprocess.DEVNULL, env=environment)
    os.close(theirs)
    parts = []
    while select.select([ours], [], [], 60)[0]:
        try:
            part = os.read(ours, 65536)
        except OSError:
            break
        if not part:
            break
        parts.append(part)
    assert process.wait(60) == 0
    return b"".join(parts).decode(errors="replace")


def test_a_terminal_shows_the_text_and_the_elapsed_time():
    shown = in_terminal(SCRIPT)
    assert "reading" in shown and "fitting [a/b]" in shown
    assert "0:00:01" in shown and "0:00:02" in shown


def test_without_a_terminal_nothing_is_printed():
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert done.returncode == 0 and done.stderr.strip() == "" and done.stdout == ""


def test_the_pace_leaves_out_the_preparation_before_the_first_of_many_steps():
    said, seconds = [], iter([0.0, 30.0, 31.0, 40.0])
    tick = paced(said.append, "image", lambda: next(seconds))
    for done in (1, 2, 11):
        tick(done, 101)
    assert said == [
        "image 1 of 101",
        "image 2 of 101, about 2 min left",
        "image 11 of 101, about 2 min left",
    ]


def test_the_first_of_few_steps_gives_a_pace():
    said, seconds = [], iter([0.0, 30.0])
    paced(said.append, "case", lambda: next(seconds))(1, 3)
    assert said == ["case 1 of 3, about 60 s left"]


def said_by_steps(total: int, steps: dict[float, str]) -> list[str]:
    """What is reported of `total` steps that begin at given seconds."""
    said, now = [], [0.0]
    step = counted(said.append, total, lambda: now[0])
    for now[0], name in steps.items():
        step(name)
    return said


def test_steps_are_counted_and_the_remaining_time_is_that_of_the_finished_ones():
    steps = {0.0: "stage geometry", 5.0: "stage drift", 20.0: "stage bending"}
    assert said_by_steps(4, steps) == [
        "stage geometry (1 of 4)",
        "stage drift (2 of 4, about 15 s left)",
        "stage bending (3 of 4, about 20 s left)",
    ]


def test_no_remaining_time_is_guessed_in_the_first_two_seconds():
    assert said_by_steps(2, {0.0: "first", 1.0: "second"})[1] == "second (2 of 2)"


def test_each_kind_of_steps_has_its_own_remaining_time():
    said, now = [], [0.0]
    tick = staged(said.append, lambda: now[0])
    for done in (1, 2, 3):
        tick("choosing pose", done, 4)
        now[0] += 3.0
    tick("exchanging pose", 1, 2)
    now[0] += 4.0
    tick("exchanging pose", 1, 2)
    assert said[2] == "choosing pose 3 of 4, about 3 s left"
    assert said[3] == "exchanging pose 1 of 2"
    assert said[4] == "exchanging pose 1 of 2, about 4 s left"


def test_a_search_of_unknown_length_says_what_follows_it_at_least():
    said, now = [], [0.0]
    step = elapsed(said.append, 5, lambda: now[0])
    step("backlash at joint-2")
    now[0] = 4.0
    step("payload at tool")
    assert said[0] == "backlash at joint-2"
    expected = "search, 4 s so far, its validation then takes 20 s or more: payload at tool"
    assert said[1] == expected


PLANNED = {
    "identifiability": (["identifiability", "elastic-arm", "--no-report"], "stage geometry (1 of "),
    "significance": (["significance", "ur10", "--no-report"], "parameter 3 of "),
    "poses": (["poses", "elastic-arm", "--count", "12", "--no-report"], "choosing pose 4 of 12"),
}


@pytest.mark.parametrize("name", PLANNED)
def test_a_command_counts_its_steps(name, tmp_path):
    words, expected = PLANNED[name]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "WORKBENCH_PROGRESS": "lines"}
    run = [sys.executable, "-m", "workbench", *words, "--out", str(tmp_path / "out")]
    done = subprocess.run(run, capture_output=True, text=True, env=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert expected in done.stderr


def test_images_of_a_board_are_counted_by_check(tmp_path):
    from datasets.formats.recording1 import read_recording
    from workbench.recordings.inspection.inspect import inspect_recording
    from workbench.recordings.templates import write_template

    write_template("board-images", tmp_path / "board")
    said = []
    inspect_recording(read_recording(tmp_path / "board"), said.append)
    assert any(line.startswith("board in image 14 of 14") for line in said)


def test_a_calibration_reports_every_stage_and_section(tmp_path):
    import datasets
    from workbench.jobs.robot.calibrate import calibrate
    from workbench.report.page import write_report

    said = []
    calibration = calibrate(datasets.read("elastic-arm"), folds=4, progress=said.append)
    # on a busy machine the time left follows
    stages = [line for line in said if line.startswith("stage ")]
    counts = [re.search(r"\((\d+) of (\d+)(, about .* left)?\)$", line) for line in stages]
    numbers = [(int(count[1]), int(count[2])) for count in counts]
    assert numbers == [(k + 1, len(numbers)) for k in range(len(numbers))] and len(numbers) > 4
    assert said[-1] == "uncertainty of the parameters"
    said.clear()
    write_report(calibration, tmp_path, progress=said.append)
    assert said[0] == "writing the report: headline (1 of 8)"
    assert said[-1] == "drawing the summary image"


def test_a_log_has_at_most_one_text_a_period():
    now, lines = [0.0], []
    step = at_most_every(60.0, lines.append, lambda: now[0])
    for now[0] in (1.0, 59.0, 61.0, 90.0, 121.5, 125.0):
        step(f"at {now[0]:g}")
    assert lines == ["at 61", "at 121.5"]
