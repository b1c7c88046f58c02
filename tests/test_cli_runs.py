"""The folder of a run: it appears whole, survives kills and interruptions, and nothing is overwritten."""

import os
import re
import subprocess
import sys

import pytest

from conftest import ROOT
from workbench.core.errors import InputError
from workbench.files import runs


def test_a_run_appears_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path / "runs")
    with runs.opened("calibrate", "some/where/my recording") as run:
        (run.partial / "a.txt").write_text("a")
        assert not run.path.exists()
    assert (run.path / "a.txt").read_text() == "a"
    assert re.fullmatch(r"\d{8}-\d{6}-calibrate-my-recording", run.path.name)
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [run.path.name]


def test_a_run_that_fails_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), runs.opened("calibrate", "x", tmp_path / "out") as run:
        (run.partial / "a.txt").write_text("a")
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []


def test_runs_of_one_second_do_not_meet(tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "RUNS", tmp_path)
    monkeypatch.setattr(runs, "_now", lambda: "20260101-000000")
    with runs.opened("demo", "x") as first, runs.opened("demo", "x") as second:
        pass
    with runs.opened("demo", "x") as third:
        pass
    assert [run.path.name for run in (first, second, third)] == [
        "20260101-000000-demo-x",
        "20260101-000000-demo-x-2",
        "20260101-000000-demo-x-3",
    ]
    assert all(run.path.is_dir() for run in (first, second, third))


def test_an_empty_folder_may_be_named(tmp_path):
    with runs.opened("demo", "x", tmp_path / "deep" / "out") as run:
        (run.partial / "a.txt").write_text("a")
    (tmp_path / "empty").mkdir()
    with runs.opened("demo", "x", tmp_path / "empty") as again:
        (again.partial / "b.txt").write_text("b")
    assert (tmp_path / "deep" / "out" / "a.txt").exists() and (
        tmp_path / "empty" / "b.txt"
    ).exists()
    assert run.path == tmp_path / "deep" / "out"


KILLED = """
import os, signal, sys
from pathlib import Path
from workbench.files import runs
with runs.opened("demo", "x", Path(sys.argv[1])) as run:
    (run.partial / "half").write_text("half")
    (run.partial / "folder").mkdir()
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_left_does_not_stand_in_the_way(tmp_path):
    out = tmp_path / "out"
    subprocess.run([sys.executable, "-c", KILLED, str(out)], cwd=ROOT, check=False)
    assert (tmp_path / ".partial-out" / "half").exists() and not out.exists()
    with runs.opened("demo", "x", out) as run:
        assert list(run.partial.iterdir()) == []
        (run.partial / "a.txt").write_text("a")
    assert [path.name for path in out.iterdir()] == ["a.txt"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_first_result_stays_where_a_run_was_killed_until_a_run_replaces_it(tmp_path):
    out, first = tmp_path / "out", '    runs.write_provisional(run, "first")\n'
    script = KILLED.replace('    (run.partial / "half")', first + '    (run.partial / "half")')
    subprocess.run([sys.executable, "-c", script, str(out)], cwd=ROOT, check=False)
    assert [path.name for path in out.iterdir()] == ["provisional.json"]
    assert (out / "provisional.json").read_text() == "first"
    with runs.opened("demo", "x", out) as run:
        runs.write_provisional(run, "second")
        (run.partial / "a.txt").write_text("a")
    assert [path.name for path in out.iterdir()] == ["a.txt"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_first_result_that_was_half_written_does_not_stand_in_the_way(tmp_path):
    """A kill between the temporary file and its final name leaves the temporary file."""
    out = tmp_path / "out"
    out.mkdir()
    (out / ".partial-7-provisional.json").write_text('{"prov')
    with runs.opened("demo", "x", out) as run:
        (run.partial / "a.txt").write_text("a")
    assert [path.name for path in out.iterdir()] == ["a.txt"]
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_two_runs_do_not_write_one_folder(tmp_path):
    with (
        runs.opened("demo", "x", tmp_path / "out") as run,
        pytest.raises(InputError, match="Another run is writing"),
        runs.opened("demo", "x", tmp_path / "out"),
    ):
        pass
    assert run.path.is_dir()


def test_a_terminated_command_ends_as_an_interrupted_one(tmp_path):
    """SIGTERM reaches the same handler as Ctrl-C, so that workers are stopped and nothing is left behind."""
    import signal

    from workbench.__main__ import stop_on_every_signal

    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGHUP)
    try:
        stop_on_every_signal()
        with pytest.raises(KeyboardInterrupt), runs.opened("demo", "x", tmp_path / "out"):
            os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before[0])
        signal.signal(signal.SIGHUP, before[1])
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(InputError, match="contains files"), runs.opened("demo", "x", tmp_path):
        pass
    with pytest.raises(InputError, match="is a file"), runs.opened("demo", "x", tmp_path / "a.txt"):
        pass
    with (
        pytest.raises(InputError, match="cannot be written"),
        runs.opened("demo", "x", tmp_path / "a.txt" / "b"),
    ):
        pass
    assert (tmp_path / "a.txt").read_text() == "mine"
