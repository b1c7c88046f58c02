"""Columns that may say which reflector each row measured: whole numbers, names or parts of names, in several rows.

A tool has one point for each reflector, so that a single point leaves a misfit as large as the reflectors are apart.
A column counts only where the points fit the robot with it and do not without it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.importers.mapping.columns.reflectors import REFLECTOR
from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.joined_tables.sessions import SESSION
from datasets.importers.mapping.label_parts import are_labels, with_recurring_part
from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from workbench.recordings.importing.interpretation.fits import CandidateFit


@dataclass(frozen=True)
class Labelled:
    """A mapping with a column of labels, the column, and its fit to the robot."""

    mapping: Mapping
    column: str
    fit: CandidateFit


def label_columns(table: RawTable, mapping: Mapping) -> list[str]:
    """Unused columns with few whole numbers or names, each in two rows or more; of equal divisions one."""
    if REFLECTOR in mapping.columns.values():
        return []
    headers = headers_of(table)
    found, divisions = [], set()
    for name in unused_columns(table, mapping):
        is_other = headers[name].unit is not None or headers[name].kind == "time"
        if is_other or name == SESSION:
            division = None
        else:
            division = _division(table.columns[name])
        if division is not None and division not in divisions:
            divisions.add(division)
            found.append(name)
    return found


def labelled(mapping: Mapping, name: str) -> Mapping:
    """The mapping with a column as the reflector of each row."""
    return replace(mapping, columns={**mapping.columns, name: REFLECTOR})


def best_labels(
    table: RawTable, mapping: Mapping, fit: Callable[[Mapping], CandidateFit | None]
) -> Labelled | None:
    """The column of labels with which the points fit the robot, where they do not without one; None for none.

    fit: the best fit of a mapping to the robot, None where there is none. None, too, where two columns fit about
    equally well.
    """
    names = label_columns(table, mapping)
    alone = fit(mapping) if names else None
    if not names or (alone is not None and alone.is_good):
        return None
    candidates = [labelled(mapping, name) for name in names]
    fits = [fit(candidate) for candidate in candidates]
    good = [place for place, fitted in enumerate(fits) if fitted is not None and fitted.is_good]
    good.sort(key=lambda place: fits[place].improbability)
    if not good or any(not fits[good[0]].clearly_beats(fits[place]) for place in good[1:]):
        return None
    best = good[0]
    if alone is not None and not fits[best].clearly_beats(alone):
        return None
    return Labelled(candidates[best], names[best], fits[best])


def label_sentence(table: RawTable, found: Labelled) -> str:
    """What the import assumes of the column, and what else its values may number."""
    cells = table.columns[found.column]
    labels = with_recurring_part(cells)
    count = len(set(labels.tolist()))
    part = "" if labels is cells else f" (of '{cells[0]}' the part '{_word(labels[0])}')"
    return (
        f"The column '{found.column}'{part} is read as the reflector of each row: with {count} points on the tool the "
        f"rows fit the robot ({found.fit.words}), with one point they do not. If its values number something else, "
        "such as set-ups between which target or instrument was moved, import each set-up by itself."
    )


def _word(label: float | str) -> str:
    return label if isinstance(label, str) else f"{label:g}"


def _division(cells: np.ndarray) -> tuple[int, ...] | None:
    """The label of each row as the place of its first occurrence; None for cells that are no labels."""
    if cells.dtype.kind == "f" and not (
        np.isfinite(cells).all() and (cells == cells.round()).all()
    ):
        return None
    values: Sequence = with_recurring_part(cells).tolist()
    if not are_labels(values):
        return None
    first = list(dict.fromkeys(values))
    return tuple(first.index(value) for value in values)
