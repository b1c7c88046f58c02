"""Images and clouds of no use are named with the reason: laser images, boards of another size, full disks, cut balls."""

import errno
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import datasets
from board_images import CHESS, homography, render
from sensor_recordings import scanner_recording
from sensors import images
from sensors.ball.search import find_balls
from sensors.boards.board import Board
from sensors.boards.detection import detect
from sensors.boards.patches import _solved
from workbench.commands import cli
from workbench.core.errors import InputError


def run(*words) -> int:
    """One command line in this process; its exit status."""
    return cli.run([str(word) for word in words])


@pytest.fixture
def spoilt(tmp_path, monkeypatch):
    """A copy of the small rendered recording."""
    from workbench.files import runs

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runs, "RUNS", tmp_path / "runs")
    return Path(shutil.copytree(scanner_recording()[0], tmp_path / "spoilt"))


def blank(folder, row, value):
    path = folder / row["image"]
    cv2.imwrite(str(path), np.full_like(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), value))


def test_laser_images_without_a_line_or_a_board_are_named(spoilt):
    images = datasets.read(spoilt).images
    laser = [row for row in images if row["role"] == "board-laser"]
    blank(spoilt, laser[3], 0)
    blank(spoilt, laser[5], 255)
    lost = laser[-1]["placement"]
    blank(
        spoilt,
        next(row for row in images if row["role"] == "board" and row["placement"] == lost),
        0,
    )
    assert run("scanner", spoilt, "--out", "s.toml", "--json", "a.json") == 0
    found = json.loads(Path("a.json").read_text())
    why = {one["image"]: one["why"] for one in found["rejected"]}
    assert why.pop(laser[3]["image"]).startswith("all black") and why.pop(
        laser[5]["image"]
    ).startswith("saturated: 100 %")
    assert set(why) == {row["image"] for row in laser if row["placement"] == lost}
    assert all("the board was not found in its pose (all black" in said for said in why.values())
    assert set(found["shared_px"]) == {"stripe", "tilt", "placement"}
    place = Path(found["run"])
    page = (place / "report.html").read_text(encoding="utf-8")
    assert "saturated: 100 %" in page and "errors that points of a stripe share" in page.lower()
    assert (place / "summary.png").stat().st_size > 20_000


def test_a_line_of_a_few_pixels_is_no_black_image():
    grey = np.zeros((400, 500), np.uint8)
    assert images.unlit(grey).startswith("all black")
    grey[10, 20] = 60
    assert images.unlit(grey) is None
    assert images.unlit(np.full((9, 9), 255, np.uint8)).startswith("saturated")


def test_images_of_two_depths_are_a_sentence(tmp_path):
    for name, kind in (("a.png", np.uint8), ("b.png", np.uint16)):
        cv2.imwrite(str(tmp_path / name), np.arange(12, dtype=kind).reshape(3, 4))
    with pytest.raises(
        InputError,
        match=r"b.png: expected 8 bits a pixel as in the images before, found 16; save",
    ):
        list(images.stacks([tmp_path / "a.png", tmp_path / "b.png"]))


@pytest.mark.parametrize(
    ("more", "stated_size"), [((1, 0), "8 x 5"), ((0, 1), "7 x 6"), ((-1, 0), "6 x 5")]
)
def test_a_board_written_with_another_size_is_found_from_all_images(spoilt, more, stated_size):
    """Also where some images have the board so near the edge that it passes for one that is cut."""
    columns, rows = 7 + more[0], 5 + more[1]
    file = spoilt / "recording.toml"
    file.write_text(
        file.read_text()
        .replace("columns = 7", f"columns = {columns}")
        .replace("rows = 5", f"rows = {rows}")
    )
    with pytest.raises(
        InputError,
        match=rf"expected {stated_size} chessboard as written there in the images, found 7 x 5 in",
    ):
        from sensors.boards.detection import detect_all

        detect_all(datasets.read(spoilt))


def test_a_patch_that_shows_nothing_of_a_number_is_no_crash():
    matrices = np.stack([np.eye(3), np.diag([1.0, 0.0, 1.0])])
    np.testing.assert_array_equal(_solved(matrices, np.ones((2, 3))), [[1, 1, 1], [0, 0, 0]])
    flat = render(CHESS, homography(CHESS), noise=0)
    wider = Board("chessboard", CHESS.columns + 1, CHESS.rows, CHESS.square_mm)
    assert f"{CHESS.columns} x {CHESS.rows}" in detect(flat, wider).why


@pytest.mark.parametrize("count", [60, 100, 400])
@pytest.mark.parametrize("plate", [False, True])
def test_small_clear_balls_are_found_without_their_radii(count, plate):
    rng = np.random.default_rng(count)
    balls = [([0.0, 0, 150], 6.0), ([30.0, 5, 155], 9.0)]
    parts = [np.array(centre)[:, None] + dome(rng, radius, count) for centre, radius in balls]
    if plate:
        flat = rng.uniform(-60, 60, (2, 4 * count))
        parts.append(np.stack([*flat, 170 + rng.normal(0, 0.01, 4 * count)]))
    found = sorted(find_balls(np.concatenate(parts, 1), None), key=lambda ball: ball.radius)
    assert [ball.radius for ball in found] == pytest.approx([6, 9], abs=0.05)


def dome(rng, radius, count, noise=0.01):
    """(3, count) mm on the side of a ball that faces the sensor, to 60 degrees from its top."""
    cosine, turn = rng.uniform(0.5, 1, count), rng.uniform(0, 2 * np.pi, count)
    sine = np.sqrt(1 - cosine**2)
    return radius * np.stack([sine * np.cos(turn), sine * np.sin(turn), -cosine]) + rng.normal(
        0, noise, (3, count)
    )


def test_a_full_disk_is_a_sentence(tmp_path, monkeypatch, capsys):
    """Wherever the disk fills up, at the first image or at the tables."""
    monkeypatch.chdir(tmp_path)
    scene = scanner_recording()[0].parent / "scene.toml"
    for place, name in ((Path, "write_bytes"), (Path, "write_text")):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, full)
            assert run("render", scene, "--out", "out") == 2
        said = capsys.readouterr().err
        assert (
            said.count("\n") == 1
            and "No space left" in said
            and "make room" in said
            and not Path("out").exists()
        )


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_scan_without_a_ball_says_where_one_may_be_cut(spoilt):
    """A sweep of two steps, of which one cuts the ball near its edge: all of it is at the field's limit."""
    steps = [row["step"] for row in datasets.read(spoilt).images if row["role"] == "scan"]
    kept = {f"-step-{step:03d}" for step in sorted(set(steps))[7:9]}
    file = spoilt / "images.csv"
    head, *lines = file.read_text().splitlines()
    lines = [line for line in lines if ",scan," not in line or any(name in line for name in kept)]
    file.write_text("\n".join([head, *lines]) + "\n")
    assert run("scan", spoilt, "--json", "a.json", "--no-report") == 0
    for scan in json.loads(Path("a.json").read_text())["scans"]:
        assert (
            not scan["balls"]
            and "a ball there is cut by the field; move it to the middle" in scan["outcome"]
        )


def test_images_of_a_scan_in_which_nothing_can_be_seen_are_named(spoilt, capsys):
    """Overexposed ones always, black ones where the neighbouring images show the line."""
    images = datasets.read(spoilt).images
    assert run("scanner", spoilt, "--out", "s.toml", "--no-report") == 0
    rows = [row for row in images if row["role"] == "scan" and row["scan"] == images[-1]["scan"]]
    middle = len(rows) // 2
    blank(spoilt, rows[middle], 0)
    blank(spoilt, rows[middle + 2], 255)
    blank(spoilt, rows[0], 0)
    capsys.readouterr()
    assert run("scan", spoilt, "--scanner", "s.toml", "--json", "a.json", "--no-report") == 0
    rejected = {
        one["image"]: one["why"]
        for scan in json.loads(Path("a.json").read_text())["scans"]
        for one in scan["rejected"]
    }
    assert list(rejected) == [rows[middle]["image"], rows[middle + 2]["image"]]
    black, bright = rejected.values()
    assert black.startswith("all black") and bright.startswith("saturated: 100 %")
    assert f"{rows[middle]['image']}: all black" in capsys.readouterr().out


def test_a_missing_image_is_one_sentence_and_not_one_within_another(spoilt, capsys):
    row = datasets.read(spoilt).images[2]
    (spoilt / row["image"]).unlink()
    assert run("camera", spoilt, "--no-report") == 2
    said = capsys.readouterr().err
    assert said.count("expected") == 1 and "found no such file" in said
