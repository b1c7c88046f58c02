"""Every effect of a robot's catalogue at every place where it can sit and whose covariates are there.

An entry is one `Option`: what would join the model, its label, the family that it shares a prior
with, and what it would need that the recording does not hold. Nothing here looks at the residual.
"""

import re
from dataclasses import dataclass

import numpy as np

from robot_model.effects import CATALOGUE
from robot_model.effects.tilt import level_axes
from workbench.core.covariates import clock
from workbench.core.effect import Effect

# an order once and twice a turn is what eccentric gears and encoders make; more are rarer
_ORDERS = {1: 0.3, 2: 0.3, 3: 0.1, 4: 0.1}
GEAR_MASS = 0.2
_DRIFTS = (
    "evenly",
    "with one bend",
    "with two bends",
)  # by the order of the polynomial: few numbers show small drifts
_LOADED_NM, _MOVES_RAD = 0.02, 0.2
_SHORTEST_MM = (
    1.0  # a link without a length has nothing that bends; what its neighbours do is theirs
)
# shares of the largest torque over which a gap is pressed shut, and how likely each is beside the sharp one
_SEATED, _SOFT_MASS = (0.05, 0.1, 0.2), 0.3


@dataclass(frozen=True)
class Option:
    """An effect, how it is told from its variants, its family and share of it, and what is missing."""

    effect: Effect
    label: str
    family: str
    mass: float = 1.0
    missing: str = ""


def options(chain, elastic: bool) -> list[Option]:
    """All named candidates of a robot's chain; `elastic`: whether something in the model yields to load."""
    joints = [option for k in range(1, chain.robot.joints + 1) for option in _joint(chain, k)]
    return [*joints, *_base(chain, elastic), *_sensor(chain), *_time(chain)]


def _joint(chain, k):
    turns = not chain.slides(k)
    moves = np.ptp(chain.variables[k - 1]) > _MOVES_RAD
    if turns and moves:
        for order, mass in _ORDERS.items():
            yield _option(
                "transmission-harmonic", f"joint-{k}", f"order {order}", mass, order=float(order)
            )
        yield _option("axis-run-out", f"joint-{k}")
    for j in range(1, chain.robot.joints + 1):
        if j != k and np.ptp(chain.variables[j - 1]) > 0:
            yield _option("joint-coupling", f"joint-{k}", f"from joint {j}", joint=j)
    if _varies(chain, f"approach{k}"):
        yield _option("backlash", f"joint-{k}", "by the side of approach")
    yield from _warm(chain, k)
    if chain.state.robot.mass.any() or chain.state.payload.any():
        yield from _loaded(chain, k)


def _loaded(chain, k):
    torque = chain.state.torque[k - 1]
    if np.ptp(torque) > _LOADED_NM:
        yield _option("joint-compliance", f"joint-{k}")
        if torque.min() < 0 < torque.max():
            yield _option("backlash", f"joint-{k}", "seated by gravity", seat="gravity")
            for share in _SEATED:
                width = float(f"{share * np.abs(torque).max():.3g}")
                label = f"seated by gravity, softly within {width:g} N m"
                yield _option(
                    "backlash", f"joint-{k}", label, _SOFT_MASS, seat="gravity", width=width
                )
        if np.ptp(chain.state.self_torque[k - 1]) > _LOADED_NM and chain.state.payload.any():
            yield _option("link-self-weight", f"joint-{k}")
    has_length = np.hypot(*chain.robot.geometry[k - 1, 1:3]) > _SHORTEST_MM
    if has_length and np.ptp(chain.state.moment[k], axis=1).max() > _LOADED_NM:
        yield _option("link-compliance", f"link-{k}")
    if np.ptp(chain.state.bearing_moment[k - 1], axis=1).max() > _LOADED_NM:
        yield _option("bearing-compliance", f"joint-{k}")


def _warm(chain, k):
    joint, link = f"temperature_j{k}_c", f"temperature_link{k}_c"
    for effect, where, column in (
        ("joint-thermal-drift", f"joint-{k}", joint),
        ("link-thermal-growth", f"link-{k}", link),
    ):
        if effect == "link-thermal-growth" and not np.abs(chain.robot.geometry[k - 1, 1:3]).any():
            continue
        missing = (
            ""
            if any(name in chain.state.covariates for name in (column, "temperature_c"))
            else "temperature"
        )
        yield _option(effect, where, missing=missing)


def _base(chain, elastic):
    if np.ptp(chain.state.moment[0], axis=1).max() > _LOADED_NM:
        yield _option("pedestal-compliance", "base")
    time = clock(chain.state)
    if np.ptp(time) > 0:
        for order, word in enumerate(_DRIFTS, 1):
            yield _option(
                "base-drift",
                "base",
                word,
                start=float(time.min()),
                end=float(time.max()),
                order=order,
            )
    if elastic:
        yield _option("mount-tilt", "base")
        if np.ptp(chain.state.torque[0]) <= _LOADED_NM and (
            chain.state.robot.mass.any() or chain.state.payload.any()
        ):
            torsion = CATALOGUE["mount-tilt-torsion"]("base")
            yield Option(torsion, "where an upright joint 1 yields to it", "mount-tilt base")
    yield _option("tool-deflection", "tool")
    yield from _tilts(chain)


def _tilts(chain):
    """An accelerometer says how base or a link tilts, whichever it stands on."""
    names = [re.fullmatch(r"accel_(\w+)_[xyz]_m_s2", name) for name in chain.state.covariates]
    sensors = dict.fromkeys(found[1] for found in names if found)
    for sensor in sensors:
        axes = level_axes(chain.state.covariates, sensor)
        if axes is not None:
            for where in ("base", *(f"link-{k}" for k in range(1, chain.robot.joints + 1))):
                yield _option(
                    "measured-tilt",
                    where,
                    f"by the accelerometer of the {sensor}",
                    1 / len(sensors),
                    sensor=sensor,
                    axes=axes,
                )


def _sensor(chain):
    if chain.measurement.place != "sensor":
        return
    z = chain.state.measured[2]
    yield _option("range-scale", "sensor", z0=float(np.round(z.mean())))
    yield _option("field-bias", "sensor")
    balls = chain.numbers("ball")
    if len(balls) > 1:
        yield from (_option("ball-position", f"ball-{k}") for k in balls)
    known = any(
        name in chain.state.covariates for name in ("temperature_artefact_c", "temperature_c")
    )
    yield _option("artefact-expansion", "artefact", missing="" if known else "temperature")


def _time(chain):
    speeds = [
        f"qdot{k}_mm_s" if chain.slides(k) else f"qdot{k}_deg_s"
        for k in range(1, chain.robot.joints + 1)
    ]
    if all(name in chain.state.covariates for name in speeds):
        yield _option("time-offset", "time")
    if all(f"move{k}" in chain.state.covariates for k in range(1, chain.robot.joints + 1)):
        yield _option("reading-lag", "time", "read while braking", law="braking")
        yield _option("reading-lag", "time", "by a share of the move", law="share")


def _varies(chain, name):
    return np.ptp(chain.state.covariates.get(name, np.zeros(1))) > 0


def _option(effect, where, label="", mass=1.0, missing="", **given):
    made = CATALOGUE[effect](where, **given)
    return Option(made, label, f"{effect} {where}", mass, missing)
