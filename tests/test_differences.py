"""What a recording and its simulation differ by: parameters with size and significance, the noise, and physics."""

from dataclasses import replace

import numpy as np
import pytest
import tomli_w

from robot_model.effects import CATALOGUE
from test_mjcf import MJCF_CELL
from workbench.core.errors import InputError
from workbench.explanation.answer import diagnose
from workbench.explanation.comparison.alternatives import alternative_sets
from workbench.explanation.comparison.differences import differences
from workbench.explanation.comparison.reference import reference_of
from workbench.explanation.comparison.uncertain_reference import ValueUncertainty
from workbench.jobs.robot.simulate import simulate
from workbench.report.diagnosis.page import page

SCENE = {
    "robot": "abb_irb120",
    "samples": 120,
    "sigma_mm": 0.02,
    "reflectors": [[30.0, -40.0, 100.0], [-60.0, 10.0, 80.0]],
    "approach": True,
    "base": {"xyz_mm": [1500.0, 100.0, 300.0], "rpy_deg": [2.0, -1.0, 140.0]},
}
NOMINAL = {"joint-2.a2": 270.0, "joint-3.theta3": 0.0, "joint-2.beta2": 0.0, "joint-4.alpha4": 0.0}
GAP = {"effect": "backlash", "where": "joint-3", "values": {"half_gap": 3e-4}}


def scene_file(folder, name="cell", **changes):
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(SCENE | changes))
    return path


def nominal_of(key):
    from robot_model import load_robot

    robot = load_robot("abb_irb120")
    joint, name = int(key[6]), key.split(".")[1][:-1]
    return robot.geometry[joint - 1, ("theta", "d", "a", "alpha", "beta").index(name)]


def recorded(folder, wrong, seed=1, sigma=0.02, effects=()):
    """A recording of an arm that differs from the simulation in some parameters, noise and effects."""
    geometry = {key: nominal_of(key) + change for key, change in wrong.items()}
    path = scene_file(folder, "truth", geometry=geometry, seed=seed, effect=list(effects))
    text = path.read_text().replace("sigma_mm = 0.02", f"sigma_mm = {sigma}")
    path.write_text(text)
    made = simulate(path)
    return type(made)(**{**vars(made), "sigma_mm": 0.02})


CASES = [
    {},
    {"joint-3.theta3": 5e-4},
    {"joint-2.beta2": 5e-4},
    {"joint-2.a2": 0.2, "joint-4.alpha4": -6e-4},
    {"joint-3.theta3": 5e-4, "joint-3.a3": 0.15, "joint-5.theta5": -1e-3},
]


@pytest.mark.parametrize("wrong", CASES, ids=lambda case: "-".join(case) or "none")
def test_the_parameters_that_differ_are_named_with_size_and_significance(wrong, tmp_path):
    recording = recorded(tmp_path, wrong)
    found = differences(reference_of(scene_file(tmp_path), None), recording, ())
    named = {f"{row['where']}.{row['name']}": row for row in found.parameters}
    assert set(named) == set(wrong)
    for key, change in wrong.items():
        row = named[key]
        assert abs(row["value"] - change) < 4 * row["std"] and row["sigmas"] > 4
        assert row["size_mm"] > 0.01 and row["unit"] in ("mm", "rad")
    assert found.noise["factor"] == pytest.approx(1, abs=0.1) and found.noise["p_value"] > 1e-3


def test_a_wrong_statement_of_the_noise_has_its_factor(tmp_path):
    recording = recorded(tmp_path, {"joint-2.a2": 0.3}, sigma=0.05)
    found = differences(reference_of(scene_file(tmp_path), None), recording, ())
    assert found.noise["factor"] == pytest.approx(2.5, rel=0.1)
    assert found.noise["p_value"] < 1e-6
    assert [row["name"] for row in found.parameters] == ["a2"]


def test_physics_is_not_booked_as_parameters_once_it_is_in_the_model(tmp_path):
    recording = recorded(tmp_path, {"joint-2.a2": 0.3}, effects=[GAP])
    reference = reference_of(scene_file(tmp_path), None)
    gap = CATALOGUE["backlash"]("joint-3")
    found = differences(reference, recording, (gap,))
    assert [row["name"] for row in found.parameters] == ["a2"]
    assert found.noise["factor"] == pytest.approx(1, abs=0.1)


def test_a_wrong_value_of_an_effect_of_the_simulation_is_a_parameter(tmp_path):
    right = recorded(tmp_path, {}, effects=[GAP])
    wrong = {**GAP, "values": {"half_gap": 1e-4}}
    found = differences(reference_of(scene_file(tmp_path, effect=[wrong]), None), right, ())
    assert [(r["where"], r["name"]) for r in found.parameters] == [("joint-3", "backlash.half_gap")]
    assert found.parameters[0]["value"] == pytest.approx(2e-4, rel=0.1)


@pytest.mark.slow
def test_the_answer_has_three_parts_and_the_solution_that_holds_beta_is_found_out(tmp_path):
    """A cell in MJCF whose axes 2 and 3 are not quite parallel in reality, with a gap that it does not know."""
    (tmp_path / "cell.xml").write_text(MJCF_CELL)
    wrong = {"joint-2.theta2": 6e-4}
    scene = {"robot": "cell.xml", "share_of_limits": 0.6, "samples": 100, "effect": [GAP]}
    truth = scene_file(tmp_path, "truth", **scene)
    nominal = simulate(truth)
    from robot_model import load_robot

    robot = load_robot(nominal.robot)
    geometry = {"joint-2.theta2": robot.geometry[1, 0] + wrong["joint-2.theta2"]}
    recording = simulate(scene_file(tmp_path, "truth", **scene, geometry=geometry))
    made = diagnose(recording, simulation=tmp_path / "cell.xml")
    result = made.as_json()["differences"]
    assert [(r["where"], r["name"]) for r in result["parameters"]] == [("joint-2", "theta2")]
    assert result["parameters"][0]["value"] == pytest.approx(6e-4, rel=0.2)
    assert result["noise"]["factor"] == pytest.approx(1, abs=0.12)
    assert [(one["effect"], one["where"]) for one in result["physics"]] == [("backlash", "joint-3")]
    assert any("servos are taken as rigid" in sentence for sentence in made.warnings)
    sections = {section.name: section for section in page(made).sections}
    shown = repr(sections["against"])
    assert "joint-2 theta2" in shown and "factor" in shown and "backlash at joint-3" in shown
    names = [step.name for step in made.views.steps]
    assert "cell.xml, base and tool fitted" in names[0] and names[1] == "baseline"
    sizes = [step.rms for step in made.views.steps]
    assert sizes[0] > sizes[1] > sizes[-1]


def test_a_cell_without_masses_is_said_to_show_no_deflection(tmp_path):
    import re

    (tmp_path / "cell.xml").write_text(re.sub(r"<(inertial|geom)[^>]*/>", "", MJCF_CELL))
    reference = reference_of(tmp_path / "cell.xml", None)
    assert any("states no masses" in note for note in reference.notes)
    with pytest.raises(InputError):
        reference_of(tmp_path / "absent.xml", None)


def test_parameters_of_an_earlier_solution_that_were_held_are_suspects(tmp_path):
    """A plan without beta at the parallel axes 2 and 3: the solution holds it, and the comparison names it."""
    from workbench.fitting.calibration_plans.plans import read_plan
    from workbench.jobs.robot.calibrate import calibrate, save

    recording = recorded(tmp_path, {"joint-2.beta2": 8e-4})
    save(calibrate(recording, read_plan("ye-mdh"), folds=4), tmp_path)
    found = differences(reference_of(None, tmp_path / "solution.json"), recording, ())
    assert found.parameters and found.parameters[0]["name"] == "beta2"
    assert found.parameters[0]["value"] == pytest.approx(8e-4, rel=0.2)
    assert np.isfinite(found.parameters[0]["std"])


def earlier_calibration(reference, rng):
    """The reference as a calibration with known uncertainty would have left it: every angle and length off by chance."""
    keys = [key for key in reference.values if key.startswith("joint-") and key.count(".") == 1]
    is_length = [key.split(".")[1][:-1] in ("d", "a") for key in keys]
    sigma = np.where(is_length, 0.03, 1e-4)  # mm, rad
    errors = dict(zip(keys, sigma * rng.normal(size=len(keys))))
    values = {key: value + errors.get(key, 0.0) for key, value in reference.values.items()}
    return replace(
        reference, values=values, uncertainty=ValueUncertainty(tuple(keys), np.diag(sigma**2))
    )


def test_an_earlier_calibration_differs_by_its_own_uncertainty_without_a_change_of_the_arm(
    tmp_path,
):
    rng = np.random.default_rng(2)
    scene = reference_of(scene_file(tmp_path), None)
    unchanged = recorded(tmp_path, {})
    for _ in range(4):
        reference = earlier_calibration(scene, rng)
        assert differences(reference, unchanged, ()).parameters == ()
        assert len(differences(replace(reference, uncertainty=None), unchanged, ()).parameters) > 3


def test_a_change_since_an_earlier_calibration_has_the_uncertainty_of_both(tmp_path):
    rng = np.random.default_rng(3)
    reference = earlier_calibration(reference_of(scene_file(tmp_path), None), rng)
    (row,) = differences(reference, recorded(tmp_path, {"joint-3.theta3": 2e-3}), ()).parameters
    assert (row["where"], row["name"]) == ("joint-3", "theta3")
    assert 1e-4 <= row["std"] < 4e-4 and abs(row["value"] - 2e-3) < 3 * row["std"]


def test_a_parameter_that_stands_for_two_others_names_them(tmp_path):
    """A length of joint 4 explains nearly what an angle and a length of joint 3 make together in few noisy poses."""
    columns, white = sets_of_columns()
    found = alternative_sets(columns, white, [2], 2)
    assert (0, 1) in found and all(2 not in one for one in found)
    # with little noise the data distinguish them
    assert alternative_sets(columns, 30 * white, [2], 2) == [(0, 1)]


def test_an_alternative_contains_no_smaller_one_and_no_column_without_evidence():
    columns, white = sets_of_columns()
    found = alternative_sets(columns, white, [2], 2)
    assert not any(set(a) < set(b) for a in found for b in found)
    assert not any(3 in one for one in found), found
    # a candidate that the others make exactly adds nothing and does not make the solution singular
    twice = np.vstack([columns, columns[0] + columns[1]])
    assert (4,) in alternative_sets(twice, white, [2], 2)


def sets_of_columns():
    """Four columns; the third is near the sum of the first two, which make the residual; the last is independent."""
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(4, 300)) / np.sqrt(300)
    columns[2] = columns[0] + columns[1] + 0.2 * columns[2]
    white = 9 * (columns[0] + columns[1]) + rng.normal(size=300)
    return columns, white


BALLS = {
    "measures": "ball-centre",
    "balls": [[0.0, 0.0, 0.0, 15.0], [80.0, 5.0, -3.0, 15.0], [10.0, 70.0, 4.0, 15.0]],
    "base": {"xyz_mm": [-450.0, 0.0, -100.0]},
    "tool": {"xyz_mm": [0.0, 0.0, 60.0]},
    "samples": 120,
}


def test_the_noise_is_what_remains_after_a_large_effect_that_was_found(tmp_path):
    """A hundred times the usual size: its usual prior would leave most of it in the residual."""
    bias = {"effect": "field-bias", "where": "sensor", "values": {"xx": 4.0, "yy": -2.0}}
    path = scene_file(tmp_path, "truth", **BALLS, seed=3, effect=[bias])
    reference = reference_of(scene_file(tmp_path, **BALLS), None)
    found = differences(reference, simulate(path), (CATALOGUE["field-bias"]("sensor"),))
    assert found.noise["factor"] == pytest.approx(1, abs=0.08)
