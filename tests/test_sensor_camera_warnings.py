"""What displaces corners by the same in many images is named: a misprinted row of the board, a lens beyond its model."""

from dataclasses import replace

import numpy as np
import pytest

from sensors.boards.board import Board
from sensors.camera.calibration import calibrate_camera
from sensors.camera.correlated_errors.displaced_lines import (
    DisplacedLine,
    PoseTables,
    displaced_lines,
    with_held_out,
)
from sensors.camera.correlated_errors.random_effects import Reduced
from sensors.camera.correlated_errors.shared_effects import BoardLine
from sensors.camera.model import Camera
from test_sensor_camera_doubts import seen_by
from workbench.fitting.verdicts.sensor_verdict import camera_warnings

BOARD = Board("chessboard", 11, 8, 5.0)
TRUE = Camera(1500.0, 1499.0, 640.0, 512.0, (-0.1, 0.06, 0.0, 0.0, 0.0), (1280, 1024))


def warned(seed, points=None, residual_px=0.0):
    """Warnings of a camera from 16 images with board points (3, n) mm and a displacement (px) that no model has."""
    rng = np.random.default_rng(seed)

    def project(there):
        pixels = TRUE.project(there)
        x, y = (pixels - [[640], [512]]) / 640
        return pixels + residual_px * np.stack([np.sin(4 * x) * np.cos(5 * y), np.sin(6 * x * y)])

    views = seen_by(project, rng, BOARD, count=16, near=(110, 170), across=(20, 15), points=points)
    return camera_warnings(calibrate_camera(views, BOARD, TRUE.size, folds=0))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_misprinted_row_of_the_board_is_named(seed):
    displaced = BOARD.points.copy()
    row = displaced[1] == np.unique(displaced[1])[2]
    displaced[0, row] += 0.04
    displaced[1, row] += 0.04
    (said,) = warned(seed, displaced)
    assert "rows or columns of the board are not where they are said to be" in said
    assert "row 3 of its points (y = 10 mm) by 0.0" in said and " mm in x and 0.0" in said


def test_a_row_so_far_off_that_its_corners_pass_for_blunders_is_named_too():
    displaced = BOARD.points.copy()
    displaced[1, displaced[1] == np.unique(displaced[1])[3]] += 0.4
    (said,) = warned(2, displaced)
    assert "The board errs: the images show row 4 of its points (y = 15 mm) by 0." in said
    assert "contradict all others and are left out" in said
    displaced[1] = BOARD.points[1] + 0.4 * (BOARD.points[1] == np.unique(BOARD.points[1])[5])
    refused, said = warned(1, displaced)
    assert refused.startswith("DO NOT USE") and "row 6 of its points (y = 25 mm) by" in said


def test_displaced_lines_have_their_size_and_are_silent_where_no_line_is_displaced():
    """Six points on two rows: size and standard uncertainty are those of least squares."""
    random, design = np.random.default_rng(3), np.random.default_rng(4).normal(size=(400, 14))
    rows = [BoardLine(1, k + 1, 5.0 * k, np.arange(3) + [[3 * k], [6 + 3 * k]]) for k in (0, 1)]
    effect, other = np.zeros(14), np.zeros(14)
    effect[[9, 10, 11]] = 0.3  # the points of the second row in y: of the model less the image
    other[13] = 0.5  # another effect, of no line
    for truth in (effect, other):
        residual = design @ truth + random.normal(0, 0.1, 400)
        gram, pull = design.T @ design, design.T @ residual
        data = Reduced(gram, pull, residual @ residual, 400, np.zeros(14, int), 1)
        found = displaced_lines(data, rows, 0.01)
        if truth is other:
            assert found == ()
            continue
        (line,) = found
        assert line.line is rows[1] and abs(line.shift[1] + 0.3) < 4 * line.std[1] < 0.03
        assert abs(line.shift[0]) < 4 * line.std[0]


def _tables(truth, poses=8, seed=5):
    """Gram tables of poses with 2 shared parameters and 3 lines, whose displacements are `truth` (6,)."""
    random, tables = np.random.default_rng(seed), []
    for _ in range(poses):
        design = random.normal(size=(60, 8))
        residual = design[:, 2:] @ truth + random.normal(0, 0.1, 60)
        table = np.column_stack([design, residual])
        tables.append(table.T @ table)
    return PoseTables(np.stack(tables), np.full(poses, 60), 2, np.zeros(2))


@pytest.mark.parametrize("size, sure", [(0.3, True), (0.0, False)])
def test_a_displaced_line_is_tested_on_board_poses_that_were_left_out(size, sure):
    truth = np.array([0, 0, 0, size, 0, 0])
    rows = [BoardLine(1, k + 1, 5.0 * k, np.zeros((2, 0), int)) for k in range(3)]
    claimed = DisplacedLine(rows[1], truth[2:4], np.full(2, 1e-3))
    (one,) = with_held_out([claimed], rows, _tables(truth))
    tested = one.held_out
    assert (tested.t > 5, tested.probability > 0.99) == (sure, sure)
    assert not sure or tested.reselected == tested.poses == 8
    assert not sure or tested.rms[0] > 2 * tested.rms[1] == pytest.approx(0.2, rel=0.1)
    (one,) = with_held_out([claimed], rows, _tables(truth, poses=2))
    assert one.held_out is None  # nothing is left out of two poses


@pytest.mark.parametrize("seed", [1, 2])
def test_a_lens_beyond_its_model_is_named(seed):
    said = " ".join(warned(seed, residual_px=0.5))
    assert "the lens is not of the model fitted" in said
    assert "rows or columns" not in said


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_good_board_and_lens_are_silent(seed):
    assert warned(seed) == []


@pytest.mark.parametrize("seed", [1, 2])
def test_fields_of_the_lens_do_not_explain_the_noise_of_the_corners(seed):
    """A field over measured pixels holds their noise, which is all that a camera leaves of its constant slope."""
    rng = np.random.default_rng(seed)
    views = seen_by(TRUE.project, rng, BOARD, count=8, near=(110, 170), across=(20, 15))
    noisy = [
        replace(view, pixels=view.pixels + rng.normal(0, 3.0, view.pixels.shape)) for view in views
    ]
    made = calibrate_camera(noisy, BOARD, TRUE.size, folds=0)
    assert not made.shared.significant
