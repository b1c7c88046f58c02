"""Boards in all images of a recording, simulated and real: views, rejected images, sentences."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from board_images import CHESS, CIRCLES, SIZE, homography, render
from datasets.recording import Recording
from sensors.boards.detection import detect_all
from workbench.core.errors import InputError


def recording(folder, named, board=CHESS):
    """A recording in memory of images by their names."""
    for name, image in named.items():
        cv2.imwrite(str(folder / name), image)
    rows = tuple(
        {"image": name, "role": "board", "placement": name[0], "time_s": 1.0} for name in named
    )
    keys = {
        "kind": board.kind,
        "columns": board.columns,
        "rows": board.rows,
        "square_mm": board.square_mm,
    }
    return Recording("board-images", {}, {}, images=rows, board=keys, name="cell-4", folder=folder)


def test_all_images_of_a_recording(tmp_path):
    """Each is a view or has its reason; progress is reported after every one."""
    one, two = (render(CHESS, homography(CHESS, turn=turn), noise=2) for turn in (0.1, 0.3))
    named = {
        "a.png": one,
        "b.png": two,
        "c.png": one,
        "d.png": 0 * one,
        "e.png": one.T.copy(),
        "f.png": np.dstack([two // 2] * 3),
    }
    made, calls = recording(tmp_path, named), []
    made = replace(
        made, images=(*made.images, made.images[1], {"image": "x.png", "role": "scan", "scan": "1"})
    )
    found = detect_all(made, lambda *done: calls.append(done))
    assert [v.image for v in found.views] == ["a.png", "b.png", "f.png"] and found.size == SIZE
    assert {r.image: r.why.split(":")[0] for r in found.rejected} == {
        "b.png": "listed twice",
        "c.png": "the same pixels as a.png",
        "d.png": "all black",
        "e.png": "wrong size",
    }
    assert (
        found.views[0].placement == "a"
        and found.views[0].row["time_s"] == 1.0
        and found.views[2].note == "three equal channels"
    )
    assert calls[-1] == (7, 7, "b.png") and [t[0] for t in calls] == list(range(1, 8))


def test_no_image_with_the_board_gets_one_sentence(tmp_path):
    made = recording(
        tmp_path,
        {"a.png": render(CHESS, homography(CHESS), noise=2)},
        replace(CHESS, columns=CHESS.columns + 1),
    )
    with pytest.raises(
        InputError,
        match=r"cell-4/recording.toml, \[board\]: expected 10 x 6 chessboard.*found 9 x 6 in 1 of 1; correct columns and rows",
    ):
        detect_all(made)
    with pytest.raises(
        InputError, match=r"found it in none of 1 \(a.png: no grid of circles found"
    ):
        detect_all(
            recording(tmp_path, {"a.png": render(CHESS, homography(CHESS), noise=2)}, CIRCLES)
        )
    with pytest.raises(InputError, match=r"key \[board\]: expected this section"):
        detect_all(replace(made, board=None))
    with pytest.raises(InputError, match="column role: expected images of a board, found none"):
        detect_all(replace(made, images=()))
    (tmp_path / "a.png").write_bytes(b"")
    with pytest.raises(InputError, match="cell-4/a.png: expected an image, found an empty file"):
        detect_all(made)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count", "limit"),
    [
        pytest.param("opencv_stereo_chess:left", 13, 0.20, marks=pytest.mark.long),
        ("opencv_stereo_chess:right", 13, 0.20),
        ("linelaser_circlegrid_zhao", 12, 0.10),
        ("handeye_open3dv:in-hand", 8, 0.03),
        ("handeye_open3dv:to-hand", 5, 0.04),
    ],
)
def test_real_images(real, name, count, limit):
    """Every board is found, whole, and plain OpenCV fits a camera to its places within the limit (px, as OpenCV counts)."""
    import datasets

    real(name.partition(":")[0])
    found = detect_all(datasets.read(name))
    assert len(found.views) == count and not found.rejected
    assert all(len(v.index) == found.board.count for v in found.views)
    points = [found.board.points.T[v.index].astype(np.float32) for v in found.views]
    rms = cv2.calibrateCamera(
        points, [v.pixels.T.astype(np.float32) for v in found.views], found.size, None, None
    )[0]
    assert rms < limit
