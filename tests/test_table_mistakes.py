"""Mistakes of tables are named: minutes of arc for decimals, angles in another order, sorted columns, lost points."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
from datasets.errors import InputError
from import_scenes import pose_scene, simulated
from robot_model import load_robot
from robot_model.files.loading import whole_keys
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.hypotheses.joint_corrections import joint_corrections

JOINTS = tuple(f"q{k}_deg" for k in range(1, 7))
VECTOR_FIRST = ("qx", "qy", "qz", "qw")


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), pose_scene("kuka_kr6_r900", 60, 29))


def found(recording, **columns):
    changed = replace(recording, columns={**recording.columns, **columns})
    return check_plausibility(load_robot(recording.robot), changed)


def in_minutes(degrees, seconds=False):
    """12.5 becomes 12.30, with seconds 12.3000."""
    size = np.abs(degrees)
    minutes = 60 * (size % 1)
    if seconds:
        minutes = np.floor(minutes) + 60 * (minutes % 1) / 100
    return np.sign(degrees) * (np.floor(size) + minutes / 100)


@pytest.mark.parametrize("seconds", [False, True])
def test_minutes_of_arc_for_decimals_are_named(seconds, truth):
    (one,) = found(truth, **{name: in_minutes(truth.columns[name], seconds) for name in JOINTS})
    assert one.cause == "joint-unit" and one.certain
    words = "minutes and seconds of arc" if seconds else "degrees with minutes of arc"
    assert words in one.sentence


def test_one_column_in_degrees_and_minutes_is_named(truth):
    (one,) = found(truth, q3_deg=in_minutes(truth.columns["q3_deg"]))
    assert "column q3_deg holds degrees with minutes of arc" in one.sentence


def test_decimals_of_degrees_are_not_taken_for_minutes(truth):
    named = [c.statement for c in joint_corrections(load_robot(truth.robot), truth)]
    assert named and not any("of arc in the place" in statement for statement in named)


@pytest.mark.parametrize(("written", "read"), [("XYZ", "xyz"), ("zyx", "xyz"), ("zxy", "xyz")])
def test_angles_that_were_read_in_another_order_are_named(written, read, truth):
    rotation = Rotation.from_quat(np.stack([truth.columns[name] for name in VECTOR_FIRST], -1))
    misread = Rotation.from_euler(read, rotation.as_euler(written)).as_quat().T
    (one,) = found(truth, **dict(zip(VECTOR_FIRST, misread)))
    assert one.cause == "angle-order" and one.certain


def test_a_joint_column_that_was_sorted_alone_is_named(truth):
    one = found(truth, q2_deg=np.sort(truth.columns["q2_deg"]))[0]
    assert one.cause == "sorted-column" and "column q2_deg" in one.sentence


def test_measurements_that_were_sorted_alone_are_named(truth):
    order = np.argsort(truth.columns["z_mm"])
    names = ("x_mm", "y_mm", "z_mm", *VECTOR_FIRST)
    one = found(truth, **{name: truth.columns[name][order] for name in names})[0]
    assert one.cause == "sorted-column" and "the measurement was sorted by z_mm" in one.sentence


def test_cells_without_their_decimal_point_are_named_and_not_the_joints(truth, tmp_path):
    values = truth.columns["z_mm"].copy()
    values[[4, 17, 40]] = 1000 * (values[[4, 17, 40]] + 5000.0)
    columns = {**truth.columns, "z_mm": values}
    changed = replace(truth, columns=columns, robot=whole_keys(truth.robot))
    datasets.write(changed, tmp_path / "made")
    with pytest.raises(InputError, match=r"column z_mm, samples .*decimal point or comma is lost"):
        datasets.read(tmp_path / "made")
