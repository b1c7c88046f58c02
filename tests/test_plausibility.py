"""Mistakes that are often made in samples.csv are named; arms that only err as arms do are not suspected."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import datasets
from conftest import mostly_slow
from datasets.samples.columns import joint_columns
from erring_scenes import erring
from plain_frames import frames_of
from pose_scenes import random_arm
from robot_model import load_robot
from robot_model.measurements import samples_of
from scenes import ARMS, BALLS, CRAIG, KINDS, scene
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.hypotheses.corrections import observed_columns

XYZ = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")


def changed(recording, **columns):
    return replace(recording, columns={**recording.columns, **columns})


def suspicions(robot, recording):
    """What is suspected beyond the number of poses, which small test recordings rightly lack."""
    return [found for found in check_plausibility(robot, recording) if found.cause != "few-poses"]


def assert_named(robot, recording, *words):
    found = suspicions(robot, recording)
    assert found and found[0].certain, found
    sentence = found[0].sentence
    assert "recording 'scene'" in sentence and sentence.endswith(".") and "\n" not in sentence
    for word in words:
        assert word in sentence


def assert_warned(robot, recording, cause, *words):
    found = suspicions(robot, recording)
    assert [f.cause for f in found] == [cause] and not found[0].certain, found
    for word in words:
        assert word in found[0].sentence


def test_a_planned_recording_is_not_warned_of_its_stated_noise():
    """Its residuals are rounding errors of computed values; those of a measurement are named."""
    made = scene("external-point", n=60, sigma=0.05)
    assert not suspicions(made.robot, made.recording)
    rng = np.random.default_rng(0)
    noise = {key: made.recording.columns[key] + rng.normal(0, 0.001, 60) for key in XYZ}
    assert_warned(made.robot, changed(made.recording, **noise), "sigma", "times the scatter")


@pytest.mark.parametrize("measures, joint", mostly_slow(product(KINDS, (1, 3, 4)), 4, 4))
def test_a_joint_of_the_other_sign_is_named(measures, joint):
    robot, recording = erring(measures, 1)
    name = f"q{joint}_deg"
    flipped = changed(recording, **{name: -recording.columns[name]})
    assert_named(
        robot, flipped, f", column {name}:", "the opposite sign", f"sign = -1 for joint {joint} "
    )


def test_two_joints_of_the_other_sign_are_named():
    robot, recording = erring("external-point", 2)
    flipped = changed(
        recording, **{name: -recording.columns[name] for name in ("q2_deg", "q5_deg")}
    )
    assert_named(
        robot, flipped, ", columns q2_deg and q5_deg:", "have the opposite sign", "joint 2 and 5"
    )


def test_a_sliding_joint_of_the_other_sign_is_named():
    robot, recording = erring("external-point", 3, arm=ARMS["sliding"])
    assert_named(
        robot,
        changed(recording, q2_mm=-recording.columns["q2_mm"]),
        ", column q2_mm:",
        "opposite sign",
    )


SWAPPED = [("q4_deg", "q5_deg"), ("q1_deg", "q2_deg"), ("q3_deg", "q6_deg")]


@pytest.mark.parametrize("first, second", mostly_slow(SWAPPED, 1))
def test_swapped_joint_columns_are_named(first, second):
    robot, recording = erring("ball-centre", 4)
    swapped = changed(
        recording, **{first: recording.columns[second], second: recording.columns[first]}
    )
    assert_named(robot, swapped, f", columns {first} and {second}:", "are swapped")


def test_a_joint_in_radians_is_named():
    robot, recording = erring("external-point", 5)
    assert_named(
        robot,
        changed(recording, q3_deg=np.deg2rad(recording.columns["q3_deg"])),
        "q3_deg",
        "holds radians",
    )


def test_all_joints_in_radians_are_named():
    robot, recording = erring("external-pose", 5)
    names = [f"q{k}_deg" for k in range(1, 7)]
    wrong = changed(recording, **{name: np.deg2rad(recording.columns[name]) for name in names})
    assert_named(robot, wrong, "columns q1_deg, q2_deg,", "hold radians")


@pytest.mark.parametrize(
    "measures, unit",
    mostly_slow(product(KINDS, ("cm", "inches", "m", "tenths of a mm", "um")), 6, 6),
)
def test_points_in_another_unit_are_named(measures, unit):
    factors = {"cm": 0.1, "inches": 1 / 25.4, "m": 0.001, "tenths of a mm": 10, "um": 1000}
    factor = factors[unit]
    robot, recording = erring(measures, 6)
    wrong = changed(recording, **{c: factor * recording.columns[c] for c in XYZ})
    assert_named(
        robot,
        wrong,
        f"columns x_mm, y_mm and z_mm hold {unit}",
        f"multiply them by {1 / factor:g},",
    )


@pytest.mark.parametrize("measures, axis", mostly_slow(product(KINDS[:2], XYZ), 2, 2))
def test_left_handed_points_are_named(measures, axis):
    robot, recording = erring(measures, 7)
    assert_named(robot, changed(recording, **{axis: -recording.columns[axis]}), "left-handed")


@pytest.mark.parametrize("axis", mostly_slow(XYZ, 1, 1))
def test_a_mirrored_axis_is_named_where_orientations_are_measured(axis):
    robot, recording = erring("external-pose", 8)
    assert_named(
        robot,
        changed(recording, **{axis: -recording.columns[axis]}),
        f", column {axis}:",
        "opposite sign",
    )


def test_swapped_axes_are_named_where_orientations_are_measured():
    robot, recording = erring("external-pose", 8)
    columns = recording.columns
    assert_named(
        robot,
        changed(recording, x_mm=columns["y_mm"], y_mm=columns["x_mm"]),
        "x_mm and y_mm are swapped",
    )


def test_a_quaternion_that_turns_the_other_way_is_named():
    robot, recording = erring("external-pose", 9)
    wrong = changed(recording, **{c: -recording.columns[c] for c in QUATERNION[1:]})
    assert_named(robot, wrong, "columns qw, qx, qy and qz hold the inverse rotation")


def test_a_quaternion_with_w_last_is_named():
    robot, recording = erring("external-pose", 9)
    wrong = changed(
        recording, **{c: recording.columns[f"q{old}"] for c, old in zip(QUATERNION, "xyzw")}
    )
    assert_named(robot, wrong, "in the order x, y, z, w")


@pytest.mark.parametrize("pair", [(1, 2), (2, 7), (4, 7)])
def test_two_swapped_balls_are_named(pair):
    robot, recording = erring("ball-centre", 10)
    label, (a, b) = recording.columns["ball"], pair
    swapped = changed(recording, ball=np.where(label == a, b, np.where(label == b, a, label)))
    assert_named(robot, swapped, f"column ball, numbers {a} and {b}", "are swapped")


@pytest.mark.parametrize("size_deg", [0.05, 0.4])
def test_a_joint_that_lost_counts_is_named_and_not_the_base(size_deg):
    """Readings of joint 3 are off from sample 60 on; a motion of the base would need six numbers for it."""
    robot, recording = erring("external-point", 6, n=120)
    wrong = recording.columns["q3_deg"] + size_deg * (np.arange(120) >= 60)
    assert_warned(robot, changed(recording, q3_deg=wrong), "moved", "the zero of joint 3")


def test_single_rows_of_another_ball_are_named():
    robot, recording = erring("ball-centre", 11)
    label = recording.columns["ball"].copy()
    assert (label[[4, 16]] == 1).all()
    label[[4, 16]] = 4.0
    wrong = changed(recording, ball=label)
    assert_warned(robot, wrong, "ball-labels", "sample 5 (ball 4 for 1) and 17 (ball 4 for 1);")


@pytest.mark.parametrize("measures, step", mostly_slow(product(KINDS, (1, -1)), 2, 3))
def test_positions_of_the_neighbouring_row_are_named(measures, step):
    words = {1: "of the row before", -1: "of the row after"}[step]
    robot, recording = erring(measures, 12)
    observed_too = observed_columns(recording)
    late = changed(recording, **{c: np.roll(recording.columns[c], step) for c in observed_too})
    assert_named(robot, late.select(np.arange(1, 59)), words)


@pytest.mark.parametrize("measures", mostly_slow(KINDS, 0, 1))
def test_shuffled_rows_are_named_but_nothing_is_to_be_changed(measures):
    robot, recording = erring(measures, 13)
    order = np.random.default_rng(13).permutation(recording.n)
    shuffled = changed(
        recording, **{c: recording.columns[c][order] for c in observed_columns(recording)}
    )
    assert_warned(
        robot, shuffled, "rows-shuffled", "no better than in random order", "mm are expected"
    )


@pytest.mark.parametrize("measures, seed", mostly_slow(product(KINDS, range(8)), 9, 9))
def test_an_arm_off_its_data_sheet_is_not_suspected(measures, seed):
    arm = list(ARMS.values())[seed % len(ARMS)]
    robot, recording = erring(
        measures, 100 + seed, n=(12, 20, 40, 80)[seed % 4], lengths=1.0, degrees=0.2, arm=arm
    )
    assert suspicions(robot, recording) == []


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("seed", [0])
def test_zero_offsets_of_degrees_are_never_called_a_mistake(measures, seed):
    robot, recording = erring(measures, 200 + seed, degrees=3.0)
    assert not any(found.certain for found in suspicions(robot, recording))


@pytest.mark.parametrize("measures", mostly_slow(KINDS, 2))
def test_gross_errors_are_named_by_sample(measures):
    robot, recording = erring(measures, 14)
    z = recording.columns["z_mm"].copy()
    z[[3, 30]] += 300.0
    assert_warned(
        robot, changed(recording, z_mm=z), "blunders", "2 of 60 rows", "(samples 4 and 31)"
    )


def test_a_mistake_is_named_although_a_row_is_lost():
    robot, recording = erring("external-point", 15)
    z = recording.columns["z_mm"].copy()
    z[7] += 400.0
    assert_named(
        robot, changed(recording, z_mm=z, q4_deg=-recording.columns["q4_deg"]), ", column q4_deg:"
    )


def test_a_zero_of_a_reversed_joint_is_changed_in_its_own_direction():
    """Both remedies that the sentence offers are the same change; a joint with sign -1 has theta = -reading + zero."""
    robot, recording = erring("external-point", 21, arm=CRAIG)
    moved = changed(recording, q2_deg=recording.columns["q2_deg"] - 90)
    assert_named(
        robot, moved, "column q2_deg:", "add 90 degrees", "or -90 to theta_deg of joint 2 of"
    )
    rows = [dict(row) for row in CRAIG["joint"]]
    rows[1]["theta_deg"] -= 90
    corrected = CRAIG | {"joint": rows}
    assert suspicions(load_robot(corrected), replace(moved, robot=corrected)) == []


@pytest.mark.parametrize("measures, n", mostly_slow(product(KINDS, (3, 4, 5)), 5))
def test_too_few_rows_say_nothing_certain(measures, n):
    robot, recording = erring(
        measures, 16, n=n, balls={1: BALLS[1]}, reflectors={1: (30.0, -40.0, 100.0)}
    )
    assert not any(found.certain for found in suspicions(robot, recording))


def test_many_rows_are_thinned_but_no_ball_is_lost():
    robot, recording = erring("ball-centre", 17, n=1200)
    seventh = recording.columns["ball"] == 7
    right = recording.select(~seventh | (np.cumsum(seventh) <= 3))
    wrong = changed(right, q3_deg=-right.columns["q3_deg"])
    assert (right.ball == 7).sum() == 3
    assert suspicions(robot, right) == []
    assert_named(robot, wrong, ", column q3_deg:")


REAL = (
    "irb120_faro",
    "irb120_wu_arm",
    "fanuc165f_innopolis",
    "hilti_jaibot_tilt:flat",
    "motoman_leica_ctu:left",
    "motoman_leica_ctu:right",
)


@pytest.mark.parametrize("name", REAL)
def test_real_recordings_are_not_suspected(name, real):
    real(name.partition(":")[0])
    recording = samples_of(datasets.read(name))
    assert check_plausibility(load_robot(recording.robot), recording) == ()


def test_deflections_at_constant_orientation_are_no_offset_of_the_ranges(real):
    """An offset of 8 mm lowered the misfit from 0.067 to 0.056 mm, and was called a wrong reflector constant."""
    real("motoman_leica_ctu")
    recording = samples_of(datasets.read("motoman_leica_ctu:right"))
    half = recording.select(np.arange(0, recording.n, 2))
    assert check_plausibility(load_robot(half.robot), half) == ()


def test_the_bundled_recording_is_not_suspected():
    recording = samples_of(datasets.read("elastic-arm"))
    assert check_plausibility(load_robot(recording.robot), recording) == ()


@pytest.mark.parametrize("joint", mostly_slow([2, 5, 6], 1, 1))
def test_orientation_counts_as_much_as_position(joint):
    """A joint whose sign hardly moves the point: the target is near the wrist centre, so only rotations show it."""
    made = scene("external-pose", n=60, seed=21)
    tool = np.eye(4)
    tool[:3, 3] = np.linalg.inv(load_flange(made.robot))[:3, 3]
    robot, recording = made.robot, observed_with_tool(made, tool)
    assert suspicions(robot, recording) == []
    name = f"q{joint}_deg"
    assert_named(
        robot,
        changed(recording, **{name: -recording.columns[name]}),
        f"column {name}",
        " deg as recorded",
    )


def load_flange(robot):
    """T_wrist_flange of the arm at rest: the wrist centre in the flange frame is at -d6 along z."""
    out = np.eye(4)
    out[2, 3] = robot.geometry[-1, 1]
    return out


def observed_with_tool(made, tool):
    """The scene with noise, its target at `tool` on the flange."""
    rng = np.random.default_rng(1)
    readings = made.recording.joints
    targets = made.base @ np.array([frames_of(made.robot, q)[-1] for q in readings]) @ tool
    turns = Rotation.from_matrix(targets[:, :3, :3]) * Rotation.from_rotvec(
        2e-4 * rng.normal(size=(len(targets), 3))
    )
    points = targets[:, :3, 3] + 0.02 * rng.normal(size=(len(targets), 3))
    columns = dict(zip(XYZ, points.T)) | {f"q{c}": v for c, v in zip("xyzw", turns.as_quat().T)}
    return changed(made.recording, **columns)


@pytest.mark.parametrize(("spread", "seed"), [(0.05, 0), (0.5, 1), (5.0, 2)])
def test_poses_of_nearly_one_orientation_get_no_advice(spread, seed):
    """Positions vary, orientations by `spread` degrees only: nothing wrong is found, and no sign is to be changed."""
    robot, recording = nearly_one_orientation(spread, seed)
    assert not any(found.certain for found in check_plausibility(robot, recording))
    assert {found.cause for found in suspicions(robot, recording)} <= set()


def nearly_one_orientation(spread, seed):
    """An arm that reaches points with a nearly constant flange, by inverse kinematics from random starts."""
    made = scene("external-pose", n=40, seed=30 + seed)
    robot, rng = made.robot, np.random.default_rng(seed)
    middle = np.array([0.1, 0.2, 0.1, 0.2, 0.9, 0.3])
    home = frames_of(robot, middle)[-1]
    readings = []
    while len(readings) < 40:
        goal = home.copy()
        goal[:3, 3] += rng.uniform(-120, 120, 3)
        goal[:3, :3] = (
            Rotation.from_rotvec(np.deg2rad(spread) * rng.normal(size=3) / 1.7).as_matrix()
            @ home[:3, :3]
        )
        found = least_squares(lambda q, goal=goal: pose_gap(robot, q, goal), middle, xtol=1e-12)
        if found.cost < 1e-6:
            readings.append(found.x)
    columns = {f"q{k + 1}_deg": np.rad2deg(row) for k, row in enumerate(np.array(readings).T)}
    moved = replace(made, recording=changed(made.recording, **columns))
    return robot, observed_with_tool(moved, made.tool)


def pose_gap(robot, q, goal):
    reached = frames_of(robot, q)[-1]
    turn = Rotation.from_matrix(reached[:3, :3] @ goal[:3, :3].T).as_rotvec()
    return np.concatenate([reached[:3, 3] - goal[:3, 3], 300 * turn])


def test_rounded_readings_of_coupled_joints_are_named():
    arm = random_arm(np.random.default_rng(2))
    arm["joint"][2]["coupled"] = {"joint": 2, "ratio": 1.0}
    robot, recording = erring("external-point", 5, n=90, arm=arm)
    readings = {
        name: np.round(2 * recording.columns[name]) / 2 for name in joint_columns(recording.columns)
    }
    found = suspicions(robot, changed(recording, **readings))
    assert [one.cause for one in found] == ["rounding"], found
