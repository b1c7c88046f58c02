"""A correction: what one mistake did to a recording or its robot file, undone; and corrections joined."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product

import numpy as np

from datasets.recording import OTHER
from datasets.samples.columns import AXES, MEASURED, POINT, QUATERNION, joint_columns
from robot_model.measurements import second_ends

LABELS = ("ball", "reflector")
_MOST_DIGITS = 6


@dataclass(frozen=True)
class Correction:
    """One mistake undone.

    `cause`: the kind of mistake. `subject` and `statement` are parts of a sentence ("column q3_deg",
    "has the opposite sign"), `remedy` says what to do. `touches`: what it changes; corrections of
    disjoint sets can be joined. `apply(robot, recording)` returns both as they would be without the
    mistake. `mistake_count`: number of elementary mistakes; fewer are preferred. `magnification`: factor by
    which measured lengths grow. `pieces`: the single corrections that were joined, () for a single one.
    """

    cause: str
    subject: str
    statement: str
    remedy: str
    touches: frozenset[str]
    apply: Callable
    mistake_count: int = 1
    magnification: float = 1.0
    pieces: tuple["Correction", ...] = ()

    def comparable(self, scale: float) -> float:
        """A misfit (mm) in terms of the data as recorded: shorter lengths alone make every misfit smaller."""
        return scale * max(1.0, 1 / self.magnification)

    @property
    def claim(self) -> str:
        """Subject and statement."""
        return f"{self.subject} {self.statement}"


def column_correction(cause, subject, statement, remedy, change, touches, **options) -> Correction:
    """A correction by `change(columns)`, which returns the columns that differ; both ends of a pair are changed."""

    def apply(robot, recording):
        columns = {**recording.columns, **change(recording.columns)}
        if recording.measures == "distance" and OTHER + "sample" in recording.columns:
            other = change(dict(second_ends(recording).columns))
            columns |= {OTHER + name: column for name, column in other.items()}
        return robot, replace(recording, columns=columns)

    return Correction(cause, subject, statement, remedy, frozenset(touches), apply, **options)


def join(corrections: Iterable[Correction]) -> Correction:
    """Several corrections of disjoint columns as one."""
    corrections = tuple(piece for c in corrections for piece in (c.pieces or (c,)))
    if len(corrections) == 1:
        return corrections[0]

    def apply(robot, recording):
        return reduce(
            lambda pair, correction: correction.apply(*pair), corrections, (robot, recording)
        )

    return Correction(
        " and ".join(dict.fromkeys(c.cause for c in corrections)),
        corrections[0].subject,
        " and ".join([corrections[0].statement, *(c.claim for c in corrections[1:])]),
        "; ".join(f"{c.subject}: {c.remedy}" for c in corrections),
        frozenset().union(*(c.touches for c in corrections)),
        apply,
        sum(c.mistake_count for c in corrections),
        math.prod(c.magnification for c in corrections),
        corrections,
    )


def listed(words) -> str:
    """'a, b and c'."""
    *leading, last = map(str, words)
    if leading:
        return f"{', '.join(leading)} and {last}"
    return last


def named_columns(names) -> str:
    """'column a' or 'columns a and b'."""
    return f"column{'s' * (len(names) > 1)} {listed(names)}"


def observed_columns(recording) -> list[str]:
    """Measured columns and the labels of what was measured."""
    return [c for c in recording.columns if c in MEASURED or c in LABELS]


def point_columns(recording) -> list[str]:
    """x_mm, y_mm and z_mm, or length_mm, where the recording has them."""
    return [c for c in (*POINT, "length_mm") if c in recording.columns]


def axis_columns(recording) -> tuple[str, ...]:
    """The columns of a measured tool axis, or ()."""
    return next((names for names in AXES if names[0] in recording.columns), ())


def revolute_columns(recording) -> list[str]:
    """Joint columns in degrees."""
    return [c for c in joint_columns(recording.columns) if c.endswith("_deg")]


def has_orientation(recording) -> bool:
    """Whether quaternions are measured."""
    return set(QUATERNION) <= set(recording.columns) and recording.measures == "external-pose"


def lost_decimal_points(recording, names, largest: float) -> Iterator[Correction]:
    """Columns of whole numbers with a decimal point some digits from the right, as far as no value exceeds `largest`.

    The columns together, where all hold large whole numbers, and each by itself.
    """
    in_whole_column = [name for name in names if _is_too_large(recording.columns[name], largest)]
    groups = [(name,) for name in in_whole_column]
    groups += [tuple(in_whole_column)] if len(in_whole_column) > 1 else []
    for columns, digits in product(groups, range(1, _MOST_DIGITS + 1)):
        size = max(np.abs(recording.columns[name]).max() for name in columns) / 10.0**digits
        if size < largest:
            yield _decimal_point(columns, digits)


def _is_too_large(values: np.ndarray, largest: float) -> bool:
    return bool((values == np.round(values)).all() and np.abs(values).max() > largest)


def _decimal_point(names, digits: int) -> Correction:
    is_single = len(names) == 1
    return column_correction(
        "decimal-point",
        named_columns(names),
        f"{'has' if is_single else 'have'} lost {'its' if is_single else 'their'} decimal point",
        f"divide {'it' if is_single else 'them'} by {10**digits}",
        lambda columns: {name: columns[name] / 10.0**digits for name in names},
        names,
    )
