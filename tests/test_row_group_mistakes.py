"""Mistakes that a part of the rows has in common are named, with the rows: conventions, one column, a moving arm."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from import_scenes import pose_scene, simulated
from robot_model import load_robot
from robot_model.files.loading import whole_keys
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.rows.change_points import find_new_setup
from workbench.recordings.inspection.needs import sample_needs

POINT = ("x_mm", "y_mm", "z_mm")
LATER = np.arange(60) >= 35


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    made = simulated(tmp_path_factory.mktemp("scene"), pose_scene("kuka_kr6_r900", 60, 23))
    assert check_plausibility(load_robot(made.robot), made) == ()
    return made


def found(recording, **columns):
    """The only suspicion about a recording with other columns."""
    changed = replace(recording, columns={**recording.columns, **columns})
    (one,) = check_plausibility(load_robot(recording.robot), changed)
    return one


def in_later_rows(recording, **columns):
    """The columns, changed in the later rows alone."""
    return {
        name: np.where(LATER, values, recording.columns[name]) for name, values in columns.items()
    }


def test_other_zeros_of_two_joints_in_one_of_two_files(truth):
    added = {
        "q2_deg": truth.columns["q2_deg"] + 90,
        "q3_deg": truth.columns["q3_deg"] - 90,
    }
    one = found(truth, **in_later_rows(truth, **added))
    assert one.cause == "joint-offset" and set(np.flatnonzero(LATER)) == set(one.rows)
    assert "column q2_deg is beyond the zero" in one.sentence
    assert "column q3_deg is short of the zero" in one.sentence


def test_a_coupling_that_one_of_two_files_counts_otherwise(truth):
    column = truth.columns["q3_deg"] + truth.columns["q2_deg"]
    one = found(truth, **in_later_rows(truth, q3_deg=column))
    assert one.cause == "coupled-joints" and "joint 3 lacks its coupling" in one.sentence


def test_quaternions_in_another_order_in_one_of_two_files(truth):
    order = {"qw": "qx", "qx": "qy", "qy": "qz", "qz": "qw"}
    columns = {name: truth.columns[source] for name, source in order.items()}
    one = found(truth, **in_later_rows(truth, **columns))
    assert one.cause == "quaternion-order" and set(np.flatnonzero(LATER)) == set(one.rows)


def test_a_mirrored_frame_in_one_of_two_files(truth):
    columns = {name: -truth.columns[name] for name in ("y_mm", "qx", "qz")}
    one = found(truth, **in_later_rows(truth, **columns))
    assert one.cause == "left-handed" and "mirrored in y_mm" in one.sentence


def test_a_dragged_cell_is_named_with_its_column(truth):
    values = truth.columns["x_mm"].copy()
    values[20:32] = values[20] + np.arange(12) * (values[21] - values[20])
    one = found(truth, x_mm=values)
    assert one.cause == "column-values" and set(one.rows) == set(range(22, 32))
    assert "column x_mm, whose values from sample" in one.sentence and "equal steps" in one.sentence


def test_wrong_readings_of_one_joint_are_named(truth):
    rng = np.random.default_rng(4)
    values = truth.columns["q4_deg"].copy()
    values[10:22] = rng.uniform(-90, 90, 12)
    one = found(truth, q4_deg=values)
    assert one.cause == "column-values" and "other values in column q4_deg alone" in one.sentence


def test_another_zero_of_any_size_in_some_rows_is_measured(truth):
    values = truth.columns["q3_deg"].copy()
    values[10:22] += 17.3
    one = found(truth, q3_deg=values)
    assert "-17.3 deg added to column q3_deg" in one.sentence


@pytest.mark.parametrize(
    ("step", "words"), [(-1, "before the arm had arrived"), (1, "after the arm had left")]
)
def test_readings_of_a_moving_arm_are_named(step, words, truth):
    rng = np.random.default_rng(3)
    readings = {f"q{k}_deg": truth.columns[f"q{k}_deg"].copy() for k in range(1, 7)}
    for row in range(15, 27):
        share = rng.uniform(0.02, 0.08)
        for name, values in readings.items():
            true = truth.columns[name]
            values[row] += share * (true[row + step] - true[row])
    one = found(truth, **readings)
    assert one.cause == "moving-arm" and words in one.sentence
    assert set(one.rows) == set(range(15, 27))


def test_a_pasted_block_of_readings_is_named_with_its_source(truth):
    readings = {f"q{k}_deg": truth.columns[f"q{k}_deg"].copy() for k in range(1, 7)}
    for values in readings.values():
        values[30:38] = values[12:20]
    one = found(truth, **readings)
    ids = truth.sample_ids
    assert one.cause == "copied-rows"
    assert (
        f"samples {ids[30]} to {ids[37]} hold the joint readings of samples {ids[12]} to {ids[19]}"
        in one.sentence
    )


def test_a_measurement_that_the_instrument_held_is_named(truth):
    names = (*POINT, "qw", "qx", "qy", "qz")
    measured = {name: truth.columns[name].copy() for name in names}
    for values in measured.values():
        values[[9, 22, 23, 41]] = values[[8, 21, 21, 40]]
    one = found(truth, **measured)
    assert one.cause == "held-measurements" and set(one.rows) == {9, 22, 23, 41}


def test_gross_errors_of_all_coordinates_keep_their_name(truth):
    rng = np.random.default_rng(8)
    measured = {name: truth.columns[name].copy() for name in POINT}
    for values in measured.values():
        values[[5, 17, 18, 33, 50]] += rng.uniform(-80, 80, 5)
    assert found(truth, **measured).cause == "blunders"


def test_a_second_tool_keeps_its_name(truth):
    moved = truth.points.copy()
    rotation = Rotation.from_quat(np.stack([truth.columns[f"q{c}"] for c in "xyzw"], -1))
    moved[20:40] += rotation.apply([18.0, -7.0, 42.0])[20:40]
    one = found(truth, **dict(zip(POINT, moved.T)))
    assert one.cause == "moved" and "another point on the flange" in one.sentence


def test_a_twist_of_the_other_sign_is_shown_by_check(truth):
    keys = whole_keys(truth.robot)
    joints = [dict(joint) for joint in keys["joint"]]
    joints[3]["alpha_deg"] *= -1
    (need,) = sample_needs(replace(truth, robot={**keys, "joint": joints}))
    assert need.is_mistake and need.is_required and "alpha_deg of joint 4" in need.sentence


def test_another_tool_between_rows_that_agree_is_no_move_of_another_part(truth):
    """The first and the last rows belong to one setup, however little of the misfit a change between them explains."""
    rotation = Rotation.from_quat(np.stack([truth.columns[q] for q in ("qx", "qy", "qz", "qw")], 1))
    middle = (np.arange(60) >= 20) & (np.arange(60) < 40)
    displacement = middle[:, None] * rotation.apply([18.0, -7.0, 42.0])
    moved = {name: truth.columns[name] + d for name, d in zip(POINT, displacement.T)}
    robot = load_robot(truth.robot)
    changed = replace(truth, columns={**truth.columns, **moved})
    assert find_new_setup(robot, changed, good_scale(robot, changed)) is None
    one = found(truth, **moved)
    assert one.cause == "moved" and set(one.rows) == set(np.flatnonzero(middle))
    assert "another point on the flange" in one.sentence


def test_a_lost_zero_is_named_though_one_row_fits_with_another_decimal_point(truth):
    """Among many rows and cells one fits so by chance, as here 0.0335 for 3.35 + 3.2."""
    joint = truth.columns["q4_deg"].copy()
    joint[LATER] += 3.2
    one = found(truth, q4_deg=joint)
    assert one.cause == "moved"
    assert "the zero of joint 4" in one.sentence
    assert "decimal point" not in one.sentence


def test_readings_of_the_last_joint_folded_into_half_a_turn(truth):
    folded = (truth.columns["q6_deg"] + 90) % 180 - 90
    one = found(truth, q6_deg=folded)
    wrong = np.flatnonzero(np.abs(folded - truth.columns["q6_deg"]) > 1)
    assert one.cause == "joint-offset"
    assert "180 deg added to column q6_deg" in one.sentence
    assert set(one.rows) <= set(wrong.tolist()) or set(one.rows) <= set(range(60)) - set(
        wrong.tolist()
    )
