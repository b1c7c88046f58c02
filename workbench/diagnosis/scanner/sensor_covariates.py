"""Covariates of the samples of a sensor, and the kind of sensor that they describe."""

from collections.abc import Mapping

import numpy as np

from workbench.diagnosis.scanner.sensor_library import Kind
from workbench.jobs.sensor.chains import Chains

_IDENTIFIERS = ("placement", "scan", "sample", "step")  # columns that only name an image


def kind_of_sensor(chains: Chains) -> Kind:
    """The parts of a scanner and the covariates that vary in its images."""
    columns: dict[str, list] = {}
    for name, chain in chains.parts.items():
        for column, values in chain.covariates.items():
            if column in _IDENTIFIERS or column == "mirror_deg":
                continue
            if name != "corners" or column not in ("sweep", "mirror_speed_deg_s"):
                columns.setdefault(column, []).append(values)
    varies = {c for c, arrays in columns.items() if np.ptp(np.concatenate(arrays)) > 0}
    mirror = chains.board_stripes is not None and chains.board_stripes.mirror is not None
    light = tuple(chains.board_stripes.mirror.point.tolist()) if mirror else None
    axis = tuple(chains.board_stripes.mirror.axis.tolist()) if mirror else None
    if chains.balls is None:
        balls = ()
    else:
        balls = tuple(sorted(set(chains.balls.number.tolist())))
    has_stripes = chains.board_stripes is not None
    times = _laser_column(chains, "time_s") if has_stripes else _times(chains.corners)
    lines = tuple(tuple(np.unique(np.round(row, 6)).tolist()) for row in chains.corners.points[:2])
    return Kind(
        has_stripes,
        mirror,
        balls,
        frozenset(varies),
        light,
        axis,
        spreads=_spreads(chains, varies),
        times=tuple(np.unique(times).tolist()),
        board_lines=lines,
        depth_mm=round(float(chains.corners.state.points[2].mean()), 1),
        line_along="columns" if has_stripes and chains.board_stripes.scan[1, 0] else "rows",
    )


def _times(corners) -> np.ndarray:
    """(n,) s when corners were seen; empty where that is not recorded."""
    return np.asarray(corners.covariates.get("time_s", ()), float)


def _laser_column(chains: Chains, name: str) -> np.ndarray:
    """(n,) a recorded column of all stripes; empty where some have none."""
    stripe_chains = [chain for part, chain in chains.parts.items() if part != "corners"]
    if not all(name in chain.covariates for chain in stripe_chains):
        return np.empty(0)
    return np.concatenate([chain.covariates[name] for chain in stripe_chains])


def _spreads(chains: Chains, varies) -> tuple[tuple[str, float], ...]:
    """Standard deviation of each recorded column that varies among the stripes."""
    if chains.board_stripes is None:
        return ()
    spreads = {name: _laser_column(chains, name) for name in sorted(varies)}
    return tuple((name, float(v.std())) for name, v in spreads.items() if v.size and v.std() > 0)


def join_covariates(tables: Mapping[str, Mapping], counts) -> dict[str, np.ndarray]:
    """(n,) every covariate of any part; in a part that does not have it the mean of the others."""
    names = sorted({name for part in tables.values() for name in part if name not in _IDENTIFIERS})
    joined = {}
    for name in names:
        known = np.concatenate([part[name] for part in tables.values() if name in part])
        middle = float(np.nan_to_num(known).mean())
        columns = []
        for part, count in zip(tables.values(), counts):
            columns.append(part.get(name, np.full(count, middle)))
        joined[name] = np.nan_to_num(np.concatenate(columns).astype(float))
    return joined


def join_described(tables: Mapping[str, Mapping], masks: Mapping[str, Mapping], counts) -> dict:
    """(n,) bool, by covariate: which samples have a value of their own, and not one that is filled in.

    tables: covariates of each part; masks: of each part, by covariate, the samples that have it, where not all do.
    """
    names = {name for part in tables.values() for name in part if name not in _IDENTIFIERS}
    joined = {}
    for name in names:
        of_parts = []
        for part, count in zip(tables, counts):
            is_known = np.full(count, name in tables[part])
            of_parts.append(is_known & masks[part].get(name, True))
        joined[name] = np.concatenate(of_parts)
    return joined


def split_covariates(covariates, counts, names) -> dict[str, dict]:
    """The covariates (n,) of all samples, by the names of the parts, with `counts` samples each."""
    edges = np.cumsum((0, *counts))
    return {
        part: {name: column[a:b] for name, column in covariates.items()}
        for part, a, b in zip(names, edges, edges[1:])
    }
