"""Orientations from three angles that were read in another order than they were written."""

import warnings
from collections.abc import Iterator
from itertools import product

import numpy as np

from datasets.samples.columns import QUATERNION
from workbench.fitting.plausibility.hypotheses.corrections import (
    Correction,
    column_correction,
    listed,
)

_VECTOR_FIRST = (*QUATERNION[1:], "qw")
_FIXED = tuple("xyz xzy yxz yzx zxy zyx".split())
_MOVING = tuple(order.upper() for order in _FIXED)
"""Orders of rotations about fixed axes and about those of the moving frame, the first one first."""


def angle_corrections() -> Iterator[Correction]:
    """Every pair of orders of three rotations about different axes.

    Rotations about the axes of the moving frame are those about fixed axes in reverse, so that only one of the two
    orders takes both.
    """
    for read, written in product(_FIXED, (*_FIXED, *_MOVING)):
        if read == written:
            continue
        yield column_correction(
            "angle-order",
            f"columns {listed(QUATERNION)}",
            f"look made from angles that were read in the order {_named(read)} where {_named(written)} was meant",
            f"read the angles of the instrument as {_named(written)}",
            lambda columns, read=read, written=written: _read_again(columns, read, written),
            QUATERNION,
        )


def _read_again(columns, read: str, written: str) -> dict[str, np.ndarray]:
    """The quaternions of the same three angles in another order."""
    from scipy.spatial.transform import Rotation

    quaternions = np.stack([columns[name] for name in _VECTOR_FIRST], axis=-1)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", UserWarning
        )  # of gimbal lock: such a reading does not fit then
        angles = Rotation.from_quat(quaternions).as_euler(read)
    return dict(zip(_VECTOR_FIRST, Rotation.from_euler(written, angles).as_quat().T))


def _named(order: str) -> str:
    """As rotations are multiplied: fixed axes xyz are Rz Ry Rx."""
    letters = order if order.isupper() else order[::-1]
    return " ".join(f"R{letter.lower()}" for letter in letters)
