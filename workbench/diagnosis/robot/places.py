"""Places of a robot for terms without a known law: smooth functions, growth of links, scans over one option."""

from itertools import combinations, product

import numpy as np

from robot_model.chain import link_lengths
from robot_model.effects import CATALOGUE
from robot_model.effects.instrument import sight_directions
from robot_model.effects.nonparametric import PeriodicMotion
from workbench.core.covariates import clock
from workbench.core.effect import Grid
from workbench.core.model import STATE_PORTS
from workbench.core.vocabulary import Covariate
from workbench.diagnosis.linear.candidates import Scan, Site
from workbench.diagnosis.robot.library import grids, scan_of

_TYPICAL = {"rad": 3e-4, "mm": 0.05}
"""Sizes of a disturbance before measuring: a shift, and the angle that moves a point 0.17 m away by as much."""
_FRAME = np.repeat([_TYPICAL["mm"], _TYPICAL["rad"]], 3)
"""Of the six components of a frame: its origin, and its rotation."""
_GROWTH = 1e-4
"""Growth of a link as a share of its length: that of steel by ten kelvin."""
# covariates that belong to one place, or stand here under another name
_SIGHT = ("sight_azimuth", "sight_elevation", "sight_range")
_SIGHT_SIZES = np.array([2e-5, 2e-5, 0.02])  # rad, rad, mm: errors of an instrument
_PARTICULAR = ("approach", "q", "qdot", "tau", "move", "seen", "down", "moment")
_ALSO_AS = ("row", "time_s", "payload_kg")


def scans(chain, rows, columns, elastic: bool) -> tuple[Scan, ...]:
    """Effects with one option on a fine grid (any instant, any order), and the floor going to and fro.

    rows: (port, components) -> (k, m, n) whitened derivatives of the residual; columns: effect -> (N, P) those by its
    parameters; elastic: whether the model holds a compliance.
    """
    all_grids = grids(CATALOGUE, chain, elastic)
    found = [_scan(grid, chain, rows, columns) for grid in all_grids]
    return (*found, *_periodic_base(chain, rows, _FRAME))


def _scan(grid: Grid, chain, rows, columns) -> Scan:
    """The grid with the derivatives of its component and its covariate."""
    effect = grid.make(grid.values[0])
    covariate = chain.state.covariates[grid.covariate]
    if effect.port in STATE_PORTS:  # its derivative is that of what deflects under the load
        rows_by_load = columns(grid.effect(grid.where), by_end=True)
        return scan_of(grid, rows_by_load.T.copy(), covariate)
    port_indices = grid.port_indices or effect.port_indices(chain)
    derivatives = rows(effect.port, port_indices)
    if grid.factor is not None and grid.factor.ndim == 3:
        derivatives = np.einsum("rkn,kmn->rmn", grid.factor, derivatives)
    elif grid.factor is not None:
        derivatives = derivatives * grid.factor[:, None]
    return scan_of(grid, _flat(derivatives), covariate)


def sites(chain, rows) -> tuple[Site, ...]:
    """Every place that may move, with the covariates that it may move with; rows as in `scans`."""
    covariates = chain.state.covariates
    general = tuple(c for c in covariates if np.ptp(covariates[c]) > 0 and _is_general(c))
    joints = chain.robot.joints
    angles = tuple(f"q{k}" for k in range(1, joints + 1) if np.ptp(covariates[f"q{k}"]) > 0)
    found = _joint_sites(chain, rows, angles, general)
    for place, loads in _loads(joints).items():
        frame_rows = rows("frame", chain.port_indices("frame", place))
        frame = _flat(frame_rows)
        varying = _varying(covariates, loads)
        names = tuple(dict.fromkeys((*angles, *varying, *general)))
        found.append(Site(place, "frame", frame, "mm and rad", _FRAME, names))
    if all(name in covariates for name in _SIGHT):
        directions = sight_directions(chain.state.measured)
        seen = np.einsum("kcn,cmn->kmn", directions, rows("sensor", [0, 1, 2]))
        description = (_flat(seen), "rad and mm", _SIGHT_SIZES, (*_SIGHT, *general), (_SIGHT[:2],))
        found.append(Site("instrument", "sensor", *description))
    if chain.measurement.place == "sensor":
        point = _flat(rows("sensor", [0, 1, 2]))
        names = ("seen_x", "seen_y", "seen_z", *general)
        found.append(Site("sensor", "sensor", point, "mm", _FRAME[:3], names))
    return tuple(found)


def _loads(joints: int) -> dict[str, tuple[str, ...]]:
    """Frame -> covariates of the load that it carries."""
    loads = {"base": ("moment_x", "moment_y"), "tool": ("down_x", "down_y", "down_z")}
    for k in range(1, joints + 1):
        moments = tuple(f"moment{k}_{axis}" for axis in "xyz")
        next_link = min(k + 1, joints)
        loads[f"link-{k}"] = (f"tau{k}", f"tau{next_link}", *moments)
    return loads


def _is_general(name: str) -> bool:
    """Whether a covariate belongs to no place and stands for itself."""
    return Covariate.of(name).kind not in _PARTICULAR and name not in (*_ALSO_AS, *_SIGHT)


def _joint_sites(chain, rows, angles, general) -> list[Site]:
    """The joints, each with the covariates that its angle may be wrong with."""
    covariates = chain.state.covariates
    found = []
    for k in range(1, chain.robot.joints + 1):
        named = (f"tau{k}", f"move{k}", f"approach{k}")
        of_joint = tuple(c for c in named if c in covariates and np.ptp(covariates[c]) > 0)
        sides = [c for c in of_joint if Covariate.of(c).kind != "tau"]
        of_reading = (f"q{k}", f"tau{k}")
        with_side = [c for c in of_reading if c in (*angles, *of_joint)]
        pairs = (*combinations(angles, 2), *product(with_side, sides))
        unit = "mm" if chain.slides(k) else "rad"
        joint_row = rows("joint", [k - 1])
        row = _flat(joint_row)
        typical = np.array([_TYPICAL[unit]])
        names = (*angles, *of_joint, *general)
        found.append(Site(f"joint-{k}", "joint", row, unit, typical, names, pairs))
    return found


def lengths(chain, rows) -> tuple[Site, ...]:
    """The growth of each link, as a share of its lengths."""
    found = []
    for k in range(1, chain.robot.joints + 1):
        port_indices, length = link_lengths(chain.robot, k)
        if length.any():
            geometry = rows("geometry", port_indices)
            row = np.einsum("k,kmn->mn", length, geometry)[None]
            found.append(Site(f"link-{k}", "geometry", _flat(row), "1", np.array([_GROWTH]), ()))
    return tuple(found)


def _varying(covariates, names):
    return tuple(name for name in names if np.ptp(covariates[name]) > 1e-9)


def _periodic_base(chain, rows, sizes) -> list[Scan]:
    """The base moving to and fro at any rate from twice in the recording to twice the samples' mean distance."""
    time = clock(chain.state)
    span = np.ptp(time)
    cycles = np.arange(2.0, chain.n / 4, 0.5)
    if span <= 0 or not len(cycles):
        return []
    units = ("mm", "mm", "mm", "rad", "rad", "rad")
    unit = PeriodicMotion("base", 1.0, units, sizes).option_unit(chain, "rate")

    def make(rate):
        return (PeriodicMotion("base", rate, units, tuple(sizes.tolist())),)

    flat = _flat(rows("frame", chain.port_indices("frame", "base")))
    return [
        Scan(
            "unknown",
            "base",
            "wave",
            flat,
            time,
            2 * np.pi * cycles / span,
            np.ones(len(cycles)),
            sizes,
            "",
            make,
            f"to and fro, {{:g}} {unit}",
            ("time",),
            option="rate",
        )
    ]


def _flat(rows):
    return rows.reshape(len(rows), -1)
