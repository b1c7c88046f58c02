"""A model: effects add up at one component, load effects act through compliances, the Jacobian is the derivative."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import ABB, CRAIG, KINDS, SLIDING, assert_rows, differences, model_of, observed, scene
from workbench.core.effect import Effect, numeric_derivative
from workbench.core.errors import InputError

MIXED = (
    ("transmission-harmonic", "joint-2", {"order": 1}),
    ("transmission-harmonic", "joint-2", {"order": 2}),
    ("backlash", "joint-2", {}),
    ("joint-compliance", "joint-2", {}),
    ("link-compliance", "link-2", {}),
    ("bearing-compliance", "joint-2", {}),
    ("link-thermal-growth", "link-2", {}),
    ("tool-deflection", "tool", {}),
    ("mount-tilt", "base", {}),
    ("first-moment", "link-3", {}),
    ("field-bias", "sensor", {}),
    ("ball-position", "ball-2", {}),
)


def switched_on(model, size=1.0, seed=1):
    """Parameters with every effect's set to random signs times `size` typical sizes."""
    start, own = model.parameters, len(model.chain.parameters)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], len(start)) * (
        np.arange(len(start)) >= own
    )
    return replace(start, values=start.values + size * signs * start.typical)


@pytest.mark.parametrize("arm", [ABB, CRAIG, SLIDING], ids=["abb", "craig", "sliding"])
@pytest.mark.parametrize("measures", KINDS)
def test_the_jacobian_of_everything_is_the_derivative(measures, arm):
    """What moves the pivots of small twists (geometry, slides) is off by half a twist, 2e-3 rad; see test_chain."""
    unfit = {"transmission-harmonic"} if arm is SLIDING else set()
    unfit |= {"ball-position"} if measures in ("external-pose", "partial-pose") else set()
    model = model_of(scene(measures, n=15, arm=arm), *(row for row in MIXED if row[0] not in unfit))
    parameters = switched_on(model)
    free = parameters.only(np.ones(len(parameters), bool))
    rows = model.linearise(free)[1]
    expected = differences(
        lambda x: model.residual(free.unpack(x)), free.pack(), 1e-3 * free.typical
    )
    assert_rows(rows, expected, 5e-3)


def test_the_jacobian_of_some_is_part_of_that_of_all():
    model = model_of(scene("external-point", n=15), *MIXED)
    parameters = switched_on(model)
    everything = model.jacobian(parameters.only(np.ones(len(parameters), bool)))
    some = np.random.default_rng(0).random(len(parameters)) < 0.3
    assert np.array_equal(model.jacobian(parameters.only(some)), everything[:, some])
    assert model.jacobian(parameters).shape == (45, 0)


def test_effects_on_one_component_of_a_port_add_up():
    made = scene("external-point", n=15)
    names = MIXED[:4]
    model = model_of(made, *names)
    parameters = switched_on(model, 1e-3)
    bare = model.residual(model.parameters)
    together = model.residual(parameters) - bare
    apart = 0
    for name in names:
        one = model_of(made, name)
        apart = apart + one.residual(one.parameters.take_over(parameters)) - bare
    assert np.abs(together).max() > 1e-3
    np.testing.assert_allclose(together, apart, atol=1e-5)


def test_the_order_of_effects_does_not_matter():
    made = scene("external-point", n=15)
    model, turned = model_of(made, *MIXED), model_of(made, *MIXED[::-1])
    parameters = switched_on(model)
    np.testing.assert_allclose(
        turned.residual(turned.parameters.take_over(parameters)),
        model.residual(parameters),
        atol=1e-9,
    )


def test_load_effects_do_nothing_where_nothing_is_compliant():
    model = model_of(
        scene("external-point", n=15), ("mount-tilt", "base", {}), ("first-moment", "tool", {})
    )
    parameters = switched_on(model)
    assert np.array_equal(model.residual(parameters), model.residual(model.parameters))
    assert not model.jacobian(
        parameters.only(np.arange(len(parameters)) >= len(model.chain.parameters))
    ).any()


@pytest.mark.parametrize(
    "cause", [("mount-tilt", "base", {}), ("first-moment", "link-4", {})], ids=lambda c: c[0]
)
def test_a_load_effect_is_the_same_as_another_robot(cause):
    """A tilt of gravity, or a shifted mass, entered as a number or as a robot that has it from the start."""
    soft = ("joint-compliance", "joint-2", {}), ("link-compliance", "link-3", {})
    made = scene("external-point", n=15)
    model = model_of(made, cause, *soft)
    parameters = switched_on(model)
    own, state = model.spans[0], model.chain.state
    change = model.effects[0].delta(parameters.values[own], state)[:, 0]
    if cause[0] == "mount-tilt":
        other = replace(state, gravity=state.gravity + change)
    else:
        com = state.robot.com.copy()
        com[3] += change / state.robot.mass[3]
        other = replace(state, robot=replace(state.robot, com=com))
    plain = model_of(made, *soft)
    plain = replace(plain, chain=replace(plain.chain, state=other), _bases={})
    np.testing.assert_allclose(
        model.residual(parameters),
        plain.residual(plain.parameters.take_over(parameters)),
        atol=1e-9,
    )


def test_part_of_the_samples_is_part_of_the_answer():
    model = model_of(scene("ball-centre", n=30), *MIXED)
    parameters = switched_on(model)
    part = np.arange(30) % 4 == 0
    np.testing.assert_allclose(
        model.at(part).residual(parameters), model.residual(parameters)[:, part], atol=1e-9
    )


def test_more_effects_join_and_none_stands_twice():
    model = model_of(scene("external-point", n=15), *MIXED[:2])
    other = model_of(scene("external-point", n=15), MIXED[2]).effects
    more = model.with_effects(*other)
    assert more.parameters.keys == (*model.parameters.keys, "joint-2.backlash.half_gap")
    with pytest.raises(InputError, match="two parameters are called joint-2.backlash.half_gap"):
        more.with_effects(*other).parameters


def test_what_was_predicted_is_measured_without_residual():
    """The simulator and the prediction are one."""
    model = model_of(scene("external-point", n=15), *MIXED[:7])
    truth = switched_on(model)
    assert np.abs(observed(model, truth).residual(truth)).max() < 1e-9


class Bent(Effect):
    """An effect that is not linear, for the numeric derivative."""

    effect, port, places = "bent", "joint", ("joint",)

    def parameters(self, chain):
        return tuple(self.parameter(name, "rad", 1e-2, name) for name in "ab")

    def delta(self, p, state):
        return (p[0] * np.sin(state.variables[0] + 10 * p[1]))[None]


def test_an_effect_that_is_not_linear_is_differentiated_numerically():
    made = scene("external-point", n=15)
    model = model_of(made).with_effects(Bent("joint-3"))
    assert not model.effects[0].linear
    parameters = switched_on(model)
    free = parameters.only(np.arange(len(parameters)) >= len(model.chain.parameters))
    expected = differences(lambda x: model.residual(free.unpack(x)), free.pack(), 1e-5)
    assert_rows(model.linearise(free)[1], expected)


def test_numeric_derivative_of_a_polynomial():
    found = numeric_derivative(
        lambda p: np.array([p[0] ** 2, p[0] * p[1]]), np.array([3.0, 5.0]), [1e-4, 1e-3]
    )
    np.testing.assert_allclose(found, [[6, 5], [0, 3]], atol=1e-9)
