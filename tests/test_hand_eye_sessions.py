"""Hand-eye: a mistake in the rows from some row on is named with these rows; mirrored and scaled target positions."""

import numpy as np
import pytest

from sensors.hand_eye.checks.target_review import review_target_poses
from sensors.hand_eye.target_poses import TargetPoses
from target_scenes import target_scene
from workbench.core.rigid import inverse, transform

COUNT = 24
NAMES = [f"row {k}" for k in range(COUNT)]


def reviewed(flange, seen, kind):
    data = TargetPoses(flange, seen, kind, NAMES[: len(flange)]).data
    return review_target_poses(flange, data, kind, NAMES[: len(flange)])


def made(kind):
    flange, seen, _ = target_scene(5, count=COUNT, kind=kind, sigma=(0.1, 0.001))
    assert not reviewed(flange, seen, kind).findings
    return flange, seen


@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
def test_target_poses_that_are_inverted_from_a_row_on(kind):
    flange, seen = made(kind)
    seen[15:] = inverse(seen[15:])
    (finding,) = reviewed(flange, seen, kind).findings
    assert finding.cause == "target-inverse" and finding.certain
    assert "in row 15 to row 23 alone" in finding.sentence


@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
def test_target_positions_in_inches_up_to_a_row(kind):
    flange, seen = made(kind)
    seen[:7, :3, 3] /= 25.4
    (finding,) = reviewed(flange, seen, kind).findings
    assert finding.cause == "target-unit" and "in row 0 to row 6 alone" in finding.sentence


@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
def test_a_flange_pose_that_is_missing_in_one_row(kind):
    flange, seen = made(kind)
    flange, seen = np.delete(flange, 9, axis=0), seen[:-1]
    (finding,) = reviewed(flange, seen, kind).findings
    assert finding.cause == "shifted" and "to row 22 alone" in finding.sentence


@pytest.mark.parametrize(("axis", "name"), [(0, "x_mm"), (1, "y_mm"), (2, "z_mm")])
def test_a_coordinate_of_the_target_with_the_opposite_sign(axis, name):
    flange, seen = made("in-hand")
    seen[:, axis, 3] *= -1
    (finding,) = reviewed(flange, seen, "in-hand").findings
    assert finding.cause == "target-axis" and f"the column {name} of the target" in finding.sentence


def test_target_poses_in_a_left_handed_frame():
    flange, seen = made("in-hand")
    mirror = np.diag([1.0, -1.0, 1.0])
    mirrored = transform(mirror @ seen[:, :3, :3] @ mirror, seen[:, :3, 3] @ mirror)
    causes = [finding.cause for finding in reviewed(flange, mirrored, "in-hand").findings]
    assert causes in (["target-mirrored"], ["mirrored"])
