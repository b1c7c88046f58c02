"""Mistakes that are often made in samples.csv are named; arms that only err as arms do are not suspected."""

from dataclasses import replace

import numpy as np
import pytest

import datasets
from robot_model import load_robot
from robot_model.system import bind, geometry_free
from scenes import ARMS, BALLS, KINDS, model_of, observed, scene
from workbench.core.model import Model
from workbench.core.solve import solve
from workbench.plans import frames_of
from workbench.suspicion import suspicion

XYZ = ("x_mm", "y_mm", "z_mm")
QUATERNION = ("qw", "qx", "qy", "qz")


def erring(measures, seed, n=60, lengths=0.4, degrees=0.06, **more):
    """A scene whose arm is off its data sheet by so much (1 sigma), measured with noise."""
    made = scene(measures, n=n, seed=seed, **more)
    rng, model = np.random.default_rng(seed), model_of(made)
    truth = model.parameters
    free = truth.only(truth.matching(*geometry_free(made.robot)))
    size = np.array([np.deg2rad(degrees) if p.unit == "rad" else lengths for p in free.table])[free.mask]
    truth = free.unpack(free.pack() + size * rng.standard_normal(len(size)))
    points = observed(model, truth, rng).chain.measurement.measured
    return made.robot, changed(made.recording, **dict(zip(XYZ, points)))


def changed(recording, **columns):
    return replace(recording, columns={**recording.columns, **columns})


def nominal_rms(robot, recording):
    model = Model(bind(robot, recording))
    start = model.parameters
    fit = solve(model, start.only(start.matching(*frames_of(start))))
    return float(np.sqrt((fit.residual[:3] ** 2).sum(0).mean()))


def told(robot, recording):
    return suspicion(robot, recording, nominal_rms(robot, recording))


def assert_named(robot, recording, *words):
    found = told(robot, recording)
    assert found is not None and found.certain, found
    assert "recording 'scene'" in found.sentence and found.sentence.endswith(".") and "\n" not in found.sentence
    for word in words:
        assert word in found.sentence


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("joint", [1, 3, 4])
def test_a_joint_of_the_other_sign_is_named(measures, joint):
    robot, recording = erring(measures, 1)
    name = f"q{joint}_deg"
    flipped = changed(recording, **{name: -recording.columns[name]})
    assert_named(robot, flipped, f", column {name}:", "the opposite sign", f"sign = -1 for joint {joint} ")


def test_two_joints_of_the_other_sign_are_named():
    robot, recording = erring("external-point", 2)
    flipped = changed(recording, **{name: -recording.columns[name] for name in ("q2_deg", "q5_deg")})
    assert_named(robot, flipped, ", columns q2_deg and q5_deg:", "have the opposite sign", "joint 2 and 5")


def test_a_sliding_joint_of_the_other_sign_is_named():
    robot, recording = erring("external-point", 3, arm=ARMS["sliding"])
    assert_named(robot, changed(recording, q2_mm=-recording.columns["q2_mm"]), ", column q2_mm:", "opposite sign")


@pytest.mark.parametrize("pair", [("q4_deg", "q5_deg"), ("q1_deg", "q2_deg"), ("q3_deg", "q6_deg")])
def test_swapped_joint_columns_are_named(pair):
    robot, recording = erring("ball-centre", 4)
    first, second = pair
    swapped = changed(recording, **{first: recording.columns[second], second: recording.columns[first]})
    assert_named(robot, swapped, f", columns {first} and {second}:", "are swapped")


def test_a_joint_in_radians_is_named():
    robot, recording = erring("external-point", 5)
    assert_named(robot, changed(recording, q3_deg=np.deg2rad(recording.columns["q3_deg"])), "q3_deg", "holds radians")


def test_all_joints_in_radians_are_named():
    robot, recording = erring("external-pose", 5)
    names = [f"q{k}_deg" for k in range(1, 7)]
    wrong = changed(recording, **{name: np.deg2rad(recording.columns[name]) for name in names})
    assert_named(robot, wrong, "columns q1_deg, q2_deg,", "hold radians")


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize(
    "factor, unit", [(0.1, "cm"), (1 / 25.4, "inches"), (0.001, "m"), (10, "tenths of a mm"), (1000, "um")]
)
def test_points_in_another_unit_are_named(measures, factor, unit):
    robot, recording = erring(measures, 6)
    wrong = changed(recording, **{c: factor * recording.columns[c] for c in XYZ})
    assert_named(robot, wrong, f"columns x_mm, y_mm and z_mm hold {unit};", f"multiply them by {1 / factor:g},")


@pytest.mark.parametrize("measures", KINDS[:2])
@pytest.mark.parametrize("axis", XYZ)
def test_left_handed_points_are_named(measures, axis):
    robot, recording = erring(measures, 7)
    assert_named(robot, changed(recording, **{axis: -recording.columns[axis]}), "left-handed")


@pytest.mark.parametrize("axis", XYZ)
def test_beside_orientations_the_mirrored_axis_is_named(axis):
    robot, recording = erring("external-pose", 8)
    assert_named(robot, changed(recording, **{axis: -recording.columns[axis]}), f", column {axis}:", "opposite sign")


def test_swapped_axes_beside_orientations_are_named():
    robot, recording = erring("external-pose", 8)
    columns = recording.columns
    assert_named(robot, changed(recording, x_mm=columns["y_mm"], y_mm=columns["x_mm"]), "x_mm and y_mm are swapped")


def test_a_quaternion_that_turns_the_other_way_is_named():
    robot, recording = erring("external-pose", 9)
    wrong = changed(recording, **{c: -recording.columns[c] for c in QUATERNION[1:]})
    assert_named(robot, wrong, "columns qw, qx, qy and qz turn the other way")


def test_a_quaternion_with_w_last_is_named():
    robot, recording = erring("external-pose", 9)
    wrong = changed(recording, **{c: recording.columns[f"q{old}"] for c, old in zip(QUATERNION, "xyzw")})
    assert_named(robot, wrong, "in the order x, y, z, w")


@pytest.mark.parametrize("pair", [(1, 2), (2, 7), (4, 7)])
def test_two_swapped_balls_are_named(pair):
    robot, recording = erring("ball-centre", 10)
    label, (a, b) = recording.columns["ball"], pair
    swapped = changed(recording, ball=np.where(label == a, b, np.where(label == b, a, label)))
    assert_named(robot, swapped, f"column ball, numbers {a} and {b}", "are swapped")


def test_single_rows_of_another_ball_are_named():
    robot, recording = erring("ball-centre", 11)
    label = recording.columns["ball"].copy()
    assert (label[[4, 16]] == 1).all()
    label[[4, 16]] = 4.0
    assert_named(robot, changed(recording, ball=label), "column ball", "sample 5 (4 for 1) and 17 (4 for 1);")


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("step, words", [(1, "of the row before"), (-1, "of the row after")])
def test_positions_of_the_neighbouring_row_are_named(measures, step, words):
    robot, recording = erring(measures, 12)
    observed_too = [c for c in (*XYZ, *QUATERNION, "ball", "reflector") if c in recording.columns]
    late = changed(recording, **{c: np.roll(recording.columns[c], step) for c in observed_too})
    assert_named(robot, late.select(np.arange(1, 59)), words)


@pytest.mark.parametrize("measures", KINDS)
def test_shuffled_rows_are_only_said_not_to_fit(measures):
    robot, recording = erring(measures, 13)
    order = np.random.default_rng(13).permutation(recording.n)
    found = told(robot, changed(recording, **{c: recording.columns[c][order] for c in XYZ}))
    assert found is not None and not found.certain
    assert "base and tool alone fit to only" in found.sentence and "% of the arm's reach" in found.sentence


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("seed", range(20))
def test_an_arm_off_its_data_sheet_is_not_suspected(measures, seed):
    arm = list(ARMS.values())[seed % len(ARMS)]
    robot, recording = erring(measures, 100 + seed, n=(12, 20, 40, 80)[seed % 4], lengths=1.0, degrees=0.2, arm=arm)
    assert suspicion(robot, recording, 1e3) is None  # all is looked at, whatever the error


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_zero_offsets_of_degrees_are_never_called_a_mistake(measures, seed):
    robot, recording = erring(measures, 200 + seed, degrees=3.0)
    found = told(robot, recording)
    assert found is None or not found.certain


@pytest.mark.parametrize("measures", KINDS)
def test_a_few_lost_rows_raise_no_suspicion(measures):
    robot, recording = erring(measures, 14)
    z = recording.columns["z_mm"].copy()
    z[[3, 30]] += 300.0
    assert nominal_rms(robot, changed(recording, z_mm=z)) > 20
    assert told(robot, changed(recording, z_mm=z)) is None


def test_a_mistake_is_named_beside_a_lost_row():
    robot, recording = erring("external-point", 15)
    z = recording.columns["z_mm"].copy()
    z[7] += 400.0
    assert_named(robot, changed(recording, z_mm=z, q4_deg=-recording.columns["q4_deg"]), ", column q4_deg:")


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("n", [3, 4, 5])
def test_too_few_rows_say_nothing_certain(measures, n):
    robot, recording = erring(measures, 16, n=n, balls={1: BALLS[1]}, reflectors={1: (30.0, -40.0, 100.0)})
    found = suspicion(robot, recording, 1e3)
    assert found is None or not found.certain


def test_many_rows_are_thinned_but_no_ball_is_lost():
    robot, recording = erring("ball-centre", 17, n=1200)
    seventh = recording.columns["ball"] == 7
    right = recording.select(~seventh | (np.cumsum(seventh) <= 3))
    wrong = changed(right, q3_deg=-right.columns["q3_deg"])
    assert (right.ball == 7).sum() == 3
    assert suspicion(robot, right, 1e3) is None
    assert_named(robot, wrong, ", column q3_deg:")


REAL = ("irb120_faro", "irb120_wu_arm", "fanuc165f_innopolis", "hilti_jaibot_tilt:flat", "motoman_leica_ctu:left")


@pytest.mark.parametrize("name", REAL)
def test_real_recordings_are_not_suspected(name, real):
    real(name.partition(":")[0])
    recording = datasets.read(name)
    assert suspicion(load_robot(recording.robot), recording.select(recording.moving), 1e3) is None


def test_the_bundled_recording_is_not_suspected():
    recording = datasets.read("elastic-arm")
    assert suspicion(load_robot(recording.robot), recording.select(recording.moving), 1e3) is None
