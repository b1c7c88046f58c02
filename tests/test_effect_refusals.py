"""Effects at a wrong place, without their covariate or with an unknown option: one sentence each."""

from dataclasses import replace

import pytest

from effect_cases import CASES, EVERY, MISSING, POINTS, started
from robot_model.effects import CATALOGUE
from scenes import SLIDING, model_of, scene
from workbench.core.effect import make_effects
from workbench.core.errors import InputError


@pytest.mark.parametrize("place", MISSING, ids=lambda place: place[0])
def test_a_missing_covariate_is_a_sentence(place):
    column, options = MISSING[place]
    made = scene("external-point", n=20)
    columns = {k: v for k, v in made.recording.columns.items() if k != column}
    model = model_of(
        replace(made, recording=replace(made.recording, columns=columns)), (*place, options)
    )
    assert column in model.effects[0].needs
    with pytest.raises(
        InputError, match=f"samples.csv .* column '{column}' is needed .* add the column"
    ):
        model.residual(started(model, 1.0)), model.sigma(started(model, 1.0))


def test_every_effect_that_names_a_need_is_in_the_table_of_missing_ones():
    needy = {
        (e.effect, e.where)
        for e in make_effects(CATALOGUE, [(n, w, o) for n, w, o in CASES])
        if e.needs
    }
    assert needy == set(MISSING)


@EVERY
def test_a_wrong_place_is_a_sentence(case):
    name, _, options = case
    with pytest.raises(InputError, match=f"effect '{name}' cannot sit at 'mirror'"):
        make_effects(CATALOGUE, [(name, "mirror", options)])


@pytest.mark.parametrize(
    "where", ["joint", "joint-", "joint-x", "joint-0", "joint--1", "joint-2.5"]
)
def test_a_place_without_a_proper_number_is_a_sentence(where):
    with pytest.raises(InputError, match="joint"):
        make_effects(CATALOGUE, [("zero-offset", where, {})])


@pytest.mark.parametrize("where", ["base-1", "base-x"])
def test_a_number_where_none_belongs_is_a_sentence(where):
    with pytest.raises(InputError, match=f"cannot sit at '{where}'"):
        make_effects(CATALOGUE, [("mount-tilt", where, {})])


@pytest.mark.parametrize(
    ("name", "where"),
    [("zero-offset", "joint-7"), ("link-compliance", "link-9"), ("first-moment", "link-7")],
)
def test_a_joint_that_the_arm_has_not_is_a_sentence(name, where):
    model = model_of(scene("external-point", n=20), (name, where, {}))
    with pytest.raises(InputError, match=where):
        model.effects[0].port_indices(model.chain)


@pytest.mark.parametrize(
    ("name", "where"),
    [("joint-compliance", "joint-99"), ("link-compliance", "link-9"), ("ball-position", "ball-9")],
)
@POINTS
def test_a_place_that_is_not_there_is_a_sentence_of_the_parameters(name, where, measures):
    with pytest.raises(
        InputError,
        match=f"{name} at {where}: expected .* one of .*, found '{where}'; correct the place",
    ):
        model_of(scene(measures, n=20), (name, where, {})).parameters


def test_yes_law_wants_six_joints():
    arm = SLIDING | {"joint": SLIDING["joint"][:5]}
    with pytest.raises(
        InputError, match="'ye-compliance': expected an arm of six joints, found .* with 5"
    ):
        model_of(
            scene("external-point", n=20, arm=arm), ("ye-compliance", "joint-1", {})
        ).parameters


def test_an_unknown_effect_or_option_is_a_sentence():
    with pytest.raises(InputError, match="no effect is called 'gremlin'"):
        make_effects(CATALOGUE, [("gremlin", "joint-1", {})])
    with pytest.raises(InputError, match="'backlash' does not take these options"):
        make_effects(CATALOGUE, [("backlash", "joint-1", {"depth": 3})])
