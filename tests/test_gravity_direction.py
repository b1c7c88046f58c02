"""An arm on a wall or a ceiling is recognised by its deflections; one on the floor, stiff or not, raises no alarm."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from datasets.recording import Recording
from mounted_arms import MountedArm
from robot_model.effects import CATALOGUE
from robot_model.files.loading import load_robot, whole_keys
from robot_model.measurements import samples_of
from robot_model.system import bind
from workbench.core.model import Model
from workbench.explanation.sentences.plausible_values import implausible_values
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.plausibility import check, check_plausibility
from workbench.fitting.plausibility.robot_files import gravity_direction
from workbench.fitting.plausibility.robot_files.gravity_direction import CAUSE
from workbench.jobs.robot.calibrate import calibrate

FLOOR, CEILING, WALL = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0)
INCLINED = (0.0, 0.5736, -0.8192)


def found_in(recording):
    """Directions of gravity that the plausibility check names."""
    samples = samples_of(recording)
    found = check_plausibility(load_robot(recording.robot), samples)
    return [suspicion for suspicion in found if suspicion.cause == CAUSE]


@pytest.mark.parametrize("has_masses", [True, False])
@pytest.mark.parametrize("gravity", [CEILING, WALL, INCLINED])
def test_the_direction_of_another_mount_is_found(gravity, has_masses):
    (found,) = found_in(MountedArm(gravity).recording(has_masses))
    assert not found.certain
    angle = np.rad2deg(np.arccos(np.clip(np.dot(found.robot_keys["gravity"], gravity), -1, 1)))
    assert angle < (0.1 if abs(max(gravity, key=abs)) == 1 else 5.0)


@pytest.mark.parametrize("has_masses", [True, False])
@pytest.mark.parametrize(
    "arm",
    [
        MountedArm(FLOOR),
        MountedArm(WALL, compliances=(0, 0, 0, 0, 0, 0)),
        MountedArm(FLOOR, compliances=(0, 0, 0, 0, 0, 0), first_harmonic=(8e-4, 0, 6e-4, 0, 0, 0)),
        MountedArm(FLOOR, springs=(1, -1, 1, 1, 1, 1)),
    ],
    ids=["compliant", "stiff", "eccentric", "counterbalanced"],
)
def test_other_arms_raise_no_alarm(arm, has_masses):
    assert not found_in(arm.recording(has_masses))


@pytest.mark.parametrize("name", ["irb120_wu_arm", "motoman_leica_ctu:right"])
def test_real_arms_on_the_floor_raise_no_alarm(name, recording):
    assert not found_in(recording(name))


def test_a_calibration_uses_the_direction_and_says_so():
    found = calibrate(MountedArm(WALL).recording(), folds=5)
    assert any("gravity = [-1, 0, 0]" in sentence for sentence in found.warnings)
    assert not found.suspicions
    np.testing.assert_allclose(found.recording.robot["gravity"], WALL)
    assert found.held_out["rms_mm"] < 3 * 0.03 * np.sqrt(3)
    assert abs(found.solution.parameters["joint-2.joint-compliance.compliance"] - 1.1e-6) < 1e-7


def test_a_stated_direction_is_not_doubted_and_trusted_data_keep_that_of_the_file():
    hanging = MountedArm(CEILING).recording()
    assert check_samples(hanging, trust_data=True).robot.gravity[2] == -1
    stated = {**hanging.robot, "gravity": [0.0, 0.0, 1.0]}
    assert not found_in(replace(hanging, robot=stated))


def test_a_built_in_arm_has_keys_to_which_a_direction_can_be_added():
    keys = whole_keys({"builtin": "abb_irb120"}) | {"gravity": [0.0, 0.0, 1.0]}
    assert load_robot(keys).gravity[2] == 1
    assert whole_keys(keys) == keys


def test_a_negative_compliance_and_a_large_tilt_raise_an_alarm():
    key = "joint-2.joint-compliance.compliance"
    row = {"key": key, "name": "compliance", "label": "joint 2's compliance", "unit": "rad/(N m)"}
    row |= {"effect": "joint-compliance", "std": 2e-7, "prior": 3e-3}
    assert "negative" in implausible_values([row | {"value": -3e-7}], 5.0, {key})[0]
    assert not implausible_values([row | {"value": -1e-7}], 5.0, {key})
    assert not implausible_values([row | {"value": -3e-7}], 5.0)
    tilt = {"name": "tilt_1", "label": "the tilt", "unit": "rad", "effect": "mount-tilt"}
    tilt |= {"std": 0.02, "prior": 1.0}
    assert "no small tilt" in implausible_values([tilt | {"value": 0.3}], 0.7)[0]
    assert not implausible_values([tilt | {"value": 0.05}], 0.7)


def few_deflections(seed: int):
    """Two poses in each fold, and six joints that each deflect as under gravity of a direction of its own."""
    rng = np.random.default_rng(seed)
    loads, noise = rng.normal(size=(10, 2, 18)), rng.normal(size=(10, 2, 1))
    sizes = rng.normal(size=(3, 6)) * rng.exponential(size=6) * 0.3
    moved = noise + np.einsum("frik,ik->fr", loads.reshape(10, 2, 3, 6), sizes)[..., None]
    rows = np.concatenate([moved, loads], 2)
    forms = np.einsum("fri,frj->fij", rows, rows)
    whole = forms.sum(0) + 1e-9 * np.eye(19)
    return gravity_direction._Deflections(whole, np.stack([whole - f for f in forms]), forms / 2)


def test_a_direction_that_the_held_out_poses_have_chosen_is_no_finding(monkeypatch):
    """Directions in space are many: the best one for all poses predicts them well by chance, that of each fold not."""
    robot = SimpleNamespace(gravity=np.array(FLOOR))
    refused = 0
    for seed in (81, 84, 91, 108):
        made = few_deflections(seed)
        monkeypatch.setattr(gravity_direction, "_deflections", lambda *given, made=made: made)
        found = gravity_direction.find_gravity(robot, None, None)
        best = gravity_direction._best_direction(made)
        errors = [made.held_out(d) for d in (best, robot.gravity, np.zeros(3))]
        looks_better = np.sqrt(errors[0].mean()) < 0.8 * min(np.sqrt(e.mean()) for e in errors[1:])
        refused += found is None and looks_better
        if found is not None and found.sigma_deg is not None:
            assert found.held_out_mm > np.sqrt(
                errors[0].mean()
            )  # that of the folds' own directions
            assert found.held_out_mm < 0.8 * np.sqrt(min(e.mean() for e in errors[1:]))
            assert found.sigma_deg > 0
    assert refused >= 2


def _scara(has_masses: bool) -> dict:
    """All axes are vertical: gravity has no torque about any of them."""
    rows = [
        (180.0, 400.0, 0.0, 9.0),
        (0.0, 250.0, 180.0, 6.0),
        (60.0, 0.0, 0.0, 1.5),
        (0, 0, 0, 0.5),
    ]
    joints = []
    for number, (d, a, alpha, mass) in enumerate(rows, 1):
        joint = {"theta_deg": 0.0, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
        joint |= {"kind": "prismatic"} if number == 3 else {}
        joint |= {"mass_kg": mass, "com_mm": [-a / 2, 10.0, 20.0]} if has_masses else {}
        joints.append(joint)
    return {"name": "a SCARA", "convention": "standard", "joint": joints}


@pytest.mark.parametrize("has_masses", [True, False])
def test_an_arm_whose_bearings_tilt_is_on_no_wall(has_masses, monkeypatch):
    """Its joints would deflect under gravity along x or y only, and may imitate what the tilting bearing does."""
    rng, n = np.random.default_rng(5), 160
    q = rng.uniform([-2.3, -2.3, 0, -2.5], [2.3, 2.3, 180, 2.5], (n, 4))
    names = ("q1_deg", "q2_deg", "q3_mm", "q4_deg")
    columns = {name: x if "mm" in name else np.rad2deg(x) for name, x in zip(names, q.T)}
    columns |= dict.fromkeys(("x_mm", "y_mm", "z_mm"), np.zeros(n))
    recording = Recording("external-point", columns, _scara(True), sigma_mm=0.02, name="made")
    start = np.array([900.0, -1200.0, 300.0, 0.1, -0.2, 0.3, 40.0, -30.0, 90.0])
    chain = bind(load_robot(recording.robot, "made"), recording, start)
    model = Model(chain, (CATALOGUE["bearing-compliance"]("joint-1"),))
    truth = model.parameters.values.copy()
    truth[6:26] += (rng.uniform(-1, 1, (4, 5)) * [0.001, 0.3, 0.3, 0.001, 0]).ravel()
    truth[-1] = 9e-5
    made = model.residual(replace(model.parameters, values=truth))
    made = chain.measurement.columns(made + rng.normal(0, 0.02, made.shape))
    recording = replace(recording, columns=columns | made, robot=_scara(has_masses))
    arguments = []
    monkeypatch.setattr(check, "find_gravity", lambda *given: arguments.append(given))
    assert not found_in(recording)
    ((robot, samples, fit),) = arguments
    rigid = gravity_direction._deflections(robot, samples, fit).held_out(robot.gravity)
    tilting = gravity_direction._with_tilting_bearings(robot, samples, fit)
    assert tilting.mean() == pytest.approx(3 * 0.02**2, rel=0.15)
    assert tilting.mean() < 0.5 * rigid.mean()
    # joints that would predict as well under another direction are no evidence of it
    monkeypatch.setattr(gravity_direction, "_best_direction", lambda deflections: np.eye(3)[0])
    held_out = gravity_direction._Deflections.held_out

    def imitating(deflections, direction, is_signed=False):
        own = held_out(deflections, direction, is_signed)
        return 1.05 * tilting if np.array_equal(direction, np.eye(3)[0]) else own

    monkeypatch.setattr(gravity_direction._Deflections, "held_out", imitating)
    assert gravity_direction.find_gravity(robot, samples, fit) is None


def test_mean_squares_of_exact_data_are_not_negative():
    """The residual and a deflection cancel but for rounding; the root of the mean was no number."""
    cancelling = np.outer([1.0, -1.0, 0.0, 0.0], [1.0, -1.0, 0.0, 0.0])
    trained = np.stack([cancelling, cancelling])
    tested = trained.copy()
    tested[:, 0, 0] -= 1e-12
    forms = gravity_direction._Deflections(cancelling, trained, tested)
    np.testing.assert_array_equal(forms.held_out(np.eye(3)[0]), 0.0)
