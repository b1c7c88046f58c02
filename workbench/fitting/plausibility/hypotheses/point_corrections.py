"""Mistakes in measured columns: units, signs and order of axes, left-handed frames, quaternions, inverse poses."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from datasets.samples.columns import POINT, QUATERNION
from workbench.fitting.plausibility.hypotheses.angle_corrections import angle_corrections
from workbench.fitting.plausibility.hypotheses.corrections import (
    Correction,
    axis_columns,
    column_correction,
    has_orientation,
    listed,
    lost_decimal_points,
    named_columns,
    point_columns,
)

LENGTH_UNITS = {
    10.0: "cm",
    25.4: "inches",
    304.8: "feet",
    1000.0: "m",
    0.1: "tenths of a mm",
    0.001: "um",
}
_FARTHEST_MM = 100_000.0


def point_corrections(recording) -> Iterator[Correction]:
    """Every single mistake of the measured columns."""
    lengths = point_columns(recording)
    yield from _units(recording, lengths)
    yield from lost_decimal_points(recording, lengths, _FARTHEST_MM)
    if set(POINT) <= set(recording.columns):
        yield from _axes(recording)
    if has_orientation(recording):
        yield from pose_corrections()
    if axis_columns(recording):
        yield from _measured_axis(recording)


def pose_corrections() -> Iterator[Correction]:
    """Every single mistake of measured orientations and of whole poses."""
    yield from _quaternions()
    yield _inverse_pose()
    yield from angle_corrections()


def _units(recording, lengths):
    for factor, unit in LENGTH_UNITS.items():
        if lengths:
            yield _unit(lengths, factor, unit)
        for name in lengths if len(lengths) > 1 else ():
            if np.abs(recording.columns[name]).max() * factor < _FARTHEST_MM:
                yield _unit([name], factor, unit)


def _unit(names, factor, unit) -> Correction:
    is_single = len(names) == 1
    return column_correction(
        "length-unit",
        named_columns(names),
        f"{'holds' if is_single else 'hold'} {unit}",
        f"multiply {'it' if is_single else 'them'} by {factor:g}, or correct the lengths of the robot file",
        lambda columns: {name: factor * columns[name] for name in names},
        names,
        magnification=factor,
    )


def _axes(recording):
    """Points without orientation only show that the frame is left-handed; with it, they show which axis is wrong."""
    if recording.measures in ("external-pose", "partial-pose"):
        for name in POINT:
            yield column_correction(
                "axis-sign",
                f"column {name}",
                "has the opposite sign",
                "negate it",
                lambda columns, name=name: {name: -columns[name]},
                POINT,
            )
        for a, b in combinations(POINT, 2):
            yield _swap(a, b)
        yield _left_handed_frame(recording)
        return
    yield column_correction(
        "left-handed",
        f"columns {listed(POINT)}",
        "are left-handed",
        "give one of them the opposite sign, or swap the two that are interchanged",
        lambda columns: {"x_mm": -columns["x_mm"]},
        POINT,
    )


def _swap(a, b) -> Correction:
    return column_correction(
        "axis-order",
        f"columns {a} and {b}",
        "are swapped",
        "swap them back",
        lambda columns: {a: columns[b], b: columns[a]},
        POINT,
    )


def _left_handed_frame(recording) -> Correction:
    """Position and orientation in a mirrored frame: z, and with it two components of the rotation, change sign.

    A mirrored frame differs from another mirrored one by a rotation, which base and tool absorb.
    """
    if has_orientation(recording):
        flipped = ("z_mm", "qx", "qy")
    else:
        flipped = ("z_mm", axis_columns(recording)[2])
    return column_correction(
        "left-handed",
        f"the measurements in columns {listed(POINT)} with their orientation",
        "are in a left-handed frame",
        f"negate {listed(flipped)}, or set the instrument to a right-handed frame",
        lambda columns: {name: -columns[name] for name in flipped},
        (*POINT, *flipped),
    )


def _quaternions():
    vector = QUATERNION[1:]
    yield column_correction(
        "inverse-rotation",
        f"columns {listed(QUATERNION)}",
        "hold the inverse rotation (a transposed matrix)",
        f"negate {listed(vector)}",
        lambda columns: {name: -columns[name] for name in vector},
        QUATERNION,
    )
    true = (*vector, "qw")
    yield column_correction(
        "quaternion-order",
        f"columns {listed(QUATERNION)}",
        "hold the quaternion in the order x, y, z, w",
        "put them in the order w, x, y, z",
        lambda columns: {name: columns[source] for name, source in zip(true, QUATERNION)},
        QUATERNION,
    )
    for names in (*combinations(vector, 1), *combinations(vector, 2)):
        yield _component_signs(names)


def _component_signs(names) -> Correction:
    """One or two components of the vector part with the opposite sign; all three are the inverse rotation."""
    return column_correction(
        "quaternion-sign",
        named_columns(names),
        f"{'have' if len(names) > 1 else 'has'} the opposite sign",
        f"multiply {'them' if len(names) > 1 else 'it'} by -1",
        lambda columns: {name: -columns[name] for name in names},
        QUATERNION,
    )


def _inverse_pose() -> Correction:
    names = (*POINT, *QUATERNION)
    return column_correction(
        "inverse-pose",
        f"columns {listed(names)}",
        "hold the inverse pose (external frame in the target frame)",
        "invert each pose",
        _inverted,
        names,
    )


def _inverted(columns):
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_quat(np.stack([columns[f"q{c}"] for c in "xyzw"], -1)).inv()
    points = -rotations.apply(np.stack([columns[name] for name in POINT], -1))
    quaternions = rotations.as_quat().T
    return dict(zip(POINT, points.T)) | {f"q{c}": row for c, row in zip("xyzw", quaternions)}


def _measured_axis(recording):
    names = axis_columns(recording)
    for name in names:
        yield column_correction(
            "axis-sign",
            f"column {name}",
            "has the opposite sign",
            "negate it",
            lambda columns, name=name: {name: -columns[name]},
            names,
        )
    for a, b in combinations(names, 2):
        yield column_correction(
            "axis-order",
            f"columns {a} and {b}",
            "are swapped",
            "swap them back",
            lambda columns, a=a, b=b: {a: columns[b], b: columns[a]},
            names,
        )
