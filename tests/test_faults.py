"""Faults at every write: a full disk, too little memory, flipped bytes. One sentence, and nothing half-written."""

import errno
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import datasets
from conftest import ROOT
from good_recordings import write_good
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.files import runs

sys.path.insert(0, str(ROOT / "tools"))

import kill_runs  # noqa: E402


class FullDisk:
    """`os.fsync` that fails at call number `at`; the system reports a full disk without a file name there."""

    def __init__(self, at):
        self.left, self.flush = at, os.fsync

    def __call__(self, descriptor):
        self.left -= 1
        if self.left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self.flush(descriptor)


@pytest.mark.parametrize("at", [1, 2, 3])
def test_a_full_disk_at_every_write_of_a_run_leaves_nothing(tmp_path, monkeypatch, at):
    monkeypatch.setattr(os, "fsync", FullDisk(at))
    with pytest.raises((InputError, OSError)), runs.opened("demo", "x", tmp_path / "out") as run:
        runs.replace_file(run.partial / "a.txt", "a")
        (run.partial / "b.txt").write_text("b")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_no_bug_even_where_the_system_names_no_file(tmp_path, monkeypatch, capsys):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(datasets, "write", full)
    scene = tmp_path / "scene.toml"
    scene.write_text('robot = "abb_irb120"\nmeasures = "external-pose"\nsamples = 8\n')
    assert cli.run(["simulate", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "disk is full" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


def test_too_little_memory_is_no_bug(tmp_path, monkeypatch, capsys):
    def large(*_, **__):
        raise MemoryError

    monkeypatch.setattr(datasets, "write", large)
    scene = tmp_path / "scene.toml"
    scene.write_text('robot = "abb_irb120"\nmeasures = "external-pose"\nsamples = 8\n')
    assert cli.run(["simulate", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert "memory of this machine" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["check", "x" * 300],
        ["identifiability", "elastic-arm", "--json", "x" * 300],
        ["datasets", "get", "irb120_faro", "--to", "x" * 300],
        ["calibrate", "elastic-arm", "--out", "x" * 300],
    ],
    ids=lambda words: words[0],
)
def test_a_name_that_is_too_long_is_a_sentence(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    assert cli.run(words) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_removed_working_directory_is_a_sentence(tmp_path, monkeypatch, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text('robot = "abb_irb120"\nmeasures = "external-pose"\nsamples = 8\n')
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert cli.run(["simulate", str(scene)]) == 2
    assert "working directory was removed" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["simulate", "significance", "compensate", "stiffness"])
def test_a_place_that_cannot_be_written_is_found_before_the_work(tmp_path, command, capsys):
    """The other arguments are never read: they do not exist."""
    (tmp_path / "file").write_text("mine")
    words = [command, str(tmp_path / "none.toml"), "--out", str(tmp_path / "file" / "out")]
    if command in ("compensate", "stiffness"):
        words.insert(2, str(tmp_path / "none.csv"))
    assert cli.run(words) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_checking_a_place_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runs.check_place(tmp_path / "deep" / "out")
    runs.check_place(None)
    assert list(tmp_path.iterdir()) == []


def test_flipped_bytes_of_a_parquet_file_are_found(tmp_path):
    """Pages carry checksums. The footer, with the names of the columns, has none in the format."""
    rng = np.random.default_rng(3)
    recording = datasets.read(write_good(tmp_path / "good", "external-pose"))
    folder = datasets.write(recording, tmp_path / "parquet", "parquet")
    path = folder / "samples.parquet"
    whole, accepted = path.read_bytes(), 0
    pages = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for position in rng.integers(4, pages, 60):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            found = datasets.read(folder)
        except InputError:
            continue
        same = all(
            np.array_equal(found.columns[n], recording.columns[n]) for n in recording.columns
        )
        accepted += not same
    assert accepted == 0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="processes are listed in /proc (Linux)")
def test_kills_lose_nothing_and_leave_no_process(tmp_path):
    """A few of the kills of `python tools/kill_runs.py`."""
    assert kill_runs.kill_runs(tmp_path, 12, seed=5) == []
