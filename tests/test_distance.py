"""Lengths between two places of a reflector: arm and reflector from joint readings and lengths alone."""

from dataclasses import replace

import numpy as np
import pytest

from datasets import read, write
from datasets.recording import Recording
from plain_frames import frames_of
from robot_model import load_robot
from robot_model.effects import CATALOGUE
from robot_model.measurements import measurement_of, samples_of
from robot_model.system import bind
from scenes import ABB, assert_rows, differences
from workbench.core.effect import make_effects
from workbench.core.errors import InputError
from workbench.core.model import Model
from workbench.fitting.cross_validation import blocks
from workbench.jobs.robot.calibrate import calibrate
from workbench.jobs.robot.identify import identifiability
from workbench.jobs.robot.poses import choose_poses, write_poses
from workbench.report.calibration.errors import errors_of, noise_sentence

REFLECTORS = {1: np.array([20.0, -15.0, 150.0]), 4: np.array([-60.0, 10.0, 80.0])}
UNSEEN = {"joint-1.theta1", "joint-1.d1"}  # the whole arm turned or lifted
LEVERLESS = {"joint-1.beta1"}  # its own turn about joint 1, as a1 is 0


def lengths(pairs=40, ids=(1,), sigma=0.01, seed=0):
    """Exact lengths of the nominal arm by plain matrix products, rows of pairs apart from one another."""
    rng, robot = np.random.default_rng(seed), load_robot(ABB)
    q, reflector = rng.uniform(-1.5, 1.5, (2 * pairs, 6)), rng.choice(ids, 2 * pairs)
    flanges = np.array([frames_of(robot, row)[-1] for row in q])
    places = np.array([f[:3, :3] @ REFLECTORS[r] + f[:3, 3] for f, r in zip(flanges, reflector)])
    apart = np.linalg.norm(places[:pairs] - places[pairs:], axis=1)
    columns = {
        "pair": np.tile(np.arange(1.0, pairs + 1), 2),
        "length_mm": np.tile(apart, 2),
        "reflector": reflector.astype(float),
        "payload_kg": rng.uniform(0, 2, 2 * pairs),
    }
    columns |= {f"q{k + 1}_deg": np.rad2deg(column) for k, column in enumerate(q.T)}
    order = rng.permutation(2 * pairs)
    columns = {"sample": np.arange(1.0, 2 * pairs + 1)} | {
        name: column[order] for name, column in columns.items()
    }
    return Recording("distance", columns, ABB, sigma_mm=sigma, name="bar")


@pytest.mark.parametrize("ids", [(1,), (1, 4)])
@pytest.mark.parametrize("pairs", [10, 40])
def test_exact_lengths_start_at_the_reflectors(ids, pairs):
    chain = bind(load_robot(ABB), samples_of(lengths(pairs, ids)))
    np.testing.assert_allclose(chain.start.reshape(-1, 3), [REFLECTORS[i] for i in ids], atol=1e-4)
    assert np.abs(Model(chain).residual(chain.parameters)).max() < 1e-5
    assert chain.base_size == 0 and chain.sigma.shape == (1, pairs) and chain.state.n == 2 * pairs


def test_the_jacobian_is_the_derivative_with_effects_on_every_port():
    """What acts differently at the two ends, of loads that differ, adds up to the one length."""
    rows = [
        ("joint-compliance", "joint-2", {}),
        ("bearing-compliance", "joint-3", {}),
        ("first-moment", "link-3", {}),
        ("transmission-harmonic", "joint-4", {"order": 1}),
    ]
    model = Model(
        bind(load_robot(ABB), samples_of(lengths(12, (1, 4)))), make_effects(CATALOGUE, rows)
    )
    start = model.parameters
    free = start.only(~np.isin(start.keys, [*UNSEEN, *LEVERLESS]))
    free = free.unpack(free.pack() + 0.02 * free.typical[free.mask])
    size = free.typical[free.mask]
    expected = differences(
        lambda x: model.residual(free.unpack(x * size)), free.pack() / size, 1e-4
    )
    assert expected.shape[2] == 12
    assert_rows(model.linearise(free)[1] * size[:, None, None], expected, 1e-4)


def test_some_lengths_are_the_same_chain():
    chain = bind(load_robot(ABB), samples_of(lengths(20, (1, 4))))
    part, values = np.array([2, 5, 17]), chain.parameters.update({"joint-3.a3": 261.0})
    np.testing.assert_allclose(
        Model(chain).at(part).residual(values), Model(chain).residual(values)[:, part]
    )
    mask = np.isin(np.arange(20), part)
    assert np.array_equal(chain.at(mask).variables, chain.at(part).variables)
    points, arrows = chain.to_root(
        values.values, chain.evaluate(values.values, {}), np.full((3, 20), 0.5)[:1]
    )
    assert points.shape == arrows.shape == (3, 20)
    np.testing.assert_allclose(np.linalg.norm(arrows, axis=0), 0.5)


def test_a_pair_is_one_sample_in_the_order_of_its_first_row():
    recording = lengths(8)
    paired = samples_of(recording)
    assert paired.n == 8 and (np.diff(paired.sample_ids) > 0).all()
    ids = np.concatenate([paired.columns["sample"], paired.columns["other_sample"]])
    assert sorted(ids) == sorted(recording.columns["sample"])
    assert samples_of(paired) is not None and samples_of(paired).n == 8
    residual = np.linspace(-1, 1, 8)[None]
    columns = measurement_of(paired).columns(residual)
    np.testing.assert_allclose(columns["length_mm"] - paired.columns["length_mm"], residual[0])


def test_the_same_two_postures_stand_on_one_side_of_a_split_and_one_home_does_not_tie_all():
    recording = lengths(12)
    columns = {k: v.copy() for k, v in samples_of(recording).columns.items()}
    for k in range(1, 7):
        columns[f"q{k}_deg"][:] = columns[f"q{k}_deg"][0]  # all from one home
        columns[f"other_q{k}_deg"][5] = columns[f"other_q{k}_deg"][4]
    poses = replace(recording, columns=columns).poses
    assert len(np.unique(poses)) == 11 and poses[4] == poses[5]
    assert len(np.unique(blocks(poses, 5))) == 5


def test_no_base_is_known_and_the_program_says_so():
    geometry = identifiability(lengths(60))["stages"][0]
    words = " ".join(geometry["undetermined"])
    assert "joint 1's zero offset (theta) has no effect on these measurements" in words
    assert "joint 1's offset (d) has no effect on these measurements" in words
    assert "base" not in words
    assert "joint 2's offset (d) and joint 3's offset (d) are confounded" in words
    # d2 is not free, as beta2 stands in for it, and is asked about all the same
    assert geometry["identifiable"] == geometry["free"] - (len(geometry["undetermined"]) - 1)


@pytest.mark.slow
def test_lengths_of_an_arm_that_the_model_did_not_make(tmp_path):
    """MuJoCo's elastic arm, 0.005 mm: nominal 1.8 mm, unseen lengths to 1.4 times the noise, through the files."""
    lengths_maker = pytest.importorskip(
        "datasets.makers.lengths", reason="MuJoCo is not installed", exc_type=ImportError
    )
    made = lengths_maker.lengths(250, noise_mm=0.005)
    answer = calibrate(read(write(made.recording(), tmp_path / "bar")), folds=5).as_json()
    assert answer["samples"] == 250 and answer["nominal"]["rms_mm"] > 1
    assert answer["held_out"]["rms_mm"] < 1.4 * 0.005
    true, found = made.truth["arm"].geometry, {row["name"]: row for row in answer["parameters"]}
    # what its pedestal and links do is only nearly in the model: single lengths take some of it
    lengths = ((0, "a1"), (1, "a2"), (2, "a3"))
    assert all(found[name]["identifiable"] for _, name in lengths)
    off, before = (
        np.array([found[name][key] - true[joint, 2] for joint, name in lengths])
        for key in ("value", "nominal")
    )
    assert np.linalg.norm(off) < 0.05 * np.linalg.norm(before)


def test_stated_sigmas_hold_their_parameters():
    """A stiff arm within the model: standardised errors of what is determined, over lengths that are not few."""
    lengths_maker = pytest.importorskip(
        "datasets.makers.lengths", reason="MuJoCo is not installed", exc_type=ImportError
    )
    made = lengths_maker.lengths(300, noise_mm=0.01, stiff=True, seed=4)
    found = calibrate(made.recording(), folds=5)
    assert found.held_out["rms_mm"] == pytest.approx(0.01, rel=0.15)
    true = {
        f"{name}{k + 1}": made.truth["arm"].geometry[k, c]
        for k in range(6)
        for c, name in enumerate(("theta", "d", "a", "alpha", "beta"))
    }
    inner = [
        row
        for row in found.parameters
        if row["identifiable"] and row["name"] in ("a1", "a2", "a3", "d4", "a4")
    ]
    assert len(inner) >= 4
    assert all(abs(row["value"] - true[row["name"]]) < 4 * row["std"] for row in inner)


def broken(recording, tmp_path, **columns):
    return read(write(replace(recording, columns=recording.columns | columns), tmp_path / "bar"))


def test_lengths_that_differ_within_a_pair_are_a_sentence(tmp_path):
    recording = lengths(10)
    length = recording.columns["length_mm"].copy()
    length[3] += 0.5
    with pytest.raises(
        InputError, match="column length_mm: expected .* as in the pair's other row, found"
    ):
        broken(recording, tmp_path, length_mm=length)


def test_a_pair_of_one_row_is_a_sentence(tmp_path):
    recording = lengths(10)
    with pytest.raises(InputError, match="column pair: expected two rows with one pair, found 1"):
        broken(recording.select(np.arange(19)), tmp_path / "one")
    fixed = np.array(["tool"] * 19 + ["floor"])
    with pytest.raises(
        InputError, match="expected two rows of the tool with one pair, found 1 with"
    ):
        calibrate(broken(recording, tmp_path, fixed_to=fixed))


@pytest.mark.parametrize(("factor", "unit"), [(1e-3, "m"), (1 / 25.4, "inches")])
def test_other_units_are_named(factor, unit):
    recording = lengths(40)
    wrong = replace(
        recording,
        columns=recording.columns | {"length_mm": factor * recording.columns["length_mm"]},
    )
    with pytest.raises(InputError, match=f"column length_mm holds {unit}; multiply it by"):
        calibrate(wrong)


def test_a_joint_of_the_other_sign_is_named_at_both_ends():
    recording = lengths(40)
    wrong = replace(recording, columns=recording.columns | {"q3_deg": -recording.columns["q3_deg"]})
    with pytest.raises(InputError, match="column q3_deg has the opposite sign"):
        calibrate(wrong)


def test_chosen_lengths_come_with_both_ends(tmp_path):
    recording = lengths(60)
    found = choose_poses(recording, 15, link_radius_mm=0)
    assert len(found.design.chosen) == 15 and found.design.gain > 1
    rows = write_poses(found, tmp_path).read_text(encoding="utf-8").splitlines()
    pairs = [row.split(",")[rows[0].split(",").index("pair")] for row in rows[1:]]
    assert len(pairs) == 30 and len(set(pairs)) == 15


def test_noise_of_a_length_is_one_sigma_in_the_report():
    words = noise_sentence(0.01, {"rms_mm": 0.02}, 1)
    assert "RMS distance of σ = 0.0100 mm" in words and "2.00 times" in words
    assert errors_of(calibrate(lengths(60), folds=3)).coordinates == 1
