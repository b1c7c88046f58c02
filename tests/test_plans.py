"""Plans: the default one suits the recording, and a plan file gives its stages or one sentence."""

from dataclasses import replace

import pytest

from robot_model.effects import CATALOGUE
from robot_model.system import bind, geometry_free
from scenes import ABB, KINDS, SLIDING, scene
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.fitting.calibration_plans.plans import default_plan, read_plan
from workbench.jobs.robot.calibrate import calibrate

GOOD = """
[[stage]]
name = "geometry"
why = "lengths differ"
free = ["base.*", "tool.*", "joint-2.a2"]
earn = false

[[stage]]
name = "gears"
why = "gears err"
loss = "huber"
steps = 20
canonical = false
effects = [{ effect = "transmission-harmonic", where = "joint-2", order = 2 }, { effect = "backlash", where = "joint-1" }]
"""
HEAD = '[[stage]]\nname = "a"\nwhy = "b"\n'
WRONG = {
    "no TOML": ("[[stage", "cannot be read"),
    "empty": ("", r"no \[\[stage\]\] found"),
    "no why": ('[[stage]]\nname = "a"\n', "stage 1: keys name and why are expected, found name"),
    "unknown key": (HEAD + "wheels = 3\n", "stage 1: key 'wheels' is not known"),
    "wrong kind": (HEAD + 'steps = "many"\n', "key steps: expected int, found 'many'"),
    "a text for a list": (HEAD + 'free = "base.*"\n', "key free: expected list"),
    "a number among patterns": (HEAD + "free = [3]\n", "key free"),
    "unknown loss": (
        HEAD + 'loss = "cubic"\n',
        "key loss: expected one of linear, huber, cauchy, found 'cubic'",
    ),
    "effect without place": (
        HEAD + 'effects = [{ effect = "backlash" }]\n',
        "each needs effect and where",
    ),
    "an effect that is a text": (HEAD + 'effects = ["backlash"]\n', "key effects"),
    "a stage that is a table": ('[stage]\nname = "a"\nwhy = "b"\n', "stage"),
    "a stage that is a number": ("stage = [3]\n", "stage"),
    "a truth value for steps": (HEAD + "steps = true\n", "key steps"),
    "no steps": (HEAD + "steps = 0\n", "key steps"),
}


def written(tmp_path, text):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    return path


def effects_of(stages):
    return [(name, where) for stage in stages for name, where, _ in stage.effects]


@pytest.mark.parametrize("measures", KINDS)
@pytest.mark.parametrize("arm", [ABB, SLIDING], ids=["abb", "sliding"])
def test_the_default_plan_makes_models_that_exist(measures, arm):
    made = scene(measures, n=40, arm=arm)
    chain = bind(made.robot, made.recording)
    stages = default_plan(chain)
    assert stages[0].name == "geometry" and not stages[0].earn
    assert all(stage.why for stage in stages)
    rows = [row for stage in stages for row in stage.effects]
    parameters = Model(chain, make_effects(CATALOGUE, rows)).parameters
    assert set(geometry_free(made.robot)) <= set(parameters.keys)
    assert len(rows) == len({(n, w, str(o)) for n, w, o in rows}) > 10


def test_the_default_plan_goes_from_geometry_through_transmission_to_compliance():
    made = scene("external-point", n=40)
    names = [stage.name for stage in default_plan(bind(made.robot, made.recording))]
    assert names[:4] == ["geometry", "coupling", "transmission", "compliance"]


def test_a_joint_that_hardly_moves_gets_no_gear_wave():
    made = scene("external-point", n=40)
    columns = made.recording.columns | {"q4_deg": made.recording.columns["q4_deg"] * 0.01}
    effects = effects_of(default_plan(bind(made.robot, replace(made.recording, columns=columns))))
    assert ("transmission-harmonic", "joint-3") in effects and (
        "transmission-harmonic",
        "joint-4",
    ) not in effects


def test_backlash_is_tried_only_where_the_approach_was_recorded():
    made = scene("external-point", n=40)
    columns = {k: v for k, v in made.recording.columns.items() if not k.startswith("approach")}
    with_it, without = (
        effects_of(default_plan(bind(made.robot, replace(made.recording, columns=c))))
        for c in (made.recording.columns, columns)
    )
    assert ("backlash", "joint-2") in with_it
    assert not [where for name, where in without if name == "backlash"]


def test_an_arm_without_masses_and_load_gets_only_compliance_times_first_moment():
    made = scene("external-point", n=40, arm={"builtin": "fanuc_lr_mate_200id"})
    columns = made.recording.columns | {"payload_kg": 0 * made.recording.columns["payload_kg"]}
    plan = default_plan(bind(made.robot, replace(made.recording, columns=columns)))
    stages = {stage.name: {row[0] for row in stage.effects} for stage in plan}
    assert stages["compliance"] == {"gravity-compliance"}
    assert stages["bending"] == {"gravity-bearing-compliance"}


def test_slides_get_no_wave_and_no_torsion():
    made = scene("external-point", n=40, arm=SLIDING)
    effects = effects_of(default_plan(bind(made.robot, made.recording)))
    turning = {"transmission-harmonic", "joint-compliance", "bearing-compliance"}
    assert not {where for name, where in effects if name in turning} & {"joint-2", "joint-4"}


def test_a_plan_file_gives_its_stages(tmp_path):
    first, second = read_plan(written(tmp_path, GOOD))
    assert first.free == ("base.*", "tool.*", "joint-2.a2") and not first.earn and first.canonical
    assert (
        second.loss == "huber"
        and second.steps == 20
        and not second.canonical
        and second.free == ("*",)
    )
    assert second.effects == (
        ("transmission-harmonic", "joint-2", {"order": 2}),
        ("backlash", "joint-1", {}),
    )


def test_a_plan_file_is_followed(tmp_path):
    result = calibrate(
        scene("external-point", n=40).recording, plan=written(tmp_path, GOOD), folds=4
    )
    assert [stage.name for stage in result.stages] == ["geometry", "gears"]
    assert result.stages[0].free == 16 and result.stages[0].earned


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_plan_is_a_sentence(tmp_path, name):
    text, sentence = WRONG[name]
    with pytest.raises(InputError, match=sentence) as problem:
        read_plan(written(tmp_path, text))
    assert "plan.toml" in str(problem.value) and "\n" not in str(problem.value)


def test_a_plan_that_is_not_there_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match=r"plan .*nowhere\.toml cannot be read"):
        read_plan(tmp_path / "nowhere.toml")


# one effect of a plan, and what its sentence says; the first ones are wrong on every arm
NO_SUCH_EFFECT = {
    "a number for a place": (
        'effect = "backlash", where = 2',
        "'backlash' cannot sit at '2': expected joint-K",
    ),
    "a number for an effect": ('effect = 3, where = "joint-1"', "no effect is called '3'"),
    "a list for an effect": ('effect = ["backlash"], where = "joint-1"', "no effect is called"),
    "a place without number": (
        'effect = "backlash", where = "joint"',
        "cannot sit at 'joint': expected joint-K",
    ),
    "a letter for a number": (
        'effect = "backlash", where = "joint-x"',
        "cannot sit at 'joint-x': expected joint-K",
    ),
    "a text for an order": (
        'effect = "transmission-harmonic", where = "joint-1", order = "two"',
        "effect 'transmission-harmonic', option order: expected a valid number, found 'two'; correct it",
    ),
    "a truth value for an order": (
        'effect = "transmission-harmonic", where = "joint-1", order = true',
        "option order",
    ),
    "an order that is none": (
        'effect = "transmission-harmonic", where = "joint-1", order = nan',
        "option order",
    ),
    "a text for an instant": (
        'effect = "base-drift", where = "base", start = "a", end = 9',
        "effect 'base-drift', option start: expected a valid number, found 'a'",
    ),
    "an end before the start": (
        'effect = "base-drift", where = "base", start = 9, end = 3',
        "an end after the start",
    ),
    "half an order": (
        'effect = "base-drift", where = "base", start = 0, end = 9, order = 1.5',
        "option order",
    ),
    "a slip of the pen": (
        'effect = "backlash", where = "joint-1", seat = "gravty"',
        "effect 'backlash', option seat: expected 'approach', 'gravity' or 'moves', found 'gravty'",
    ),
    "no width": (
        'effect = "backlash", where = "joint-1", seat = "gravity", width = 0',
        "option width",
    ),
    "no spread": (
        'effect = "noise-heteroscedastic", where = "noise", covariate = "time_s", spread = 0',
        "option spread",
    ),
    "a number for a column": (
        'effect = "noise-heteroscedastic", where = "noise", covariate = 3',
        "option covariate",
    ),
    "an option left out": (
        'effect = "zero-shift", where = "joint-1"',
        "'zero-shift': option after is expected",
    ),
    "an unknown option": (
        'effect = "zero-offset", where = "joint-1", depth = 3',
        "expected no option, found depth",
    ),
}
NOT_ON_THIS_ARM = {
    "a joint too far": (
        'effect = "joint-compliance", where = "joint-99"',
        "expected joint-K with K one of 1, 2, 3, 4, 5, 6",
    ),
    "a link too far": (
        'effect = "link-compliance", where = "link-9"',
        "at link-9: expected link-K",
    ),
    "no such ball": (
        'effect = "ball-position", where = "ball-9"',
        "ball-9: expected ball-K with K one of 1, 2, 4, 7",
    ),
    "coupled to nothing": (
        'effect = "joint-coupling", where = "joint-2", joint = 9',
        "option joint: expected one of",
    ),
}


def one_effect(tmp_path, keys):
    return read_plan(written(tmp_path, HEAD + f"effects = [{{ {keys} }}]\n"))


@pytest.mark.parametrize("name", NO_SUCH_EFFECT)
def test_an_effect_that_cannot_be_is_a_sentence_of_the_plan(tmp_path, name):
    keys, sentence = NO_SUCH_EFFECT[name]
    with pytest.raises(InputError, match=sentence) as problem:
        one_effect(tmp_path, keys)
    assert "plan.toml, stage 1, key effects" in str(problem.value) and "\n" not in str(
        problem.value
    )


@pytest.mark.parametrize("name", NOT_ON_THIS_ARM)
def test_an_effect_at_a_place_that_is_not_there_is_a_sentence(tmp_path, name):
    keys, sentence = NOT_ON_THIS_ARM[name]
    (stage,) = one_effect(tmp_path, keys)
    made = scene("ball-centre", n=20)
    model = Model(bind(made.robot, made.recording), make_effects(CATALOGUE, stage.effects))
    with pytest.raises(InputError, match=sentence) as problem:
        model.parameters
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (HEAD + 'free = ["joint-9.*"]\n', r"no parameter matches 'joint-9\.\*'"),
        (
            HEAD + 'effects = [{ effect = "gremlin", where = "joint-1" }]\n',
            "no effect is called 'gremlin'",
        ),
        (
            HEAD + 'effects = [{ effect = "backlash", where = "base" }]\n',
            "'backlash' cannot sit at 'base'",
        ),
        (HEAD + 'effects = [{ effect = "zero-offset", where = "joint-9" }]\n', "joint-9"),
        (
            HEAD + 'effects = [{ effect = "joint-coupling", where = "joint-2", joint = 9 }]\n',
            "joint",
        ),
    ],
    ids=["pattern", "effect", "place", "joint", "coupled joint"],
)
def test_a_plan_that_does_not_suit_the_arm_is_a_sentence(tmp_path, text, sentence):
    with pytest.raises(InputError, match=sentence):
        calibrate(scene("external-point", n=30).recording, plan=written(tmp_path, text), folds=3)
