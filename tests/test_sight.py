"""Poses for a sensor that sees so far, so wide and only the top of a ball: what it cannot see is never chosen."""

import numpy as np
import pytest

from plain_frames import frames_of
from robot_model import load_robot
from scenes import scene
from workbench.core.errors import InputError
from workbench.files.images.visibility import BEHIND_HORIZON, OUTSIDE_FIELD, TOO_FAR, Sight
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.poses import choose_poses
from workbench.jobs.robot.simulate import simulate

SCENE = """
robot = "fanuc_lr_mate_200id"
measures = "ball-centre"
samples = 160
seed = 3
share_of_limits = 1.0
stand_off_mm = [180.0, 260.0]
field_deg = 12.0
cap_deg = 35.0
balls = [[420, 90, 60, 15], [470, -110, 80, 15], [330, 30, 50, 15]]
[tool]
xyz_mm = [6, 1.5, 60]
"""


@pytest.fixture(scope="module")
def looking(tmp_path_factory):
    """Views within 180 to 260 mm along the axis, 12 deg off it and 35 deg off the vertical."""
    path = tmp_path_factory.mktemp("scene") / "looking.toml"
    path.write_text(SCENE, encoding="utf-8")
    return simulate(path)


def test_a_scene_draws_views_within_its_stand_off_field_and_cap(looking):
    seen = looking.points.T
    assert 170 < seen[2].min() < 190 and 250 < seen[2].max() < 270
    off = np.rad2deg(np.arctan2(np.hypot(*seen[:2]), seen[2]))
    assert 7 < off.max() < 12.2
    robot = load_robot(looking.robot)
    down = np.array(
        [-frames_of(robot, q)[-1][2, 2] for q in looking.joints]
    )  # its z axis against the vertical
    assert np.cos(np.deg2rad(36)) < down.min() < np.cos(np.deg2rad(30))


def test_what_is_chosen_lies_within_the_sight(looking):
    sight = Sight((190.0, 250.0), 8.0, 25.0)
    found = choose_poses(looking, 30, link_radius_mm=0, sight=sight)
    rows = np.isin(looking.sample_ids, found.samples)
    seen = looking.points[rows].T
    distance = np.linalg.norm(seen, axis=0)
    assert rows.sum() == 30 and distance.min() >= 190 and distance.max() <= 250
    assert np.rad2deg(np.arctan2(np.hypot(*seen[:2]), seen[2])).max() <= 8
    robot = load_robot(looking.robot)
    hand = np.eye(4)
    hand[:3, 3] = [6, 1.5, 60]
    balls = np.array([looking.balls[b][:3] for b in looking.ball[rows]])
    eyes = np.array([(frames_of(robot, q)[-1] @ hand)[:3, 3] for q in looking.joints[rows]])
    up = (eyes - balls) / np.linalg.norm(eyes - balls, axis=1)[:, None]
    assert np.rad2deg(np.arccos(up[:, 2])).max() < 25 + 0.3  # base and hand-eye are those fitted
    left = found.left_out
    assert min(left[TOO_FAR], left[OUTSIDE_FIELD], left[BEHIND_HORIZON]) > 0
    assert found.candidates == looking.n - sum(left.values())


def test_what_may_be_seen_everywhere_leaves_nothing_out(looking):
    found = choose_poses(looking, 30, link_radius_mm=0, sight=Sight((0, 1e4), 90.0, 180.0))
    assert not any(found.left_out.values()) and found.candidates == looking.n


def test_a_narrow_sight_still_beats_random(looking):
    found = choose_poses(looking, 25, link_radius_mm=0, sight=Sight((185.0, 255.0)))
    assert found.design.gain > 1.1


@pytest.mark.parametrize(
    ("sight", "words"),
    [
        (Sight((300.0, 200.0)), "--stand-off 300 200: expected the nearest and the farthest"),
        (Sight(field_deg=0.0), "--field 0: expected an angle above 0"),
        (Sight(cap_deg=200.0), "--cap 200: expected an angle above 0 and up to 180"),
        (
            Sight((1000.0, 2000.0)),
            "expected at least 2 poses that can be used, found 0 \\(160 out of the stand-off\\)",
        ),
    ],
)
def test_a_sight_that_cannot_be_is_a_sentence(looking, sight, words):
    with pytest.raises(InputError, match=words):
        choose_poses(looking, 20, link_radius_mm=0, sight=sight)


def test_nothing_looks_where_an_instrument_measures():
    with pytest.raises(
        InputError, match="expected candidates that measure ball-centre.*found external-point"
    ):
        choose_poses(scene("external-point", n=60).recording, 20, sight=Sight((100.0, 200.0)))


def test_a_scene_of_another_sight_calibrates(looking):
    assert calibrate(looking, folds=5).held_out["rms_mm"] < 2 * looking.sigma_mm * 3**0.5


def test_criteria_and_tasks_go_together(looking):
    with pytest.raises(
        InputError, match="--criterion X: expected one of D, O1.* found none of them"
    ):
        choose_poses(looking, 20, "X")
    with pytest.raises(
        InputError, match="--criterion task: expected --tasks RECORDING .* found none"
    ):
        choose_poses(looking, 20, "task")
