"""Scenes: every effect of the catalogue is simulated and found again, and a scene that cannot be is a sentence."""

import numpy as np
import pytest
import tomli_w
from scipy import stats

import datasets
from conftest import ROOT
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.system import bind
from scenes import CRAIG, SLIDING
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.jobs.robot.simulate import simulate

TRACKER = {
    "robot": "abb_irb120",
    "measures": "external-point",
    "samples": 150,
    "seed": 4,
    "payload_kg": [0.0, 3.0],
    "approach": True,
    "speeds_deg_s": 20.0,
    "temperature_c": [18.0, 30.0],
    "reflectors": [[30.0, -40.0, 100.0], [-60.0, 10.0, 80.0], [15.0, 75.0, 60.0]],
    "base": {"xyz_mm": [1500.0, 100.0, 300.0], "rpy_deg": [2.0, -1.0, 140.0]},
}
SCANNER = TRACKER | {
    "measures": "ball-centre",
    "samples": 120,
    "tool": {"xyz_mm": [0.0, 0.0, 60.0]},
    "base": {"xyz_mm": [-450.0, 0.0, -100.0]},
    "balls": [
        [0.0, 0.0, 0.0, 15.0],
        [80.0, 5.0, -3.0, 15.0],
        [10.0, 70.0, 4.0, 15.0],
        [90.0, 80.0, 40.0, 15.0],
        [40.0, 30.0, 20.0, 15.0],
    ],
}
SOFT = (
    ("joint-compliance", "joint-2", {}, {"compliance": 3e-4}),
    ("joint-compliance", "joint-3", {}, {"compliance": 3e-4}),
)
# effect, place, options, true values; a sag that is the same along all axes is a shift of the base along gravity
CAUSES = (
    ("transmission-harmonic", "joint-2", {"order": 2}, {"cos2": 5e-4, "sin2": -3e-4}),
    ("zero-offset", "joint-3", {}, {"k0": 1e-3}),
    ("backlash", "joint-2", {}, {"half_gap": 3e-4}),
    ("backlash", "joint-3", {"seat": "gravity"}, {"half_gap": 3e-4}),
    ("zero-shift", "joint-2", {"after": 900.0}, {"shift": 5e-4}),
    ("joint-coupling", "joint-6", {"joint": 5}, {"from5": 5e-4}),
    ("joint-thermal-drift", "joint-2", {}, {"per_unit": 5e-5}),
    ("time-offset", "time", {}, {"offset": 0.01}),
    ("reading-lag", "time", {}, {"short": 1e-3}),
    ("reading-lag", "time", {"law": "share"}, {"share": 1e-3}),
    ("joint-curve", "joint-2", {"start": -2.0, "end": 2.0, "terms": 3}, {"c1": 6e-4, "c3": -4e-4}),
    ("joint-hysteresis", "joint-2", {}, {"wind_up": 6e-4}),
    ("joint-torque", "joint-2", {"start": -2.0, "end": 2.0}, {"p1": 9e-4, "p2": 4e-4}),
    ("shift", "tool", {"after": 900.0}, {"x": 0.3, "ry": 1e-3}),
    ("target-shift", "ball-2", {"after": 900.0}, {"ball-2.shift.x": 0.2, "ball-2.shift.z": -0.1}),
    ("warm-up", "joint-2", {"time_constant": 600.0}, {"final": 9e-4}),
    ("link-warm-up", "link-2", {"time_constant": 600.0}, {"link-2.warm-up.final": 6e-4}),
    (
        "base-warm-up",
        "base",
        {"time_constant": 600.0},
        {"base.warm-up.x": 0.3, "base.warm-up.rz": 1e-3},
    ),
    ("load-deflection", "tool", {"after": 900.0}, {"tool.payload.joint2": 1e-3}),
    ("loosening", "tool", {"start": 0.0, "end": 1500.0}, {"sag_x": 0.5, "tilt": 1e-3}),
    (
        "link-beam",
        "link-2",
        {},
        {"link-2.link-compliance.bending": 3e-5, "link-2.link-compliance.torsion": 3e-5},
    ),
    ("gravity-compliance", "joint-2", {}, {"sag": 1e-3}),
    ("gravity-bearing-compliance", "joint-3", {}, {"joint-3.gravity-compliance.tilt": 5e-3}),
    ("gravity-link-compliance", "link-2", {}, {"link-2.gravity-compliance.tilt": 1e-3}),
    ("gravity-pedestal-compliance", "base", {}, {"base.gravity-compliance.tilt": 1e-3}),
    ("sight-line-refraction", "instrument", {}, {"gradient_x": 0.3, "gradient_z": 0.3}),
    ("azimuth-harmonic", "instrument", {"order": 5}, {"cos5": 3e-4, "sin5": 2e-4}),
    ("elevation-harmonic", "instrument", {"order": 7}, {"cos7": 3e-4, "sin7": 2e-4}),
    ("instrument-range-scale", "instrument", {}, {"instrument.range-scale.scale": 3e-4}),
    ("range-offset", "instrument", {}, {"offset": 0.4}),
    ("reflector-incidence", "tool", {}, {"x_by_x": 0.2}),
    ("payload", "tool", {}, {"mass": 3.0}),
    ("payload-centre", "tool", {}, {"x": 120.0, "y": -80.0, "z": 150.0}),
    ("joint-compliance", "joint-2", {}, {"compliance": 2e-5}),
    ("link-self-weight", "joint-2", {}, {"compliance": 2e-5}),
    (
        "ye-compliance",
        "joint-1",
        {},
        {
            "joint-2.joint-compliance.load": 5e-4,
            "joint-3.joint-compliance.load": 8e-4,
            "joint-2.link-self-weight.s1": 900.0,
        },
    ),
    ("link-compliance", "link-2", {}, {"bending": 2e-5}),
    ("bearing-compliance", "joint-2", {}, {"tilt": 2e-5}),
    ("pedestal-compliance", "base", {}, {"about_x": 2e-5, "about_y": 1e-5}),
    ("tool-deflection", "tool", {}, {"sag_x": 0.1, "sag_y": -0.06, "sag_z": -0.04}),
    ("mount-tilt", "base", {}, {"tilt_1": 0.02, "tilt_2": -0.01}),
    (
        "mount-tilt-torsion",
        "base",
        {},
        {"base.mount-tilt.torsion_1": 6e-6, "base.mount-tilt.torsion_2": -4e-6},
    ),
    ("first-moment", "link-3", {}, {"mx": 100.0}),
    ("link-thermal-growth", "link-2", {}, {"per_unit": 2.4e-5}),
    ("base-drift", "base", {"start": 0.0, "end": 1490.0, "order": 1}, {"x_t1": 0.1, "rz_t1": 1e-4}),
    ("axis-run-out", "joint-2", {}, {"x_cos": 0.03, "y_sin": -0.02}),
    ("range-scale", "sensor", {"z0": 125.0}, {"scale": 0.002}),
    ("lateral-scale", "sensor", {}, {"scale_x": 2e-3}),
    ("sensor-thermal-growth", "sensor", {}, {"per_unit": 3e-4}),
    ("field-bias", "sensor", {}, {"x": 0.02, "xx": -0.02}),
    ("ball-position", "ball-2", {}, {"x": 0.1, "y": -0.05, "z": 0.03}),
    ("artefact-expansion", "artefact", {}, {"per_unit": 2.4e-5}),
    (
        "noise-heteroscedastic",
        "noise",
        {"covariate": "payload_kg", "mean": 1.5},
        {"payload_kg": 0.4},
    ),
)
BY_SCANNER = (
    "range-scale",
    "lateral-scale",
    "sensor-thermal-growth",
    "ball-position",
    "artefact-expansion",
    "target-shift",
)
HOURS = ("joint-thermal-drift", "link-thermal-growth", "artefact-expansion")


def written(folder, scene):
    path = folder / "a.toml"
    path.write_text(tomli_w.dumps(scene))
    return path


def cause(name, where, options, values):
    return {"effect": name, "where": where, "values": values, **options}


def recorded(tmp_path, scene):
    """The recording of a scene as it is read from disk."""
    return datasets.read(datasets.write(simulate(written(tmp_path, scene)), tmp_path / "recording"))


def fitted(recording, causes):
    """Base, tool and the effects' parameters solved: keys, values and covariance (what was known before counts)."""
    model = Model(
        bind(load_robot(recording.robot), recording),
        make_effects(CATALOGUE, [c[:3] for c in causes]),
    )
    own = [p.key for effect in model.effects for p in effect.parameters(model.chain)]
    frames = [
        key for key in model.parameters.keys if key.count(".") == 1 and not key.startswith("joint-")
    ]
    start = model.parameters.free(*frames, *own)
    fit = solve(model, start.nudged())
    covariance = np.linalg.inv(fit.normal + np.diag(fit.parameters.precision[start.mask]))
    mine = np.isin(np.array(start.keys)[start.mask], own)
    assert fit.converged
    return own, fit.parameters.values[np.isin(start.keys, own)], covariance[np.ix_(mine, mine)], fit


def true_values(keys, causes):
    """What the scene gave to each key."""
    given = {}
    for name, where, _, values in causes:
        given |= {
            end if "." in end else f"{where}.{name}.{end}": value for end, value in values.items()
        }
    return np.array([given.get(key, 0.0) for key in keys])


def distance(off, covariance):
    """By how many sigmas P numbers are off together, as likely as one number by so many (chi-square)."""
    return stats.norm.isf(stats.chi2.sf(off @ np.linalg.solve(covariance, off), len(off)) / 2)


def test_every_effect_of_the_catalogue_is_simulated():
    """Except a tilt that an accelerometer has measured (no scene makes its columns), errors of a slide (no robot of
    these scenes has one: `test_lead_error`), and two effects on the data.

    Terms without a physical law are made by a diagnosis and are simulated in `test_corrected_models`.
    """
    elsewhere = {"measured-tilt", "cyclic-lead-error"}
    of_data = {"reading-lattice", "angular-noise"}  # they move no mean
    unnamed = {"smooth-function", "periodic-motion", "compliance-with-masses"}
    assert {name for name, *_ in CAUSES} == set(CATALOGUE) - elsewhere - of_data - unnamed


@pytest.mark.parametrize("this", CAUSES, ids=lambda c: "-".join(map(str, (c[0], *c[2].values()))))
def test_what_is_simulated_is_found_again(tmp_path, this):
    causes = [
        this,
        *(SOFT if this[0] in ("mount-tilt", "first-moment", "payload", "payload-centre") else ()),
    ]
    scene = SCANNER if this[0] in BY_SCANNER else TRACKER
    recording = recorded(tmp_path, scene | {"effect": [cause(*c) for c in causes]})
    keys, values, covariance, fit = fitted(recording, causes)
    true = true_values(keys, causes)
    assert np.count_nonzero(true) == sum(len(c[3]) for c in causes)
    assert (np.abs(values - true) <= 4 * np.sqrt(np.diag(covariance))).all(), (values, true)
    assert distance(values - true, covariance) < 4
    assert distance(values, covariance) > 4  # it was there to be found
    assert 0.9 < fit.sigma_scale < 1.1


@pytest.mark.parametrize("name", HOURS)
def test_what_grows_by_the_hour_is_not_shrunk(tmp_path, name):
    """Ten kelvins an hour of aluminium, and no thermometer."""
    where, size = (
        {c[0]: c[1] for c in CAUSES}[name],
        2.4e-4 if name != "joint-thermal-drift" else 1e-3,
    )
    causes = [(name, where, {}, {"per_unit": size})]
    scene = SCANNER if name in BY_SCANNER else TRACKER
    scene = {k: v for k, v in scene.items() if k != "temperature_c"} | {"seconds_per_sample": 100.0}
    _, (value,), covariance, _ = fitted(
        recorded(tmp_path, scene | {"effect": [cause(*c) for c in causes]}), causes
    )
    sigma = np.sqrt(covariance[0, 0])
    assert abs(value - size) < 4 * sigma and sigma < size / 5


@pytest.mark.parametrize("measures", ["external-point", "external-pose", "ball-centre"])
def test_without_effects_only_noise_is_left(tmp_path, measures):
    *_, fit = fitted(recorded(tmp_path, SCANNER | {"measures": measures}), [])
    assert 0.9 < fit.sigma_scale < 1.1


ARMS = [
    path
    for path in sorted((ROOT / "docs" / "scenes").glob("*.toml"))
    if "[camera]" not in path.read_text("utf-8")
]
"""The others are scenes of `workbench render`."""


@pytest.mark.parametrize("path", ARMS, ids=lambda path: path.stem)
def test_the_scenes_of_the_documentation_run(tmp_path, path):
    assert datasets.read(datasets.write(simulate(path), tmp_path / "recording")).n >= 100


def test_covariates_are_as_the_scene_says(tmp_path):
    columns = recorded(tmp_path, SCANNER).columns
    heat, speed = columns["temperature_c"], columns["qdot3_deg_s"]
    assert heat[0] == 18 and heat[-1] == 30 and (np.diff(heat) > 0).all()
    assert np.abs(speed).max() <= 20 and np.ptp(speed) > 30
    np.testing.assert_allclose(
        columns["range_mm"], np.sqrt(sum(columns[f"{c}_mm"] ** 2 for c in "xyz")), atol=0.2
    )


@pytest.mark.parametrize("arm", ["fanuc_lr_mate_200id", "kuka_kr6_r900"])
def test_an_arm_with_coupled_or_turned_round_readings_looks_at_the_balls(tmp_path, arm):
    recording = recorded(tmp_path, SCANNER | {"robot": arm, "samples": 20, "share_of_limits": 1.0})
    assert (
        np.abs(recording.points[:, :2]).max() < 20
        and (np.abs(recording.points[:, 2] - 125) < 12).all()
    )
    lowest, highest = load_robot(arm).limits.T
    assert not ((recording.joints < lowest) | (recording.joints > highest)).any()


@pytest.mark.parametrize("arm", [CRAIG, SLIDING], ids=["craig", "sliding"])
def test_an_arm_of_ones_own_goes_with_the_recording(tmp_path, arm):
    (tmp_path / "arm.toml").write_text(tomli_w.dumps(arm))
    recording = recorded(tmp_path, TRACKER | {"robot": "arm.toml", "samples": 40})
    assert recording.robot["name"] == arm["name"]
    assert (
        "qdot2_mm_s" in recording.columns if arm is SLIDING else "qdot2_deg_s" in recording.columns
    )
    *_, fit = fitted(recording, [])
    assert 0.8 < fit.sigma_scale < 1.2


WRONG = {
    "kind": (
        {"measures": "touch-point"},
        r"key measures: input should be 'external-point', 'external-pose' or 'ball-centre', found 'touch-point'",
    ),
    "joints": ({"joints": "j.csv"}, "key joints: extra inputs are not permitted"),
    "payload": ({"payload_kg": [3.0, 1.0]}, "key payload_kg: expected the lower one first"),
    "less than no payload": ({"payload_kg": [-1.0, 1.0]}, "key payload_kg"),
    "no reflector": ({"reflectors": []}, "key reflectors: .*at least 1 item"),
    "not a number": ({"sigma_mm": float("nan")}, "key sigma_mm"),
    "far balls": (
        {"measures": "ball-centre", "balls": [[5000.0, 0.0, 0.0, 15.0]]},
        "key balls: expected balls .* only 0 of the 150 wanted views",
    ),
    "no balls": ({"measures": "ball-centre"}, "key balls: a ball-centre scene needs at least one"),
    "a ball without size": (
        {"balls": [[0.0, 0.0, 0.0, 0.0]]},
        "key balls.1: expected .* a radius above 0.1",
    ),
    "a robot that is not there": ({"robot": "my.toml"}, "my.toml: expected a readable file"),
    "a robot that nobody knows": (
        {"robot": "my arm"},
        "key robot: key builtin: expected one of .*'my arm'",
    ),
    "no such joint": (
        {"effect": [cause("zero-offset", "joint-9", {}, {"k0": 1.0})]},
        "key effect: zero-offset at joint-9",
    ),
    "no such effect": (
        {"effect": [cause("gremlin", "joint-1", {}, {})]},
        "key effect: no effect is called 'gremlin'",
    ),
    "no such value": (
        {"effect": [cause("zero-offset", "joint-1", {}, {"k1": 1.0})]},
        "key values: expected its parameters k0, found k1",
    ),
    "two at one place": (
        {"effect": [cause("zero-offset", "joint-1", {}, {})] * 2},
        "key effect: two parameters are called",
    ),
    "no masses": (
        {
            "robot": "kuka_kr6_r900",
            "payload_kg": None,
            "effect": [cause("joint-compliance", "joint-2", {}, {"compliance": 2e-4})],
        },
        "joint-compliance at joint-2 has no torque to act on: .* Use gravity-compliance",
    ),
    "no speeds": ({"speeds_deg_s": 0.0}, "key speeds_deg_s"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_scene_that_cannot_be_is_a_sentence(tmp_path, name):
    keys, sentence = WRONG[name]
    with pytest.raises(InputError, match=sentence) as problem:
        scene = {key: value for key, value in (TRACKER | keys).items() if value is not None}
        simulate(written(tmp_path, scene))
    assert "\n" not in str(problem.value) and ".toml" in str(problem.value)


@pytest.mark.parametrize(
    ("key", "row", "sentence"),
    [
        (
            "speeds_deg_s",
            ("time-offset", "time", {}),
            "column 'qdot1_deg_s', found none; add speeds_deg_s = 20.0 to the scene",
        ),
        (
            "approach",
            ("backlash", "joint-2", {}),
            "column 'approach2', found none; add approach = true to the scene",
        ),
        (
            "payload_kg",
            ("noise-heteroscedastic", "noise", {"covariate": "payload_kg"}),
            "add payload_kg = .* to the scene",
        ),
        (
            "temperature_c",
            ("noise-heteroscedastic", "noise", {"covariate": "temperature_c"}),
            "add temperature_c = .* to the scene",
        ),
        (
            "title",
            ("noise-heteroscedastic", "noise", {"covariate": "humidity"}),
            "column 'humidity' is needed",
        ),
    ],
)
def test_a_covariate_that_the_scene_does_not_give_is_a_sentence(tmp_path, key, row, sentence):
    values = {"humidity": 0.1} if row[2].get("covariate") == "humidity" else {}
    scene = {k: v for k, v in TRACKER.items() if k != key} | {"effect": [cause(*row, values)]}
    with pytest.raises(InputError, match=f"a.toml, key effect: .*{sentence}"):
        simulate(written(tmp_path, scene))


@pytest.mark.parametrize(
    ("more", "effects"),
    [
        ({"payload_kg": [0.0, 3.0]}, []),
        ({}, [cause("payload", "tool", {}, {"mass": 3.0})]),
    ],
    ids=["recorded", "not recorded"],
)
def test_a_load_is_a_torque_for_compliance_to_act_on(tmp_path, more, effects):
    """The arm states no masses; a load alone makes joints deflect, whether its mass is recorded or not."""
    plain = {k: v for k, v in TRACKER.items() if k != "payload_kg"} | {"robot": "kuka_kr6_r900"}
    soft = cause("joint-compliance", "joint-2", {}, {"compliance": 2e-4})
    stiff = simulate(written(tmp_path, plain | more | {"effect": effects}))
    loaded = simulate(written(tmp_path, plain | more | {"effect": [*effects, soft]}))
    assert np.abs(loaded.points - stiff.points).max() > 0.1


@pytest.mark.parametrize("arm", [CRAIG, SLIDING], ids=["craig", "sliding"])
def test_balls_are_looked_at_by_distal_arms_that_turn(tmp_path, arm):
    (tmp_path / "arm.toml").write_text(tomli_w.dumps(arm))
    with pytest.raises(
        InputError, match="key robot: a ball-centre scene needs an arm in the standard convention"
    ):
        simulate(written(tmp_path, SCANNER | {"robot": "arm.toml"}))
