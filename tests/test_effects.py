"""Every effect of the catalogue keeps the contract: exact null, right derivative, components, names, sentences."""

from dataclasses import replace

import numpy as np
import pytest

from effect_cases import (
    ADDITIONS,
    CASES,
    EVERY,
    POINTS,
    PORT_SIZES,
    VARIANTS,
    VOCABULARY,
    own_part,
    started,
    state_of,
    with_effect,
)
from robot_model.effects import CATALOGUE
from scenes import ABB, CRAIG, REFLECTORS, SLIDING, assert_rows, differences, model_of, scene
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.model import NOISE
from workbench.core.rigid import rotation_matrix

ADDITIONS |= {
    "joint-curve",
    "gravity-compliance",
    "payload",
    "shift",
    "loosening",
    "warm-up",
    "joint-hysteresis",
    "joint-torque",
    "reading-lattice",
    "sight-line-refraction",
    "azimuth-harmonic",
    "elevation-harmonic",
    "reflector-incidence",
    "angular-noise",
}


def test_every_effect_of_the_catalogue_is_in_the_table():
    assert {name for name, _, _ in CASES} == set(CATALOGUE)


@EVERY
def test_its_name_is_in_the_vocabulary_and_says_where_it_is_from(case):
    kind = CATALOGUE[case[0]]
    assert kind.effect in VOCABULARY | ADDITIONS
    own = ("smooth-function", "periodic-motion", "compliance-with-masses")
    assert kind.effect == case[0] or case[0] in (*VARIANTS, *own)  # variants of laws
    assert kind.port in PORT_SIZES
    assert kind.__doc__.strip() and kind.equation and kind.source


@EVERY
def test_parameters_carry_key_unit_null_size_and_label(case):
    model = with_effect(case)
    table = model.effects[0].parameters(model.chain)
    assert table
    for parameter in table:
        where, effect, name = parameter.key.split(".")
        assert parameter.unit and parameter.label.strip() and name
        assert parameter.null == 0 and parameter.typical > 0
        assert parameter.prior is None or parameter.prior >= parameter.typical
        if (
            case[0] != "ye-compliance"
        ):  # which sits at all six joints at once, and has two laws of the vocabulary
            assert (where, effect) == (case[1], model.effects[0].effect)
        assert effect in VOCABULARY | ADDITIONS


@EVERY
def test_port_indices_lie_in_the_port_and_match_the_shapes(case):
    model = with_effect(case)
    effect, state = model.effects[0], state_of(model)
    port_indices = effect.port_indices(model.chain)
    count = len(effect.parameters(model.chain))
    assert len(set(port_indices)) == len(port_indices) > 0
    assert all(0 <= port_index < PORT_SIZES[effect.port] for port_index in port_indices)
    assert effect.delta(np.ones(count), state).shape == (len(port_indices), state.n)
    assert effect.derivative(np.ones(count), state).shape == (count, len(port_indices), state.n)
    assert effect.title


@EVERY
@POINTS
def test_it_is_exactly_absent_at_null(case, measures):
    model = with_effect(case, measures)
    effect = model.effects[0]
    nothing = np.zeros(len(effect.parameters(model.chain)))
    assert not effect.delta(nothing, state_of(model)).any()
    bare = replace(model, effects=(), _bases={})
    assert np.array_equal(model.residual(model.parameters), bare.residual(bare.parameters))
    assert np.array_equal(model.sigma(model.parameters), bare.sigma(bare.parameters))


@EVERY
@POINTS
@pytest.mark.parametrize("sizes", [0.0, 1.0, -2.0])
def test_its_jacobian_is_the_derivative_of_the_residual(case, measures, sizes):
    """At null, and where everything else that it needs is switched on."""
    model = with_effect(case, measures)
    parameters = started(
        model, np.where(np.arange(len(model.parameters)) < own_part(model).stop, sizes, 1.5)
    )
    own = own_part(model)
    mask = np.zeros(len(parameters), bool)
    mask[own] = True
    free = parameters.only(mask)
    found = model.jacobian(free).T.reshape(own.stop - own.start, *model.residual(free).shape)
    expected = differences(
        lambda x: model.residual(free.unpack(x)), free.pack(), 1e-2 * free.typical[own]
    )
    assert_rows(found, expected)


@EVERY
@POINTS
def test_it_moves_the_point_or_widens_the_noise(case, measures):
    model = with_effect(case, measures)
    before = started(
        model, np.where(np.arange(len(model.parameters)) < own_part(model).stop, 0.0, 1.5)
    )
    after = started(model, 1.5)
    if model.effects[0].port == NOISE:
        growth = np.log(model.sigma(after) / model.sigma(before))
        if case[0] != "noise-heteroscedastic":
            assert 1e-3 < np.abs(growth).max() < 3
            return
        expected = 1.5 * 0.3 * (state_of(model).covariates["range_mm"] - 250) / 30
        np.testing.assert_allclose(growth, np.tile(expected, (3, 1)), atol=1e-12)
    else:
        moved = np.sqrt(((model.residual(after) - model.residual(before)) ** 2).sum(0))
        assert 1e-3 < moved.max() < 100


@EVERY
def test_a_part_of_the_samples_means_the_same(case):
    """Held-out samples must be predicted by the law that was fitted."""
    model = with_effect(case)
    part = np.arange(0, 40, 3)
    parameters = started(model, 1.3)
    np.testing.assert_allclose(
        model.at(part).residual(parameters), model.residual(parameters)[:, part], rtol=1e-12
    )
    np.testing.assert_allclose(
        model.at(part).sigma(parameters), model.sigma(parameters)[:, part], rtol=1e-12
    )


@EVERY
@pytest.mark.parametrize("arm", [CRAIG, SLIDING], ids=["craig", "sliding"])
def test_it_stands_on_any_arm(case, arm):
    if arm is SLIDING and CATALOGUE[case[0]].turning:
        case = (case[0], "joint-1", case[2])  # the others slide, or may
    model = with_effect(case, "ball-centre", arm)
    assert np.isfinite(model.residual(started(model, 0.5))).all()


@pytest.mark.parametrize("name", ["transmission-harmonic", "axis-run-out"])
def test_what_speaks_of_a_turn_does_not_sit_at_a_slide(name):
    with pytest.raises(
        InputError, match=f"{name} .*at joint-2: expected a revolute joint, found a prismatic one"
    ):
        model_of(scene("external-point", n=20, arm=SLIDING), (name, "joint-2", {})).parameters


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("zero-offset", {}),
        ("backlash", {}),
        ("zero-shift", {"after": 90.0}),
        ("joint-coupling", {"joint": 4}),
        ("joint-coupling", {"joint": 1}),
        ("joint-thermal-drift", {}),
        ("joint-compliance", {}),
        ("link-self-weight", {}),
    ],
)
def test_a_slides_error_is_in_millimetres(name, options):
    model = model_of(
        scene("external-point", n=20, arm=SLIDING),
        (name, "joint-2", options),
        (name, "joint-3", options),
    )
    slide, turn = model.parameters.table[-2:]
    per = {
        "joint-coupling": "/mm" if options.get("joint") == 4 else "/rad",
        "joint-thermal-drift": "/K",
    }.get(name, "")
    force = {"joint-compliance": ("/N", "/(N m)"), "link-self-weight": ("/N", "/(N m)")}.get(
        name, (per, per)
    )
    assert (slide.unit, turn.unit) == ("mm" + force[0], "rad" + force[1])
    assert slide.typical == pytest.approx(
        turn.typical * (1 if name in ("joint-compliance", "link-self-weight") else 1000)
    )


@pytest.mark.parametrize("arm", [ABB, CRAIG, SLIDING], ids=["abb", "craig", "sliding"])
@pytest.mark.parametrize("number", [1, 3, 6])
def test_an_axis_runs_out_across_itself(arm, number):
    """The cosine's x shifts what is beyond joint K by A cos q along one direction that its turn leaves alone."""
    model = model_of(
        scene("external-point", n=30, arm=arm), ("axis-run-out", f"joint-{number}", {})
    )
    before = model.parameters
    base = rotation_matrix(before.values[3:6])
    moved = base.T @ (
        model.residual(before.update({f"joint-{number}.axis-run-out.x_cos": 0.1}))
        - model.residual(before)
    )
    frames = state_of(model).frames
    np.testing.assert_allclose((moved * frames.z[number - 1]).sum(0), 0, atol=1e-12)
    cosine = np.cos(state_of(model).variables[number - 1])
    np.testing.assert_allclose(np.sqrt((moved**2).sum(0)), 0.1 * np.abs(cosine), atol=1e-12)
    if (
        arm is CRAIG
    ):  # whose frame before the joint is not at hand otherwise: the x axis of joint K's twist
        np.testing.assert_allclose(moved, 0.1 * cosine * frames.x[number - 1], atol=1e-12)


def test_a_slides_speed_is_in_millimetres():
    made = scene("external-point", n=20, arm=SLIDING)
    basis = (
        (effect := model_of(made, ("time-offset", "time", {})))
        .effects[0]
        .basis(state_of(effect))[0]
    )
    columns = made.recording.columns
    np.testing.assert_allclose(basis[1], columns["qdot2_mm_s"])
    np.testing.assert_allclose(basis[0], np.deg2rad(columns["qdot1_deg_s"]))


@pytest.mark.parametrize(
    "case",
    [
        ("joint-thermal-drift", "joint-2"),
        ("link-thermal-growth", "link-2"),
        ("artefact-expansion", "artefact"),
    ],
)
def test_growth_an_hour_is_taken_to_be_larger_than_growth_a_kelvin(case):
    """10 K an hour of aluminium, 2.4e-5 a kelvin, must lie within one sigma of the prior."""
    made = scene("external-point", n=20)
    cold = {k: v for k, v in made.recording.columns.items() if k != "temperature_c"}
    warm = model_of(made, (*case, {})).parameters.table[-1]
    hours = model_of(
        replace(made, recording=replace(made.recording, columns=cold)), (*case, {})
    ).parameters.table[-1]
    assert warm.unit.endswith("/K") and hours.unit.endswith("/h")
    assert hours.prior >= 24 * warm.typical and hours.typical > warm.typical


def test_a_balls_error_moves_that_ball_alone():
    model = model_of(scene("ball-centre", n=40), ("ball-position", "ball-4", {}))
    moved = model.residual(started(model, 1.0)) - model.residual(model.parameters)
    own = model.chain.state.index == 4
    np.testing.assert_allclose(
        np.sqrt((moved**2).sum(0)), np.where(own, 0.05 * np.sqrt(3), 0), atol=1e-12
    )


def test_heat_falls_back_from_place_to_ambient_to_time():
    made = scene("external-point", n=20)
    ambient, time = made.recording.columns["temperature_c"], made.recording.columns["time_s"]
    named = replace(
        made.recording, columns=made.recording.columns | {"temperature_j2_c": ambient + 7}
    )
    cold = replace(
        made.recording,
        columns={k: v for k, v in made.recording.columns.items() if k != "temperature_c"},
    )
    for recording, expected in (
        (named, ambient + 7 - 20),
        (made.recording, ambient - 20),
        (cold, time / 3600),
    ):
        model = model_of(replace(made, recording=recording), ("joint-thermal-drift", "joint-2", {}))
        np.testing.assert_allclose(model.effects[0].basis(state_of(model))[0, 0], expected)


def test_base_drift_is_a_smooth_function_of_time_without_a_constant():
    """Legendre polynomials have no mean over the span, so that the base pose keeps its meaning."""
    model = model_of(
        scene("external-point", n=501), ("base-drift", "base", {"start": 0.0, "end": 5000.0})
    )
    waves = model.effects[0].basis(state_of(model))[::6, 0]
    assert np.abs(waves.mean(1)).max() < 5e-3
    assert waves.max() == pytest.approx(1) and waves.min() == pytest.approx(-1)


def test_yes_law_is_its_equations():
    """Ye 2024 eq. 24-27 written out for one sample; joint 3 is the other way round, its axis being opposite."""
    model = model_of(
        scene("external-point", n=5, reflectors={1: REFLECTORS[1]}),
        ("ye-compliance", "joint-1", {}),
    )
    p, state = np.array([1e-4, 2e-4, -1e-4, 3e-4, 1e-4, 2e-4, 900.0, 400.0]), state_of(model)
    found, lever = model.effects[0].delta(p, state)[:, 3], state.unit_load_torque[:, 3]
    q = state.variables[:, 3]
    expected = p[:6] * lever
    expected[1] += p[1] * (0.9 * np.sin(q[1]) + 0.4 * np.sin(q[1] - q[2]))
    expected[2] -= p[2] * 0.4 * np.sin(q[1] - q[2])
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_an_effect_that_overrides_the_earlier_name_of_its_port_indices_is_refused():
    """Nothing calls `slots`: the effect would act on all components of its port, without a word."""
    with pytest.raises(TypeError, match="effect Stuck: .* rename the method"):
        type("Stuck", (Effect,), {"slots": lambda self, chain: (0,)})
