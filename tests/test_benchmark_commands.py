"""The benchmark of commands: what a row says, and what is measured of a process."""

import pytest

from benchmarks.commands import Command, Used, line, run


def test_a_row_says_which_criteria_are_met():
    used = Used(processor_s=1.2, wall_s=70.0, first_s=9.5, memory_mib=2048.4)
    about = Command("diagnose x", ("diagnose", "x"), processor_s=2.0, wall_s=60.0)
    assert line(about, used) == (
        "diagnose x: processor time 1.20 s (criterion 2 s: met), wall time 70.00 s (criterion 60 s: not met), "
        "first result 9.50 s, 2,048 MiB"
    )


def test_a_row_without_a_first_result_does_not_state_one():
    used = Used(processor_s=1.2, wall_s=2.0, first_s=float("nan"), memory_mib=300.0)
    assert "first" not in line(Command("check x", ("check", "x"), first_s=None), used)


def test_processor_time_and_memory_of_a_command_are_measured(tmp_path):
    used = run(Command("check", ("check", "elastic-arm")), tmp_path)
    assert 0 < used.processor_s < used.wall_s + 1
    assert used.memory_mib > 50


def test_a_command_that_fails_is_no_figure(tmp_path):
    with pytest.raises(SystemExit, match="ended with 2"):
        run(Command("check", ("check", "no-such-recording")), tmp_path)
