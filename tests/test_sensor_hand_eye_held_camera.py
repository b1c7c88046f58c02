"""A hand-eye transform with a camera from a file: its sigmas include those of the camera."""

from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w

from hand_eye_scenes import CAMERA, images, off
from sensors.boards.board import Board
from sensors.boards.detection import View
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model import StatedCamera, camera_keys, covariance_keys
from sensors.hand_eye.images import hand_eye_from_views
from workbench.core.errors import InputError
from workbench.jobs.sensor import camera as cameras
from workbench.jobs.sensor import hand_eye

BOARD = Board("chessboard", 7, 5, 15.0)
NOISE_PX = 0.1
ROBOTS = ((0.03, 1e-4), (0.1, 3e-4))
"""Sigmas of flange poses, mm and rad, of every second set."""


def seen(seed: int, count: int, robot=ROBOTS[0], points=BOARD.points):
    """Views of a board with `points` (3, 35) mm and flange poses."""
    shift, spin = robot
    simple, flange = images(
        seed, count=count, noise=NOISE_PX, shift=shift, spin=spin, points=points
    )
    sigma = np.full(35, NOISE_PX)
    views = [
        View(f"{k}.png", str(k), one.index, one.pixels, CAMERA.size, sigma)
        for k, one in enumerate(simple)
    ]
    return views, flange


def camera_file(views, path):
    """camera.toml of a camera that is calibrated from views."""
    made = calibrate_camera(views, BOARD, CAMERA.size, folds=0)
    count = len(made.camera.values)
    covariance = made.covariance[:count, :count]
    keys = {"format": "camera/1", **camera_keys(made.camera), **covariance_keys(covariance)}
    path.write_text(tomli_w.dumps(keys))
    return path


def read(path):
    """The camera as `workbench handeye --camera` or `--scanner` takes it."""
    recording, found = SimpleNamespace(name="here", guess={}), SimpleNamespace(size=CAMERA.size)
    return hand_eye._camera(recording, path, found, None)[0]


def squared_errors(found) -> list[float]:
    """Of position and rotation, squared, in stated sigmas, for each of the three numbers."""
    error, covariance = off(found.sensor), found.covariance
    parts = (slice(0, 3), slice(3, 6))
    return [error[p] @ np.linalg.solve(covariance[p, p], error[p]) / 3 for p in parts]


@pytest.mark.parametrize(
    ("images_of_the_camera", "count"),
    [
        pytest.param("the same", 10, marks=pytest.mark.slow),
        pytest.param("others", 20, marks=pytest.mark.slow),
        pytest.param("the same", 40, marks=pytest.mark.long),
        pytest.param("others", 40, marks=pytest.mark.long),
    ],
)
def test_sigmas_hold_over_many_sets(images_of_the_camera, count, tmp_path):
    """Of these images counts what they say of the transform, once; of the camera, what its file says."""
    squares = []
    for seed in range(61_000, 61_000 + count):
        views, flange = seen(seed, 14, ROBOTS[seed % 2])
        others = views if images_of_the_camera == "the same" else seen(seed + 7000, 20)[0]
        camera = read(camera_file(others, tmp_path / "camera.toml"))
        squares.append(squared_errors(hand_eye_from_views(views, BOARD, camera, flange)))
    assert np.mean(squares, axis=0) == pytest.approx([1.0, 1.0], abs=0.3)


def test_the_camera_is_held_and_its_covariance_propagated(tmp_path):
    views, flange = seen(62_000, 14)
    stated = read(camera_file(views, tmp_path / "camera.toml"))
    assert isinstance(stated, StatedCamera)
    found = hand_eye_from_views(views, BOARD, stated, flange)
    plain = hand_eye_from_views(views, BOARD, stated.camera, flange)
    np.testing.assert_array_equal(found.camera.values, stated.camera.values)
    np.testing.assert_allclose(found.sensor, plain.sensor, atol=1e-12)
    added = found.covariance - plain.covariance
    assert np.linalg.eigvalsh(added)[0] > -1e-12 * added[0, 0]
    assert max(squared_errors(plain)) > 9 > 3 > max(squared_errors(found))


def displaced_lines(random):
    """Board points (3, 35) of a printed board: columns and rows are each displaced by 0.05 mm (1 sigma)."""
    column, row = random.normal(0, 0.05, 7), random.normal(0, 0.05, 5)
    return BOARD.points + np.stack([np.tile(column, 5), np.repeat(row, 7), np.zeros(35)])


@pytest.mark.parametrize("board", ["exact", "printed"])
def test_a_numerical_derivative_gives_the_same_covariance(board):
    """The transform moves with a held camera as its covariance says: one principal point, moved by one sigma.

    Line errors of a printed board add to the covariance, not to the sensitivity to the camera.
    """
    points = displaced_lines(np.random.default_rng(8)) if board == "printed" else BOARD.points
    views, flange = seen(62_001, 14, points=points)
    sigma = 0.5
    covariance = np.zeros((9, 9))
    covariance[2, 2] = sigma**2
    found = hand_eye_from_views(views, BOARD, StatedCamera(CAMERA, covariance), flange)
    assert found.misfit.significant == (board == "printed")
    plain = hand_eye_from_views(views, BOARD, CAMERA, flange)
    values = CAMERA.values.copy()
    values[2] += sigma
    moved = hand_eye_from_views(views, BOARD, type(CAMERA).of(values, CAMERA.size), flange)
    away = off(moved.sensor, plain.sensor)
    added = found.covariance - plain.covariance
    np.testing.assert_allclose(added, np.outer(away, away), rtol=0.1, atol=0.05 * added.max())


def test_a_file_without_a_covariance_is_said_to_lack_it(tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(tomli_w.dumps(camera_keys(CAMERA)))
    camera = read(path)
    assert camera == CAMERA
    (note,) = hand_eye._on_camera(camera, f"read from {path}")
    assert "does not include that of the camera" in note and "calibrate the camera" in note
    assert hand_eye._on_camera(camera, hand_eye.SCANNER) == ()


@pytest.mark.parametrize(
    "wrong", [[[1.0]], "none", (-np.eye(9)).tolist(), (np.eye(9) + np.eye(9, k=1)).tolist()]
)
def test_a_covariance_that_is_none_is_refused(wrong, tmp_path):
    path = tmp_path / "camera.toml"
    path.write_text(tomli_w.dumps(camera_keys(CAMERA) | {"covariance": wrong}))
    with pytest.raises(InputError, match="key covariance: expected a symmetric, positive matrix"):
        cameras.read(path)
