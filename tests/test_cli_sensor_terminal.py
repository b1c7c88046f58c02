"""What a person meets at the command line: sentences for wrong images and files, tables that fit, whole JSON."""

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from sensor_recordings import handeye_recording, scanner_recording
from test_cli_sensor import answers, here, run, runs_elsewhere  # noqa: F401

# ruff: noqa: F811 (fixtures of another file are arguments here)


def copied(tmp_path, name="damaged") -> Path:
    """A copy of the rendered recording that may be damaged."""
    return Path(shutil.copytree(scanner_recording()[0], tmp_path / name))


def images_of(folder: Path, role: str) -> list[Path]:
    import csv

    with open(folder / "images.csv", newline="") as file:
        return [folder / row["image"] for row in csv.DictReader(file) if row["role"] == role]


@pytest.mark.slow
@pytest.mark.parametrize(("level", "why"), [(0, "all black"), (255, "saturated")])
def test_scans_without_a_laser_line_are_named_and_leave_the_json_whole(
    workbench, answers, tmp_path, level, why
):
    import cv2

    folder, home = copied(tmp_path), answers("scan")[1]
    for path in images_of(folder, "scan"):
        cv2.imwrite(str(path), np.full(cv2.imread(str(path), 0).shape, level, np.uint8))
    done = workbench(
        "scan", folder, "--scanner", home / "scanner.toml", "--no-report", "--json", "-"
    )
    assert done.returncode == 0, done.stderr
    for one in json.loads(done.stdout)["scans"]:  # no library may write to the same stream
        assert one["points"] == 0 and one["balls"] == [] and one["cloud"] is None
        assert "no laser line was found" in one["outcome"] and why in one["outcome"]
    assert "no ball" in done.stderr and max(map(len, done.stderr.splitlines()[:4])) <= 80


def test_a_scanner_of_another_image_size_is_refused(here, answers, capsys):
    text = (answers("scan")[1] / "scanner.toml").read_text()
    before = set(Path("runs").glob("*"))  # of the fixture, where this test is its first user
    Path("other.toml").write_text(text.replace("width_px = 400", "width_px = 800"))
    assert run("scan", scanner_recording()[0], "--scanner", "other.toml") == 2
    assert (
        "400 x 320 px" in (said := capsys.readouterr().err)
        and "800 x 320 px" in said
        and said.count("\n") == 1
    )
    assert run("handeye", handeye_recording()[0], "--scanner", "other.toml") == 2
    assert "other.toml: expected the camera of images of" in capsys.readouterr().err
    assert set(Path("runs").glob("*")) == before


def test_scans_alone_ask_for_a_scanner(here, capsys):
    folder = copied(here)
    lines = (folder / "images.csv").read_text().splitlines(keepends=True)
    (folder / "images.csv").write_text("".join(line for line in lines if "board-laser" not in line))
    assert run("scan", folder) == 2
    assert "name a calibrated one with --scanner" in capsys.readouterr().err


def test_a_board_with_a_row_too_many_says_what_was_found(here, capsys):
    folder = copied(here)
    text = (folder / "recording.toml").read_text()
    (folder / "recording.toml").write_text(text.replace("rows = 5", "rows = 6"))
    assert run("camera", folder) == 2
    said = capsys.readouterr().err
    assert (
        "expected 7 x 6 chessboard as written there in the images, found 7 x 5 in" in said
        and "columns and rows" in said
        and said.count("\n") == 1
    )


def test_a_file_is_wanted_where_a_folder_is_named(here, capsys):
    (here / "there").mkdir()
    assert run("scanner", scanner_recording()[0], "--out", "there") == 2
    assert "--out there expects a file, found a folder" in capsys.readouterr().err


def test_the_run_folder_of_a_camera_is_exported(here, answers):
    assert (
        run("export", answers("camera")[1] / "camera", "--to", "ros", "--out", "camera.yaml") == 0
    )
    assert f"image_width: {400}" in Path("camera.yaml").read_text()


def test_an_interrupted_command_says_so(monkeypatch, capsys):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("workbench.commands.shared.answer.check_target", stopped)
    assert run("camera", "nothing") == 130
    assert capsys.readouterr().err.strip() == "Interrupted; nothing was written."


@pytest.mark.parametrize("command", ["camera", "scanner", "scan", "handeye"])
def test_tables_fit_80_columns_and_round_to_what_is_known(answers, command, capsys):
    import io
    import re

    from rich.console import Console

    from workbench.commands.shared import sensor_tables

    console = Console(file=io.StringIO(), width=80)
    getattr(sensor_tables, command)(console, answers(command)[0])
    lines = console.file.getvalue().splitlines()
    assert all(len(line) <= 80 for line in lines if not line.startswith("- "))
    assert not re.search(r"\d\.\d{7,}", "\n".join(lines)), (
        "more digits than anything here is known to"
    )


def test_values_are_given_to_two_digits_of_their_sigma():
    from workbench.commands.shared.tables import measured

    assert measured(533.4904, 0.40006) == ("533.49", "0.4")
    assert measured(-1133.2, 299.1) == ("-1133", "299")
    assert measured(40.0, None) == ("40", "–") and measured(None, 1.0) == ("–", "–")


def test_figures_in_space_keep_all_of_a_long_scene_in_view():
    import plotly.graph_objects as go

    from workbench.report import style

    made = go.Figure()
    made.add_scatter3d(x=[0, 10, None], y=[0, 20, None], z=[0, 1000, None])
    shown = json.loads(style.packed(made))["layout"]["scene"]
    ratio = [shown["aspectratio"][axis] for axis in "xyz"]
    assert shown["aspectmode"] == "manual" and max(ratio) < 1.5 and np.argmax(ratio) == 2


def test_a_result_says_the_version_that_made_it():
    """That of the code that ran, not what an install once wrote down of a checkout."""
    from types import SimpleNamespace

    from workbench.core import VERSION
    from workbench.files.provenance import provenance

    record = provenance(SimpleNamespace(sha256="", source="", licence="", name="x"))
    assert record["workbench"] == VERSION and record["numpy"] == np.__version__


@pytest.mark.parametrize(
    ("number", "words"), [(0, "0 scans"), (1, "1 scan"), (2, "2 scans"), (2000, "2,000 scans")]
)
def test_one_scan_is_singular(number, words):
    from workbench.commands.shared import sensor_tables

    empty = {"scans": [], "outcome": "", "balls": [], "rejected": [], "acceptance": []}
    one = {"scan": "a", "points": 0, "outcome": "", "balls": [], "rejected": []}
    console = Console(width=100, file=io.StringIO())
    sensor_tables.scan(console, {**empty, "recording": "r", "scans": [one] * number})
    assert f"r: {words}, 0 points" in console.file.getvalue()
