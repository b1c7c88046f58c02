"""A camera whose image depends on gravity or on a recorded column is not blamed on the flange poses."""

import numpy as np

from hand_eye_scenes import CAMERA, HAND_EYE, board, images
from sensors.hand_eye.checks.camera_dependence import GRAVITY, TARGET, Conditions
from sensors.hand_eye.images import hand_eye_from_views

DOWN = np.array([0.0, 0.0, -1.0])
POSES = 16
WARM = 1 - np.exp(-np.arange(POSES) / 5)


def calibrated(seed, displacement=None, **columns):
    """Hand-eye of a set in which each image moves by `displacement`, from gravity in the camera (P, 3), to (P, 2) px."""
    views, flange = images(seed, count=POSES, shift=0.02, spin=5e-5)
    if displacement is not None:
        down = (flange @ HAND_EYE)[:, :3, :3].transpose(0, 2, 1) @ DOWN
        for view, moved in zip(views, displacement(down)):
            view.pixels = view.pixels + moved[:, None]
    conditions = Conditions(columns, DOWN)
    return hand_eye_from_views(views, board(), CAMERA, flange, conditions=conditions)


def test_a_lens_that_sags_is_named_with_its_size_and_direction():
    found = calibrated(0, lambda down: 3.0 * down[:, :2]).dependence
    assert (found.parameter, found.covariate) == ("principal point", GRAVITY)
    assert abs(found.size_px - 3.0) < 4 * found.std_px
    assert found.direction @ DOWN > 0.99
    assert "direction of gravity" in found.sentence


def test_a_camera_that_warms_up_is_named():
    found = calibrated(1, lambda down: WARM[:, None] * [[4.0, 1.0]], temperature_c=WARM).dependence
    assert (found.parameter, found.covariate) == ("principal point", "temperature_c")
    assert abs(found.size_px - np.hypot(4, 1) * np.ptp(WARM)) < 4 * found.std_px


def test_nothing_is_named_where_only_the_flange_poses_err():
    assert all(calibrated(seed, temperature_c=WARM).dependence is None for seed in range(20, 26))


def test_a_displacement_along_another_direction_of_the_base_is_no_sag():
    views, flange = images(3, count=POSES, shift=0.02, spin=5e-5)
    across = (flange @ HAND_EYE)[:, :3, :3].transpose(0, 2, 1) @ [1.0, 0.0, 0.0]
    for view, moved in zip(views, 3.0 * across[:, :2]):
        view.pixels = view.pixels + moved[:, None]
    made = hand_eye_from_views(views, board(), CAMERA, flange, conditions=Conditions({}, DOWN))
    assert made.dependence is None


def test_a_moving_board_is_no_moving_lens():
    views, flange = images(4, count=POSES, shift=0.02, spin=5e-5)
    flange[:, :3, 3] += WARM[:, None] * [1.0, 0.5, 0.0]
    conditions = Conditions({"time_s": WARM}, DOWN)
    found = hand_eye_from_views(views, board(), CAMERA, flange, conditions=conditions).dependence
    assert (found.parameter, found.covariate) == (TARGET, "time_s")
