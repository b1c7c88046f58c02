"""Effects of recorded columns are named: exposure, warm-up of the laser, rolling shutter, vibration; lines of boards, lobes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sensor_virtual
from conftest import mostly_slow
from sensors.effects import CATALOGUE
from sensors.light.shared_errors import SharedStripeErrors
from simulated_images import simulated
from workbench.diagnosis.scanner import sensor
from workbench.diagnosis.search.select import find, found_terms
from workbench.diagnosis.validation.proof import retained_in_fold

CASES = {
    "recorded-column": ("mirror", {"column": "exposure_ms"}, {"slope": 1e-4}),
    "laser-drift": ("laser", {"time_constant_s": 120.0}, {"amplitude": 1e-3}),
    "rolling-shutter": ("time", {}, {"readout": 4e-3}),
    "mirror-vibration": ("mirror", {"angular_frequency": 0.31}, {"cos": 2e-4, "sin": 1e-4}),
    "board-point-errors": ("artefact", {"line": "row", "at_mm": 24.0}, {"row24_x": 0.03}),
    "ball-form": ("ball-1", {"degree": 3}, {"d3m0": 0.05, "d3m6": 0.04}),
}


@cache
def true():
    """Measurements with the exposure and the time of every image."""
    chains = sensor_virtual.chains()
    rng = np.random.default_rng(8)
    parts, start = {}, 0.0
    for name in ("board_stripes", "balls"):
        chain = getattr(chains, name)
        group = chain.labels["placement" if name == "board_stripes" else "ball"]
        code = group * chain.planes.shape[1] + chain.labels["step"]
        _, image = np.unique(code, return_inverse=True)
        time = start + np.cumsum(rng.uniform(1.5, 2.5, image.max() + 1))
        exposure = rng.choice([2.0, 4.0, 6.0], image.max() + 1)
        columns = {"exposure_ms": exposure[image], "time_s": time[image]}
        parts[name] = replace(chain, covariates={**chain.covariates, **columns})
        start = float(time[-1])
    corners = chains.corners
    still = np.full(corners.pixels.shape[1], 4.0)
    corners = replace(corners, covariates={**corners.covariates, "exposure_ms": still})
    return replace(chains, corners=corners, **parts)


NAMES = [
    "recorded-column",
    "laser-drift",
    "rolling-shutter",
    "mirror-vibration",
    "board-point-errors",
    "ball-form",
]


@pytest.mark.parametrize("name", mostly_slow(NAMES, 1, 3))
def test_an_effect_of_a_recorded_column_is_named(name):
    where, options, values = CASES[name]
    effect = CATALOGUE[name](where, **options)
    values = {f"{where}.{name}.{key}": value for key, value in values.items()}
    bench = sensor.SensorBench(simulated(true(), (effect,), values, 3))
    found = find(bench)
    named = [(one.effect, one.where) for one in found.findings]
    assert named == [(name, where)], found
    assert found.findings[0].probability > 0.4


def test_a_laser_that_turns_about_a_place_of_its_own_drifts_in_parallel_too():
    start = sensor.SensorBench(true()).kind
    options = {"apex_mm": list(start.light), "axis": list(start.light_axis)}
    effect = CATALOGUE["laser-drift"]("laser", time_constant_s=120.0, **options)
    values = {"laser.laser-drift.amplitude": 5e-4, "laser.laser-drift.shift_amplitude": 0.1}
    bench = sensor.SensorBench(simulated(true(), (effect,), values, 5))
    found = find(bench)
    assert [(one.effect, one.where) for one in found.findings] == [("laser-drift", "laser")]
    estimated = {row["key"]: row for row in bench.parameters(found.findings[0].effects)}
    for key, value in values.items():
        assert abs(estimated[key]["value"] - value) < 0.1 * abs(value) + 4 * estimated[key]["std"]


def test_a_ball_of_a_wrong_radius_that_was_scanned_twice_is_found_from_either_scan():
    effect = CATALOGUE["ball-radius"]("ball-2")
    values = {"ball-2.ball-radius.growth": 0.1}
    bench = sensor.SensorBench(simulated(sensor_virtual.chains(scans=2), (effect,), values, 6))
    second_ball = np.unique(bench.pose)[-2]
    found = retained_in_fold(bench, bench.pose != second_ball, found_terms)
    assert [(one.effect, one.where) for one in found] == [("ball-radius", "ball-2")]


def test_a_wrong_radius_of_balls_without_numbers_is_a_group_with_subsurface_scatter():
    """Both make all balls seem smaller: no pose of theirs distinguishes the two."""
    chains = sensor_virtual.chains(scans=2)
    balls = replace(chains.balls, number=np.zeros_like(chains.balls.number))
    effect = CATALOGUE["ball-radius"]("artefact")
    values = {"artefact.ball-radius.growth": -0.05}
    bench = sensor.SensorBench(simulated(replace(chains, balls=balls), (effect,), values, 8))
    (found,) = find(bench).findings
    assert (found.effect, found.where) == ("ball-radius", "artefact")
    assert ("subsurface-scatter", "sensor") in [(a.effect, a.where) for a in found.alternatives]
    assert found.probability < 0.6
    (row,) = bench.parameters(found.effects)
    assert row["value"] == pytest.approx(-0.05, abs=4 * row["std"])


def test_a_lens_has_one_focal_length_in_each_image():
    chains = sensor_virtual.chains(scans=2)
    of_pose = {}
    for chain in (chains.corners, chains.board_stripes):
        label, depth = chain.labels["placement"], chain.state.focus_depth
        for pose in np.unique(label):
            (one,) = np.unique(depth[label == pose].round(9))
            assert one == pytest.approx(of_pose.setdefault(pose, one), abs=1e-3)
    assert np.ptp(list(of_pose.values())) > 1
    balls = replace(chains.balls, scan_of=np.arange(len(chains.balls.centres)) % 2)
    scan = balls.scan_of[balls.labels["ball"]]
    for k in (0, 1):
        mean = balls.centres[balls.scan_of == k, 2].mean()
        assert balls.state.focus_depth[scan == k] == pytest.approx(mean)


def test_variants_of_one_effect_have_labels_of_their_own():
    kind = sensor.SensorBench(true()).kind
    for effect in CATALOGUE.values():
        labels = [(one.effect.where, one.label) for one in effect.candidates(kind)]
        assert len(set(labels)) == len(labels), effect.effect


def test_what_stripes_share_without_an_effect_does_not_weaken_the_fit_with_it():
    """A calibration that knows no vibration takes it for a random displacement of whole stripes."""
    effect = CATALOGUE["mirror-vibration"]("mirror", angular_frequency=0.31)
    keys = [f"mirror.mirror-vibration.{wave}" for wave in ("cos", "sin")]
    values = dict(zip(keys, (4e-4, 2e-4)))
    chains = simulated(true(), (effect,), values, 7)
    stripes = chains.board_stripes
    alike = SharedStripeErrors.of(stripes.labels, stripes.stripe_place)
    alike = replace(alike, sigma=np.array([0.5, 0.0, 0.2]))
    chains = replace(chains, board_stripes=replace(stripes, shared_errors=alike))
    rows = {row["key"]: row for row in sensor.SensorBench(chains).parameters((effect,))}
    for key, value in values.items():
        assert rows[key]["std"] < 0.02 * abs(value)
        assert abs(rows[key]["value"] - value) < 4 * rows[key]["std"]


def test_clean_measurements_with_many_columns_are_silent():
    found = find(sensor.SensorBench(simulated(true(), (), {}, 4)))
    assert found.p_first > 0.005 and not found.findings
