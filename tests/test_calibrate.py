"""The main job on made recordings: which stages are retained, which samples are left out, which messages appear."""

from dataclasses import replace

import numpy as np
import pytest

from scenes import ABB, CRAIG, model_of, observed, scene
from workbench.core.errors import InputError
from workbench.fitting.verdicts.calibration_verdict import calibration_verdict
from workbench.jobs.robot.calibrate import calibrate

SIGMA = 0.02
_MASSES = ("mass_kg", "com_mm")
WITHOUT_MASSES = {key: value for key, value in CRAIG.items() if key != "payload"} | {
    "joint": [{k: v for k, v in row.items() if k not in _MASSES} for row in CRAIG["joint"]]
}


def recorded(seed=0, n=160, change=lambda points: points, **truth):
    """A tracker recording of an arm with elastic joints 2 and 3; `change` acts on the points (n, 3)."""
    made = scene("external-point", n=n, seed=seed, sigma=SIGMA)
    elastic = [("joint-compliance", f"joint-{k}", {}) for k in (2, 3)]
    model = model_of(made, *elastic)
    values = (
        {f"joint-{k}.joint-compliance.compliance": 2e-4 for k in (2, 3)}
        | {"joint-3.a3": 70.4}
        | truth
    )
    seen = observed(model, model.parameters.update(values), np.random.default_rng(seed))
    points = change(seen.chain.measurement.measured.T.copy())
    columns = dict(made.recording.columns) | dict(zip(("x_mm", "y_mm", "z_mm"), points.T))
    return replace(made.recording, columns=columns, sigma_mm=SIGMA)


@pytest.fixture(scope="module")
def clean():
    return calibrate(recorded())


def rows(calibration):
    return {f"{row['where']}.{row['name']}": row for row in calibration.parameters}


def test_the_true_cause_is_kept_and_reaches_the_noise(clean):
    kept = [stage.name for stage in clean.stages if stage.earned]
    assert kept == ["geometry", "compliance"]
    assert clean.held_out["rms_mm"] < 1.15 * np.sqrt(3) * SIGMA


def test_a_stage_that_another_replaces_is_taken_back(clean):
    gears = next(stage for stage in clean.stages if stage.name == "transmission")
    assert not gears.earned
    assert "left out" in gears.sentence


@pytest.mark.parametrize(
    ("effect", "masses", "payload", "warned"),
    [
        ("joint-compliance", False, False, True),
        ("pedestal-compliance", False, False, True),
        ("joint-compliance", True, False, False),
        ("joint-compliance", False, True, False),
    ],
)
def test_a_compliance_without_any_mass_is_warned_of(effect, masses, payload, warned, tmp_path):
    """Torques of gravity need the mass of a link or of a load; without both the stage estimates nothing."""
    robot = ABB if masses else WITHOUT_MASSES
    recording = scene("external-point", n=40, arm=robot).recording
    columns = {name: column for name, column in recording.columns.items() if name != "payload_kg"}
    if payload:
        columns["payload_kg"] = np.linspace(0, 3, 40)
    recording = replace(recording, columns=columns)
    plan = tmp_path / "elastic.toml"
    where = "base" if effect == "pedestal-compliance" else "joint-2"
    plan.write_text(
        'format = "plan/1"\n[[stage]]\nname = "compliance"\nwhy = "gravity"\n'
        f'effects = [{{ effect = "{effect}", where = "{where}" }}]\nearn = false\n'
    )
    warnings = calibrate(recording, plan=str(plan)).warnings
    found = [one for one in warnings if one.startswith("The robot has no masses")]
    assert bool(found) is warned
    if warned:
        assert f"{effect} has no effect" in found[0] and "Use gravity-compliance" in found[0]


def test_confounded_parameters_name_each_other_and_carry_no_std(clean):
    table = rows(clean)
    assert "base.z" in table["joint-1.d1"]["tied_to"] and "joint-1.d1" in table["base.z"]["tied_to"]
    for key in ("joint-1.d1", "base.z"):
        assert table[key]["std"] is None and not table[key]["identifiable"]
    assert table["base.z"]["std_given_tied"] > 0
    assert any("joint 1's offset (d)" in sentence for sentence in clean.as_json()["undetermined"])


def test_a_determined_length_is_found_within_its_sigma(clean):
    row = rows(clean)["joint-3.a3"]
    assert row["identifiable"] and abs(row["value"] - 70.4) < 4 * row["std"]


@pytest.mark.slow
def test_a_blunder_is_named_and_costs_nothing(clean):
    def blunder(points):
        points[17] += [30.0, -12.0, 8.0]
        return points

    found = calibrate(recorded(change=blunder))
    assert found.suspects == (int(found.recording.sample_ids[17]),)
    assert found.held_out["samples"] == 159
    assert found.held_out["rms_mm"] == pytest.approx(clean.held_out["rms_mm"], rel=0.1)


def test_held_out_covers_every_sample_once(clean):
    assert clean.held_out["samples"] == 160 and clean.held_out["folds"] == 10
    assert np.isfinite(clean.held_out_residual).all()


def test_stages_chosen_on_some_samples_are_fitted_to_all(clean, monkeypatch):
    monkeypatch.setattr("workbench.jobs.robot.calibrate._CHOSEN_ON", 80)
    found = calibrate(recorded())
    assert [s.earned for s in found.stages] == [s.earned for s in clean.stages]
    assert found.held_out["samples"] == 160
    assert found.held_out["rms_mm"] == pytest.approx(clean.held_out["rms_mm"], rel=0.01)
    assert found.fit["rms_mm"] == pytest.approx(clean.fit["rms_mm"], rel=0.01)


@pytest.mark.slow
def test_test_samples_have_no_part_in_any_choice():
    made = recorded()
    test = made.sample_ids[::4]
    worse = dict(made.columns) | {
        "z_mm": np.where(
            np.isin(made.sample_ids, test), made.columns["z_mm"] + 1, made.columns["z_mm"]
        )
    }
    first, second = (calibrate(r, test_samples=test) for r in (made, replace(made, columns=worse)))
    assert [s.earned for s in first.stages] == [s.earned for s in second.stages]
    np.testing.assert_allclose(first.solution.parameters.values, second.solution.parameters.values)
    assert second.held_out["rms_mm"] > 0.9 > 0.1 > first.held_out["rms_mm"]


def test_without_sigma_the_noise_is_estimated(clean):
    found = calibrate(replace(recorded(), sigma_mm=None))
    assert [s.earned for s in found.stages] == [s.earned for s in clean.stages]
    assert rows(found)["joint-3.a3"]["std"] == pytest.approx(
        rows(clean)["joint-3.a3"]["std"], rel=0.25
    )


def test_exact_data_are_fitted_without_complaint():
    found = calibrate(scene("ball-centre", n=60).recording, plan=())
    assert found.solution.converged and found.fit["rms_mm"] < 1e-6


def test_one_posture_is_refused_in_a_sentence():
    made = recorded()
    still = {
        k: np.full_like(v, v[0]) if k.startswith("q") and k.endswith("_deg") else v
        for k, v in made.columns.items()
    }
    with pytest.raises(InputError, match="1 distinct poses"):
        calibrate(replace(made, columns=still))


def test_a_flipped_joint_is_refused_by_name():
    made = recorded()
    flipped = dict(made.columns) | {"q4_deg": -made.columns["q4_deg"]}
    with pytest.raises(InputError, match="q4_deg"):
        calibrate(replace(made, columns=flipped))


@pytest.mark.parametrize(
    ("part", "words"),
    [("base", "the instrument or the base ("), ("tool", "the reflector, sensor or tool (")],
)
def test_a_part_that_moved_between_fitted_and_test_samples_is_named(part, words):
    """The verdict blamed too few poses, whatever the test samples had in common."""
    made = scene("external-point", n=60, sigma=SIGMA)
    model = model_of(made)
    values = dict(zip(model.parameters.keys, model.parameters.values))
    is_moved = "base.x".__eq__ if part == "base" else lambda key: key.endswith("_x")
    moved = {key: value + 2.0 for key, value in values.items() if is_moved(key)}
    rng = np.random.default_rng(0)
    before, after = (
        observed(model, model.parameters.update(change), rng).chain.measurement.measured
        for change in ({}, moved)
    )
    is_test = np.arange(60) >= 40
    points = np.where(is_test, after, before)
    columns = dict(made.recording.columns) | dict(zip(("x_mm", "y_mm", "z_mm"), points))
    recording = replace(made.recording, columns=columns)
    numbers = recording.sample_ids
    found = calibrate(recording, "base-and-tool", numbers[~is_test], numbers[is_test])
    sentence = calibration_verdict(found.held_out, found.noise).sentence
    assert words in sentence and sentence.count("with it estimated on them") == 1
    assert found.held_out["refitted_mm"][part] < 0.1 < found.held_out["rms_mm"]
