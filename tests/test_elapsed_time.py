"""The uncertainty of a correction grows with the time since the recording, as far as the arm drifted within it."""

from types import SimpleNamespace

import numpy as np
import pytest

from robot_model.effects import CATALOGUE
from robot_model.effects.nonparametric import PeriodicMotion, SmoothFunction
from test_correction_limits import RANGE, solution
from workbench.files.solution_file import read_solution
from workbench.jobs.robot.compensation.compensate import compensate
from workbench.jobs.robot.compensation.elapsed_time import elapsed_time_words

LENGTH_S = 4000.0
JOINT = SmoothFunction("joint-2", "joint", ["time"], [[0.0, LENGTH_S]], "rad", [3e-4])
READINGS = np.deg2rad([[0, 10, 10, 0, 30, 0], [40, -20, 25, 10, 50, 5], [-30, 20, 5, 60, 20, 5]])


def swings(rng):
    """A drift of one to three oscillations of unrelated periods, as a function of time."""
    count = rng.integers(1, 4)
    rates = 2 * np.pi / rng.uniform(1500, 9000, count)
    phases, sizes = rng.uniform(0, 2 * np.pi, count), 2e-4 * rng.uniform(0.3, 1, count)
    return lambda time: sizes @ np.sin(np.outer(rates, time) + phases[:, None])


def straight(rng):
    slope = rng.normal(0, 2e-4) / LENGTH_S
    return lambda time: slope * time


def random_walk(rng):
    """A Wiener process that changes by 0.2 mrad over the recording, 1 sigma."""
    grid = np.linspace(0, 2 * LENGTH_S, 801)
    steps = rng.normal(0, 2e-4 / np.sqrt(400), 800)
    values = np.concatenate([[0.0], np.cumsum(steps)])
    return lambda time: np.interp(time, grid, values)


def fitted(function):
    """Coefficients of `JOINT` by least squares on 200 samples of a function, its constant, and the RMS residual."""
    time = np.linspace(0, LENGTH_S, 200)
    waves = JOINT.basis(clock_state(time))[:, 0]
    columns = np.concatenate([waves, np.ones((1, 200))])
    found = np.linalg.lstsq(columns.T, function(time), rcond=None)[0]
    return found[:-1], found[-1], np.std(function(time) - found @ columns)


def clock_state(time):
    return SimpleNamespace(covariates={"time": time, "time_s": time}, n=len(time))


@pytest.mark.parametrize("drift", [swings, straight, random_walk])
def test_three_sigma_hold_the_error_after_the_recording(drift):
    """200 drifts of each kind, frozen at the end of the recording, 2 to 40 % of its length later.

    What the fit leaves within the recording is in the held-out error, and so in the uncertainty of every target.
    """
    rng = np.random.default_rng(5)
    later = LENGTH_S * (1 + np.array([0.02, 0.1, 0.2, 0.4]))
    errors, sigmas = [], []
    for _ in range(200):
        function = drift(rng)
        p, constant, left = fitted(function)
        state = clock_state(later)
        errors.append(function(later) - JOINT.delta(p, state)[0] - constant)
        sigmas.append(np.hypot(JOINT.extrapolation(p, state)[0], left))
    errors, sigmas = np.array(errors), np.array(sigmas)
    assert ((np.abs(errors) <= 3 * sigmas).mean(0) >= 0.95).all()
    ratio = np.sqrt((errors**2).mean(0) / (sigmas**2).mean(0))
    assert (ratio > 0.4).all() and (ratio < 1.6).all()


def drifting(folder, seed=3):
    """An ABB whose joint 2 swings in the course of the recording, and these swings."""
    function = swings(np.random.default_rng(seed))
    p, constant, _ = fitted(function)
    keys = [q.key for q in JOINT.table(None)]
    row = {"effect": "smooth-function", "where": "joint-2", **JOINT.options}
    made = solution(
        folder / "arm", (row,), dict(zip(keys, p)), fitted_range=RANGE | {"time_s": [0.0, LENGTH_S]}
    )
    return read_solution(made), lambda time: function(np.array([time]))[0] - constant


def test_the_stated_uncertainty_of_a_correction_grows_and_holds_its_error(tmp_path):
    arm, function = drifting(tmp_path)
    uncertainty, correction = [], []
    for time in LENGTH_S * np.array([0.5, 1.0, 1.05, 1.2, 1.5]):
        found = compensate(arm, READINGS, covariates={"time_s": np.full(3, time)})
        uncertainty.append(found.uncertainty_mm)
        correction.append(found.readings[:, 1])
    uncertainty = np.array(uncertainty)
    np.testing.assert_allclose(uncertainty[0], uncertainty[1], rtol=3e-3)
    assert (np.diff(uncertainty[1:], axis=0) > 0).all()
    # joint 2 moves the flange by its angle times less than 700 mm; the correction stays that of the end
    np.testing.assert_allclose(correction[-1], correction[1], atol=1e-6)
    missed = abs(function(1.2 * LENGTH_S) - function(LENGTH_S))
    assert 300 * missed < 3 * uncertainty[3].max()


def test_the_change_is_stated_for_late_targets_and_for_targets_without_times(tmp_path):
    arm, _ = drifting(tmp_path)
    found = compensate(arm, READINGS, covariates={"time_s": np.full(3, LENGTH_S)})
    for time, words in (
        (LENGTH_S, "Within 400 s after the end"),
        (1.2 * LENGTH_S, "Since the end"),
    ):
        (said,) = elapsed_time_words(arm, found, {"time_s": np.full(3, time)})
        assert said.startswith(words) and "sigma_mm contains this" in said
    still = read_solution(solution(tmp_path / "still"))
    assert elapsed_time_words(still, found, {"time_s": np.full(3, LENGTH_S)}) == []


@pytest.mark.parametrize(
    ("name", "where", "options", "key", "late_grows"),
    [
        ("joint-thermal-drift", "joint-3", {}, "per_unit", True),
        ("link-thermal-growth", "link-2", {}, "per_unit", True),
        ("warm-up", "joint-3", {"time_constant": 2000.0}, "final", True),
        ("zero-shift", "joint-3", {"after": 900.0}, "shift", False),
    ],
)
def test_laws_of_time_are_uncertain_by_what_they_predict_after_the_recording(
    name, where, options, key, late_grows, tmp_path
):
    """A step has happened once and is over; a drift may go on or end."""
    effect = CATALOGUE[name](where, **options)
    row = {"effect": name, "where": where, **options}
    changes = {f"{where}.{effect.effect}.{key}": 1e-3}
    ranges = RANGE | {"time_s": [0.0, LENGTH_S]}
    arm = read_solution(solution(tmp_path / "arm", (row,), changes, fitted_range=ranges))
    sigma = [
        compensate(arm, READINGS, covariates={"time_s": np.full(3, time)}).sigma_mm
        for time in (LENGTH_S, 1.3 * LENGTH_S)
    ]
    assert ((sigma[1] > 5 * sigma[0]).all()) == late_grows
    assert late_grows or np.allclose(sigma[0], sigma[1], rtol=1e-3)


def test_a_cycle_is_uncertain_by_its_amplitude_after_a_period():
    motion = PeriodicMotion("base", 2 * np.pi / 500, ["mm"], [0.1])
    time = np.array([100.0, LENGTH_S, LENGTH_S + 250, LENGTH_S + 1000])
    p = np.array([0.03, 0.04])
    assert motion.extrapolation(p, clock_state(time[:2]), {"time": (0.0, LENGTH_S)}) is None
    sigma = motion.extrapolation(p, clock_state(time), {"time": (0.0, LENGTH_S)})
    np.testing.assert_allclose(sigma[0], [0, 0, 0.0707, 0.0707], atol=2e-3)
