"""A session of many scans is held on disk, is read back as it was, and needs no more memory the longer it is."""

import gc
import tracemalloc
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

import datasets
from sensor_recordings import scanner_recording
from workbench.core.errors import InputError
from workbench.files.spool import Spool
from workbench.jobs.sensor import ball_centres, scan
from workbench.machine.progress import paced


def test_a_spool_is_the_sequence_that_went_in():
    things = [{"number": k, "values": np.arange(k)} for k in range(20)]
    made = Spool(iter(things), in_memory=5)
    assert len(made) == 20 and made[0] is things[0]
    assert (
        [one["number"] for one in made]
        == list(range(20))
        == [made[k]["number"] for k in range(-20, 0)]
    )
    assert [one["number"] for one in made[3:12:4]] == [3, 7, 11]
    assert all(np.array_equal(one["values"], np.arange(one["number"])) for one in made)
    with pytest.raises(IndexError):
        made[20]


def test_a_full_disk_is_named_by_its_folder(monkeypatch, tmp_path):
    monkeypatch.setattr(
        "workbench.files.spool.tempfile.TemporaryFile", lambda prefix, dir: open("/dev/full", "w+b")
    )
    with pytest.raises(InputError, match=f"{tmp_path}.*No space left.*free space"):
        Spool(range(9), in_memory=2, folder=tmp_path)


def test_a_spool_holds_no_more_the_longer_it_is():
    def held(count):
        tracemalloc.start()
        made = Spool(
            (np.random.default_rng(k).normal(size=20_000) for k in range(count)), in_memory=8
        )
        total = sum(float(one.sum()) for one in made)
        gc.collect()
        size, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert np.isfinite(total) and len(made) == count
        return peak

    short, long = held(40), held(400)
    assert long < short + 400 * 400  # bytes: a place in a list, and not 160 kB a thing


@pytest.mark.slow
def test_scans_are_the_same_from_the_spool_as_from_memory(tmp_path, monkeypatch):
    folder, _ = scanner_recording()
    recording = datasets.read(folder)
    said = []
    made = scan.scan(recording, None, tmp_path, said.append)
    monkeypatch.setattr(scan, "Spool", lambda things, folder: Spool(things, 0, folder))
    again = scan.scan(recording, None, _new(tmp_path / "again"), lambda text: None)
    first, second = (ball_centres.as_json(one, tmp_path) for one in (made, again))
    assert {**first, "scans": list(first["scans"])} == {**second, "scans": list(second["scans"])}
    assert all(
        one.row == other.row and np.array_equal(one.drawn, other.drawn)
        for one, other in zip(made.scans, again.scans)
    )
    names = [field.name for field in fields(made.scans[0].balls[0])]
    assert names == [field.name for field in fields(again.scans[0].balls[0])]
    assert any(text.startswith("scan 2 of 2") for text in said)


def test_progress_says_how_many_scans_and_how_long_still():
    said, clock = [], SimpleNamespace(now=0.0)
    tick = paced(said.append, "scan", lambda: clock.now)
    for done in (1, 100, 5000):
        clock.now = done * 0.5
        tick(done, 10_000)
    assert said == [
        "scan 1 of 10000",
        "scan 100 of 10000, about 82 min left",
        "scan 5000 of 10000, about 42 min left",
    ]


def _new(folder):
    folder.mkdir()
    return folder
