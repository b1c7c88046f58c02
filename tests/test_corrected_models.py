"""A diagnosis leaves a plan, a solution and a scene of what it found, and every command accepts them."""

import json
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w

from robot_model.effects import CATALOGUE
from robot_model.system import bind
from workbench.commands.shared.model_run import is_model_run, scene_of
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.core.rigid import rotation_matrix
from workbench.diagnosis.linear.problem import Finding
from workbench.explanation.answer import diagnose
from workbench.explanation.output.corrected_model import (
    corrected_stages,
    estimated_std,
    write_model,
)
from workbench.explanation.result import Term
from workbench.files.solution_file import read_solution, without_terms
from workbench.fitting.calibration_plans import plan_file
from workbench.fitting.calibration_plans.plans import read_plan
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.compensation.compensate import actual_poses, compensate
from workbench.jobs.robot.compensation.correction_limits import checked
from workbench.jobs.robot.compensation.switched_off import switched_off_warnings
from workbench.jobs.robot.poses import choose_poses
from workbench.jobs.robot.simulate import simulate

HALF_GAP = 4e-4
SCENE = {
    "robot": "abb_irb120",
    "samples": 90,
    "seed": 3,
    "sigma_mm": 0.02,
    "reflectors": [[30.0, -40.0, 100.0]],
    "approach": True,
    "base": {"xyz_mm": [1500.0, 100.0, 300.0], "rpy_deg": [2.0, -1.0, 140.0]},
    "errors": {"length_mm": 0.3, "angle_deg": 0.05},
    "effect": [{"effect": "backlash", "where": "joint-3", "values": {"half_gap": HALF_GAP}}],
}
CURVE = {
    "port": "joint",
    "names": ["q2"],
    "spans": [[-1.8, 1.8]],
    "unit": "rad",
    "sizes": [3e-4],
}


def recorded(folder, scene):
    """The recording of a scene."""
    path = folder / "given.toml"
    path.write_text(tomli_w.dumps(scene))
    return simulate(path)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A recording, its diagnosis and the folder with the model files."""
    folder = tmp_path_factory.mktemp("run")
    recording = recorded(tmp_path_factory.mktemp("scene"), SCENE)
    made = diagnose(recording)
    files = write_model(made, recording, folder)
    return recording, made, folder, files


@pytest.mark.slow
def test_the_run_folder_holds_plan_solution_and_scene(run):
    _, made, folder, files = run
    assert [(t.finding.effect, t.finding.where) for t in made.terms] == [("backlash", "joint-3")]
    result = files.as_json(folder)
    assert all(result[key].startswith(str(folder)) for key in ("plan", "solution", "scene"))
    assert not result["left_out"] and 0.02 < result["held_out_rms_mm"] < 0.05
    assert is_model_run(folder) and scene_of(folder).is_file()


def test_a_model_without_findings_is_the_nominal_arm_where_a_fit_predicts_no_better(tmp_path):
    """Few samples of an arm that is built as its file says; the files can be exported without being forced."""
    scene = {key: value for key, value in SCENE.items() if key not in ("errors", "effect")}
    recording = recorded(tmp_path, scene | {"samples": 45, "seed": 4})
    files = write_model(diagnose(recording), recording, tmp_path)
    arm = read_solution(tmp_path)
    assert len(files.left_out) == 1 and "predicts unseen poses no better" in files.left_out[0]
    assert all(key.startswith(("base.", "tool.")) for key in arm.free)
    assert checked(arm, tmp_path, force=False) is arm
    again = calibrate(recording, read_plan(tmp_path))
    assert again.held_out["rms_mm"] == pytest.approx(arm.held_out_mm)


@pytest.mark.slow
def test_a_refused_term_counts_for_the_uncertainty_of_the_model_without_it(run, tmp_path):
    """A backlash that is certainly there and not in the model: its uncertainty is the error that it makes."""
    recording, made, folder, _ = run
    refused = replace(made.terms[0], kept=False, t=8.0)
    write_model(replace(made, terms=(), refused=(refused,)), recording, tmp_path)
    arm, right = read_solution(tmp_path), read_solution(folder)
    joints = np.deg2rad(np.random.default_rng(8).uniform(-50, 50, (40, 6)))
    sides = np.random.default_rng(9).choice([-1.0, 1.0], (6, 40))
    columns = {f"approach{k}": side for k, side in enumerate(sides, 1)}
    assert not arm.effects and [one.title for one in arm.considered.effects] == [
        "backlash at joint-3"
    ]
    wrong_by = measured_points(arm, joints, columns) - measured_points(right, joints, columns)
    done = compensate(arm, joints, covariates=columns)
    alone = compensate(replace(arm, considered=None), joints, covariates=columns)
    added = np.sqrt((done.sigma_mm**2 - alone.sigma_mm**2).mean())
    assert np.sqrt((wrong_by**2).sum(1).mean()) == pytest.approx(added, rel=0.1)
    assert added > 3 * np.sqrt((alone.sigma_mm**2).mean())


def measured_points(arm, readings, columns):
    """(n, 3) mm: the reflector of a calibrated arm in the instrument's frame."""
    base = np.array([arm.values[f"base.{c}"] for c in ("x", "y", "z", "rx", "ry", "rz")])
    reflector = np.array([arm.values[f"tool.reflector1_{c}"] for c in "xyz"] + [1.0])
    in_root = (actual_poses(arm, readings, columns) @ reflector)[:, :3]
    return in_root @ rotation_matrix(base[3:]).T + base[:3]


def test_a_damaged_matrix_of_considered_terms_is_a_sentence(run, tmp_path):
    keys = json.loads((run[2] / "solution.json").read_text())
    row = {"effect": "backlash", "where": "joint-2", "seat": "approach"}
    gap = "joint-2.backlash.half_gap"
    model = {"effects": [row], "free": [gap], "values": {gap: 0.0}, "probability": 0.5}
    considered = {"models": [model | {"covariance": [[-1.0]]}], "recorded_rms_mm": 0.0}
    (tmp_path / "solution.json").write_text(json.dumps(keys | {"considered": considered}))
    words = "key considered.models.covariance: expected a covariance matrix"
    with pytest.raises(InputError, match=words):
        read_solution(tmp_path)


def test_the_page_shows_the_residual_term_by_term(run, tmp_path):
    from workbench.report.diagnosis.page import page
    from workbench.report.diagnosis.terms import over_covariates

    _, made, _, _ = run
    steps = made.views.steps
    assert [step.name for step in steps] == ["baseline", f"+ {made.terms[0].title}"]
    assert np.array_equal(steps[0].residual, made.views.before)
    assert np.array_equal(steps[-1].residual, made.views.after)
    assert steps[0].rms > 1.5 * steps[1].rms
    drawn = over_covariates(made)
    titles = [axis.title.text for axis in drawn.select_xaxes() if axis.title.text]
    assert len(titles) == 7 and len(drawn.data) == 2 * 7
    sections = {section.name: section for section in page(made).sections}
    assert "+ backlash" in str(sections["terms"].blocks[1]["rows"])


def test_the_plan_read_back_has_the_accepted_terms(run):
    recording, made, folder, _ = run
    robot = bind_robot(recording)
    stages = corrected_stages(made, robot)
    assert read_plan(folder) == stages
    assert [stage.name for stage in stages] == ["geometry", "joint-3.backlash"]
    assert not any(stage.earn for stage in stages)


def bind_robot(recording):
    from robot_model import load_robot

    return load_robot(recording.robot)


def test_the_solution_is_that_of_a_calibration_by_the_plan(run):
    recording, _, folder, _ = run
    arm = read_solution(folder)
    again = calibrate(recording, folder)
    for key, value in zip(again.solution.parameters.keys, again.solution.parameters.values):
        assert arm.values[key] == pytest.approx(value, abs=1e-9)
    index = arm.free.index("joint-3.backlash.half_gap")
    std = np.sqrt(arm.covariance[index, index])
    assert abs(arm.values["joint-3.backlash.half_gap"] - HALF_GAP) < 4 * std < HALF_GAP
    assert arm.trusted


def test_a_term_is_switched_off_by_name(run):
    _, _, folder, _ = run
    arm = read_solution(folder)
    bare = without_terms(arm, ["joint-3.back*"], "run")
    assert not bare.effects and bare.values == arm.values
    readings = np.deg2rad([[10.0, 20, -15, 30, 40, 5]])
    side = {f"approach{k}": np.ones(1) for k in range(1, 7)}
    moved = (
        actual_poses(arm, readings, side)[0, :3, 3] - actual_poses(bare, readings, side)[0, :3, 3]
    )
    assert np.linalg.norm(moved) > 0.05
    stages = plan_file.without_terms(read_plan(folder), ["joint-3.backlash"])
    assert [stage.name for stage in stages] == ["geometry"]
    with pytest.raises(InputError, match="--without joint-4.backlash: .* its terms are joint-3.b"):
        without_terms(arm, ["joint-4.backlash"], "run")


def test_the_scene_simulates_the_corrected_arm(run):
    """At the recorded readings the simulated arm is where the recording says, within the noise."""
    recording, _, folder, _ = run
    keys = tomllib.loads((folder / "scene.toml").read_text())
    again = simulate(folder / "scene.toml")
    assert again.n == recording.n and again.sigma_mm == pytest.approx(0.02, rel=0.3)
    arm = read_solution(folder)
    model = Model(bind(bind_robot(again), again), arm.effects)
    known = {k: v for k, v in arm.values.items() if k in model.parameters.index}
    residual = model.residual(model.parameters.update(known))
    assert np.sqrt((residual**2).mean()) == pytest.approx(keys["sigma_mm"], rel=0.2)
    plain = simulate(folder / "scene.toml", ["joint-3.backlash"])
    off = np.linalg.norm(plain.points - again.points, axis=1)
    assert np.sqrt((off**2).mean()) > 0.08  # a gap of 0.4 mrad at 300 mm
    with pytest.raises(InputError, match="--without base.backlash"):
        simulate(folder / "scene.toml", ["base.backlash"])


def test_poses_are_chosen_for_the_terms_of_the_model(run):
    _, _, folder, _ = run
    rows = tuple(row for stage in read_plan(folder) for row in stage.effects)
    found = simulate(folder / "scene.toml")
    plain = choose_poses(found, 30, link_radius_mm=0)
    chosen = choose_poses(found, 30, effects=rows, link_radius_mm=0)
    assert chosen.parameters == plain.parameters + 1


def test_a_scene_with_an_unknown_parameter_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match="key geometry: expected parameters of the arm"):
        recorded(tmp_path, SCENE | {"geometry": {"joint-9.a9": 1.0}})


def test_what_a_switched_off_term_moves_is_said_and_not_in_the_uncertainty(run):
    """A gap of 0.4 mrad at joint 3 moves the flange, 0.4 m away, by 0.1 to 0.3 mm."""
    arm = read_solution(run[2])
    bare = without_terms(arm, ["joint-3.backlash"], "run")
    readings = np.random.default_rng(0).uniform(-1, 1, (20, 6))
    sides = {f"approach{k}": np.ones(20) for k in range(1, 7)}
    (said,) = switched_off_warnings(arm, bare, readings, sides)
    assert "joint-3.backlash" in said and "do not contain this" in said
    largest = float(said.split("by up to ")[1].split(" mm")[0])
    moved = actual_poses(arm, readings, sides) - actual_poses(bare, readings, sides)
    assert largest == pytest.approx(np.linalg.norm(moved[:, :3, 3], axis=1).max(), rel=0.01)
    assert 0.1 < largest < 0.3
    readings[0] = np.nan  # a target that is not reached
    assert "by up to" in switched_off_warnings(arm, bare, readings, sides)[0]
    assert "do not determine" in switched_off_warnings(arm, bare, readings, {})[0]
    assert switched_off_warnings(arm, arm, readings, sides) == []


def test_smooth_functions_are_part_of_the_model_files(run, tmp_path):
    """A curve without a law goes through plan, solution and scene, and predicts the same after each."""
    curve = CATALOGUE["smooth-function"]("joint-2", **CURVE)
    scene = SCENE | {
        "effect": [
            {
                "effect": "smooth-function",
                "where": "joint-2",
                **CURVE,
                "values": {"q2_0_4": 5e-4, "q2_0_6": -4e-4},
            }
        ]
    }
    recording = recorded(tmp_path, scene)
    finding = Finding("unknown", "joint-2", "", (curve,), 1e-9, 1.0, 1.0, 1.0, ("q2",))
    made = replace(run[1], terms=(Term(finding),))
    files = write_model(made, recording, tmp_path)
    assert not files.left_out and files.held_out_rms_mm < 0.06
    arm = read_solution(tmp_path)
    assert [effect.title for effect in arm.acting_effects] == ["smooth function of q2 at joint-2"]
    assert arm.effects[0].options == curve.options
    (again,) = make_effects(CATALOGUE, read_plan(tmp_path)[1].effects)
    assert again.options == curve.options
    grid = np.linspace(-1.7, 1.7, 50)
    readings = np.zeros((50, 6))
    readings[:, 1] = grid
    without = without_terms(arm, ["joint-2.unknown"], "run")
    off = actual_poses(arm, readings) - actual_poses(without, readings)
    assert 0.05 < np.linalg.norm(off[:, :3, 3], axis=1).max() < 1.5
    assert simulate(tmp_path / "scene.toml").n == recording.n


def test_the_model_of_images_is_said_to_be_none(run, tmp_path):
    files = write_model(replace(run[1], unit="px"), None, tmp_path)
    result = json.loads(json.dumps(files.as_json(tmp_path)))
    assert result["plan"] is None and "images" in result["left_out"][0]


def test_the_solution_has_the_standard_deviations_of_the_diagnosis():
    """The plan fixes an order that the diagnosis estimated, so that the covariance of a calibration lacks its part."""
    row = {"key": "joint-1.wave", "std": 5.0, "conditional_std": 3.0}
    derived = {"key": "joint-1.deflection", "std": 1.0, "derived": True}
    terms = [SimpleNamespace(parameters=(row, derived)), SimpleNamespace(parameters=())]
    assert estimated_std(terms) == {"joint-1.wave": 5.0}


def test_a_model_without_terms_says_so():
    from workbench.core.terms import switched_off

    with pytest.raises(InputError, match="its model has no terms to omit"):
        switched_off([], ["joint-3.backlash"], "found")
