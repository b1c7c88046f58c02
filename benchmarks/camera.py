"""A camera from 200 images of 88 corners against cv2.calibrateCamera, and how the cost grows with the images.

Run `python benchmarks/camera.py` in an environment with the extra `bench`. Both sides get the same
corners and no start, on one thread; ours ends with the covariance of all that it fits.
"""

import os
import sys
from functools import partial
from pathlib import Path

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def main() -> int:
    """Print the table; 1 where the two sides of a row give different answers, else 0."""
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read by numpy when it is first imported, below
    root = str(Path(__file__).resolve().parents[1])
    if root not in sys.path:
        sys.path.insert(0, root)
    from benchmarks import table
    from workbench.core.memory import keep_freed_memory

    keep_freed_memory()  # as the command line does
    return table.show(comparisons())


def comparisons():
    """The rows' functions."""
    return [camera_opencv, camera_with_checks, camera_with_bow, camera_linear]


VIEWS, NOISE, SIZE = 200, 0.06, (1280, 1024)
LEAST_RATIO, LONGEST = 4, 4.6
FX = 3421.0


def camera_opencv():
    """The same answer: five coefficients and all poses, least squares, a flat board. Ours adds their covariance."""
    from benchmarks.table import Row, agree, compare

    views, board = _images(VIEWS, bow=0.0)
    ours, peer = partial(_fit, views, board), partial(_opencv, views, board)
    fit, (rms, matrix, *_) = ours().fit, peer()
    ours_rms = (fit.residual[0] ** 2).sum(0).mean() ** 0.5
    place = fit.table.index["camera.fx"]
    sigma = fit.covariance[place, place] ** 0.5
    note = agree("RMS in px", abs(ours_rms - rms), 1e-4 * rms)
    note += ", " + agree(
        "fx in its sigmas", abs(fit.table.values[place] - matrix[0, 0]) / sigma, 0.1
    )
    return Row(
        f"camera, {VIEWS} x 88 corners, cv2.calibrateCamera",
        *compare(ours, peer, (7, 5)),
        LEAST_RATIO,
        note,
    )


def camera_with_checks():
    """For information: the same with the tests for errors that many corners share, which OpenCV does not make."""
    from benchmarks.table import Row, compare

    views, board = _images(VIEWS, bow=0.0)
    ours = partial(_ours, views, board, bow=False, loss="linear")
    times = compare(ours, partial(_opencv, views, board), (7, 5))
    return Row(
        f"camera with checks, {VIEWS} x 88, cv2.calibrateCamera",
        *times,
        None,
        "errors of the print, of the lens and of the focal length from image to image are tested",
    )


def camera_with_bow():
    """For information: what a user gets, with the bow that the board has, Huber's loss and the search for blunders."""
    from benchmarks.table import Row, compare

    views, board = _images(VIEWS, bow=0.05)
    ours, peer = partial(_ours, views, board), partial(_opencv, views, board)
    made, (_, matrix, *_) = ours(), peer()
    off, theirs = abs(made.camera.fx - FX), abs(matrix[0, 0] - FX)
    sigma = made.std["camera.fx"]
    note = f"fx off by {off:.2f} px (sigma {sigma:.2f}), OpenCV's, which knows no bow, by {theirs:.1f} px"
    return Row(
        f"camera with bow, {VIEWS} x 88, cv2.calibrateCamera",
        *compare(ours, peer, (7, 5)),
        None,
        note,
    )


def camera_linear():
    """Four times the images in at most 4.6 times the time: the peer is our own fit of a quarter of them."""
    from benchmarks.table import Row, compare

    few, many = (partial(_ours, *_images(count, bow=0.05)) for count in (VIEWS // 2, 2 * VIEWS))
    note = (
        f"{len(many().fit.history) - 1} last steps, those of the few {len(few().fit.history) - 1}"
    )
    times = compare(many, few, (7, 15))
    return Row(
        f"camera, {2 * VIEWS} images (ours) against {VIEWS // 2} (peer)",
        *times,
        1 / LONGEST,
        note,
    )


def _ours(views, board, **options):
    from sensors.camera.calibration import calibrate_camera

    return calibrate_camera(views, board, SIZE, folds=0, **options)


def _fit(views, board):
    from sensors.camera.adjust import adjusted

    return adjusted(views, board, SIZE, "brown", (), "linear")


def _opencv(views, board):
    import cv2
    import numpy as np

    cv2.setNumThreads(1)
    points = [board.points.T.astype(np.float32)] * len(views)
    return cv2.calibrateCamera(
        points, [view.pixels.T.astype(np.float32) for view in views], SIZE, None, None
    )


def _images(count, bow):
    """Views of an 11 x 8 board, half as wide as far away, with normal noise; `bow` in mm along its length."""
    import cv2
    import numpy as np

    from sensors.boards.board import Board
    from sensors.boards.detection import View

    random, board = np.random.default_rng(0), Board("chessboard", 11, 8, 3.5)
    x = (board.points[0] - board.middle[0]) / board.half_diagonal
    bent = (board.points + np.stack([0 * x, 0 * x, bow * x**2])).T
    matrix, lens = (
        np.array([[FX, 0, 640], [0, FX - 1, 512], [0, 0, 1]]),
        np.array([-0.1, 0.05, 1e-3, -1e-3, 0.0]),
    )
    views = []
    for k in range(count):
        turn = random.uniform(-0.6, 0.6, 3)
        away = random.uniform([-4, -4, 115], [4, 4, 135]) - cv2.Rodrigues(turn)[0] @ board.middle
        pixels = cv2.projectPoints(bent, turn, away, matrix, lens)[0][:, 0].T
        pixels += random.normal(0, NOISE, pixels.shape)
        views.append(
            View(
                f"{k}.png",
                str(k),
                np.arange(board.count),
                pixels,
                SIZE,
                np.full(board.count, NOISE),
            )
        )
    return views, board


if __name__ == "__main__":
    sys.exit(main())
