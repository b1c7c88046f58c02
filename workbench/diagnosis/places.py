"""Where a robot's model may be wrong without a law being known: places, growth of links, scans over one number."""

from dataclasses import replace

import numpy as np

from robot_model.effects import CATALOGUE
from workbench.core.covariates import clock
from workbench.core.effect import Effect
from workbench.diagnosis.library import GEAR_MASS
from workbench.diagnosis.problem import Scan, Site
from workbench.diagnosis.rivals import Wave

_TYPICAL = {"rad": 3e-4, "mm": 0.05}
_FRAME = np.array([0.05, 0.05, 0.05, 3e-4, 3e-4, 3e-4])
_GROWTH = 1e-4  # of a link's length, ten kelvin
_LONGEST_GEAR, _HALVES, _HALF_MASS = 200.0, 40.0, 0.2
# covariates that belong to one place, or stand here under another name
_PARTICULAR = ("approach", "q", "tau", "move", "seen", "down", "moment", "time_s", "payload_kg")


def scans(chain, rows) -> tuple[Scan, ...]:
    """Slips at any instant and waves of any order at each joint, and the floor going to and fro.

    rows: (port, slots) -> (k, m, n) whitened derivatives of the residual.
    """
    time = clock(chain.state)
    instants = np.unique(time)
    between = (instants[1:] + instants[:-1]) / 2
    between = between[2:-2]
    made = [
        scan
        for k in range(1, chain.robot.joints + 1)
        for scan in _joint_scans(chain, rows, k, time, between)
    ]
    return (*made, *_floor(chain, rows, _FRAME))


def _joint_scans(chain, rows, k: int, time, between):
    """A slip at any instant, and waves of any order that gears have, at joint k."""
    where, slides = f"joint-{k}", chain.slides(k)
    row, size = (
        rows("joint", [k - 1]).reshape(1, -1),
        np.array([_TYPICAL["mm" if slides else "rad"]]),
    )
    if len(between):
        yield Scan(
            "zero-shift",
            where,
            "step",
            row,
            time,
            between,
            np.ones(len(between)),
            size,
            f"zero-shift {where}",
            _maker("zero-shift", where, "after"),
            "after {:g}",
        )
    span = np.ptp(chain.variables[k - 1])
    orders, mass = _orders(chain.robot.gear_ratio[k - 1])
    if span > 0.2 and not slides:
        yield Scan(
            "transmission-harmonic",
            where,
            "wave",
            row,
            chain.variables[k - 1],
            orders,
            GEAR_MASS * mass,
            size,
            f"transmission-harmonic {where}",
            _maker("transmission-harmonic", where, "order"),
            "order {:g}",
            together=True,
        )


def _orders(ratio: float) -> tuple[np.ndarray, np.ndarray]:
    """Orders (V,) that a gear may have and the prior of each: whole ones, halves of the low ones, the motor's turns.

    Half of the prior stands on the motor's turn and half turn where the robot's file states the ratio.
    """
    halves = np.arange(4.5, _HALVES, 1.0)
    orders = np.concatenate([np.arange(5.0, _LONGEST_GEAR + 1), halves])
    mass = np.concatenate([np.ones(len(orders) - len(halves)), np.full(len(halves), _HALF_MASS)])
    if np.isfinite(ratio):
        motor = np.abs(ratio) * np.array([1.0, 2.0])
        kept = ~np.isin(orders, motor)
        orders = np.concatenate([orders[kept], motor])
        mass = np.concatenate([mass[kept] / mass[kept].sum(), [0.5, 0.5]])
    order = np.argsort(orders)
    return orders[order], mass[order] / mass.sum()


def _maker(effect, where, option):
    def make(value: float) -> tuple[Effect, ...]:
        return (CATALOGUE[effect](where, **{option: float(value)}),)

    return make


def sites(chain, rows) -> tuple[Site, ...]:
    """Every place that may move, with the covariates that it may move with; rows as in `scans`."""
    own = chain.state.covariates
    general = tuple(
        c for c in own if c != "row" and np.ptp(own[c]) > 0 and not c.startswith(_PARTICULAR)
    )
    angles = tuple(f"q{k}" for k in range(1, chain.robot.joints + 1) if np.ptp(own[f"q{k}"]) > 0)
    made = _joint_sites(chain, rows, angles, general)
    turns = _FRAME
    more = {"base": ("moment_x", "moment_y"), "tool": ("down_x", "down_y", "down_z")}
    more |= {
        f"link-{k}": (
            f"tau{k}",
            f"tau{min(k + 1, chain.robot.joints)}",
            *(f"moment{k}_{c}" for c in "xyz"),
        )
        for k in range(1, chain.robot.joints + 1)
    }
    for place in more:
        made.append(
            Site(
                place,
                "frame",
                _flat(rows("frame", chain.slots("frame", place))),
                "mm and rad",
                turns,
                tuple(dict.fromkeys((*angles, *_varying(own, more[place]), *general))),
            )
        )
    if chain.measurement.place == "sensor":
        seen = ("seen_x", "seen_y", "seen_z")
        made.append(
            Site(
                "sensor",
                "sensor",
                _flat(rows("sensor", [0, 1, 2])),
                "mm",
                turns[:3],
                (*seen, *general),
            )
        )
    return tuple(made)


def _joint_sites(chain, rows, angles, general) -> list[Site]:
    """The joints, each with the covariates that its angle may be wrong with."""
    own = chain.state.covariates
    made = []
    for k in range(1, chain.robot.joints + 1):
        mine = tuple(
            c for c in (f"tau{k}", f"move{k}", f"approach{k}") if c in own and np.ptp(own[c]) > 0
        )
        pairs = tuple((a, b) for i, a in enumerate(angles) for b in angles[i + 1 :])
        sides = [c for c in mine if not c.startswith("tau")]
        pairs += tuple((a, b) for a in (f"q{k}", f"tau{k}") if a in (*angles, *mine) for b in sides)
        unit = "mm" if chain.slides(k) else "rad"
        made.append(
            Site(
                f"joint-{k}",
                "joint",
                _flat(rows("joint", [k - 1])),
                unit,
                np.array([_TYPICAL[unit]]),
                (*angles, *mine, *general),
                pairs,
            )
        )
        if f"q{k}" in angles:
            made.append(replace(made[-1], covariates=(f"q{k}",), pairs=(), sharp=True))
    return made


def lengths(chain, rows) -> tuple[Site, ...]:
    """The growth of each link, as a share of its lengths."""
    made = []
    for k in range(1, chain.robot.joints + 1):
        d, a = chain.robot.geometry[k - 1, 1:3]
        if abs(d) + abs(a) > 0:
            first = 5 * (k - 1)
            row = d * rows("geometry", [first + 1]) + a * rows("geometry", [first + 2])
            made.append(Site(f"link-{k}", "geometry", _flat(row), "1", np.array([_GROWTH]), ()))
    return tuple(made)


def _varying(covariates, names):
    return tuple(name for name in names if np.ptp(covariates[name]) > 1e-9)


def _floor(chain, rows, turns) -> list[Scan]:
    """The base moving to and fro at any rate from twice in the recording to twice the samples' mean distance."""
    time = clock(chain.state)
    span = np.ptp(time)
    cycles = np.arange(2.0, chain.n / 4, 0.5)
    if span <= 0 or not len(cycles):
        return []
    units = ("mm", "mm", "mm", "rad", "rad", "rad")

    def make(rate):
        return (Wave("base", rate, units, tuple(turns.tolist())),)

    flat = _flat(rows("frame", chain.slots("frame", "base")))
    return [
        Scan(
            "unknown",
            "base",
            "wave",
            flat,
            time,
            2 * np.pi * cycles / span,
            np.ones(len(cycles)),
            turns,
            "",
            make,
            "to and fro, {:g} rad a unit of time",
            ("time",),
        )
    ]


def _flat(rows):
    return rows.reshape(len(rows), -1)


__all__ = ["lengths", "scans", "sites"]
