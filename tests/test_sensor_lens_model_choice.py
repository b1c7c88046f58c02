"""The model of the lens, chosen by errors on held-out board poses."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sensors.boards.board import Board
from sensors.boards.detection import View
from sensors.camera.calibration import calibrate_camera
from sensors.camera.model import Camera
from sensors.camera.model_choice import choose_model

BOARD = Board("chessboard", 9, 6, 10.0)
SIZE = (1280, 960)
LENSES = {
    "brown": Camera(1100.0, 1102.0, 640.0, 480.0, (-0.2, 0.1, 5e-4, -4e-4, 0.0), SIZE),
    "fisheye": Camera(470.0, 471.0, 640.0, 480.0, (0.03, -0.012, 0.004, -0.0008), SIZE),
    "rational": Camera(
        700.0, 701.0, 640.0, 480.0, (0.6, 0.08, 3e-4, -2e-4, 0.002, 0.9, 0.2, 0.008), SIZE
    ),
}


def views_of(camera, margin=0.05, count=14, sigma=0.05):
    """Boards that face the camera roughly, their middles anywhere but in the margins (a share of the image)."""
    rng = np.random.default_rng(1)
    found = []
    while len(found) < count:
        share = rng.uniform(margin, 1 - margin, (2, 1))
        ray = camera.rays(share * np.array([[SIZE[0]], [SIZE[1]]]))[:, 0]
        facing = Rotation.align_vectors([ray], [[0, 0, 1.0]])[0]
        tilted = facing * Rotation.from_rotvec(rng.normal(0, 0.35, 3))
        corners = tilted.as_matrix() @ (BOARD.points - BOARD.middle[:, None])
        points = corners + (camera.fx / 4 * rng.uniform(0.7, 1.4) * ray)[:, None]
        if points[2].min() < 5:
            continue
        pixels = camera.project(points)
        inside = (pixels > 0).all(0) & (pixels < np.array([[SIZE[0] - 1], [SIZE[1] - 1]])).all(0)
        index = np.flatnonzero(inside)
        if len(index) < 30:
            continue
        noisy = pixels[:, index] + rng.normal(0, sigma, (2, len(index)))
        name = f"{len(found)}.png"
        found.append(View(name, name, index, noisy, SIZE, np.full(len(index), sigma)))
    return found


@pytest.mark.parametrize("model", sorted(LENSES))
def test_the_model_of_the_lens_is_chosen(model):
    assert choose_model(views_of(LENSES[model]), BOARD, SIZE).chosen == model


def test_corners_that_a_model_leaves_out_count_as_its_errors():
    choice = choose_model(views_of(LENSES["fisheye"], margin=0.02), BOARD, SIZE)
    errors = {row.model: row.held_out_px for row in choice.candidates}
    assert errors["brown"] is None or errors["brown"] > 5 * errors["fisheye"]


def test_models_that_differ_only_outside_of_the_corners_are_named():
    views = views_of(LENSES["brown"], margin=0.35)
    choice = choose_model(views, BOARD, SIZE)
    (sentence,) = choice.extrapolation
    assert "where there are no corners" in sentence
    assert not choose_model(
        views_of(LENSES["brown"], margin=0.02, count=25), BOARD, SIZE
    ).extrapolation


def test_the_calibration_takes_the_chosen_model_and_says_so():
    made = calibrate_camera(views_of(LENSES["fisheye"]), BOARD, SIZE, "auto", folds=0)
    assert made.camera.is_fisheye
    assert made.choice.sentence in made.notes
    assert np.abs(made.camera.values[:4] - LENSES["fisheye"].values[:4]).max() < 1


def test_too_few_board_poses_keep_the_simplest_model():
    choice = choose_model(views_of(LENSES["brown"], count=4), BOARD, SIZE)
    assert choice.chosen == "brown"
    assert "too few to hold any out" in choice.sentence
