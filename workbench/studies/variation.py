"""Values of the varied parameters, computed block by block to limit the memory.

Points of the unit cube from scipy.stats.qmc, scaled to the range of each parameter. A Latin hypercube of more than
`BLOCK` runs consists of hypercubes of `BLOCK` runs each (replicated Latin hypercube sampling: Iman, Comput. Stat.
1981). A Sobol sequence is one sequence, advanced to the block.
"""

import warnings
from functools import lru_cache
from math import prod

import numpy as np

from workbench.core.errors import InputError
from workbench.studies.spec import Axis, Study, Vary, validated

BLOCK = 4096
_DESIGN = 0x5EED
"""Separates the random numbers of the design from those of the runs."""


def count(study: Study) -> int:
    """Number of runs. Raises InputError if it is missing or not possible."""
    return _points(study.vary) * study.vary.repeats


def _points(vary: Vary) -> int:
    if vary.method == "grid":
        return _grid(vary)
    if vary.runs is None:
        raise InputError(
            f"study, key vary.runs: expected the number of runs of {vary.method}, found none; add it"
        )
    if vary.method == "saltelli":
        return _saltelli_base(vary) * (len(vary.parameter) + 2)
    return vary.runs


def _grid(vary: Vary) -> int:
    total = prod(_levels(axis) for axis in vary.parameter)
    if vary.runs is not None and vary.runs != total:
        raise InputError(
            f"study, key vary.runs: expected {total}, the points of the grid, found {vary.runs}; omit it"
        )
    return total


def _levels(axis: Axis) -> int:
    if axis.values is None:
        return axis.levels
    return len(axis.values)


def _saltelli_base(vary: Vary) -> int:
    """N of SALib's N (D + 2) points: a power of two, which keeps Sobol's sequence balanced."""
    width = len(vary.parameter) + 2
    if width < 4:
        raise InputError(
            "study, key vary.parameter: expected at least two parameters for saltelli, found fewer; "
            "add one"
        )
    base = 2 ** max(int(np.log2(max(vary.runs / width, 1))), 3)
    if base * width != vary.runs:
        raise InputError(
            f"study, key vary.runs: expected {base * width} or another power of two times {width} for saltelli, "
            f"found {vary.runs}; correct it"
        )
    return base


def values_of(study: Study, run: int) -> dict[str, float | str | list]:
    """name -> value of each varied parameter in run 1, 2, ….  IndexError beyond the last run."""
    if not 1 <= run <= count(study):
        raise IndexError(run)
    place = (run - 1) // study.vary.repeats
    axes = study.vary.parameter
    if study.vary.method == "grid":
        if axes:
            index = np.unravel_index(place, [_levels(axis) for axis in axes])
        else:
            index = ()
        return {axis.name: _level(axis, int(k)) for axis, k in zip(axes, index)}
    unit = _cube(study.vary.method, len(axes), _points(study.vary), study.seed, place // BLOCK)[
        place % BLOCK
    ]
    return {axis.name: _scaled(axis, float(u)) for axis, u in zip(axes, unit)}


@lru_cache(maxsize=2)
def _cube(method: str, width: int, points: int, seed: int, block: int) -> np.ndarray:
    """(up to BLOCK, width) points of the unit cube: those of one block."""
    from scipy.stats import qmc

    rows = min(BLOCK, points - block * BLOCK)
    rng = np.random.default_rng([seed, _DESIGN, 0 if method in ("sobol", "saltelli") else block])
    if not width:
        return np.empty((rows, 0))
    if method == "random":
        return rng.random((rows, width))
    if method == "latin-hypercube":
        return qmc.LatinHypercube(width, rng=rng).random(rows)
    if method == "saltelli":
        return _saltelli(width, points // (width + 2), seed)[block * BLOCK : block * BLOCK + rows]
    sequence = qmc.Sobol(width, rng=rng)
    with warnings.catch_warnings(
        action="ignore"
    ):  # warning on counts that are not powers of two: only the last block can be one
        if block:
            return sequence.fast_forward(block * BLOCK).random(rows)
        return sequence.random(rows)


@lru_cache(maxsize=1)
def _saltelli(width: int, base: int, seed: int) -> np.ndarray:
    """(base (width + 2), width): Saltelli's scheme for SALib's Sobol indices."""
    from SALib.sample import sobol

    return sobol.sample(problem(width), base, calc_second_order=False, seed=seed)


def problem(width: int) -> dict:
    """SALib's problem definition for `width` parameters from 0 to 1."""
    return {
        "num_vars": width,
        "names": [f"x{k}" for k in range(width)],
        "bounds": [[0.0, 1.0]] * width,
    }


def unit_of(axis: Axis, values: np.ndarray) -> np.ndarray:
    """(n,) positions of a parameter's values in the unit interval; the inverse of `_scaled`."""
    if axis.values is not None:
        index = [axis.values.index(value) for value in values.tolist()]
        return (np.array(index) + 0.5) / len(axis.values)
    scale = np.log if axis.scale == "log" else np.asarray
    return (scale(values) - scale(axis.low)) / (scale(axis.high) - scale(axis.low))


def _level(axis: Axis, k: int):
    if axis.values is not None:
        return axis.values[k]
    return _scaled(axis, k / (axis.levels - 1))


def _scaled(axis: Axis, u: float):
    if axis.values is not None:
        return axis.values[min(int(u * len(axis.values)), len(axis.values) - 1)]
    if axis.scale == "log":
        return float(axis.low * (axis.high / axis.low) ** u)
    return float(axis.low + (axis.high - axis.low) * u)


def ends(axis: Axis) -> list:
    """Values at which a study is validated: both ends, or all listed values."""
    if axis.values is None:
        return [axis.low, axis.high]
    return list(axis.values)


def with_values(study: Study, values: dict) -> Study:
    """The study with the parameters of one run. Raises InputError for an unknown path or an invalid value."""
    keys = study.model_dump()
    for axis in study.vary.parameter:
        if axis.name in values:
            for path in axis.paths:
                _set(keys, path, values[axis.name], axis.name)
    return validated(Study, keys, "study")


def _set(keys: dict, path: str, value, name: str) -> None:
    """Set the value at a path such as `scene.effect.2.values.compliance`; tables of a list are numbered from 1."""
    *way, last = path.split(".")
    place = keys
    for part in way:
        place = _element(place, part, path, name)
    if isinstance(place, list):
        _element(place, last, path, name)
        place[int(last) - 1] = value
    elif isinstance(place, dict):
        place[last] = value
    else:
        raise _nowhere(path, name, last)


def _element(place, part, path, name):
    if isinstance(place, list) and part.isdecimal() and 1 <= int(part) <= len(place):
        return place[int(part) - 1]
    if isinstance(place, dict):
        if place.get(part) is None:
            place[part] = {}
        return place[part]
    raise _nowhere(path, name, part)


def _nowhere(path, name, part):
    return InputError(
        f"study, parameter {name}, key path: expected keys of the study or its scene, found no "
        f"'{part}' in '{path}'; correct it (tables of a list are numbered from 1)"
    )
