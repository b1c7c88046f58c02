"""Hand-eye from measured poses of a target: truth within the stated uncertainty, gross errors and mistakes named."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sensors.hand_eye.checks.half_turn import target_rotations_deg
from sensors.hand_eye.checks.target_review import review_target_poses
from sensors.hand_eye.motion import motion
from sensors.hand_eye.target_poses import TargetPoses, hand_eye_from_target_poses
from target_scenes import quaternions, target_scene
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, transform

NAMES = [f"row {k}" for k in range(14)]


def _error_in_sigmas(seed, kind, sigma):
    flange, seen, sensor = target_scene(seed, kind=kind, sigma=sigma)
    made = hand_eye_from_target_poses(TargetPoses(flange, seen, kind, NAMES))
    turn = Rotation.from_matrix(made.sensor[:3, :3] @ sensor[:3, :3].T).as_rotvec()
    error = np.concatenate([made.sensor[:3, 3] - sensor[:3, 3], turn])
    return error / np.sqrt(np.diag(made.covariance))


@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
@pytest.mark.parametrize("sigma", [(1.0, 0.003), (0.2, 0.01)])
def test_the_truth_lies_within_the_stated_uncertainty(kind, sigma):
    errors = np.array([_error_in_sigmas(seed, kind, sigma) for seed in range(20)])
    assert 0.8 < np.sqrt((errors**2).mean()) < 1.2


def test_variances_of_position_and_rotation_are_estimated():
    flange, seen, _ = target_scene(1, count=60, sigma=(0.5, 0.004))
    made = hand_eye_from_target_poses(TargetPoses(flange, seen, "in-hand", NAMES))
    assert made.robot_sigma["position_mm"] == pytest.approx(0.5, rel=0.15)
    assert np.radians(made.robot_sigma["rotation_deg"]) == pytest.approx(0.004, rel=0.15)
    assert made.held_out["origin_mm"] > made.fit["origin_mm"]


def test_exact_poses_give_the_exact_transform():
    flange, seen, sensor = target_scene(2, sigma=(0, 0))
    made = hand_eye_from_target_poses(TargetPoses(flange, seen, "in-hand", NAMES))
    assert np.abs(made.sensor - sensor).max() < 1e-6


def test_a_wrong_pose_is_left_out_and_named():
    flange, seen, sensor = target_scene(3)
    seen[4, :3, 3] += [25.0, 0, 0]
    made = hand_eye_from_target_poses(TargetPoses(flange, seen, "in-hand", NAMES))
    assert made.outliers == (4,)
    assert "left out" in made.poses[4].why
    assert np.linalg.norm(made.sensor[:3, 3] - sensor[:3, 3]) < 3


def test_rotations_about_one_axis_leave_the_transform_undetermined():
    flange, seen, sensor = target_scene(4, sigma=(0, 0))
    about_z = Rotation.from_rotvec(np.outer(np.linspace(0, 1, 14), [0, 0, 1.0])).as_matrix()
    moved = flange[0] @ transform(about_z, np.random.default_rng(1).normal(0, 80, (14, 3)))
    target = flange[0] @ sensor @ seen[0]
    poses = TargetPoses(moved, inverse(sensor) @ inverse(moved) @ target, "in-hand", NAMES)
    made = hand_eye_from_target_poses(poses)
    assert not np.isfinite(made.covariance).all()
    assert "turned about one axis only" in made.undetermined[0]


def test_two_poses_are_too_few():
    flange, seen, _ = target_scene(5, count=2)
    with pytest.raises(InputError, match="at least 3 poses"):
        hand_eye_from_target_poses(TargetPoses(flange, seen, "in-hand", NAMES[:2]))


def _reviewed(flange, seen, kind="in-hand"):
    poses = TargetPoses(flange, seen, kind, NAMES)
    return review_target_poses(flange, poses.data, kind, NAMES)


def test_poses_that_fit_raise_no_suspicion():
    assert _reviewed(*target_scene(6)[:2]).findings == ()


def _in_other_order(seen):
    return transform(
        Rotation.from_quat(quaternions(seen)[:, [1, 2, 3, 0]]).as_matrix(), seen[:, :3, 3]
    )


def _half_turned(seen):
    turned = seen.copy()
    half = transform(np.diag([-1.0, -1, 1]), np.array([120.0, 80, 0]))
    turned[[2, 5, 9]] = turned[[2, 5, 9]] @ half
    return turned


MISTAKES = {
    "inverse": lambda flange, seen: (inverse(flange), seen),
    "target-inverse": lambda flange, seen: (flange, inverse(seen)),
    "target-quaternion": lambda flange, seen: (flange, _in_other_order(seen)),
    "permuted": lambda flange, seen: (flange, seen[[0, 1, 3, 2, *range(4, 14)]]),
    "half-turn": lambda flange, seen: (flange, _half_turned(seen)),
}


@pytest.mark.parametrize("cause", MISTAKES)
def test_one_mistake_is_named(cause):
    found = _reviewed(*MISTAKES[cause](*target_scene(7)[:2]))
    assert found.certain
    assert found.findings[0].cause == cause
    assert "image" not in found.sentences[0]


def test_rows_of_a_board_rotated_by_180_deg_are_found():
    flange, seen, _ = target_scene(8)
    rows = target_rotations_deg(TargetPoses(flange, _half_turned(seen), "in-hand", NAMES).data)
    assert np.flatnonzero(rows).tolist() == [2, 5, 9]


def test_rows_of_a_marker_whose_corners_begin_at_another_one_are_found():
    flange, seen, _ = target_scene(8)
    quarter = transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), np.zeros(3))
    seen[[2, 5, 9]] = seen[[2, 5, 9]] @ quarter
    data = TargetPoses(flange, seen, "in-hand", NAMES).data
    assert target_rotations_deg(data).tolist() == [90 * (k in (2, 5, 9)) for k in range(14)]
    found = review_target_poses(flange, data, "in-hand", NAMES)
    assert found.certain
    assert "row 2 (90 deg), row 5 (90 deg), row 9 (90 deg)" in found.sentences[0]


def test_rotations_that_disagree_are_not_called_no_rotations():
    """Of errors of 39 deg it is not true that the flange never turned."""
    flange, _, _ = target_scene(8)
    (sentence,) = motion(flange, "in-hand", spin=np.radians(25)).sentences
    assert "disagree by 25 deg RMS in rotation" in sentence
    assert "never turned" not in sentence
