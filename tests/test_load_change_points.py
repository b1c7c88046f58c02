"""A load that changes, or a target that slips, in the course of a recording is named with the instant."""

from dataclasses import replace

import numpy as np
import pytest

import elastic_arm
from datasets.recording import Recording
from robot_model import load_robot
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.fitting import fit_recording
from workbench.fitting.plausibility.rows.change_points import find_change_point
from workbench.fitting.plausibility.rows.load_deflection import of_one_sign

POINT = ("x_mm", "y_mm", "z_mm")
COMPLIANCE = np.array([0.0, 4e-6, 6e-6, 0.0, 9e-6, 0.0])
SPLIT = 32
ROBOT = elastic_arm.robot_file()


def half_loaded(kg: float, compliance=COMPLIANCE, n: int = 70):
    """A recording of an arm that carries a load from sample `SPLIT` + 1 on; the load is not recorded."""
    arm = elastic_arm.ElasticArm(
        compliance, centre=elastic_arm.POINT + np.array([60.0, 0.0, -80.0])
    )
    empty = elastic_arm.measured(arm, ROBOT, [0.0], n)
    joints = np.stack([empty.columns[f"q{k}_deg"] for k in range(1, 7)], 1)
    loaded = np.array([arm.point(np.deg2rad(row), kg) for row in joints])
    unloaded = np.array([arm.point(np.deg2rad(row), 0.0) for row in joints])
    change = np.where(np.arange(n)[:, None] >= SPLIT, loaded - unloaded, 0.0)
    points = {name: empty.columns[name] + change[:, i] for i, name in enumerate(POINT)}
    return replace(empty, columns=empty.columns | points)


def change_of(recording):
    robot = load_robot(recording.robot, "test")
    return find_change_point(robot, recording, fit_recording(robot, recording))


def test_a_load_that_is_added_is_named_with_its_instant():
    recording = half_loaded(10.0)
    change = change_of(recording)
    assert change.is_load and (change.before, change.after) == (SPLIT, SPLIT + 1)
    (one,) = check_plausibility(load_robot(ROBOT, "test"), recording)
    assert "the load of the tool has changed" in one.sentence
    assert "column payload_kg" in one.sentence
    assert one.instant == (SPLIT, SPLIT + 1)


def test_a_recorded_change_of_load_is_none():
    recording = half_loaded(10.0)
    load = np.where(np.arange(recording.n) >= SPLIT, 10.0, 0.0)
    change = change_of(replace(recording, columns=recording.columns | {"payload_kg": load}))
    assert change is None or not change.is_load


def test_an_arm_without_a_change_has_none():
    assert change_of(half_loaded(0.0)) is None


@pytest.mark.parametrize("moved", ["base", "tool"])
def test_a_shift_is_no_change_of_load(moved):
    recording = half_loaded(0.0)
    arm = elastic_arm.ElasticArm(np.zeros(6))
    shift = np.tile([0.4, -0.3, 0.5], (recording.n, 1))
    if moved == "tool":
        joints = np.stack([recording.columns[f"q{k}_deg"] for k in range(1, 7)], 1)
        flange = np.array([arm.frames(np.deg2rad(row))[-1][:3, :3] for row in joints])
        shift = np.einsum("nij,nj->ni", flange, shift)
    shift[:SPLIT] = 0.0
    points = {name: recording.columns[name] + shift[:, i] for i, name in enumerate(POINT)}
    change = change_of(replace(recording, columns=recording.columns | points))
    assert not change.is_load and change.others == ()
    assert ("target" in change.moved_object) == (moved == "tool")
    assert change.before == SPLIT


def gantry():
    """A recording of three perpendicular slides, whose flange keeps its orientation; the target slips."""
    rng = np.random.default_rng(5)
    rows = [
        {"kind": "prismatic", "theta_deg": t, "d_mm": 0.0, "a_mm": 0.0, "alpha_deg": -90.0}
        for t in (0, -90, 0)
    ]
    robot = load_robot({"name": "gantry", "convention": "standard", "joint": rows}, "test")
    travel = rng.uniform(0, 800, (60, 3))
    columns = {f"q{k}_mm": travel[:, k - 1] for k in (1, 2, 3)}
    recording = Recording(
        "external-point",
        columns | dict.fromkeys(POINT, np.zeros(60)) | {"sample": np.arange(1.0, 61)},
        {"name": "gantry", "convention": "standard", "joint": rows},
        name="gantry",
    )
    axes = np.array([[0, 0, 1.0], [0, 1.0, 0], [1.0, 0, 0]])
    points = travel @ axes + rng.normal(0, 0.01, (60, 3))
    points[30:] += [0.5, -0.4, 0.3]
    return robot, replace(
        recording, columns=recording.columns | {name: points[:, i] for i, name in enumerate(POINT)}
    )


def test_base_and_target_are_both_listed_where_the_flange_keeps_its_orientation():
    robot, recording = gantry()
    change = find_change_point(robot, recording, fit_recording(robot, recording))
    named = {change.moved_object, *change.others}
    assert named == {"the instrument or the robot's base", "the target on the flange"}
    assert (change.before, change.after) == (30, 31)


def test_deflections_have_one_sign():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(5, 5))
    matrix = root @ root.T + np.eye(5)
    for truth in (np.array([1.0, 2, 0, 0.5, 3]), -np.array([1.0, 2, 0, 0.5, 3])):
        np.testing.assert_allclose(of_one_sign(matrix, matrix @ truth), truth, atol=1e-8)
    mixed = of_one_sign(matrix, matrix @ np.array([1.0, -2, 1, 0.5, -3]))
    assert (mixed >= 0).all() or (mixed <= 0).all()
