"""Orientation errors stand next to position errors wherever poses are measured, and stages are judged by both."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

import datasets
from robot_model.system import bind, geometry_free
from scenes import model_of, scene
from workbench.commands.robot import compare as compare_command
from workbench.commands.robot import diagnose as diagnose_command
from workbench.core.errors import InputError
from workbench.core.least_squares.identifiability import identifiability, independent
from workbench.core.least_squares.solver import normal_matrix
from workbench.core.model import Model
from workbench.core.rigid import rotation_matrix
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.validation.held_out import Errors
from workbench.explanation.answer import diagnose
from workbench.explanation.output.files import save as save_diagnosis
from workbench.fitting.cross_validation import HeldOut, cross_validate, error_summary
from workbench.jobs.robot.calibrate import calibrate, save
from workbench.jobs.robot.calibrate_large import calibrate_chunks
from workbench.jobs.robot.compare import compare
from workbench.jobs.robot.compare import save as save_comparison
from workbench.jobs.robot.poses import choose_poses
from workbench.jobs.robot.simulate import simulate
from workbench.report.diagnosis.page import page as diagnosis_page

ROTATION_KEYS = ("rotation_rms_deg", "rotation_mean_deg", "rotation_p95_deg", "rotation_max_deg")
SIGMA_RAD = 2e-3


def noisy(measures, n=60, seed=4):
    """A recording with 0.02 mm of noise a coordinate and 2 mrad about each axis."""
    rng = np.random.default_rng(seed)
    recording = scene(measures, n=n, seed=seed).recording
    columns = dict(recording.columns)
    for name in ("x_mm", "y_mm", "z_mm"):
        columns[name] = columns[name] + rng.normal(0, 0.02, n)
    turn = Rotation.from_rotvec(rng.normal(0, SIGMA_RAD, (n, 3)))
    if measures == "external-pose":
        quaternion = np.stack([columns[f"q{c}"] for c in "xyzw"], -1)
        columns |= {
            f"q{c}": row
            for c, row in zip("xyzw", (turn * Rotation.from_quat(quaternion)).as_quat().T)
        }
    else:
        axis = turn.apply(np.stack([columns[f"o{c}"] for c in "xyz"], -1))
        columns |= {f"o{c}": row for c, row in zip("xyz", axis.T)}
    columns["sigma_deg"] = np.full(n, np.rad2deg(SIGMA_RAD))
    return replace(recording, columns=columns)


@pytest.fixture(scope="module", params=["external-pose", "partial-pose"])
def calibration(request):
    return calibrate(noisy(request.param), plan=(), folds=5)


def test_every_error_block_of_poses_has_rotation_figures(calibration):
    answer = calibration.as_json()
    axes = 3 if calibration.recording.measures == "external-pose" else 2
    expected = np.rad2deg(SIGMA_RAD) * np.sqrt(axes)
    for block in ("fit", "held_out", "nominal"):
        assert set(ROTATION_KEYS) <= set(answer[block])
        assert answer[block]["rotation_rms_deg"] == pytest.approx(expected, rel=0.15)
        assert (
            answer[block]["rotation_max_deg"]
            >= answer[block]["rotation_p95_deg"]
            >= answer[block]["rotation_mean_deg"]
        )


def test_stages_have_rotation_figures():
    stages = calibrate(noisy("external-pose"), folds=5).as_json()["stages"]
    for stage in stages:
        assert 0 < stage["rotation_rms_deg"] < 0.4 and 0 < stage["held_out_rotation_rms_deg"] < 0.4
        assert "deg" in stage["sentence"]


def test_residual_table_holds_the_rotation_of_every_sample(calibration, tmp_path):
    save(calibration, tmp_path)
    table = np.genfromtxt(tmp_path / "residuals.csv", delimiter=",", names=True)
    names = ("rx", "ry", "rz") if calibration.recording.measures == "external-pose" else ("axis",)
    for block in ("fit", "held_out", "nominal"):
        angle = np.sqrt(sum(table[f"{block}_{name}_deg"] ** 2 for name in names))
        found = getattr(calibration, block)["rotation_rms_deg"]
        # the figure of the nominal robot is held out, its residuals are those of the fit
        assert np.sqrt((angle**2).mean()) == pytest.approx(
            found, rel=0.05 if block == "nominal" else 1e-4
        )
    assert "rotation_rms_deg" in json.loads((tmp_path / "calibration.json").read_text())["fit"]


def test_recordings_of_points_have_no_rotation_figures(tmp_path):
    found = calibrate(scene("external-point", n=60, seed=4).recording, plan=(), folds=5)
    answer = found.as_json()
    assert not any(
        key in answer[block] for key in ROTATION_KEYS for block in ("fit", "held_out", "nominal")
    )
    assert all(not len(rows) for rows in found.rotation.values())
    save(found, tmp_path)
    assert "deg" not in (tmp_path / "residuals.csv").read_text().splitlines()[0]


def test_rotation_figures_are_of_the_angle():
    residual = np.zeros((6, 3))
    residual[3:, 0] = np.deg2rad([3.0, 0.0, 4.0])
    residual[:, 2] = np.nan
    found = error_summary(residual)
    assert found["rotation_max_deg"] == pytest.approx(5) and found[
        "rotation_mean_deg"
    ] == pytest.approx(2.5)
    assert found["rms_mm"] == 0
    assert "rotation_rms_deg" not in error_summary(residual[:3])


def test_a_sample_that_is_far_off_in_orientation_alone_is_left_out_and_named():
    recording = noisy("external-pose")
    turned = recording.columns["qw"].copy(), recording.columns["qx"].copy()
    columns = {name: column.copy() for name, column in recording.columns.items()}
    columns["qw"][7], columns["qx"][7] = -turned[1][7], turned[0][7]
    found = calibrate(replace(recording, columns=columns), plan=(), folds=5)
    assert found.suspects == (int(recording.sample_ids[7]),)


@pytest.mark.parametrize("degrees", [1e-7, 0.01, 10.0, 89.0, 91.0, 170.0, 180.0])
def test_residual_of_an_axis_is_the_angle_between_the_axes(degrees):
    """Its sine is small again beyond 90 degrees: an axis that points the other way looked perfect."""
    made = scene("partial-pose", n=20, seed=2)
    model = model_of(made)
    measurement = model.chain.measurement
    across = measurement.transverse_axes[0]
    angle = np.deg2rad(degrees)
    axis = np.cos(angle) * measurement.axis + np.sin(angle) * across
    leaning = replace(
        model, chain=replace(model.chain, measurement=replace(measurement, axis=axis)), _bases={}
    )
    truth = model.parameters
    clean = model.residual(truth)[3:]
    np.testing.assert_allclose(clean, 0, atol=1e-7)
    found = np.linalg.norm(leaning.residual(truth)[3:], axis=0)
    np.testing.assert_allclose(found, angle, atol=1e-6)


def test_residual_of_an_axis_is_differentiated_at_large_angles():
    made = scene("partial-pose", n=20, seed=2)
    model = model_of(made)
    start = model.parameters.free("base.*", "joint-*")
    turn = rotation_matrix(np.array([0.9, -1.2, 0.8]))
    measurement = replace(model.chain.measurement, axis=turn @ model.chain.measurement.axis)
    model = replace(model, chain=replace(model.chain, measurement=measurement), _bases={})
    residual, rows = model.linearise(start)
    assert np.linalg.norm(residual[3:], axis=0).max() > np.pi / 2
    for k, step in enumerate(np.full(len(rows), 1e-6)):
        moved = np.zeros(len(rows))
        moved[k] = step
        up, down = (model.residual(start.unpack(start.pack() + sign * moved)) for sign in (1, -1))
        expected = (up - down)[3:] / (2 * step)
        np.testing.assert_allclose(
            rows[k, 3:], expected, atol=1e-5 * max(1, np.abs(expected).max())
        )


def held_out(position, rotation, seed=0, sigma=None):
    """Held-out residuals of 60 samples with so much position error (mm) and orientation error (rad)."""
    fold = np.repeat(np.arange(10), 6)
    residual = np.random.default_rng(seed).normal(0, 1.0, (6, 60))
    residual[:3] *= position
    residual[3:] *= rotation
    return HeldOut(residual, fold, sigma=sigma)


def test_a_stage_that_improves_position_and_destroys_orientation_does_not_win():
    before = held_out(1.0, 1e-3)
    assert held_out(0.8, 1e-3).beats(before)
    assert held_out(0.8, 0.8e-3).beats(before)
    assert held_out(0.99, 0.5e-3).beats(before)
    assert not held_out(0.1, 2e-3).beats(before)
    assert not held_out(0.5, 1.5).beats(before)


def test_changes_far_below_the_stated_noise_do_not_outweigh_a_gain():
    """Orientations without any noise: their rounding must not decide."""
    sigma = np.repeat([[0.02], [2e-4]], 3, axis=0) * np.ones(60)
    before, after = held_out(1.0, 1e-9, sigma=sigma), held_out(0.8, 5e-9, sigma=sigma)
    assert after.beats(before)
    assert not before.beats(after)


def test_positions_alone_are_judged_as_before():
    before, after = held_out(1.0, 0.0), held_out(0.8, 0.0)
    before, after = (replace(one, residual=one.residual[:3]) for one in (before, after))
    assert after.beats(before) and not before.beats(after) and not before.beats(before)
    relative = after.falls_from(before) * np.nanmean(before.squares)
    expected = [(before.squares - after.squares)[before.fold == k].mean() for k in range(10)]
    np.testing.assert_allclose(relative, expected)


FRAMES_ONLY = """
[[stage]]
name = "frames"
why = "base and tool"
free = ["base.*", "tool.*"]
earn = false
"""
WITH_TWIST = FRAMES_ONLY.replace('"tool.*"]', '"tool.*", "joint-4.alpha4", "joint-5.alpha5"]')


def test_plans_are_compared_by_position_and_orientation(tmp_path):
    (tmp_path / "frames.toml").write_text(FRAMES_ONLY)
    (tmp_path / "twist.toml").write_text(WITH_TWIST)
    recording = noisy("external-pose")
    found = compare(recording, [str(tmp_path / "frames.toml"), str(tmp_path / "twist.toml")])
    for row, angles in zip(found.rows(), found.angles):
        assert row["held_out_rotation_rms_deg"] == pytest.approx(np.sqrt((angles**2).mean()))
        assert row["fit_rotation_rms_deg"] > 0 and row["rotation_ratio"] > 0
    assert 0 < found.rows()[1]["rotation_p"] <= 1
    save_comparison(found, tmp_path)
    table = np.genfromtxt(tmp_path / "held-out.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["twist_rotation_deg"], found.angles[1], rtol=1e-5)
    console = Console(record=True, width=100)
    compare_command._show(console, found.as_json() | {"run": "run"})
    assert "fit RMS mm" in (said := console.export_text()) and "fit RMS deg" in said


def test_a_calibration_in_chunks_reports_orientation(tmp_path):
    (tmp_path / "frames.toml").write_text(FRAMES_ONLY)
    recording = noisy("external-pose", n=120)
    folder = datasets.write(recording, tmp_path / "long", samples="parquet")
    whole = calibrate(datasets.read(folder), tmp_path / "frames.toml", folds=3)
    chunked = calibrate_chunks(folder, tmp_path / "frames.toml", folds=3).as_json()
    for block in ("fit", "held_out", "nominal"):
        assert set(ROTATION_KEYS) <= set(chunked[block])
    assert chunked["fit"]["rotation_rms_deg"] == pytest.approx(
        whole.fit["rotation_rms_deg"], rel=0.01
    )
    assert chunked["held_out"]["rotation_rms_deg"] == pytest.approx(
        whole.held_out["rotation_rms_deg"], rel=0.03
    )


SCENE = """
robot = "ur10"
measures = "external-pose"
samples = 120
seed = 7
sigma_mm = 0.05
share_of_limits = 0.4
[base]
xyz_mm = [2500.0, 300.0, -600.0]
rpy_deg = [0.5, -0.3, 150.0]
[errors]
length_mm = 0.3
angle_deg = 0.1
[[effect]]
effect = "joint-compliance"
where = "joint-2"
values = { compliance = 1e-5 }
"""


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "pose.toml"
    path.write_text(SCENE)
    return diagnose(simulate(path), jobs=1)


def test_a_diagnosis_reports_orientation_before_and_after(diagnosis):
    held_out = diagnosis.as_json()["held_out"]
    assert held_out["after_mm"] < 0.3 * held_out["before_mm"]
    # noise of the orientation: 0.05 mm at 100 mm, about three axes
    expected = np.rad2deg(0.05 / 100) * np.sqrt(3)
    assert held_out["after_deg"] == pytest.approx(expected, rel=0.15)
    assert held_out["after_deg"] < 0.95 * held_out["before_deg"]
    # the stated noise is of three coordinates, not of all six components
    assert held_out["noise_mm"] == pytest.approx(np.sqrt(3) * 0.05)


def test_the_files_and_the_page_of_a_diagnosis_show_orientation(diagnosis, tmp_path):
    save_diagnosis(diagnosis, tmp_path)
    rows = list(csv.DictReader((tmp_path / "residuals.csv").open()))
    assert len(rows) == diagnosis.samples and None not in rows[0]
    angle = np.array([float(row["held_out_after_deg"]) for row in rows])
    assert np.sqrt((angle**2).mean()) == pytest.approx(
        diagnosis.as_json()["held_out"]["after_deg"], rel=1e-4
    )
    position = np.array([[float(row[f"after_{axis}_mm"]) for axis in "xyz"] for row in rows])
    assert 0.03 < position.std() < 0.07
    names = [section.name for section in diagnosis_page(diagnosis).sections]
    figures = [
        block["name"]
        for section in diagnosis_page(diagnosis).sections
        for block in section.blocks
        if block["kind"] == "figure"
    ]
    assert "proof" in names and "heldout-rotation" in figures
    console = Console(record=True, width=100)
    diagnose_command.show(console, diagnosis.as_json())
    assert "deg" in console.export_text()


def test_angles_belong_to_the_distances_of_the_same_prediction():
    bench = bench_of(noisy("external-pose"))
    errors, fold = Errors(bench), np.arange(60) // 20
    distances = errors((), fold)
    angles = errors.angles_of(distances)
    direct = cross_validate(*bench.solve(())[:1], bench.solve(())[1].parameters, fold, "huber")
    np.testing.assert_allclose(distances, np.sqrt(direct.squares), rtol=1e-6)
    np.testing.assert_allclose(angles, np.rad2deg(np.sqrt((direct.rotation**2).sum(0))), rtol=1e-6)
    assert np.isnan(errors.angles_of(distances + 1)).all()


def test_predicted_orientation_error_at_tasks_is_that_of_the_covariance():
    every = noisy("external-pose", n=60, seed=4)
    robot = scene("external-pose", n=60, seed=4).robot
    low, high = robot.limits.T
    candidates = every.select(((every.joints > low) & (every.joints < high)).all(1))
    tasks = every.select(np.arange(20))
    found = choose_poses(candidates, 20, "task", tasks, link_radius_mm=0).predicted()
    chain = bind(robot, candidates)
    model = Model(chain)
    free = model.parameters.free("base.*", "tool.*", *geometry_free(chain.robot))
    free, _ = independent(normal_matrix(model, free), free)
    covariance = identifiability(normal_matrix(model, free), free).covariance
    at_tasks = Model(bind(chain.robot, tasks, chain.start))
    rows = at_tasks.linearise(at_tasks.parameters.only(free.mask))[1][:, 3:]
    expected = np.rad2deg(np.sqrt(np.einsum("fmt,fg,gmt->", rows, covariance, rows) / tasks.n))
    assert found["all_deg"] == pytest.approx(expected, rel=1e-3)
    assert found["chosen_deg"] > found["all_deg"]


def test_a_simulated_pose_recording_states_the_noise_of_its_orientation(tmp_path):
    (tmp_path / "pose.toml").write_text(SCENE)
    recording = simulate(tmp_path / "pose.toml")
    np.testing.assert_allclose(recording.columns["sigma_deg"], np.rad2deg(0.05 / 100))
    again = datasets.read(datasets.write(recording, tmp_path / "copy"))
    np.testing.assert_allclose(again.columns["sigma_deg"], recording.columns["sigma_deg"])
    (tmp_path / "point.toml").write_text(SCENE.replace("external-pose", "external-point"))
    assert "sigma_deg" not in simulate(tmp_path / "point.toml").columns
    assert "sigma_deg" not in recording.covariates
    recording.columns["sigma_deg"][3] = 0.0
    with pytest.raises(
        InputError, match=r"row 5 .*column sigma_deg: expected a number above 0, found 0"
    ):
        datasets.read(datasets.write(recording, tmp_path / "zero"))
