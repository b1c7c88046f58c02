"""The instrument is a part of the measuring chain: errors of its angle encoders, and moves of its reflector."""

from dataclasses import replace

import numpy as np
import pytest

from noise_scenes import XYZ, recorded
from robot_model.effects import CATALOGUE
from robot_model.effects.instrument import sight_directions
from robot_model.effects.steps import Shift
from robot_model.system import bind
from scenes import model_of, scene
from workbench.diagnosis.linear.problem import Alternative, Finding
from workbench.diagnosis.robot.derived import reflector_rows
from workbench.explanation.answer import diagnose
from workbench.explanation.numbered_samples import with_numbered_label
from workbench.explanation.result import Term
from workbench.explanation.sentences.plausible_values import implausible_values
from workbench.explanation.sentences.statements import instants_in_brackets, with_sample_numbers


def away(points):
    """Points (3, n) mm as from an instrument 3 m from their middle."""
    return points - points.mean(1, keepdims=True) + np.array([[2400.0], [1500.0], [-900.0]])


def test_directions_are_the_derivatives_of_the_point():
    rng = np.random.default_rng(1)
    azimuth, elevation, length = 0.7, -0.3, 2500.0 + rng.uniform(0, 100)

    def point(values):
        a, e, r = values
        return r * np.array([[np.cos(e) * np.cos(a)], [np.cos(e) * np.sin(a)], [np.sin(e)]])

    here = np.array([azimuth, elevation, length])
    made = sight_directions(point(here))
    for k, step in enumerate([1e-6, 1e-6, 1e-3]):
        ends = [point(here + sign * step * np.eye(3)[k]) for sign in (1, -1)]
        np.testing.assert_allclose(made[k], (ends[0] - ends[1]) / (2 * step), rtol=1e-6, atol=1e-5)


def test_an_error_curve_of_the_azimuth_is_named_with_its_order():
    def change(points, rng):
        points = away(points)
        azimuth = np.arctan2(points[1], points[0])
        return points + 6e-5 * np.sin(11 * azimuth + 1) * sight_directions(points)[0]

    found = diagnose(recorded(4, n=120, change=change))
    own = [t for t in found.terms if t.finding.effect == "azimuth-harmonic"]
    assert found.verdict == "explained" and len(own) == 1
    sizes = [row["value"] for row in own[0].parameters if row["name"][:3] in ("cos", "sin")]
    assert own[0].finding.effects[0].order == pytest.approx(11, abs=0.5)
    assert np.hypot(*sizes) == pytest.approx(6e-5, rel=0.15)


def test_points_about_the_robot_have_no_sight_lines():
    recording = recorded(4, n=60, change=lambda points, rng: away(points))
    points = np.stack([recording.columns[name] for name in XYZ])
    chain = bind(scene("external-point").robot, recording)
    root = chain.start[:3, None]
    around = replace(recording, columns=recording.columns | dict(zip(XYZ, points - root)))
    assert chain.has_sight_lines
    assert not bind(chain.robot, around).has_sight_lines


def test_a_step_of_the_tool_is_the_move_of_its_only_reflector():
    chain = model_of(scene("external-point", n=20, reflectors={1: (30.0, -40.0, 100.0)})).chain
    rng = np.random.default_rng(2)
    twist, root = rng.normal(0, 1e-3, 6), rng.normal(0, 1e-4, (6, 6))
    rows = reflector_rows(Shift("tool", 50.0), twist, root @ root.T, chain)
    lever = chain.state.target[:, 0]
    expected = twist[:3] + np.cross(twist[3:], lever)
    assert [row["value"] for row in rows] == pytest.approx(expected)
    assert all(row["std"] > 0 and row["unit"] == "mm" for row in rows)
    assert not reflector_rows(Shift("base", 50.0), twist, root @ root.T, chain)


def test_a_value_far_beyond_its_prior_raises_an_alarm():
    row = {"name": "tilt_1", "label": "the tilt of gravity (1)", "unit": "rad", "prior": 0.03}
    assert "not plausible" in implausible_values([row | {"value": -0.8, "std": 0.1}], 6.7)[0]
    assert not implausible_values([row | {"value": -0.8, "std": 0.5}], 6.7)
    assert not implausible_values([row | {"value": 0.04, "std": 0.001}], 6.7)


def test_instants_are_between_two_samples():
    order, ids = np.arange(5.0), np.array([1, 2, 3, 5, 6])
    said = with_sample_numbers("a step (after row 2.5)", order, ids)
    assert said == "a step (between samples 3 and 5)"
    said = with_sample_numbers("a step (after 25 s): 3 mm", 10 * order, ids)
    assert said == "a step (at 25 s, between samples 3 and 5): 3 mm"


def test_next_experiment_names_samples_in_brackets_only():
    order, ids = np.arange(5.0), np.array([1, 2, 3, 5, 6])
    said = instants_in_brackets("zero-shift (after row 2.5) at joint 3, after 2 more", order, ids)
    assert said == "zero-shift (between samples 3 and 5) at joint 3, after 2 more"


@pytest.mark.parametrize("name", ["azimuth-harmonic", "elevation-harmonic"])
def test_an_angle_harmonic_is_no_part_of_the_arm(name):
    assert CATALOGUE[name].of_session


def test_labels_of_instants_name_samples_as_the_statements_do():
    order, ids = np.arange(5.0), np.array([1, 2, 3, 5, 6])
    other = Alternative("shift", "tool", "after row 0.5", 0.3, 1.0, "")
    found = Finding("zero-shift", "joint-3", "after row 2.5", (), 1e-9, 1.0, 1.0, 1.0)
    named = with_numbered_label(Term(replace(found, alternatives=(other,))), order, ids).finding
    assert named.label == "between samples 3 and 5"
    assert named.alternatives[0].label == "between samples 1 and 2"
