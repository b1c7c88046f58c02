"""Runs in the background: progress, failure, cancelling, and what `workbench open` refuses."""

import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from workbench.app.jobs import CANCELLED, DONE, FAILED, Job


@pytest.fixture
def project(monkeypatch):
    """Processes that a job starts find this checkout."""
    root = str(Path(__file__).resolve().parent.parent)
    monkeypatch.setenv("PYTHONPATH", root)


def test_a_job_that_fails_says_why(tmp_path, project):
    job = Job(["calibrate", "no-such-recording"], tmp_path / "out", tmp_path)
    assert job.wait(120) == FAILED
    assert "no-such-recording" in job.last_line and not (tmp_path / "out").exists()


def test_a_job_reports_its_progress_and_ends(tmp_path, project):
    (tmp_path / "plan.toml").write_text(
        '[[stage]]\nname = "g"\nwhy = "w"\nfree = ["base.*", "sensor.*"]\n'
    )
    words = ["calibrate", "elastic-arm", "--plan", "plan.toml", "--folds", "2", "--no-report"]
    job = Job(words, tmp_path / "out", tmp_path)
    assert job.wait(300) == DONE
    assert job.lines[0] == "reading elastic-arm" and any("stage g" in line for line in job.lines)
    assert json.loads((tmp_path / "out" / "answer.json").read_text())["command"] == "calibrate"


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_a_cancelled_job_leaves_nothing(tmp_path, project):
    job = Job(["calibrate", "elastic-arm", "--no-report"], tmp_path / "out", tmp_path)
    while not any("stage" in line for line in list(job.lines)) and job.state == "running":
        job._process.poll()
    job.cancel()
    assert job.state == CANCELLED
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_a_job_is_cancelled_only_once_its_folder_is_removed(tmp_path, project, monkeypatch):
    job = Job(["calibrate", "elastic-arm", "--no-report"], tmp_path / "out", tmp_path)
    states = []
    monkeypatch.setattr(
        "workbench.app.jobs.shutil.rmtree", lambda *words, **named: states.append(job.state)
    )
    job.cancel()
    assert states == ["running"] and job.state == CANCELLED


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_a_job_that_does_not_end_in_time_is_killed_and_leaves_nothing(
    tmp_path, project, monkeypatch
):
    job = Job(["calibrate", "elastic-arm", "--no-report"], tmp_path / "out", tmp_path)
    while not (tmp_path / "out").exists() and job.state == "running":
        time.sleep(0.02)
    monkeypatch.setattr(job, "_signal", lambda number: number == signal.SIGINT or kill(job))
    monkeypatch.setattr("workbench.app.jobs._PATIENCE_S", 0.2)
    job.cancel()
    assert job.wait(30) == CANCELLED
    assert list(tmp_path.iterdir()) == []


def kill(job) -> None:
    """Kill the processes of a job at once."""
    os.killpg(job._process.pid, signal.SIGKILL)
    job._process.wait(30)


def test_without_trame_the_command_says_what_to_install(workbench, tmp_path):
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    for name in ("trame_plotly", "trame_vuetify", "trame"):
        (blocked / f"{name}.py").write_text(
            f"raise ModuleNotFoundError('no {name}', name='{name}')\n"
        )
    import os
    import subprocess

    root = Path(__file__).resolve().parent.parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(blocked), str(root)])}
    words = [sys.executable, "-m", "workbench", "open", "elastic-arm"]
    done = subprocess.run(
        words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "vision-sensor-workbench[app]" in done.stderr and "workbench open" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_subject_that_is_nothing_is_refused(workbench):
    done = workbench("open", "no-such-thing", "--no-browser")
    assert done.returncode == 2 and "no-such-thing" in done.stderr
