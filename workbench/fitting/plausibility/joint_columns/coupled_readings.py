"""Couplings of joint readings with any ratio, as of the gears of a wrist, that the robot file lacks or states wrongly.

The ratio by which an earlier joint moves a later one is a regression coefficient, next to base, tool and plausible
geometry errors. It is estimated at the robust fit; where that is far off, also at the ratios of a grid that leave the
smallest misfit of the nominal arm. Of a wrist, two couplings may be missing at once: the second is searched with the
first one applied.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from workbench.fitting.plausibility.fitting import (
    FAILURES,
    Fit,
    fit_recording,
    nominal_scale,
    nominal_scales,
)
from workbench.fitting.plausibility.hypotheses.corrections import Correction, join
from workbench.fitting.plausibility.hypotheses.coupling_corrections import coupling_correction
from workbench.fitting.plausibility.linearised_fit import LinearisedFit
from workbench.fitting.plausibility.sampling import even_rows
from workbench.fitting.plausibility.search import Explanation

_ROWS, _SCREEN_ROWS, _STEPS, _ROUNDS = 240, 50, 60, 8
_SWEEPS = 3
_MOST_COUPLINGS = 2  # of a wrist with three axes
_GRID = np.arange(-2.0, 2.01, 0.25)
_REFINED = 3  # places that are fitted
_LOWER = 0.7  # share of the misfit at which a grid point is worth a fit, and that a coupling has to reach
_SIGNIFICANT = 6.0  # standard deviations
_SETTLED = 0.1  # standard deviations
_LEAST_RATIO = 0.004  # from the stated ratio and from whole ones: gears have fewer than 250 teeth
_DEFLECTION_RAD = 0.01  # by which no gear and no gravity moves a joint


@dataclass(frozen=True)
class _Ratio:
    """Joint and other joint (indices), their ratio with its standard deviation, and the fit with it."""

    place: tuple[int, int]
    value: float
    std: float
    fit: Fit


def coupled_readings(robot, recording, is_far: bool) -> list[Explanation]:
    """One coupling, and then two, that explain part of the misfit, each fitted; is_far: the recording does not fit."""
    if robot.mixing.shape != (robot.joints,) * 2:
        return []  # mimic joints of a URDF state their couplings
    chosen = recording.select(even_rows(recording, _ROWS))
    found, ratios = [], []
    for _ in range(_MOST_COUPLINGS):
        try:
            best = _best_ratio(_with_ratios(robot, ratios), chosen, is_far)
        except FAILURES:
            break
        if best is None:
            break
        ratios = _refined_jointly(robot, chosen, [*ratios, best])
        if len(ratios) > 1 or not best.value.is_integer():
            corrections = [_correction(robot, ratio) for ratio in ratios]
            found.append(Explanation(join(corrections), ratios[-1].fit))
    return found


def _refined_jointly(robot, recording, ratios: list[_Ratio]) -> list[_Ratio]:
    """The ratios estimated in turn, each next to the others; the last one holds the fit with all."""
    for _ in range(_SWEEPS if len(ratios) > 1 else 0):
        for k in range(len(ratios)):
            others = _with_ratios(robot, ratios[:k] + ratios[k + 1 :])
            refined = _refined(others, recording, ratios[k].place, ratios[k].value)
            ratios = [*ratios[:k], refined or ratios[k], *ratios[k + 1 :]]
    return ratios


def _with_ratios(robot, ratios: list[_Ratio]):
    for ratio in ratios:
        robot = _with_ratio(robot, ratio.place, ratio.value)
    return robot


def _correction(robot, found: _Ratio) -> Correction:
    digits = max(int(np.ceil(-np.log10(max(found.std, 1e-6)))) + 1, 0)
    return coupling_correction(robot, found.place, round(found.value, digits))


def _with_ratio(robot, place, ratio: float):
    mixing = robot.mixing.copy()
    mixing[place] = ratio
    return replace(robot, mixing=mixing)


def _places(robot) -> Iterator[tuple[int, int]]:
    """Later and earlier revolute joint; of a joint that is coupled already, that coupling alone."""
    revolute = np.flatnonzero(~robot.prismatic)
    for joint in revolute:
        coupled = [k for k in np.flatnonzero(robot.mixing[joint]) if k != joint]
        for other in revolute[revolute < joint]:
            if not coupled or coupled == [other]:
                yield int(joint), int(other)


def _best_ratio(robot, recording, is_far: bool) -> _Ratio | None:
    """The significant ratio that leaves the smallest misfit, far below that without it; None where there is none."""
    fit = fit_recording(robot, recording, steps=_STEPS)
    starts = _clear_changes(robot, recording, fit)
    if is_far:
        starts += _grid_points(robot, recording)
    refined = [_refined(robot, recording, place, ratio) for place, ratio in starts]
    found = [
        candidate
        for candidate in refined
        if candidate is not None and candidate.fit.scale < _LOWER * fit.scale
    ]
    return min(found, key=lambda candidate: candidate.fit.scale, default=None)


def _clear_changes(robot, recording, fit: Fit) -> list[tuple[tuple[int, int], float]]:
    """Places and ratios of the most significant changes, linearised at a fit."""
    linear = LinearisedFit.at(robot, recording, fit)
    found = []
    for place in _places(robot):
        estimate = _change(linear, recording, place)
        if estimate is not None and abs(estimate[0]) > _SIGNIFICANT * estimate[1]:
            found.append((abs(estimate[0]) / estimate[1], place, robot.mixing[place] + estimate[0]))
    return [(place, ratio) for _, place, ratio in sorted(found, reverse=True)[:_REFINED]]


def _grid_points(robot, recording) -> list[tuple[tuple[int, int], float]]:
    """The best ratio of each place by the nominal arm's misfit, of the places with the smallest ones."""
    rows = recording.select(even_rows(recording, _SCREEN_ROWS))
    cases = [(place, ratio) for place in _places(robot) for ratio in _GRID]
    scales = nominal_scales([(_with_ratio(robot, *case), rows) for case in cases])
    limit = _LOWER * nominal_scale(robot, rows)
    best = {}
    for scale, (place, ratio) in zip(scales, cases):
        if scale < min(limit, best.get(place, (np.inf, 0.0))[0]):
            best[place] = scale, float(ratio)
    ordered = sorted(best.items(), key=lambda item: item[1][0])
    return [(place, ratio) for place, (_, ratio) in ordered[:_REFINED]]


def _refined(robot, recording, place, ratio: float) -> _Ratio | None:
    """The ratio at the fit with it; None where it is no more than the deflection of a joint, or does not converge."""
    stated = robot.mixing[place]
    for _ in range(_ROUNDS):
        arm = _with_ratio(robot, place, ratio)
        try:
            fit = fit_recording(arm, recording, steps=_STEPS)
            estimate = _change(LinearisedFit.at(arm, recording, fit), recording, place)
        except FAILURES:
            return None
        if estimate is None or not abs(ratio) < 2 * _GRID.max():
            return None
        change, std = estimate
        if abs(change) < _SETTLED * std:
            break
        ratio += change
    if abs(ratio - stated) < max(_LEAST_RATIO, _SIGNIFICANT * std):
        return None
    if abs(ratio - round(ratio)) < _LEAST_RATIO:
        ratio = float(round(ratio))
    if _is_deflection(robot, recording, place, ratio - stated):
        return None
    return _Ratio(place, ratio, std, fit)


def _change(linear: LinearisedFit, recording, place) -> tuple[float, float] | None:
    """Change of a ratio and its standard deviation; None where base, tool and geometry make the same errors."""
    joint, other = place
    reading = recording.joints[:, other]
    solved = linear.solved(linear.joints[joint], (reading - reading.mean())[None])
    if solved is None:
        return None
    change, precision = solved
    return float(change[0]), float(precision[0, 0] ** -0.5)


def _is_deflection(robot, recording, place, change: float) -> bool:
    """Whether gravity or a gear could move the joint as far, and by the same law over the angles that were recorded.

    Deflection under gravity is a sinusoid of the joint's own angle and of its sum with that of the earlier joint.
    """
    joint, other = place
    law = change * (recording.joints[:, other] - recording.joints[:, other].mean())
    if np.abs(law).max() > _DEFLECTION_RAD:
        return False
    joint_angle = robot.mixing[joint] @ recording.joints.T
    waves = [np.ones_like(joint_angle)]
    for angle in (
        recording.joints[:, other],
        joint_angle,
        joint_angle + recording.joints[:, other],
    ):
        waves += [np.cos(angle), np.sin(angle)]
    columns = np.stack(waves).T
    remainder = law - columns @ np.linalg.lstsq(columns, law, rcond=1e-9)[0]
    return bool((remainder**2).sum() < 0.1 * (law**2).sum())
