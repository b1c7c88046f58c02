"""The progress line of long commands: text, elapsed time, number of the step and remaining time."""

import os
import pty
import select
import subprocess
import sys

from conftest import ROOT
from workbench.machine.progress import counted

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
