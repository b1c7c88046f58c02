"""Unused columns of a proposed mapping that look like a quantity: sentences for the person who completes it."""

from collections.abc import Iterable

import numpy as np

from datasets.importers.mapping.columns.sets import find_sets, headers_of
from datasets.importers.mapping.columns.stems import columns_by_stem
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable

_FEWEST = 3
_UNIT_LENGTH = 1e-2  # a vector of two decimals misses one by 0.005 sqrt(3) at most
_ROTATIONS = ("angles", "quaternion", "vector", "matrix")


def left_out_sentences(table: RawTable, mapping: Mapping, has_images: bool) -> tuple[str, ...]:
    """Sentences on a pose without a rotation, and on unused columns that look like components of one quantity.

    has_images: the source holds images of a board, which need poses of the flange.
    """
    unused = unused_columns(table, mapping)
    sentences = []
    if mapping.flange_point is not None and mapping.flange_rotation is None:
        names = ", ".join(mapping.flange_point.columns)
        need = "a hand-eye calibration" if has_images else "a pose of the flange"
        sentences.append(
            f"The position of the flange ({names}) has no rotation, which {need} needs: no header names one. Add "
            '[flange_rotation] columns = ["...", "...", "..."] to the mapping.'
        )
    axes = unit_vectors(table, unused) if mapping.axis is None else []
    for names in axes:
        quoted = ", ".join(f'"{name}"' for name in names)
        sentences.append(
            f"The columns {_quoted(names)} are components of a unit vector in every row and are not used. If they "
            f"are a measured axis of the target, add [axis] columns = [{quoted}] to the mapping."
        )
    for names in similar_columns(
        table, [column for column in unused if not any(column in a for a in axes)]
    ):
        sentences.append(
            f"The columns {_quoted(names)} {_reason(table, names)} and are not used. If they are a point, a "
            "rotation or joint readings of the recording, add them to the mapping under [point], [rotation], "
            "[flange_rotation] or [joints]."
        )
    return tuple(sentences)


def unused_rotation_sentences(table: RawTable, mapping: Mapping) -> tuple[str, ...]:
    """A sentence on each rotation that a mapping without one leaves out; commanded ones excepted."""
    if mapping.rotation is not None or mapping.flange_rotation is not None:
        return ()
    unused = set(unused_columns(table, mapping))
    return tuple(
        f"The columns {_quoted(column_set.names)} are a rotation by their headers and are not used: state whose it is "
        "with [rotation] or [flange_rotation] in a mapping file for --map, or ignore them."
        for column_set in find_sets(table)
        if column_set.kind in _ROTATIONS
        and not column_set.is_nominal
        and unused >= set(column_set.names)
    )


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _reason(table: RawTable, names: Iterable[str]) -> str:
    """Why columns may be left out, as far as their headers say."""
    headers = headers_of(table)
    if any(headers[name].is_nominal for name in names):
        return "have headers of commanded values"
    if any(headers[name].is_deviation for name in names):
        return "have headers of differences, spreads, speeds or loads"
    return "look like components of one quantity"


def unused_columns(table: RawTable, mapping: Mapping) -> tuple[str, ...]:
    """Columns that no quantity of a mapping is read from."""
    used = set(mapping.columns)
    for name in ("joints", "point", "rotation", "axis", "flange_point", "flange_rotation"):
        group = getattr(mapping, name)
        used |= set(group.columns) if group is not None else set()
    return tuple(name for name in table.columns if name not in used)


def unit_vectors(table: RawTable, names: Iterable[str]) -> list[tuple[str, ...]]:
    """Triples of neighbouring columns of numbers that are unit vectors, to the digits of a table, in every row."""
    found: list[tuple[str, ...]] = []
    numbers = [name for name in names if table.columns[name].dtype.kind == "f"]
    for triple in zip(numbers, numbers[1:], numbers[2:]):
        vectors = np.stack([table.columns[name] for name in triple])
        lengths = np.linalg.norm(vectors, axis=0)
        is_unit = len(lengths) >= _FEWEST and bool((np.abs(lengths - 1) < _UNIT_LENGTH).all())
        is_new = not any(set(triple) & set(other) for other in found)
        if is_unit and is_new and np.ptp(vectors, axis=1).max() > _UNIT_LENGTH:
            found.append(triple)
    return found


def similar_columns(table: RawTable, names: Iterable[str]) -> list[tuple[str, ...]]:
    """Three or more columns of numbers each, whose headers differ in one letter or number, as "Turn X", "Turn Y"."""
    numbers = [
        name
        for name in names
        if table.columns[name].dtype.kind == "f" and np.isfinite(table.columns[name]).any()
    ]
    by_stem = columns_by_stem(numbers)
    groups, taken = [], set()
    for group in sorted(by_stem.values(), key=len, reverse=True):
        left = tuple(name for name in group if name not in taken)
        if len(left) >= _FEWEST:
            groups.append(left)
            taken |= set(left)
    return groups
