"""Ranges of joints that a solution was fitted on: broken ones, and joints that stood still."""

import numpy as np
import pytest

from robot_model import load_robot
from robot_model.system import geometry_priors
from scenes import ABB
from test_correction_limits import solution
from workbench.core.errors import InputError
from workbench.files.solution_file import read_solution
from workbench.jobs.robot.compensation.compensate import compensate


@pytest.mark.parametrize("ranges", [[1], {"q1_deg": 3}, {"q1_deg": ["a", "b"]}, "x"])
def test_broken_ranges_are_a_sentence(tmp_path, ranges):
    with pytest.raises(InputError, match="expected a whole solution/1 file"):
        read_solution(solution(tmp_path / "arm", fitted_range=ranges))


def test_joints_that_stood_still_do_not_take_part_where_others_can(tmp_path):
    """A rail before a six-axis arm: its axis is unknown where it never moved, and the six reach the target alone."""
    robot = {
        "name": "rail and arm",
        "convention": "distal",
        "joint": [
            {"theta_deg": 0.0, "d_mm": 0.0, "a_mm": 0.0, "alpha_deg": 90.0, "kind": "prismatic"},
            *_rows(ABB),
        ],
    }
    arm = load_robot(robot)
    values = {key: nominal for key, (nominal, _) in geometry_priors(arm).items()}
    values |= {f"base.{c}": 0.0 for c in ("x", "y", "z", "rx", "ry", "rz")} | {
        "joint-4.theta4": values["joint-4.theta4"] + 0.01
    }
    ranges = {"q1_mm": [100.0, 100.0]} | {f"q{k}_deg": [-100.0, 100.0] for k in range(2, 8)}
    folder = solution(
        tmp_path / "arm", robot=robot, values=values, free=[], covariance=[], fitted_range=ranges
    )
    readings = np.array([[100.0, *np.deg2rad([10, 10, 10, 10, 40, 0])]])
    found = compensate(read_solution(folder), readings)
    assert found.reached.all() and abs(found.readings[0, 0] - 100) < 1e-3
    assert found.position_mm[0] > 1


def _rows(spec):
    import tomllib
    from importlib import resources

    text = (
        resources.files("robot_model")
        .joinpath("robots", f"{spec['builtin']}.toml")
        .read_text(encoding="utf-8")
    )
    return tomllib.loads(text)["joint"]
