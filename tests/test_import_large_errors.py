"""Tables of arms with errors of several millimetres: accepted with the misfit, where one reading explains the points."""

import numpy as np
import pytest

from import_scenes import write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.jobs.robot.compensation.compensate import nominal_poses
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.robots import robot_keys

SEVEN_AXES = """joint,theta [deg],d [mm],a [mm],alpha [deg]
1,0,310,70,-90
2,0,0,0,90
3,0,290,20,-90
4,0,0,-30,90
5,0,270,0,-90
6,0,0,0,90
7,0,60,0,0
"""
THREE_AXES = """joint,theta [deg],d [mm],a [mm],alpha [deg]
1,0,120,0,90
2,0,0,160,0
3,0,0,130,0
"""
POINT = ["x", "y", "z"]


class Arm:
    """An arm with a table, and points (n, 3) mm that an instrument measures with errors of `error_mm` a coordinate."""

    def __init__(self, folder, table, error_mm, rows, seed):
        self.path = folder / "arm_standard.csv"
        self.path.write_text(table)
        robot = load_robot(robot_keys(str(self.path), "arm"))
        random = np.random.default_rng(seed)
        self.joints = random.uniform(-1.3, 1.3, (rows, robot.joints))
        self.random = random
        self.error_mm = error_mm
        poses = nominal_poses(robot, self.joints)
        self.points = poses[:, :3, :3] @ [15.0, 40.0, 85.0] + poses[:, :3, 3] + [700, -200, 300]
        self.points += random.normal(size=self.points.shape) * error_mm
        self.headers = [f"q{k}" for k in range(1, robot.joints + 1)]

    def imported(self, folder, joints=None, points=None):
        """The import of radians and metres whose headers state no unit."""
        joints = self.joints if joints is None else joints
        points = self.points if points is None else points
        cells = np.column_stack([joints, points / 1000])
        path = write_rows(folder / "t.csv", [*self.headers, *POINT], cells)
        return import_recording([path], folder / "out", ImportOptions(robot=str(self.path)))


@pytest.fixture(scope="module")
def inaccurate(tmp_path_factory):
    return Arm(tmp_path_factory.mktemp("arm"), SEVEN_AXES, error_mm=4.0, rows=45, seed=3)


def test_an_inaccurate_arm_is_accepted_with_its_misfit(inaccurate, tmp_path):
    made = inaccurate.imported(tmp_path)
    assert np.allclose(made.recording.columns["q3_deg"], np.rad2deg(inaccurate.joints[:, 2]))
    assert np.allclose(made.recording.columns["y_mm"], inaccurate.points[:, 1], atol=1e-3)
    assert 4 < made.fits[0].rms_mm < 9
    said = [sentence for sentence in made.suspicions if "large errors only" in sentence]
    assert len(said) == 1 and f"{made.fits[0].rms_mm:.3g} mm" in said[0]


def test_a_row_far_off_is_named_where_all_rows_have_large_errors(inaccurate, tmp_path):
    points = inaccurate.points.copy()
    points[17] += [60.0, -50.0, 40.0]
    made = inaccurate.imported(tmp_path, points=points)
    assert any("1 of 45 rows is off" in s and "sample 18" in s for s in made.suspicions)


def test_points_of_other_rows_stay_refused(inaccurate, tmp_path):
    points = inaccurate.random.permutation(inaccurate.points)
    with pytest.raises(InputError):
        inaccurate.imported(tmp_path, points=points)


def test_a_misfit_near_the_scatter_of_the_points_is_refused_with_the_limit(inaccurate, tmp_path):
    wide = inaccurate.random.normal(size=inaccurate.points.shape) * 40.0
    with pytest.raises(InputError, match=r"scatter of the points, where at most 5 % are accepted"):
        inaccurate.imported(tmp_path, points=inaccurate.points + wide)


def test_a_reversed_joint_of_an_inaccurate_arm_is_named(tmp_path):
    arm = Arm(tmp_path, THREE_AXES, error_mm=1.5, rows=12, seed=8)
    arm.headers = ["q1 [rad]", "q2 [rad]", "q3 [rad]"]
    joints = arm.joints * [1.0, -1.0, 1.0]
    with pytest.raises(InputError, match=r"q2.* opposite sign"):
        arm.imported(tmp_path, joints=joints)
