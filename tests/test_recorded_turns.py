"""Targets that are poses take the revolution of a joint that the recording has."""

from dataclasses import replace

import numpy as np

from counted_robots import arm, counted
from robot_model import load_robot
from workbench.jobs.robot.compensation.compensate import nominal_poses
from workbench.jobs.robot.compensation.revolutions import nearest_revolutions, recorded_middle

ROBOT = counted("ABB")
OPEN = replace(ROBOT, limits=np.full((6, 2), np.nan))


def test_readings_without_limits_come_next_to_the_recorded_range():
    recorded = np.array([[-300.0, -30, -30, -100, 200, 10], [-10, 40, 20, 100, 350, 200]])
    wanted = np.array([[-200.0, 10, -20, 60, 300, 150]])
    other = wanted + [[360, 0, 0, -720, 0, 360]]
    middle = recorded_middle(arm(OPEN, recorded))
    found = nearest_revolutions(OPEN, np.deg2rad(other), middle)
    np.testing.assert_allclose(np.rad2deg(found), wanted, atol=1e-9)
    np.testing.assert_allclose(nominal_poses(OPEN, found), nominal_poses(OPEN, np.deg2rad(wanted)))


def test_limits_and_slides_stay():
    robot = load_robot("ur10")  # its joints turn from -360 to 360 deg
    reference = np.deg2rad([300.0, 0, 0, 0, 0, 0])
    found = nearest_revolutions(robot, np.deg2rad([[-40.0, 200, -300, 10, 10, 10]]), reference)
    np.testing.assert_allclose(np.rad2deg(found), [[320, -160, 60, 10, 10, 10]])
    narrow = nearest_revolutions(
        ROBOT, np.deg2rad([[-170.0, 0, 0, 0, 0, 0]]), np.deg2rad([[190.0] * 6])
    )
    np.testing.assert_allclose(np.rad2deg(narrow[0, 0]), -170)
