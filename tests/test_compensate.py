"""A calibration that is used: corrected readings bring an arm that another engine simulates where it was sent."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import ROOT
from datasets.makers import gubankov, liu, ye
from datasets.makers.mujoco_arm import pose, reflector_points
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from robot_model.effects import CATALOGUE
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix
from workbench.files.solution_file import CalibratedArm, _trust, read_solution
from workbench.files.targets import read_programme, target_warnings
from workbench.fitting.calibration_plans.plans import geometry
from workbench.jobs.robot.calibrate import calibrate, save
from workbench.jobs.robot.compensation.compensate import (
    actual_poses,
    compensate,
    nominal_poses,
)
from workbench.jobs.robot.compensation.correction_limits import checked
from workbench.jobs.robot.compensation.moved_tool import moved_tool_words
from workbench.jobs.robot.compensation.target_units import check_units

sys.path.insert(0, str(ROOT / "tools"))

from study_compensation import position_covariance  # noqa: E402

N = 200


@pytest.fixture(scope="module")
def made():
    return ye.ye_second_experiment(n=N + 100, seed=4)


@pytest.fixture(scope="module")
def run(made, tmp_path_factory):
    """The run folder of a calibration on the first N samples, and the calibration."""
    columns = {name: np.asarray(v, float)[:N] for name, v in made.columns.items()}
    recording = Recording(made.measures, columns, made.robot, sigma_mm=made.sigma_mm, name="ye")
    calibration = calibrate(recording, folds=5)
    folder = tmp_path_factory.mktemp("run")
    save(calibration, folder)
    return folder, calibration


def targets(made):
    return np.deg2rad(np.stack([made.columns[f"q{k}_deg"] for k in range(1, 7)], 1)[N:])


def wanted_points(arm, readings):
    """(n, 3) where the nominal arm would bring the reflector, with base and reflector as calibrated."""
    base = np.array([arm.values[f"base.{c}"] for c in ("x", "y", "z", "rx", "ry", "rz")])
    reflector = np.array([arm.values[f"tool.reflector1_{c}"] for c in "xyz"] + [1.0])
    return (nominal_poses(arm.robot, readings) @ reflector)[:, :3] @ rotation_matrix(
        base[3:]
    ).T + base[:3]


def true_points(readings):
    """(n, 3) where MuJoCo's arm with the 53 published parameters really brings it."""
    return reflector_points(
        ye._flange(ye.SECOND, np.rad2deg(readings)), ye.SECOND.tool[0], pose(*ye.SECOND.user)
    )


def test_the_file_gives_back_the_calibration(run):
    folder, calibration = run
    arm = read_solution(folder)
    assert arm.trusted and arm.values == dict(
        zip(calibration.solution.parameters.keys, calibration.solution.parameters.values)
    )
    assert [e.title for e in arm.effects] == [e.title for e in calibration.model.effects]
    np.testing.assert_array_equal(arm.covariance, calibration.solution.covariance)
    assert arm.held_out_mm == calibration.held_out["rms_mm"]


def test_compensated_readings_are_as_good_as_the_calibration(run, made):
    folder, _ = run
    arm, readings = read_solution(folder), targets(made)
    done = compensate(arm, readings)
    wanted = wanted_points(arm, readings)
    before = np.sqrt(((true_points(readings) - wanted) ** 2).sum(1).mean())
    after = np.sqrt(((true_points(done.readings) - wanted) ** 2).sum(1).mean())
    assert done.reached.all() and done.left_mm.max() < 1e-4
    assert before > 0.5 and after <= 1.1 * arm.held_out_mm
    sent, came = nominal_poses(arm.robot, readings), actual_poses(arm, readings)
    moved = np.linalg.norm(came[:, :3, 3] - sent[:, :3, 3], axis=1)
    assert (
        done.correction_mm >= moved - 1e-9
    ).all()  # of the flange: its place, or its turn at a lever's length
    turned = np.arccos(
        np.clip(
            (np.trace(np.swapaxes(sent[:, :3, :3], 1, 2) @ came[:, :3, :3], axis1=1, axis2=2) - 1)
            / 2,
            -1,
            1,
        )
    )
    np.testing.assert_allclose(done.correction_mm, np.maximum(moved, 200 * turned), rtol=1e-3)
    assert 0 < done.sigma_mm.max() < arm.held_out_mm


def test_what_the_model_misses_is_part_of_the_uncertainty(run, made, tmp_path):
    keys = json.loads((run[0] / "solution.json").read_text())
    larger = {"held_out": keys["held_out"] | {"rms_mm": 0.5}, "noise": {"rms_mm": 0.4}}
    larger["noise"]["source"] = "stated"
    (tmp_path / "solution.json").write_text(json.dumps(keys | larger))
    done = compensate(read_solution(tmp_path), targets(made))
    held_out = keys["held_out"]
    fitted = held_out["samples"] * (1 - 1 / held_out["folds"])
    uncertain = 0.4**2 * len(read_solution(tmp_path).free) / (3 * fitted)  # sigma^2 p/n
    remaining = done.uncertainty_mm**2 - done.sigma_mm**2
    np.testing.assert_allclose(remaining, remaining[0])
    # a posterior mean: the half-Cauchy prior favours less by a few percent
    assert 0.95 * (0.3**2 - uncertain) <= remaining[0] < 0.3**2 - 0.3 * uncertain
    (tmp_path / "solution.json").write_text(json.dumps(keys | {"discrepancy_rms_mm": -0.3}))
    with pytest.raises(
        InputError, match="key discrepancy_rms_mm: expected a distance of 0 or more"
    ):
        read_solution(tmp_path)


def test_an_empirical_function_is_uncertain_beyond_its_range(run, made):
    """Joint 2 errs in proportion to its angle, and the function knows it only up to half of the programmed range."""
    arm, readings = read_solution(run[0]), targets(made)
    low, high = readings[:, 1].min(), np.median(readings[:, 1])
    options = {"port": "joint", "names": ["q2"], "spans": [[low, high]], "unit": "rad"}
    function = CATALOGUE["smooth-function"]("joint-2", **options, sizes=[1e-3])
    values = arm.values | {p.key: 0.0 for p in function.table(None)}
    values["joint-2.unknown.q2_0_0"] = 1e-3  # times q2 scaled to -1 ... 1: the linear term
    with_function = replace(arm, effects=(*arm.effects, function), values=values)
    known, found = compensate(arm, readings), compensate(with_function, readings)
    beyond = readings[:, 1] > high + 0.1
    more = np.sqrt(found.sigma_mm**2 - np.minimum(known.sigma_mm, found.sigma_mm) ** 2)
    lever = _distance_from_axis_2(arm, readings)
    scaled = 2 * (found.readings[:, 1] - high) / (high - low)
    expected = 1e-3 * scaled * lever
    assert beyond.sum() > 20
    np.testing.assert_allclose(more[beyond], expected[beyond], rtol=0.05)
    inside = (readings[:, 1] < high - 0.1) & (found.readings[:, 1] > low)
    np.testing.assert_allclose(found.sigma_mm[inside], known.sigma_mm[inside], rtol=0.02)


def _distance_from_axis_2(arm, readings):
    """(n,) mm: distance of the reflector from the axis of joint 2, nominal arm."""
    frames = forward(arm.robot, arm.robot.mixing @ readings.T)
    reflector = [arm.values[f"tool.reflector1_{c}"] for c in "xyz"] + [1.0]
    point = (nominal_poses(arm.robot, readings) @ reflector)[:, :3]
    return np.linalg.norm(np.cross(point - frames.z_origin[1].T, frames.z[1].T), axis=1)


def test_the_covariance_of_positions_has_their_sigmas_and_what_they_share(run, made):
    arm, readings = read_solution(run[0]), targets(made)[:20]
    done = compensate(arm, readings)
    covariance = position_covariance(arm, done.readings)
    variances = np.diag(covariance).reshape(20, 3).sum(1)
    np.testing.assert_allclose(np.sqrt(variances), done.sigma_mm, rtol=1e-6)
    twice = position_covariance(arm, done.readings[[0, 0]])
    np.testing.assert_allclose(twice[:3, 3:], twice[:3, :3], atol=1e-12)


def test_the_model_is_inverted_exactly(run, made):
    arm, readings = read_solution(run[0]), targets(made)
    done = compensate(arm, readings)
    np.testing.assert_allclose(
        actual_poses(arm, done.readings)[:, :3, 3], done.poses[:, :3, 3], atol=1e-4
    )
    np.testing.assert_allclose(
        actual_poses(arm, done.readings)[:, :3, :3], done.poses[:, :3, :3], atol=1e-6
    )


def test_a_lag_of_the_readings_corrects_no_target(run, made):
    """The arm stands where it was sent, however early its joints were read."""
    arm, readings = read_solution(run[0]), targets(made)[:5]
    lag = CATALOGUE["reading-lag"]("time")
    late = replace(
        arm, effects=(*arm.effects, lag), values=arm.values | {"time.reading-lag.short": 1e-3}
    )
    np.testing.assert_allclose(
        compensate(late, readings).readings, compensate(arm, readings).readings, atol=1e-12
    )


def test_a_reflector_that_was_remounted_corrects_no_target(run, made):
    """A step of the tool is beyond the flange, as is a tool that moved: the sentence says what to do in both cases."""
    step = CATALOGUE["shift"]("tool", after=10.0)
    values = {f"tool.shift.{name}": 1.0 for name in "xyz"}
    values |= {f"tool.shift.r{name}": 0.0 for name in "xyz"}
    arm, readings = read_solution(run[0]), targets(made)[:4]
    moved = replace(arm, effects=(*arm.effects, step), values=arm.values | values)
    assert np.array_equal(actual_poses(moved, readings, {}), actual_poses(arm, readings, {}))
    of_reflector = replace(moved, keys={**arm.keys, "measures": "external-point"})
    (sentence,) = moved_tool_words(of_reflector)
    assert "shift at tool is not corrected" in sentence and "column reflector" in sentence
    of_sensor = replace(moved, keys={**arm.keys, "measures": "ball-centre"})
    (sentence,) = moved_tool_words(of_sensor)
    assert "hand-eye" in sentence and "reflector" not in sentence
    assert moved_tool_words(arm) == []


def test_poses_are_reached_from_a_start_that_is_far_off(run, made):
    arm, readings = read_solution(run[0]), targets(made)
    start = readings + np.random.default_rng(0).uniform(-0.15, 0.15, readings.shape)
    done = compensate(arm, start, nominal_poses(arm.robot, readings))
    assert done.reached.mean() > 0.95
    np.testing.assert_allclose(done.left_mm[done.reached], 0, atol=1e-3)


@pytest.mark.parametrize("name", ["abb_irb120", "kuka_kr6_r900", "ur10e"])
def test_a_pose_is_reached_in_whatever_posture_the_limits_allow(name):
    """From the middle of the limits alone one pose in four would be called out of reach."""
    robot = load_robot(name)
    low, high = robot.limits.T
    poses = nominal_poses(
        robot,
        np.random.default_rng(0).uniform(0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high, (60, 6)),
    )
    values = {
        f"joint-{k + 1}.{c}{k + 1}": float(robot.geometry[k, j])
        for k in range(6)
        for j, c in enumerate(("theta", "d", "a", "alpha", "beta"))
    }
    arm = CalibratedArm(robot, (), values, (), np.zeros((0, 0)), np.zeros(3), 0.1, True, "", {})
    done = compensate(arm, np.tile((low + high) / 2, (60, 1)), poses, anywhere=True)
    assert done.reached.all()
    np.testing.assert_allclose(nominal_poses(robot, done.readings), poses, atol=1e-3)


def test_a_target_out_of_reach_is_said_to_be(run, made):
    arm, readings = read_solution(run[0]), targets(made)[:3]
    poses = nominal_poses(arm.robot, readings)
    poses[1, :3, 3] *= 10
    done = compensate(arm, readings, poses)
    assert done.reached.tolist() == [True, False, True]
    assert np.isnan(done.readings).all(1).tolist() == [
        False,
        True,
        False,
    ]  # nothing that an arm could be sent to


def test_the_correction_of_a_pose_does_not_depend_on_where_the_search_began(run, made):
    arm, readings = read_solution(run[0]), targets(made)[:20]
    start = readings + np.random.default_rng(1).uniform(-0.1, 0.1, readings.shape)
    there = compensate(arm, start, nominal_poses(arm.robot, readings))
    np.testing.assert_allclose(
        there.correction_mm, compensate(arm, readings).correction_mm, atol=5e-3
    )


@pytest.mark.parametrize(
    ("maker", "values"),
    [
        (gubankov.rv2fb, (0.16, 21)),
        (gubankov.ur10e, (0.16, 22)),
        (liu.irb120, (12, 7, 0.02, 23)),
    ],
    ids=["rv2fb", "ur10e", "beams"],
)
def test_what_no_touch_or_beam_can_tell_is_no_part_of_sigma(maker, values, tmp_path):
    """The turn about joint 1 and the way along a beam once made metres of it; the flange's real error is covered."""
    recording = maker(*values)
    robot = load_robot(recording.robot)
    calibration = calibrate(recording.recording(), plan=[geometry(robot)])
    save(calibration, tmp_path)
    low, high = robot.limits.T
    readings = np.random.default_rng(3).uniform(
        0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high, (40, 6)
    )
    done = compensate(read_solution(tmp_path), readings)
    _, found, own = calibration.model.chain.split(calibration.solution.parameters.values)
    tip, true_tip = (
        (np.zeros(3),) * 2 if "tip" not in recording.truth else (own[:3], recording.truth["tip"])
    )
    readings = done.readings[done.reached]
    seen, true = (
        gubankov.tips(found, tip, readings),
        gubankov.tips(recording.truth["geometry"], true_tip, readings),
    )
    angle = np.angle(((true[:, 0] + 1j * true[:, 1]) / (seen[:, 0] + 1j * seen[:, 1])).mean())
    off = Rotation.from_rotvec([0, 0, angle]).apply(seen) - true
    error = np.sqrt(((off - [0, 0, off[:, 2].mean()]) ** 2).sum(1).mean())
    sigma = np.sqrt((done.sigma_mm**2).mean())
    assert error < 2.5 * sigma < 50 * error


def test_a_recording_in_doubt_is_not_used_unless_forced(run):
    keys = json.loads((run[0] / "solution.json").read_text())
    assert read_solution(run[0]).trusted and keys["warnings"] == []
    assert not _trust(keys | {"warnings": ["base and tool alone fit to only 300 mm"]})[0]


@pytest.mark.parametrize("lost", ["joint-2.a2", "tool.reflector1_x"])
def test_a_file_that_lost_a_value_is_a_sentence(run, tmp_path, lost):
    keys = json.loads((run[0] / "solution.json").read_text())
    del keys["values"][lost]
    (tmp_path / "solution.json").write_text(json.dumps(keys))
    with pytest.raises(InputError, match=f"expected a value of {lost}"):
        read_solution(tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "x_mm,y_mm,z_mm,qw,qx,qy,qz\n1,2,3,1,0,0,0\nnan,2,3,1,0,0,0",
            "row 3, column x_mm: expected a finite number",
        ),
        (
            "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,payload_kg\n1,2,3,4,5,6,-1",
            "column payload_kg: expected a mass",
        ),
    ],
)
def test_a_target_that_cannot_be_is_named_by_its_own_column(run, tmp_path, text, words):
    (tmp_path / "t.csv").write_text(text + "\n")
    with pytest.raises(InputError, match=words):
        read_programme(tmp_path / "t.csv", read_solution(run[0]).robot)


def test_what_was_not_found_good_is_not_used_unless_forced(run):
    arm = replace(read_solution(run[0]), trusted=False, why="the solve did not converge")
    with pytest.raises(InputError, match="did not converge; correct the recording"):
        checked(arm, "solution.json", force=False)
    assert checked(arm, "solution.json", force=True) is arm


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected JSON"),
        ("[]", "expected 'solution/1'"),
        ('{"format": "solution/2"}', "expected 'solution/1'"),
        ('{"format": "solution/1"}', "'effects' is missing"),
    ],
)
def test_a_broken_file_is_a_sentence(tmp_path, text, words):
    (tmp_path / "solution.json").write_text(text)
    with pytest.raises(InputError, match=words):
        read_solution(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read_solution(tmp_path / "none")


def test_a_table_with_foreign_headers_gets_the_names_of_its_columns(run, tmp_path):
    """What the table holds is named, and what this robot's table has; `sample` and `note` are no clue."""
    path = tmp_path / "targets.csv"
    path.write_text("sample,Wert 1,Wert 2,note\n1,10,20,x\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_programme(path, read_solution(run[0]).robot)
    sentence = str(caught.value)
    assert "targets.csv: expected joint columns q1_deg ... q6_deg, or pose columns x_mm" in sentence
    assert "not recognised: Wert 1, Wert 2;" in sentence
    assert "rename the columns of the joint readings to q1_deg, q2_deg" in sentence


def test_targets_in_radians_or_metres_are_doubted(run, tmp_path):
    arm, path = read_solution(run[0]), tmp_path / "targets.csv"
    head = ",".join(f"q{k}_deg" for k in range(1, 7))
    for row, doubt in (("0.5,0.2,-0.3,1.2,-0.6,2", ["radians"]), ("28,11,-17,69,-34,115", [])):
        path.write_text(f"{head}\n{row}\n", encoding="utf-8")
        said = target_warnings(read_programme(path, arm.robot), arm.robot)
        assert len(said) == len(doubt) and all(
            word in sentence for word, sentence in zip(doubt, said)
        )
    path.write_text("x_mm,y_mm,z_mm,qw,qx,qy,qz\n0.4,0.1,0.3,1,0,0,0\n", encoding="utf-8")
    assert "metres" in target_warnings(read_programme(path, arm.robot), arm.robot)[0]


def test_targets_in_another_unit_are_refused_where_the_recording_tells(run, made, tmp_path):
    """An arm folds itself around its root for metres that are read as mm; small angles are in no recorded range."""
    arm, path = read_solution(run[0]), tmp_path / "targets.csv"
    readings = targets(made)[:4]
    head = ",".join(f"q{k}_deg" for k in range(1, 7))
    poses = nominal_poses(arm.robot, readings)
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)
    narrow = replace(arm, fitted_range=arm.fitted_range | {"q2_deg": (-120.0, -60.0)})
    readings[:, 1] = np.deg2rad(-90)

    def read(columns, rows):
        np.savetxt(path, rows, delimiter=",", header=columns, comments="")
        return read_programme(path, arm.robot)

    check_units(narrow, read(head, np.rad2deg(readings)))
    with pytest.raises(InputError, match="radians; multiply the angles by 57.29578"):
        check_units(narrow, read(head, readings))
    with pytest.raises(
        InputError, match="radians"
    ):  # near zero in every joint, also where zero was recorded
        check_units(arm, read(head, targets(made)[:4]))
    check_units(arm, read(head, np.zeros((2, 6))))
    check_units(arm, read(head, [[0.0, 0, 0, 0, 0, 2.0]]))
    for factor, unit in ((1000.0, "metres"), (25.4, "inches")):
        rows = np.column_stack([poses[:, :3, 3] / factor, turns])
        with pytest.raises(InputError, match=f"if they are {unit}; multiply the positions by"):
            check_units(arm, read("x_mm,y_mm,z_mm,qw,qx,qy,qz", rows))
    rows = np.column_stack([poses[:, :3, 3], turns])
    check_units(arm, read("x_mm,y_mm,z_mm,qw,qx,qy,qz", rows))
