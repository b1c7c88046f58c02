"""Values that cannot be right whatever the robot does: sigma, payload, temperature, time, number of poses."""

from collections.abc import Iterator

import numpy as np

from robot_model.system import geometry_free
from workbench.core.vocabulary import Covariate
from workbench.fitting.plausibility.fitting import reach_of
from workbench.fitting.plausibility.joint_columns.rounding import lattice_step
from workbench.fitting.plausibility.suspicion import Suspicion

_LEAST_SIGMA_MM = 2e-4
"""No instrument that follows a robot is better than 0.2 um."""
_PAYLOAD_KG_AT_1_M = 60.0
"""More than any arm of 1 m reach carries; the limit grows with the cube of the reach."""
_WARMEST_AMBIENT_C, _WARMEST_C = 55.0, 160.0
_LONGEST_STEP_S = 1200.0
_ROUNDING = 1.2
"""Times the stated noise: it contains that of rounding, and is itself stated with few digits."""


def stated_value_suspicions(robot, recording) -> Iterator[Suspicion]:
    """One suspicion for every stated value that is out of any plausible range."""
    for check in (_sigma, _payload, _temperature, _time, _poses, _rounded_points):
        yield from check(robot, recording)


def _column(recording, name) -> str:
    return f"samples.csv of recording '{recording.name}', column {name}"


def _sigma(robot, recording):
    sigma = recording.sigma
    if sigma is None or not 0 < np.median(sigma) < _LEAST_SIGMA_MM:
        return
    value = float(np.median(sigma))
    yield Suspicion(
        f"recording '{recording.name}', sigma_mm: expected the standard deviation of a coordinate in mm, found "
        f"{value:.2g} mm, finer than any instrument that follows a robot; it is {1000 * value:.2g} mm if the number "
        "is in m; correct it, or leave it out if it is unknown.",
        False,
        "sigma",
    )


def _payload(robot, recording):
    payload = recording.columns.get("payload_kg")
    if payload is None:
        return
    limit = _PAYLOAD_KG_AT_1_M * max(reach_of(robot, recording) / 1000, 0.5) ** 3
    if payload.min() < 0:
        row = int(np.argmin(payload))
        yield Suspicion(
            f"{_column(recording, 'payload_kg')}: expected masses in kg that are not negative, found "
            f"{payload[row]:.4g} at sample {recording.sample_ids[row]}; correct the sign.",
            True,
            "payload",
        )
    elif payload.max() > limit:
        yield Suspicion(
            f"{_column(recording, 'payload_kg')}: expected masses in kg that this arm can carry (below about "
            f"{limit:.0f} kg), found up to {payload.max():.4g}; compliance would be estimated too small by the same "
            "factor; if the column holds grams, divide it by 1000.",
            False,
            "payload",
        )


def _temperature(robot, recording):
    for name, values in recording.columns.items():
        if Covariate.of(name).kind != "temperature":
            continue
        limit = _WARMEST_AMBIENT_C if name == "temperature_c" else _WARMEST_C
        if np.median(values) > limit:
            yield Suspicion(
                f"{_column(recording, name)}: expected degrees Celsius, found a median of {np.median(values):.4g}; "
                f"that is {(np.median(values) - 32) / 1.8:.3g} C if the column holds degrees Fahrenheit; convert it.",
                False,
                "temperature",
            )


def _time(robot, recording):
    time = recording.columns.get("time_s")
    if time is None or recording.n < 3:
        return
    steps = np.diff(np.unique(time))
    if len(steps) and np.median(steps) > _LONGEST_STEP_S:
        yield Suspicion(
            f"{_column(recording, 'time_s')}: expected seconds, found a median step of {np.median(steps):.4g} between "
            f"samples ({np.ptp(time) / 86400:.3g} days in all); divide by 1000 if the column holds milliseconds.",
            False,
            "time",
        )


def _poses(robot, recording):
    poses = len(np.unique(recording.poses))
    a_pose = {"external-pose": 6, "partial-pose": 5, "external-point": 3, "ball-centre": 3}.get(
        recording.measures
    )
    if a_pose is None:
        return
    if recording.measures == "external-point":
        reflectors = len(np.unique(recording.reflector))
    else:
        reflectors = 1
    known = min(a_pose * reflectors, 6) * poses
    unknown = 6 + len(geometry_free(robot)) + (3 * reflectors if a_pose == 3 else 6)
    if known < 1.25 * unknown:
        yield Suspicion(
            f"samples.csv of recording '{recording.name}': {poses} distinct poses give {known} independent "
            f"coordinates for {unknown} unknowns of base, tool and geometry: too few poses to determine and check "
            f"them; measure at least {int(np.ceil(2 * unknown / min(a_pose * reflectors, 6)))} poses.",
            False,
            "few-poses",
        )


def _rounded_points(robot, recording):
    sigma = recording.sigma
    for name in ("x_mm", "y_mm", "z_mm"):
        if sigma is None or name not in recording.columns:
            return
        step = lattice_step(recording.columns[name])
        if step / np.sqrt(12) > _ROUNDING * np.median(sigma):
            yield Suspicion(
                f"{_column(recording, name)}: all values are multiples of {step:g} mm, so that rounding alone has a "
                f"standard deviation of {step / np.sqrt(12):.2g} mm, but sigma_mm is {np.median(sigma):.2g}; export "
                "the column with all digits, or state the larger sigma_mm.",
                False,
                "rounding",
            )
