"""What effects say of themselves to the diagnosis: candidates, grids, constraints, covariates that they read."""

import numpy as np
import pytest

from robot_model.effects import CATALOGUE as ROBOT
from robot_model.effects.elastic import JointCompliance, LinkSelfWeight
from robot_model.effects.transmission import Backlash, TransmissionHarmonic
from scenes import ABB, SLIDING, model_of, scene
from sensors.effects import CATALOGUE as SCANNER
from workbench.core.effect import Effect, Grid, Variant, option_types
from workbench.diagnosis.linear.hypotheses import ranked_hypotheses
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.robot.library import compliances, grids, names, subsumed, variants
from workbench.diagnosis.scanner.sensor_library import Kind

SCAN = Kind(
    stripes=True,
    mirror=True,
    balls=(1, 2),
    varying=frozenset({"time_s", "sweep", "mirror_speed_deg_s"}),
    light=(0.0, 50.0, 0.0),
    light_axis=(0.0, 1.0, 0.0),
    mirror_angles=(0.1, 0.12, 0.14),
)


def chain_of(arm):
    """The chain of ball centres that an arm has measured."""
    return model_of(scene("ball-centre", arm=arm)).chain


@pytest.mark.parametrize("kind", [*ROBOT.values(), *SCANNER.values()])
def test_members_have_the_types_that_readers_expect(kind):
    known = names([*ROBOT.values(), *SCANNER.values()])
    assert set(kind.subsumes) <= known
    assert isinstance(kind.nonnegative, int) and isinstance(kind.plant_weight, float)
    assert isinstance(kind.unrecorded, str) and isinstance(kind.stage, str)
    assert kind.candidates.__doc__ and kind.grids.__doc__
    assert not kind.plant_weight or kind.planted.__func__ is not Effect.planted.__func__


@pytest.mark.parametrize("robot", [ABB, SLIDING])
def test_candidates_of_a_robot_sit_at_its_places_and_have_parameters(robot):
    chain = chain_of(robot)
    for variant in variants(ROBOT, chain, elastic=True):
        effect = variant.effect
        assert isinstance(variant, Variant) and effect.parameters(chain)
        assert effect.nonnegative <= len(effect.parameters(chain))
        assert effect.where in {w for place in effect.places for w in chain.places(place)}
        assert isinstance(effect.reads, tuple) and variant.prior_weight > 0


def test_candidates_come_joint_by_joint_and_those_of_gravity_last():
    chain = chain_of(ABB)
    found = [v.effect for v in variants(ROBOT, chain) if v.effect.places[0] in ("joint", "link")]
    order = [(effect.number, bool(effect.elastic)) for effect in found]
    assert order == sorted(order) and len(order) > 40


def test_variants_of_one_family_differ_in_their_label():
    chain = chain_of(ABB)
    listed = [(v.family, v.label) for v in variants(ROBOT, chain, elastic=True)]
    assert len(set(listed)) == len(listed)
    listed = [(v.family, v.label) for v in variants(SCANNER, SCAN)]
    assert len(set(listed)) == len(listed) > 20


def test_an_effect_of_gravity_in_the_model_makes_the_tilt_of_the_mount_observable():
    chain = chain_of(ABB)
    rigid, elastic = (names(v.effect for v in variants(ROBOT, chain, e)) for e in (False, True))
    assert elastic - rigid == {"mount-tilt", "payload", "payload-centre"}


@pytest.mark.parametrize(("catalogue", "chain"), [(ROBOT, None), (SCANNER, SCAN)])
def test_a_grid_makes_the_effect_of_each_of_its_values(catalogue, chain):
    chain = chain or chain_of(ABB)
    for grid in grids(catalogue, chain):
        assert isinstance(grid, Grid) and (np.diff(grid.values) > 0).all()
        made = grid.make(float(grid.values[-1]))
        value = made.options[grid.option]
        assert value == grid.values[-1]
        assert isinstance(value, option_types(grid.effect)[grid.option])
        assert len(grid.prior_weights) == len(grid.values) and grid.label.format(value)


def test_compliances_are_the_mass_dependent_effects_without_their_special_cases():
    assert subsumed(ROBOT) == {LinkSelfWeight.effect, Backlash.effect, TransmissionHarmonic.effect}
    found = compliances(ROBOT)
    assert JointCompliance in found and LinkSelfWeight not in found
    assert all(kind.nonnegative and kind.elastic for kind in found)


def test_what_belongs_to_the_session_is_no_part_of_the_arm():
    of_session = names(kind for kind in ROBOT.values() if kind.of_session)
    assert not ROBOT["shift"]("tool", 3.5).of_session
    assert ROBOT["shift"]("tool", 3.5).beyond_flange
    assert not ROBOT["shift"]("link-2", 3.5).beyond_flange
    encoders = {"azimuth-harmonic", "elevation-harmonic"}
    instrument = {"sight-line-refraction", "reflector-incidence", "range-offset"} | encoders
    stands = {"base-drift", "warm-up", "shift"}
    assert of_session == stands | {"time-offset", "reading-lag", "payload"} | instrument
    warm_ups = {kind.places: kind.of_session for kind in ROBOT.values() if kind.effect == "warm-up"}
    assert warm_ups == {("joint",): False, ("link",): False, ("base",): True}


@pytest.mark.parametrize("measures", ["external-pose", "ball-centre"])
def test_the_basis_on_a_part_of_the_samples_is_a_slice_of_that_on_all(measures):
    """Folds take slices: a basis must be a function of each sample's own state."""
    model = model_of(scene(measures, n=20))
    samples = np.arange(20) % 3 != 1
    part, alone = model.part(samples), model.at(samples)
    linear = [v.effect for v in variants(ROBOT, model.chain, elastic=True) if v.effect.linear]
    assert len(linear) > 50
    for effect in linear:
        sliced, expected = part.basis(effect), alone.basis(effect)
        scale = np.abs(expected).max(initial=1e-12)
        np.testing.assert_allclose(sliced, expected, atol=1e-12 * scale, err_msg=repr(effect))


@pytest.mark.parametrize(("arm", "is_observable"), [(ABB, False), (SLIDING, True)])
def test_the_scale_of_an_instrument_is_observable_on_arms_with_slides_alone(arm, is_observable):
    """The reading of a slide is a length; all other lengths of an arm are estimated."""
    recording = scene("external-point", n=60, arm=arm, reflectors={1: (30, -40, 100)}).recording
    problem = bench_of(recording).problem()
    found = [
        h
        for h in ranked_hypotheses(problem)
        if h.where == "instrument" and h.effect == "range-scale"
    ]
    assert [h.rank for h in found] == [int(is_observable)]
