"""Rows that repeat an earlier row's joint readings and measured values exactly: one measurement written twice.

Such a row carries no information. Counted as a measurement of its own it makes the noise estimated from replicates
too small, and every standard deviation too small by the square root of the number of copies.
"""

from dataclasses import replace

import numpy as np

from datasets.samples.columns import AXES, MEASURED, OTHER, joint_columns

_TARGETS = ("ball", "reflector", "point", "sphere", "plane")
_NUMBERING = {"sample", "pose", "repeat", "pair", "row"}
_DECIMALS = 6
_SHOWN = 8
# replicates that scatter by less than this many steps of the last digit may agree by chance
_STEPS = 2.0


def without_duplicates(recording):
    """The recording with every measurement once, and a warning that names the rows that were left out."""
    first = first_of_equal_rows(recording)
    copies = np.flatnonzero(first != np.arange(recording.n))
    if not copies.size:
        return recording
    warning = duplicate_sentence(
        recording.name, recording.sample_ids[copies], recording.sample_ids[first[copies]]
    )
    kept = recording.select(np.flatnonzero(first == np.arange(recording.n)))
    return replace(kept, warnings=(*recording.warnings, warning))


def duplicate_sentence(name: str, copies: np.ndarray, originals: np.ndarray) -> str:
    """Sentence on duplicates: finding, consequence and action; copies and originals (k,) sample numbers."""
    pairs = [f"{copy} = {original}" for copy, original in zip(copies[:_SHOWN], originals[:_SHOWN])]
    remainder = f" and {len(copies) - _SHOWN} more" if len(copies) > _SHOWN else ""
    rows = "1 row repeats" if len(copies) == 1 else f"{len(copies)} rows repeat"
    return (
        f"samples.csv of recording '{name}': {rows} the joint readings and the measured values of an earlier row "
        f"exactly (sample {', '.join(pairs)}{remainder}); a copy is no further measurement and is counted once; remove "
        "these rows, or export the measurements again if they were repeated."
    )


def first_of_equal_rows(recording) -> np.ndarray:
    """(n,) index of the first row that each row is a copy of, its own index where it is none."""
    found = first_of_each_key(recording)
    row_numbers = np.arange(recording.n)
    if (found != row_numbers).any() and agree_by_rounding(recording, found):
        return row_numbers
    return found


def first_of_each_key(recording) -> np.ndarray:
    """(n,) index of the first row with the same `measurement_keys`."""
    keys = measurement_keys(recording)
    if not keys.size:
        return np.arange(recording.n)
    first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)[1:]
    return first[group.ravel()]


def measurement_keys(recording) -> np.ndarray:
    """(n, k) all that tells one measurement from another: readings, what was measured, and of which target.

    Where no coordinate is measured (touches of a point or plane) every column but the numbering counts, since the
    same target may well be touched twice in the same pose.
    """
    columns = recording.columns
    measured = [name for name in columns if name.removeprefix(OTHER) in MEASURED]
    if measured:
        labels = [name for name in columns if name.removeprefix(OTHER) in _TARGETS]
        names = [*_joints(columns), *measured, *labels]
    else:
        names = [
            name
            for name, column in columns.items()
            if name not in _NUMBERING and column.dtype.kind == "f"
        ]
    return (
        np.stack([columns[name] + 0.0 for name in names], 1)
        if names
        else np.empty((recording.n, 0))
    )


def agree_by_rounding(recording, first: np.ndarray) -> bool:
    """Whether measured values are rounded so coarsely that genuine replicates agree exactly now and then.

    Judged on the replicates of one pose and target that do differ: their scatter against the step of the last digit.
    """
    columns = recording.columns
    measured = [name for name in columns if name in MEASURED and not name.startswith(_DIRECTIONS)]
    distinct = first == np.arange(recording.n)
    labels = [columns[name][distinct] for name in _TARGETS if name in columns]
    keys = np.stack([*(columns[name][distinct] for name in _joints(columns)), *labels], 1)
    group = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    free = len(group) - (group.max(initial=-1) + 1)
    if free < 1 or not measured:
        return False
    for name in measured:
        values = columns[name][distinct]
        mean = (np.bincount(group, values) / np.bincount(group))[group]
        scatter = float(np.sqrt(((values - mean) ** 2).sum() / free))
        if scatter > _STEPS * _last_digit(values):
            return False
    return True


def row_hashes(keys: np.ndarray) -> np.ndarray:
    """(n,) 64-bit hashes of rows (n, k), equal for equal rows: Fibonacci hashing, column by column."""
    bits = np.ascontiguousarray(keys + 0.0).view(np.uint64)
    label = np.zeros(len(keys), np.uint64)
    with np.errstate(over="ignore"):
        for column in bits.T:
            label = (label ^ (column ^ column >> np.uint64(32))) * np.uint64(0x9E3779B97F4A7C15)
            label ^= label >> np.uint64(29)
    return label


_DIRECTIONS = tuple({name[0] for axis in AXES for name in axis} | {"q"})


def _last_digit(values: np.ndarray) -> float:
    """The step 10^-k that all values are multiples of, 10^-_DECIMALS where they have more digits."""
    for k in range(_DECIMALS):
        if np.abs(values - values.round(k)).max() < 1e-9 * max(np.abs(values).max(), 1.0):
            return 10.0**-k
    return 10.0**-_DECIMALS


def _joints(columns) -> list[str]:
    plain = joint_columns(columns)
    other = [
        name
        for name in columns
        if name.startswith(OTHER) and joint_columns([name.removeprefix(OTHER)])
    ]
    return [*plain, *other]
