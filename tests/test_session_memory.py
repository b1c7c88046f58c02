"""`workbench scan` on a long session, report and answer included, needs no more memory than on a short one."""

import gc
import json
import pickle
import tracemalloc
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import datasets
from ball_scenes import cap
from benchmarks.session import session
from sensors.acceptance import Probed, acceptance
from sensors.ball.fit import fit_ball
from sensors.boards.detection import Rejected
from sensors.camera.model import Camera
from sensors.scanner.model import Scanner
from workbench.commands.sensor import scan as scan_command
from workbench.commands.shared import answer
from workbench.files.spool import JoinedMapping, Spool
from workbench.jobs.sensor import ball_centres, scan
from workbench.report.sensor import summary_image
from workbench.report.sensor.scan import page

CAMERA = Camera(20.0, 20.0, 8.0, 6.0, (0.0,) * 5, (16, 12))
SCANNER = Scanner(CAMERA, np.arange(2), np.array([[0.0, 0, 1, -130], [0.0, 0, 1, -131]]).T)
RADIUS = 12.0
PER_SCAN = 2_000
"""Bytes by which the peak may grow with every scan: two rows of images.csv and one of samples.csv are 0.3 kB of
numbers and names, their text ten times that while some of it is read; one scan with its ball is 30 kB, its part of the
answer 4 kB."""


@pytest.fixture
def few(tmp_path) -> Path:
    """A recording of one scan of two images, without a board."""
    folder = tmp_path / "few"
    (folder / "images").mkdir(parents=True)
    for step in range(2):
        cv2.imwrite(str(folder / f"images/{step}.png"), np.full((12, 16), 90, np.uint8))
    rows = "".join(f"images/{step}.png,scan,1,{step}\n" for step in range(2))
    (folder / "images.csv").write_text("image,role,scan,step\n" + rows)
    (folder / "artefact.csv").write_text(f"ball,x_mm,y_mm,z_mm,radius_mm\n1,0,0,0,{RADIUS}\n")
    head = 'format = "recording/1"\nmeasures = "scan-images"\n[images]\nfile = "images.csv"\n[artefact]\nfile = "artefact.csv"\n'
    board = '[board]\nkind = "chessboard"\ncolumns = 7\nrows = 5\nsquare_mm = 6.0\n'
    (folder / "recording.toml").write_text(head + board)
    return folder


@pytest.fixture
def found(monkeypatch) -> scan.Scan:
    """What every scan is found to hold: a ball of 400 points, a image left out and a sentence of its own."""
    points = cap(400, np.pi / 3, RADIUS) + [[0], [0], [130]]
    points += np.random.default_rng(1).normal(0, 0.02, points.shape)
    fit = fit_ball(points, 0.02, RADIUS)
    ball = scan.Ball(1, RADIUS, fit, fit.free, points, points[:2], False)
    accepted = acceptance([Probed(1, points, fit, RADIUS)])
    unseen = (Rejected("1.png", "dim"),)
    made = scan.Scan(
        "", {}, 400, "clouds/1.ply", points, {"weak": 1}, (ball,), "", unseen, accepted
    )

    def work(self, named):
        name, rows = named
        own = {"name": name, "row": rows[0], "outcome": f"{name} of 9999 points"}
        return replace(pickle.loads(pickle.dumps(made)), **own)

    monkeypatch.setattr(
        scan, "Spool", lambda things, folder: Spool(things, 0, folder)
    )  # the first are as all others
    monkeypatch.setattr(scan._Work, "__call__", work)
    monkeypatch.setattr(scan.calibrated, "read", lambda path: SCANNER)
    return made


@pytest.mark.slow
def test_the_command_needs_no_more_memory_the_longer_the_session(few, found, tmp_path, capsys):
    def peak(scans, out):
        folder = session(few, tmp_path / f"recording-{out}", scans)
        gc.collect()
        tracemalloc.start()
        scan_command.command(str(folder), Path("scanner.toml"), out=tmp_path / out, no_report=True)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return size

    peak(70, "first")  # what is loaded and made once
    short, long = peak(80, "short"), peak(300, "long")
    assert long < short + 220 * PER_SCAN
    result = json.loads((tmp_path / "long" / "answer.json").read_text())
    assert [one["sample"] for one in result["scans"]] == list(range(1, 301)) and result[
        "ball_centres"
    ]["samples"] == 300
    assert datasets.read(tmp_path / "long" / "ball-centres").n == 300
    form = next(one for one in result["acceptance"] if one["name"] == "probing_form")
    assert (
        list(form["parts"]) == [f"scan {k}, ball-1" for k in range(1, 301)]
        and form["n"] == 300 * 400
    )
    assert "288 more scans have other remarks" in capsys.readouterr().out


@pytest.mark.slow
def test_the_report_needs_no_more_memory_the_longer_the_session(few, found, tmp_path):
    def peak(scans, out):
        folder = session(few, tmp_path / f"recording-{out}", scans)
        made = scan.scan(
            datasets.read(folder), Path("scanner.toml"), new(tmp_path / out), lambda text: None
        )
        gc.collect()
        tracemalloc.start()
        panels = summary_image.scan(made)
        shown = page(made)
        size = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert shown.numbers[2][1] == str(scans) and len(panels) == 2
        return size

    peak(70, "first")
    short, long = peak(80, "short"), peak(300, "long")
    assert long < short + 220 * PER_SCAN


def new(folder):
    folder.mkdir()
    return folder


def test_what_all_scans_tell_is_worked_out_once_and_shown_of_a_few(
    few, found, tmp_path, monkeypatch
):
    folder = session(few, tmp_path / "recording", 90)
    made = scan.scan(
        datasets.read(folder), Path("scanner.toml"), new(tmp_path / "run"), lambda text: None
    )
    computed, columns_of = [], ball_centres._ball_columns
    monkeypatch.setattr(
        ball_centres, "_ball_columns", lambda *given: computed.append(1) or columns_of(*given)
    )
    result = ball_centres.as_json(made, tmp_path)
    shown = page(made)
    assert len(computed) == 90 and ball_centres.characteristics(
        made
    ) is ball_centres.characteristics(made)
    assert ball_centres.centres_of(made) is ball_centres.centres_of(made)
    assert ("scans", "90", "") in shown.numbers and ("balls found", "90", "") in shown.numbers
    assert "The JSON holds 78 more." in str(shown)
    whole = json.loads(answer.as_text(result))
    assert (
        whole["acceptance"] == json.loads(json.dumps(whole["acceptance"]))
        and len(whole["scans"]) == 90
    )


def test_parts_of_a_mapping_are_that_mapping():
    made = JoinedMapping([{"a": 1, "b": 2}, {}, {"c": 3}])
    assert made == {"a": 1, "b": 2, "c": 3} and list(made.items()) == [("a", 1), ("b", 2), ("c", 3)]
    assert len(made) == 3 and "d" not in made and not JoinedMapping([])
