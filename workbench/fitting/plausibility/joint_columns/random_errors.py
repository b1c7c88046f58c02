"""Random errors of one column: the readings of one joint, one measured coordinate, or the range of the instrument.

Readings that were commanded instead of measured, a loose encoder, or one bad axis of an instrument displace every
measured point along one known line, by an amount that is independent from pose to pose. Gears, springs and gravity
displace it along the same line, but as a smooth function of the pose, and a gap or friction by the side from which a
joint comes: the column is named only where its variance component explains the residual also next to trigonometric
functions of all joints and to these sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from datasets.samples.columns import POINT, joint_columns, joint_number
from robot_model.system import bind
from workbench.core.covariates import last_side
from workbench.fitting.plausibility.fitting import FAILURES, Fit, fit_recording, row_residual
from workbench.fitting.plausibility.good_fit import good_scale
from workbench.fitting.plausibility.joint_columns.variance_model import DirectedNoise, VarianceModel
from workbench.fitting.plausibility.linearised_fit import LinearisedFit
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.suspicion import Suspicion

READINGS, COORDINATES = "reading-noise", "coordinate-noise"
_RANGE = "range"
_ROWS, _STEPS = 240, 60
_LEAST_DEGREES = 60
_EVIDENCE = 25.0
"""Difference of log likelihoods: odds of 10^10."""
_CLEAR = 10.0
"""The same against the second best column."""
_REMAINING, _REMAINING_NEXT_TO_SMOOTH = 0.75, 0.8
"""Share of the isotropic noise that the variance component leaves at most, without and with smooth functions."""
_RANDOM_SHARE = 0.5
"""Share of the errors that smooth functions of the joints leave at least."""
_LARGE_DEG, _LARGE_MM = 0.03, 0.1
"""Sound drives repeat within a third of it, and their random effects are for the diagnosis."""


@dataclass(frozen=True)
class _Column:
    """Derivative (m, n) of the residual by the error of a column of readings or of a coordinate, weighted."""

    name: str
    direction: np.ndarray
    min_size: float

    @property
    def is_reading(self) -> bool:
        return self.name.startswith("q")


def random_errors(robot, recording, recorded: Fit) -> Suspicion | None:
    """The column whose random errors explain most of what the fit leaves, or None.

    recorded: fit of the data as they are.
    """
    if recorded.degrees < _LEAST_DEGREES:
        return None
    rows = even_rows(recording, _ROWS)
    chosen = recording.select(rows)
    fit = fit_recording(robot, chosen, steps=_STEPS)
    linear = LinearisedFit.at(robot, chosen, fit)
    columns = _columns(robot, chosen, fit, linear, good_scale(robot, recording))
    model = VarianceModel(linear)
    noises = {
        name: model.fit(column.direction)
        for name, column in columns.items()
        if model.quick_gain(column.direction) > 0
    }
    if not noises:
        return None
    ordered = sorted(noises, key=lambda name: -noises[name].log_likelihood)
    best = columns[ordered[0]]
    noise = noises[best.name]
    second = noises[ordered[1]].log_likelihood if len(ordered) > 1 else -np.inf
    if noise.log_likelihood - second < _CLEAR or noise.deviation < best.min_size:
        return None
    if not _is_better(model.undirected, noise, _REMAINING):
        return None
    functions = smooth_functions(chosen.joints, robot.prismatic)
    if best.is_reading:
        functions = np.vstack([functions, *sides_of(robot, recording, best.name)[:, rows]])
    smooth = model.with_columns(functions[:, None, :] * best.direction)
    rough = smooth.fit(best.direction)
    if not _is_better(smooth.undirected, rough, _REMAINING_NEXT_TO_SMOOTH):
        return None
    if rough.deviation < max(_RANDOM_SHARE * noise.deviation, best.min_size):
        return None
    return _suspicion(recording, best, rough.deviation, fit)


def _is_better(alone: DirectedNoise, noise: DirectedNoise, remaining: float) -> bool:
    gain = noise.log_likelihood - alone.log_likelihood
    return gain > _EVIDENCE and noise.isotropic < remaining * alone.isotropic


def smooth_functions(joints: np.ndarray, prismatic: np.ndarray) -> np.ndarray:
    """(K, n): a constant, a drift over the rows, and smooth functions of the readings of joints (n, J), rad or mm.

    They span what gravity, links and the first two harmonics of gears make of the error of a joint: sines and cosines
    of revolute joints, of sums and of twice a joint. A slide errs with its place, in up to two periods over its travel,
    and is a lever of what gravity makes. prismatic (J,): which joints slide.
    """
    n = len(joints)
    functions = [np.ones(n), np.linspace(-1.0, 1.0, n)]
    angles = joints[:, ~prismatic]
    places = [_place_in_travel(travel) for travel in joints[:, prismatic].T]
    for first in range(angles.shape[1]):
        functions += _sine_and_cosine(2 * angles[:, first])
        for last in range(first, angles.shape[1]):
            waves = _sine_and_cosine(angles[:, first : last + 1].sum(1))
            functions += [*waves, *(place * wave for place in places for wave in waves)]
    for place in places:
        functions.append(place)
        for half_periods in range(1, 5):
            functions += _sine_and_cosine(half_periods * np.pi / 2 * place)
    return np.array(functions)


def sides_of(robot, recording, column: str) -> np.ndarray:
    """(K, n), -1 to 1: from which side the joint of a column of readings came, as recorded and by its last move.

    Only the rows of the whole recording, and not some of them, are the moves of the arm.
    """
    joint = joint_number(column)
    covariates = bind(robot, recording).state.covariates
    names = (f"approach{joint}", last_side(joint))
    sides = [covariates[name] for name in names if name in covariates]
    return np.array([side for side in sides if len(side) == recording.n]).reshape(-1, recording.n)


def _sine_and_cosine(angle: np.ndarray) -> list[np.ndarray]:
    return [np.cos(angle), np.sin(angle)]


def _place_in_travel(travel: np.ndarray) -> np.ndarray:
    """(n,) places mm of a slide, as -1 to 1 over the travel that is recorded; 0 where it does not move."""
    half = np.ptp(travel) / 2
    return (travel - travel.min()) / half - 1 if half > 0 else np.zeros_like(travel)


def _columns(robot, recording, fit: Fit, linear, good: float) -> Mapping[str, _Column]:
    """Columns whose error moves the measured points."""
    columns = []
    for name, direction in zip(joint_columns(recording.columns), linear.readings):
        min_size = np.deg2rad(_LARGE_DEG) if name.endswith("_deg") else _LARGE_MM
        columns.append(_Column(name, direction, min_size))
    if set(POINT) <= set(recording.columns):
        residual = row_residual(robot, recording, fit)
        for name, added in _displacements(recording).items():
            moved = {point: recording.columns[point] + shift for point, shift in added.items()}
            changed = replace(recording, columns={**recording.columns, **moved})
            try:
                direction = (row_residual(robot, changed, fit) - residual) * linear.root
            except FAILURES:
                continue
            columns.append(_Column(name, direction, good))
    return {column.name: column for column in columns if np.abs(column.direction).max() > 0}


def _displacements(recording) -> Mapping[str, Mapping[str, np.ndarray]]:
    """1 mm of each coordinate, and of the distance from the origin of the measurements."""
    points = np.stack([recording.columns[name] for name in POINT])
    rays = points / np.maximum(np.linalg.norm(points, axis=0), 1e-9)
    single = {name: {name: np.ones(recording.n)} for name in POINT}
    return {**single, _RANGE: dict(zip(POINT, rays))}


def _suspicion(recording, column: _Column, deviation: float, fit: Fit) -> Suspicion:
    named = f"samples.csv of recording '{recording.name}'"
    if column.is_reading:
        unit = "deg" if column.name.endswith("_deg") else "mm"
        size = np.rad2deg(deviation) if unit == "deg" else deviation
        subject = f"column {column.name}"
        errors = f"errors of its readings, about {size:.2g} {unit} (standard deviation)"
        advice = (
            "check whether the controller logged the commanded instead of the measured angle of this joint, its "
            "encoder and coupling, and whether the arm stood still; then measure again"
        )
        cause = READINGS
    else:
        is_range = column.name == _RANGE
        subject = "distance from the origin" if is_range else f"column {column.name}"
        errors = f"errors of its values, about {deviation:.2g} mm (standard deviation)"
        advice = (
            "check this axis of the instrument and the export of its values; then measure again"
        )
        cause = COORDINATES
    return Suspicion(
        f"{named}, {subject}: what the fit leaves ({fit.scale:.2g} mm) lies along the motion of this column and "
        f"differs from pose to pose like noise, as of random {errors}; {advice}.",
        False,
        cause,
    )
