"""Mathematics 2023, 11, 4802: a TX60 seen by its place and one axis; which axis, and how well it then predicts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets import write
from datasets.makers import poses
from datasets.makers.tx60 import geometries, tx60
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.identify import identifiability
from workbench.jobs.robot.significance import robot_called, significance

PLAN = Path("mdh-partial-pose")
OPEN = "joint 6's twist (alpha) has no effect on these measurements"


def calibrated(kind, seed=1):
    recording = replace(tx60(kind, seed=seed).recording(), name=kind)
    ids = recording.sample_ids
    return calibrate(recording, PLAN, fit_samples=ids[:100], test_samples=ids[100:])


def alpha6(calibration):
    return next(row for row in calibration.parameters if row["name"] == "alpha6")


def test_the_maker_and_the_model_agree_on_where_the_flange_is():
    """Two codes, one arm: the maker's matrix products and the model's chain."""
    made = tx60("full", 40)
    joints = made.recording().joints
    frames = forward(load_robot(made.robot), joints.T, made.truth["geometry"])
    assert frames.end_origin.T == pytest.approx(made.truth["flange"][:, :3, 3], abs=1e-9)


def test_the_published_errors_make_the_published_start():
    """0.585 and 0.547 mm in the paper before calibration, over its cube."""
    made, (nominal, _) = tx60("op"), geometries()
    place = poses.forward_kinematics(nominal, made.recording().joints)[:, :3, 3]
    off = np.linalg.norm(place - made.truth["flange"][:, :3, 3], axis=1)
    assert off[:100].mean() == pytest.approx(0.585, abs=0.05) and off[100:].mean() == pytest.approx(
        0.547, abs=0.05
    )
    assert np.abs(place - [550, 0, 550]).max() < 501


@pytest.mark.parametrize("kind", ["full", "np", "op"])
def test_100_fitted_and_200_checked_samples(kind):
    """Mean 3-D distance, the paper's figure: 0.074 +- 0.01 mm fitted, at most 0.16 mm checked."""
    found = [calibrated(kind, seed) for seed in (1, 2, 3)]
    assert np.mean([c.fit["mean_mm"] for c in found]) == pytest.approx(0.074, abs=0.01)
    assert all(c.held_out["mean_mm"] <= 0.16 and c.held_out["samples"] == 200 for c in found)
    assert all(c.stages[-1].free == 24 and c.solution.converged for c in found)


def test_np_leaves_alpha6_open_and_op_finds_it():
    seen, found = alpha6(calibrated("np")), alpha6(calibrated("op"))
    assert not seen["identifiable"] and seen["std"] is None and seen["value"] == 0
    assert found["identifiable"] and abs(found["value"] - 0.783e-3) < 3 * found["std"] < 2e-3


def test_it_is_said_before_anybody_measures():
    """A plan of the measurement, nominal arm, no noise: NP leaves alpha6 open in words, OP and full poses nothing."""
    said = {
        kind: identifiability(tx60(kind, planned=True).recording(), PLAN)["stages"][0]
        for kind in ("np", "op", "full")
    }
    assert said["np"]["undetermined"] == [OPEN] and said["np"]["identifiable"] == 23
    assert said["op"]["undetermined"] == said["full"]["undetermined"] == []
    assert said["op"]["free"] == said["op"]["identifiable"] == 24


def test_without_the_plan_the_tool_takes_up_joint_6():
    stage = identifiability(tx60("op", planned=True).recording())["stages"][0]
    assert any(
        "joint 6's twist (alpha)" in s and "tool rotation about x" in s
        for s in stage["undetermined"]
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_average_significance(seed):
    """Section 2.2: alpha6 and theta6 do not move the place; no length turns an axis; n misses alpha6, a theta6, o nothing."""
    found = significance(load_robot("staubli_tx60"), points=50, seed=seed)
    unseen = found.unseen()
    lengths = {
        key
        for key in found.keys
        if key.split(".")[1][0] == "d" or key.split(".")[1] in {f"a{k}" for k in range(1, 7)}
    }
    assert len(found.keys) == 24 and set(unseen["position"]) == {"joint-6.theta6", "joint-6.alpha6"}
    assert set(unseen["x"]) == lengths | {"joint-6.alpha6"}
    assert set(unseen["y"]) == lengths and set(unseen["z"]) == lengths | {"joint-6.theta6"}


def test_significance_by_plain_matrix_products():
    """One parameter, moved by hand."""
    robot = load_robot("staubli_tx60")
    found = significance(robot, points=30, seed=3, step_rad=0.1)
    joints = np.random.default_rng(3).uniform(*np.array(robot.limits).T, (30, 6))
    moved = robot.geometry.copy()
    moved[2, 3] += 0.1
    before, after = (
        poses.forward_kinematics(robot.geometry, joints),
        poses.forward_kinematics(moved, joints),
    )
    row = found.index[found.keys.index("joint-3.alpha3")]
    by_hand = [np.linalg.norm((after - before)[:, :3, c], axis=1).mean() for c in (3, 0, 1, 2)]
    assert row == pytest.approx(by_hand, rel=1e-9)


def test_what_a_plan_holds_stays_held():
    found = calibrated("op")
    assert all(
        found.solution.parameters[f"{place}.{axis}"] == 0
        for place in ("base", "tool")
        for axis in ("x", "rz")
    )


def test_a_recording_is_asked_about_its_own_poses(tmp_path):
    robot, readings = robot_called(str(write(tx60("op", 40).recording(), tmp_path / "op")))
    found = significance(robot, points=25, readings=readings)
    assert found.points == 25 and found.place == "of its recorded configurations"
    whole = significance(robot, points=500, readings=readings)
    assert whole.points == 40
    row = whole.index[whole.keys.index("joint-3.a3")]
    assert row[0] == pytest.approx(0.1) and row[1:] == pytest.approx([0, 0, 0], abs=1e-12)
    assert (
        robot_called("elastic-arm")[1].shape == (300, 6) and robot_called("staubli_tx60")[1] is None
    )


def test_significance_of_nothing_known_is_a_sentence(tmp_path):
    with pytest.raises(
        InputError, match="nosuch: expected a robot .*abb_irb120.* or a recording .*elastic-arm"
    ):
        robot_called("nosuch")
    with pytest.raises(InputError, match="nothing.toml"):
        robot_called(str(tmp_path / "nothing.toml"))
