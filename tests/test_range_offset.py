"""A constant error of all ranges of the instrument, such as that of another reflector, is named with its size."""

from dataclasses import replace

import numpy as np
import pytest

from import_scenes import pose_scene, simulated
from robot_model import load_robot
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.range_offset import CAUSE, range_offset, shortened_columns

POINT = ("x_mm", "y_mm", "z_mm")


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), pose_scene("kuka_kr6_r900", 60, 23))


def lengthened(recording, offset):
    columns = shortened_columns(recording.columns, -offset)
    return replace(recording, columns={**recording.columns, **columns})


def test_the_offset_is_that_which_was_added(truth):
    robot = load_robot(truth.robot)
    found = range_offset(robot, lengthened(truth, 19.05))
    assert abs(found.offset - 19.05) < 4 * found.std < 2.0
    back = shortened_columns(lengthened(truth, 19.05).columns, 19.05)
    for name in POINT:
        np.testing.assert_allclose(back[name], truth.columns[name], atol=1e-9)


def test_check_names_the_offset_and_is_silent_without_it(truth):
    robot = load_robot(truth.robot)
    assert check_plausibility(robot, truth) == ()
    (one,) = check_plausibility(robot, lengthened(truth, 19.05))
    assert one.cause == CAUSE and not one.certain
    assert "too far along the sight line" in one.sentence and "reflector constant" in one.sentence


def test_no_offset_where_the_origin_is_among_the_points(truth):
    centred = {name: truth.columns[name] - truth.columns[name].mean() for name in POINT}
    moved = replace(truth, columns={**truth.columns, **centred})
    assert range_offset(load_robot(truth.robot), lengthened(moved, 19.05)) is None
