"""Points on balls as scans: one sample a scan, which says as much of the arm as its points, and one instant a pose."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from profile_scenes import profile_recording
from robot_model import load_robot
from robot_model.system import bind, row_instants
from scenes import assert_rows, differences
from test_ball_surface import surface
from workbench.commands import cli
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.diagnosis.linear.problem import Located
from workbench.diagnosis.robot.bench import bench_of
from workbench.diagnosis.search.select import find
from workbench.explanation.answer import diagnose
from workbench.explanation.scan_search import find_in_weighed_scans
from workbench.explanation.unexplained import is_structure_located
from workbench.fitting.ball_scans import scans_of
from workbench.fitting.scan_weights import _likeliest_ratio, _Residual


def test_points_of_one_pose_are_simultaneous():
    assert row_instants(np.array([0, 0, 0, 1, 1, 2])).tolist() == [0, 0, 0, 3, 3, 5]
    assert row_instants(np.arange(4)).tolist() == [0, 1, 2, 3]
    returned_to = row_instants(np.array([0, 1, 0]))
    assert returned_to.tolist() == [0, 1, 2]


def test_points_of_a_profile_share_one_instant_of_the_clock():
    recording = profile_recording(n=8, each=10)
    clock = bind(load_robot("ur5"), recording).state.covariates["row"]
    assert [len(np.unique(clock[recording.poses == k])) for k in range(8)] == [1] * 8


def test_profiles_with_equal_joint_readings_are_two_scans():
    recording = profile_recording(n=8, each=10)
    columns = dict(recording.columns)
    second, third = (columns["pose"] == number for number in (2, 3))
    for name in [f"q{k}_deg" for k in range(1, 7)]:
        columns[name] = columns[name].copy()
        columns[name][third] = columns[name][second][0]
    scans = scans_of(load_robot("ur5"), replace(recording, columns=columns))
    assert scans.n == 8


@pytest.mark.parametrize(
    "made",
    [lambda: profile_recording(n=12), lambda: surface(n=12)[1]],
    ids=("profiles", "clouds"),
)
def test_the_jacobian_of_scans_is_the_derivative(made):
    recording = made()
    robot = load_robot(recording.robot)
    model = Model(bind(robot, scans_of(robot, recording)))
    everything = model.parameters.only(np.ones(len(model.parameters), bool))
    everything = everything.unpack(everything.pack() + 1e-3)
    expected = differences(lambda x: model.residual(everything.unpack(x)), everything.pack(), 1e-6)
    assert_rows(model.linearise(everything)[1], expected, 1e-4)


@pytest.mark.parametrize(
    "made",
    [lambda: profile_recording(n=40, each=80), lambda: surface(n=40, each=40, sigma=0.02)[1]],
    ids=("profiles", "clouds"),
)
def test_a_scan_says_as_much_as_its_points(made):
    """Estimates and their covariance from scans are those from all points: a scan is a sufficient statistic.

    Points of a profile are weighted otherwise: in space where they are fitted, in the light plane where a scan is.
    """
    recording = made()
    robot = load_robot(recording.robot)
    points_of_a_scan = recording.n / len(np.unique(recording.columns["pose"]))
    scans = replace(scans_of(robot, recording), sigma_mm=0.02 / np.sqrt(points_of_a_scan))
    start = bind(robot, recording).start  # any rotation about one ball: the same for both
    fits = []
    for samples in (replace(recording, sigma_mm=0.02), scans):
        model = Model(bind(robot, samples, start))
        free = ("base.x", "base.y", "base.z", "sensor.*", "joint-2.theta2", "joint-3.a3")
        fits.append(solve(model, model.parameters.free(*free)))
    of_points, of_scans = fits
    free = of_points.parameters.mask
    apart = (of_points.parameters.values - of_scans.parameters.values)[free]
    is_cloud = np.ptp(recording.points[:, 1]) > 0
    squared_deviations = apart @ of_points.normal @ apart / free.sum()
    information = np.trace(np.linalg.solve(of_points.normal, of_scans.normal)) / free.sum()
    assert squared_deviations < (0.02 if is_cloud else 0.5)
    assert information == pytest.approx(1 if is_cloud else 1.2, abs=0.02 if is_cloud else 0.2)


def test_points_far_from_the_ball_are_left_out_and_reported():
    recording = profile_recording(n=8)
    columns = dict(recording.columns) | {"z_mm": recording.columns["z_mm"].copy()}
    columns["z_mm"][[30, 100]] += 3.0
    scans = scans_of(load_robot("ur5"), replace(recording, columns=columns))
    clean = scans_of(load_robot("ur5"), recording)
    assert np.abs(scans.points - clean.points).max() < 0.02
    assert any(warning.startswith("2 of ") for warning in scans.warnings)


def test_a_gross_point_that_larger_ones_hide_is_left_out():
    """The large ones displace the first fit of their scan, next to which 0.3 mm is no more than its spread."""
    recording = profile_recording(n=8, each=40)
    columns = dict(recording.columns)
    columns["z_mm"] = columns["z_mm"].copy()
    rows = np.flatnonzero(columns["pose"] == 3)
    columns["z_mm"][rows[[5, 12, 20, 30]]] += [7.0, 5.0, -0.3, 6.0]
    scans = scans_of(load_robot("ur5"), replace(recording, columns=columns))
    assert scans.warnings[-1].startswith(f"4 of {recording.n} points")


def test_a_scan_that_determines_no_ball_is_left_out_and_reported():
    recording = profile_recording(n=8)
    few = recording.select((recording.columns["pose"] != 3) | (np.arange(recording.n) % 30 == 0))
    scans = scans_of(load_robot("ur5"), few)
    assert scans.n == 7 and 3 not in scans.sample_ids
    assert any("1 of 8 scans do not determine a ball" in warning for warning in scans.warnings)


@pytest.mark.parametrize(("n", "each", "seed"), [(14, 300, 1), (30, 100, 2), (50, 60, 3)])
def test_clean_profiles_show_no_effect(n, each, seed):
    diagnosis = diagnose(profile_recording(n, each, seed))
    assert diagnosis.verdict == "consistent"
    assert not diagnosis.terms and diagnosis.samples == n


def test_a_transmission_harmonic_in_profiles_is_named():
    def error(joints):
        return 4e-4 * np.cos(2 * joints[:, [2]] + 0.7) * (np.arange(6) == 2)

    diagnosis = diagnose(profile_recording(40, 100, 4, error=error))
    (term,) = diagnosis.terms
    assert (term.finding.effect, term.finding.where) == ("transmission-harmonic", "joint-3")
    assert diagnosis.verdict in ("explained", "ambiguous")


def test_a_step_begins_between_two_poses():
    moved = np.where(np.arange(36)[:, None] < 18, 0.0, [0.2, -0.1, 0.15])
    diagnosis = diagnose(profile_recording(36, 80, 5, moved=moved))
    (term,) = diagnosis.terms
    assert "between samples 18 and 19" in term.statement
    assert (
        0.05 < term.size < 0.3
    )  # of 0.27 mm a part is absorbed by the geometry, and half the poses moved


def test_the_command_counts_scans(tmp_path):
    profile_recording(20, 80, 6).save(tmp_path / "profiles")
    run = tmp_path / "run"
    assert cli.run(["diagnose", str(tmp_path / "profiles"), "--out", str(run)]) == 0
    answer = json.loads((run / "answer.json").read_text())
    assert answer["verdict"] == "consistent" and answer["samples"] == 20
    assert len((run / "residuals.csv").read_text().splitlines()) == 21
    assert (run / "solution.json").exists()


@pytest.mark.parametrize("seed", [7, 8])
def test_an_arm_that_repeats_worse_than_its_profiler_measures_shows_no_effect(seed):
    rng = np.random.default_rng(seed)
    recording = profile_recording(30, 80, seed, 0.01, lambda q: 3e-5 * rng.normal(size=q.shape))
    assert diagnose(recording).verdict == "consistent"


def with_backlash(wild: float):
    """A recording of an arm with 0.2 mrad of backlash of joint 3, and one pose off by `wild` rad."""

    def error(joints):
        out = np.zeros_like(joints)
        out[1:, 2] = 2e-4 * np.sign(np.diff(joints[:, 2]))
        out[28, 1] = wild
        return out

    return profile_recording(40, 80, 12, error=error)


def test_an_effect_is_no_error_of_poses_that_makes_it_uncertain():
    """With weights next to nothing alone the standard deviation is 5.9 urad."""
    (term,) = diagnose(with_backlash(0.0)).terms
    assert (term.finding.effect, term.finding.where) == ("backlash", "joint-3")
    (gap,) = (row for row in term.parameters if row["name"] == "half_gap")
    assert gap["std"] < 3.5e-6
    assert abs(gap["value"] - 2e-4) < 4 * gap["std"]


def test_neither_an_effect_nor_a_wild_scan_counts_as_errors_of_poses():
    bench, found = find_in_weighed_scans(bench_of(with_backlash(1e-3)), find)
    assert [(one.effect, one.where) for one in found.findings] == [("backlash", "joint-3")]
    assert np.allclose(bench.chain.measurement.root, bench.roots_of_points, atol=0.05)
    without = bench.weighed_next_to(())
    assert np.abs(without.chain.measurement.root - bench.roots_of_points).max() > 0.2


def test_the_ratio_of_pose_errors_counts_what_the_parameters_absorb():
    """Of 18 scans 31 parameters leave 23 numbers: the plain likelihood takes most of the pose errors for none."""
    rng = np.random.default_rng(0)
    values = np.tile([0.0, 0.3, 1.0], (18, 1))
    weights, true = np.ones(18), 30.0
    found = []
    for _ in range(60):
        columns = rng.normal(size=(18, 3, 31))
        along = np.sqrt(1 + true * values) * rng.normal(size=values.shape)
        along = along + columns @ rng.normal(size=31)
        found.append(_likeliest_ratio(_Residual(values, along, columns, weights)))
    assert 10.0 < np.median(found) < 90.0
    assert np.mean(np.array(found) == 0.0) < 0.35


def test_few_scans_without_pose_errors_keep_the_weights_of_their_points():
    rng = np.random.default_rng(1)
    values = np.tile([0.0, 0.3, 1.0], (18, 1))
    found = []
    for _ in range(60):
        columns, along = rng.normal(size=(18, 3, 31)), rng.normal(size=values.shape)
        found.append(_likeliest_ratio(_Residual(values, along, columns, np.ones(18))))
    assert np.mean(np.array(found) == 0.0) > 0.8


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_few_profiles_of_an_arm_that_repeats_badly_show_no_effect(seed):
    rng = np.random.default_rng(seed)
    recording = profile_recording(18, 45, seed, 0.01, lambda q: 1.5e-5 * rng.normal(size=q.shape))
    assert diagnose(recording).verdict == "consistent"


def test_an_unknown_effect_in_few_profiles_is_unexplained():
    """The power of the tests that keep false alarms out of 18 poses."""

    def corner(joints):
        out = np.zeros_like(joints)
        out[:, 2] = 1e-3 * np.abs(joints[:, 1] - joints[:, 1].mean())
        return out

    diagnosis = diagnose(profile_recording(18, 60, 21, 0.02, corner))
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.terms[0].finding.where == "joint-3"


def test_a_law_without_support_of_held_out_poses_needs_a_smaller_p_value():
    arm = SimpleNamespace(chain=object())

    def is_located(p_first, t, located=()):
        found = SimpleNamespace(p_first=p_first, located=located)
        return is_structure_located(arm, found, (), SimpleNamespace(t=t))

    assert not is_located(4e-4, -1.4)
    assert is_located(4e-4, 2.5)
    assert is_located(1e-6, -1.4)
    smooth = Located("joint-3", "joint", ("q2",), 0.2, 1e-3, 0.1)
    assert is_located(4e-4, 0.0, (smooth,))
