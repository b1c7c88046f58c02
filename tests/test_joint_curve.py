"""Error curves of joints: the law, its spectrum, recovery on simulated arms, and the real UR10."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from robot_model.effects.curve import (
    JointCurve,
    curve_candidates,
    curve_options,
    describe_curves,
    dominant_cycles,
    resolved_terms,
)
from scenes import model_of, scene
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.fitting.calibration_plans.joint_curves import choose_joint_curves
from workbench.fitting.calibration_plans.plans import geometry, stage_mask

ANGLES = np.linspace(-2.0, 1.5, 400)


def fitted(angle, error, terms):
    """A curve of a joint and its coefficients by least squares."""
    curve = JointCurve("joint-2", **curve_options(angle, terms))
    columns = np.concatenate([curve.cosines(angle), np.ones((1, len(angle)))])
    return curve, np.linalg.lstsq(columns.T, error, rcond=None)[0][:-1]


def test_a_curve_makes_a_function_that_is_not_periodic():
    error = 1e-4 * ANGLES + 2e-4 * np.exp(-((ANGLES - 0.4) ** 2) / 0.1)
    curve, coefficients = fitted(ANGLES, error, 31)
    left = error - curve.curve(coefficients, ANGLES)
    assert np.std(left) < 0.01 * np.std(error)


def test_beyond_the_visited_angles_a_curve_is_constant():
    curve, coefficients = fitted(ANGLES, 1e-4 * ANGLES, 15)
    outside = curve.curve(coefficients, np.array([curve.end, curve.end + 1.0, curve.end + 2.0]))
    assert np.ptp(outside) == 0


def sigma_beyond(curve, coefficients, angle, recorded=None):
    """(n,) 1 sigma of a curve of joint 2 at angles (n,)."""
    state = SimpleNamespace(drive_angles=np.stack([np.zeros(len(angle)), angle]))
    return curve.extrapolation(coefficients, state, recorded)[0]


def harmonics(rng):
    """A sum of one to three harmonics of 0.5 to 4 cycles per revolution at random phases, as a function."""
    count = rng.integers(1, 4)
    orders, phases = rng.uniform(0.5, 4, count), rng.uniform(0, 2 * np.pi, count)
    sizes = 3e-4 * rng.uniform(0.3, 1, count)
    return lambda angle: sizes @ np.sin(np.outer(orders, angle) + phases[:, None])


def test_three_sigma_of_the_extrapolation_hold_the_error_beyond_the_recorded_angles():
    """At 10, 20 and 40 degrees beyond, on either side; 300 curves of sums of harmonics without noise."""
    rng = np.random.default_rng(17)
    distance = np.deg2rad([10.0, 20.0, 40.0])
    errors, sigmas = [], []
    for _ in range(300):
        function = harmonics(rng)
        curve, coefficients = fitted(ANGLES, function(ANGLES), 15)
        beyond = np.array([ANGLES[-1] + distance, ANGLES[0] - distance])
        ends = ANGLES[[-1, 0]]
        constant = function(ends) - curve.curve(coefficients, ends)
        left = [function(x) - curve.curve(coefficients, x) - c for x, c in zip(beyond, constant)]
        errors.append(left)
        sigmas.append([sigma_beyond(curve, coefficients, x) for x in beyond])
    errors, sigmas = np.abs(errors), np.array(sigmas)
    assert ((errors <= 3 * sigmas).mean((0, 1)) >= 0.95).all()
    ratio = np.sqrt((errors**2).mean((0, 1)) / (sigmas**2).mean((0, 1)))
    assert (ratio > 0.5).all() and (ratio < 1.5).all()


def test_extrapolation_starts_at_the_last_recorded_angle_and_never_shrinks():
    """Not at the end of the domain; and a harmonic is not known again at its period."""
    curve, coefficients = fitted(ANGLES, 2e-4 * np.sin(6 * ANGLES), 31)
    assert sigma_beyond(curve, coefficients, ANGLES).max() < 1e-12
    beyond = ANGLES[-1] + np.linspace(0.01, 2.5, 100)
    sigma = sigma_beyond(curve, coefficients, beyond)
    assert beyond[0] < curve.end and sigma[0] > 0 and (np.diff(sigma) >= 0).all()
    assert sigma[-1] == pytest.approx(2e-4 * np.sqrt(2), rel=0.05)  # the crest: sqrt(2) amplitudes
    shorter = sigma_beyond(curve, coefficients, np.array([1.3]), {"q2": (-2.0, 1.2)})
    assert shorter[0] > 0


def test_a_linear_curve_is_off_by_its_slope():
    """An error of the gear ratio goes on beyond the recorded angles."""
    curve, coefficients = fitted(ANGLES, 1e-4 * ANGLES, 15)
    sigma = sigma_beyond(curve, coefficients, ANGLES[0] - np.array([0.5, 3.0]))
    np.testing.assert_allclose(sigma, [0.5e-4, 3e-4], rtol=0.02)


def test_the_spectrum_names_the_cycles_per_revolution_that_are_there():
    error = 2e-4 * np.cos(17 * ANGLES + 0.3) + 1e-4 * np.sin(4 * ANGLES)
    curve, coefficients = fitted(ANGLES, error, 63)
    cycles = dominant_cycles(curve, coefficients)
    assert cycles[0].order == pytest.approx(17, abs=0.3)
    assert cycles[0].amplitude == pytest.approx(2e-4, rel=0.1)
    assert cycles[1].order == pytest.approx(4, abs=0.5)
    assert cycles[0].per_motor_revolution is None
    tied = dominant_cycles(curve, coefficients, gear_ratio=-8.5)
    assert tied[0].per_motor_revolution == 2 and tied[1].per_motor_revolution is None


def test_an_end_before_the_start_is_a_sentence():
    with pytest.raises(InputError, match="expected an end after the start"):
        JointCurve("joint-1", start=1.0, end=1.0)


@pytest.mark.parametrize(
    ("angle", "numbers", "terms"),
    [
        (np.linspace(0, 3, 500), 2000, 63),
        (np.linspace(0, 3, 500), 250, 31),  # too few measured numbers
        (np.repeat([0.0, 1.0, 2.0, 3.0], 50), 2000, 3),  # four angles only
        (np.append(np.linspace(0, 1, 500), [2.0, 3.0]), 2000, 63),  # two poses far from the others
        (np.repeat([0.0, 0.02, 1.48, 1.5], 300) + np.tile(np.linspace(0, 0.02, 300), 4), 10**5, 0),
        (np.linspace(0, 3, 64), 2000, 31),  # two poses in each half wave of 31 terms
        (np.linspace(0, 3, 500), 8, 0),
    ],
)
def test_the_resolution_follows_from_visited_angles_and_numbers(angle, numbers, terms):
    assert resolved_terms(angle, numbers) == terms


def test_repeats_of_a_pose_do_not_raise_the_resolution():
    made = model_of(scene("external-point", n=40, seed=3))
    repeated = made.at(np.tile(np.arange(40), 10))
    once = [curve.terms for curve in curve_candidates(made.chain)]
    assert [curve.terms for curve in curve_candidates(repeated.chain)] == once


def with_curves(shapes, n=300, sigma=0.02, seed=5):
    """A model on simulated samples in which some joints err by functions of their own angle, and its geometry fit."""
    model = model_of(scene("external-point", n=n, seed=seed))
    evaluation = model.evaluate(model.parameters)
    rng = np.random.default_rng(seed)
    moved = rng.normal(0, sigma, evaluation.residual.shape)
    for joint, shape in shapes.items():
        row = evaluation.rows("joint", np.array([joint - 1]))[0]
        moved = moved + row * shape(model.chain.variables[joint - 1])
    measured = model.chain.measurement.measured + evaluation.residual + moved
    measurement = replace(model.chain.measurement, measured=measured)
    sigmas = np.full_like(model.chain.sigma, sigma)
    chain = replace(model.chain, measurement=measurement, sigma=sigmas, stated_sigma=sigmas)
    model = replace(model, chain=chain, _bases={})
    mask = stage_mask(model.parameters, geometry(chain.robot), (), chain)
    fit = solve(model, model.parameters.only(mask))
    return model, fit.parameters


def test_curves_of_three_joints_are_found_together():
    shapes = {
        2: lambda q: 4e-4 * np.sin(11 * q),
        3: lambda q: 3e-4 * np.exp(-((q - q.mean()) ** 2) / 0.02),
        5: lambda q: 6e-4 * np.cos(7 * q),
    }
    model, parameters = with_curves(shapes)
    chosen = choose_joint_curves(model, parameters)
    assert {where for _, where, _ in chosen} == {"joint-2", "joint-3", "joint-5"}


def test_an_arm_without_curves_gets_none():
    for seed in range(4):
        model, parameters = with_curves({}, seed=seed)
        assert choose_joint_curves(model, parameters) == ()


def test_the_chosen_curves_lower_the_error_and_state_the_order():
    model, parameters = with_curves({2: lambda q: 4e-4 * np.sin(11 * q)})
    rows = choose_joint_curves(model, parameters)
    effect = CATALOGUE["joint-curve"](rows[0][1], **rows[0][2])
    wider = model.with_effects(effect)
    start = wider.parameters.take_over(parameters)
    mask = parameters.mask.tolist() + [True] * effect.terms
    fit = solve(wider, start.only(np.array(mask)))
    coefficients = fit.parameters.values[wider.spans[0]]
    assert dominant_cycles(effect, coefficients)[0].order == pytest.approx(11, abs=0.3)
    assert np.sqrt((fit.residual**2).mean()) < 0.025


@pytest.mark.long
def test_default_calibration_of_the_ur10_finds_the_curves(recording):
    """Held-out errors at most 0.20 mm and 0.03 deg; geometry and two harmonics per joint leave 0.43 mm and 0.05 deg."""
    from workbench.jobs.robot.calibrate import calibrate

    found = calibrate(recording("ur10_ipa_tmac_A"))
    assert found.held_out["rms_mm"] <= 0.20
    assert found.held_out["rotation_rms_deg"] <= 0.03
    curves = found.as_json()["joint_curves"]
    assert {"joint-1", "joint-2", "joint-3"} <= {row["where"] for row in curves}
    assert all(row["cycles"] for row in curves)


def test_terms_that_cancel_are_described_by_their_sum():
    """A curve and a harmonic of one joint that nearly cancel are one small error of this joint."""
    made = scene("external-point", n=300, seed=3)
    angle = np.deg2rad(made.recording.columns["q2_deg"])
    small = 1e-4 * np.cos(8 * angle)
    curve, coefficients = fitted(angle, small - 5e-3 * np.cos(angle), 31)
    model = model_of(
        made,
        ("transmission-harmonic", "joint-2", {"order": 1.0}),
        ("joint-curve", "joint-2", dict(curve.options)),
    )
    known = {"joint-2.transmission-harmonic.cos1": 5e-3}
    known |= {f"joint-2.joint-curve.c{j}": c for j, c in enumerate(coefficients, 1)}
    (row,) = describe_curves(model, model.parameters.update(known))
    assert row["rms"] == pytest.approx(small.std(), rel=0.2)
    assert row["cycles"][0]["order"] == pytest.approx(8, abs=0.7)
    assert row["cycles"][0]["amplitude"] == pytest.approx(1e-4, rel=0.2)
