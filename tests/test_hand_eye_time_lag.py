"""Flange poses of another moment than the images: recognised with their share of the motion, and not suspected else."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hand_eye_scenes import CAMERA, board, images
from sensors.hand_eye.checks.time_lag import without_lag
from sensors.hand_eye.images import review_views


def lagging(flange, step, share):
    """Poses on the way to those `step` rows later, as a controller moves in a line; one row has another neighbour."""
    found = flange.copy()
    for row, pose in enumerate(flange):
        if not 0 <= row + step < len(flange):
            found[row, :3, 3] += share * np.array([50.0, -30.0, 40.0])
            continue
        other = flange[row + step]
        turn = Rotation.from_matrix(pose[:3, :3].T @ other[:3, :3]).as_rotvec()
        found[row, :3, :3] = pose[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
        found[row, :3, 3] = (1 - share) * pose[:3, 3] + share * other[:3, 3]
    return found


@pytest.mark.parametrize("step", [1, -1])
def test_the_true_poses_are_found_from_recorded_ones(step):
    _, flange = images(3)
    found = without_lag(lagging(flange, step, 0.2), step, 0.2)
    rows = slice(0, 4) if step == 1 else slice(-4, None)
    np.testing.assert_allclose(found[rows], flange[rows], atol=0.01)


@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
@pytest.mark.parametrize(("step", "words"), [(1, "the next pose"), (-1, "the previous pose")])
@pytest.mark.parametrize("share", [0.02, 0.25])
def test_poses_of_another_moment_are_named_with_their_share(kind, step, words, share):
    views, flange = images(31, kind)
    found = review_views(views, board(), CAMERA, lagging(flange, step, share), kind)
    (finding,) = found.findings
    assert finding.cause == "lag" and words in finding.sentence
    assert "different moments" in finding.sentence
    stated = float(finding.sentence.split(" % of the motion")[0].rsplit(" ", 1)[1]) / 100
    assert abs(stated - share) < 0.003


@pytest.mark.parametrize("seed", range(40, 46))
@pytest.mark.parametrize("kind", ["in-hand", "to-hand"])
def test_errors_of_an_arm_are_no_lag(kind, seed):
    """An arm that is off by 0.05 mm and by 1 mm, and rows that are shifted by one."""
    views, flange = images(seed, kind)
    random = np.random.default_rng(seed)
    rough = flange.copy()
    rough[:, :3, 3] += random.normal(0, 0.6, (len(flange), 3))
    for poses in (flange, rough, np.roll(flange, 1, 0)):
        found = review_views(views, board(), CAMERA, poses, kind)
        assert "lag" not in [finding.cause for finding in found.findings]
