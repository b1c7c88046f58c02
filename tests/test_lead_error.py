"""Cyclic lead errors of prismatic joints, found in tables of a portal that are computed here."""

import numpy as np
import pytest

from datasets.recording import Recording
from robot_model import load_robot
from robot_model.effects.lead_error import CyclicLeadError
from robot_model.system import bind
from scenes import ABB, model_of, scene
from workbench.core.errors import InputError
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.compatible import compatible
from workbench.explanation.sentences.words import figures, law

ROWS = (
    (0, 0, 0, -90),
    (90, 0, 0, 90),
    (0, 0, 0, 0),
    (0, 180, 0, 90),
    (0, 0, 0, -90),
    (0, 130, 0, 0),
)
TRAVEL_MM = (1500.0, 1000.0, 600.0)
PERIOD_MM, SIZE_MM = 16.3, 0.03
SIGMA_MM = 0.01


def portal(pitch_mm=None):
    """The robot file's keys: three slides and a wrist."""
    joints = []
    for k, (theta, d, a, alpha) in enumerate(ROWS):
        row = {"theta_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
        joints.append(row | ({"kind": "prismatic"} if k < 3 else {}))
    if pitch_mm:
        joints[1]["pitch_mm"] = pitch_mm
    return {"name": "portal", "convention": "distal", "joint": joints}


def flange_point(variables):
    """(3,) of a point on the tool, by the product of the rows' transforms."""
    pose = np.eye(4)
    for k, (theta, d, a, alpha) in enumerate(ROWS):
        turn = np.deg2rad(theta) + (variables[k] if k > 2 else 0.0)
        c, s = np.cos(turn), np.sin(turn)
        ca, sa = np.cos(np.deg2rad(alpha)), np.sin(np.deg2rad(alpha))
        row = [
            [c, -s * ca, s * sa, a * c],
            [s, c * ca, -c * sa, a * s],
            [0, sa, ca, d + (variables[k] if k < 3 else 0.0)],
            [0, 0, 0, 1],
        ]
        pose = pose @ np.array(row)
    return (pose @ [40.0, -30.0, 90.0, 1.0])[:3]


def measured(size_mm, pitch_mm=None, n=90):
    """A recording in which joint 2 errs by a sine of its travel."""
    rng = np.random.default_rng(5)
    slides = rng.uniform(0, TRAVEL_MM, (n, 3))
    angles = rng.uniform(-1.5, 1.5, (n, 3))
    actual = np.hstack([slides, angles])
    actual[:, 1] += size_mm * np.sin(2 * np.pi * slides[:, 1] / PERIOD_MM + 0.4)
    points = np.array([flange_point(q) for q in actual]) + rng.normal(0, SIGMA_MM, (n, 3))
    columns = {"sample": np.arange(1.0, n + 1), "reflector": np.ones(n)}
    columns |= {f"q{k + 1}_mm": slides[:, k] for k in range(3)}
    columns |= {f"q{k + 4}_deg": np.rad2deg(angles[:, k]) for k in range(3)}
    columns |= {f"{axis}_mm": points[:, i] for i, axis in enumerate("xyz")}
    return Recording("external-point", columns, portal(pitch_mm), sigma_mm=SIGMA_MM, name="portal")


def test_the_period_is_found_and_a_fast_wave_stands_next_to_a_smooth_function_of_the_same_travel():
    problem = bench_of(measured(SIZE_MM)).problem()
    ranked = ranked_hypotheses(problem)
    first = ranked[0]
    assert (first.effect, first.where) == ("cyclic-lead-error", "joint-2")
    assert first.value == pytest.approx(PERIOD_MM, abs=PERIOD_MM**2 / TRAVEL_MM[1] / 2)
    smooth = next(h for h in ranked if h.where == "joint-2" and h.smooth_covariates == ("q2",))
    assert compatible(first, smooth)


def test_of_a_table_without_the_error_no_period_is_likely():
    ranked = ranked_hypotheses(bench_of(measured(0.0)).problem())
    assert ranked
    assert all(h.evidence + h.log_prior < 0 for h in ranked if h.effect == "cyclic-lead-error")


def test_the_stated_pitch_and_half_of_it_are_likelier_than_other_periods():
    grids = [
        next(
            g
            for g in CyclicLeadError.grids(bench_of(measured(0.0, pitch)).chain)
            if g.where == "joint-2"
        )
        for pitch in (None, PERIOD_MM)
    ]
    for grid in grids:
        assert grid.prior_weights.sum() == pytest.approx(1.0)
        assert (np.diff(grid.values) > 0).all()
    plain, stated = grids
    assert PERIOD_MM not in plain.values
    weights = dict(zip(stated.values, stated.prior_weights))
    assert weights[PERIOD_MM] > weights[PERIOD_MM / 2] > 20 * np.median(stated.prior_weights)


def test_a_revolute_joint_has_no_lead_error():
    with pytest.raises(InputError, match="expected a prismatic joint.*transmission-harmonic"):
        model_of(
            scene("external-point", n=20), ("cyclic-lead-error", "joint-2", {"period": 8.0})
        ).parameters
    chain = bind(load_robot(ABB), scene("external-point", n=20).recording)
    assert not list(CyclicLeadError.grids(chain))


def test_its_sentence_names_amplitude_and_drive():
    rows = [
        {"name": "cos16_3", "value": 0.03, "std": 0.001, "unit": "mm"},
        {"name": "sin16_3", "value": 0.04, "std": 0.001, "unit": "mm"},
    ]
    assert figures(rows).startswith("amplitude 50.0 ± 1.0 µm")
    assert law("cyclic-lead-error", "joint-2").startswith("Joint 2 has a lead error")
