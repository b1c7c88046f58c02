"""On a real Dask scheduler with two worker processes on loopback, one of which is killed in the middle."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import study_scenes as scenes
from workbench.core.errors import InputError
from workbench.studies import executors, tables
from workbench.studies.engine import carry_out, given, parts_of
from workbench.studies.study import carried_out, read

pytest.importorskip("distributed", reason="needs the package distributed (extra study)")
ROOT = Path(__file__).resolve().parents[1]


def started(*words, cwd):
    environment = {
        **os.environ,
        "PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}",
        "DASK_DISTRIBUTED__WORKER__DAEMON": "False",
    }
    with (cwd / f"{words[0]}-{time.monotonic_ns()}.log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, "-m", *words], cwd=cwd, env=environment, stdout=log, stderr=log
        )


@contextmanager
def cluster(folder: Path):
    """Address of a scheduler, and its two worker processes."""
    file = folder / "scheduler.json"
    scheduler = started(
        "distributed.cli.dask_scheduler",
        "--host",
        "127.0.0.1",
        "--port",
        "0",
        "--no-dashboard",
        "--scheduler-file",
        str(file),
        cwd=folder,
    )
    workers = []
    try:
        address = _address(file)
        workers = [
            started(
                "distributed.cli.dask_worker",
                address,
                "--nthreads",
                "1",
                "--no-nanny",
                "--no-dashboard",
                "--host",
                "127.0.0.1",
                cwd=folder,
            )
            for _ in range(2)
        ]
        yield address, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def _address(file: Path) -> str:
    import json

    for _ in range(300):
        if file.exists() and file.read_text():
            return json.loads(file.read_text())["address"]
        time.sleep(0.1)
    raise TimeoutError("no scheduler came up")


def both_there(address):
    from distributed import Client

    with Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)


@pytest.mark.slow
def test_a_killed_worker_loses_no_run_and_the_rows_are_those_of_a_local_study(tmp_path):
    study, _ = read(scenes.written(tmp_path))
    local, marks, place = tmp_path / "local", tmp_path / "marks", tmp_path / "dask"
    for folder in (local, place):
        (folder / tables.PARTS_FOLDER).mkdir(parents=True)
    marks.mkdir()
    carry_out(study, local, partial(executors.local, 1), 1, lambda *_: None)
    tables.put_together(local, len(parts_of(study)))
    with cluster(tmp_path) as (address, workers):
        both_there(address)
        killed = []

        def kill(done, total):
            if done >= 12 and not killed:
                os.kill(workers[0].pid, signal.SIGKILL)
                killed.append(done)

        with executors.dask(address) as (pool, threads):
            assert threads == 2
            work = partial(scenes.noted, str(marks), 0.2)
            carry_out(study, place, partial(given, pool), threads, kill, work)
        pids = [(marks / f"run-{run}").read_text().split() for run in range(1, 41)]
    tables.put_together(place, len(parts_of(study)))
    assert killed and pq.read_table(place / tables.TABLE).equals(
        pq.read_table(local / tables.TABLE)
    )
    assert {str(worker.pid) for worker in workers} == {pid for made in pids for pid in made}
    # what a part's worker had in hand, or had done and not yet handed over, when it was killed may have been made again
    twice = [made for made in pids if len(made) > 1]
    assert all(made[0] == str(workers[0].pid) for made in twice) and len(twice) <= 2 * 3


@pytest.mark.slow
def test_a_study_on_a_cluster_from_the_command(tmp_path, workbench):
    path = scenes.written(tmp_path, ("runs = 40", "runs = 8"))
    with cluster(tmp_path) as (address, _):
        both_there(address)
        done = workbench(
            "study", path, "--scheduler", address, "--out", tmp_path / "out", "--no-report"
        )
    assert done.returncode == 0, done.stderr
    here = carried_out(path, tmp_path / "here", 1, None, lambda line: None)
    assert pq.read_table(tmp_path / "out" / tables.TABLE).equals(
        pq.read_table(here.path / tables.TABLE)
    )


def test_no_scheduler_is_said_in_one_sentence(monkeypatch):
    import distributed

    def refused(*_, **__):
        raise OSError("timed out")

    monkeypatch.setattr(distributed, "Client", refused)
    with (
        pytest.raises(InputError, match="expected a Dask scheduler that answers"),
        executors.dask("tcp://127.0.0.1:1"),
    ):
        pass
