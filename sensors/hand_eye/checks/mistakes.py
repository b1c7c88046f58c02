"""Mistakes that are made when flange poses are written down, each with the poses as they read once it is undone."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, permutations, product

import numpy as np

from sensors.hand_eye.checks.nouns import BOARD_IMAGES, Nouns
from sensors.hand_eye.start import NO_ROTATION_RAD
from workbench.core.rigid import inverse, rotation_vector, transform

_EULER = tuple("xyz xzy yxz yzx zxy zyx XYZ XZY YXZ YZX ZXY ZYX".split())
_AXES = "xyz"


@dataclass(frozen=True)
class Reading:
    """Another reading of the recorded flange poses.

    `cause`: short name of the mistake. `symptom`: a clause on what the data look like. `do`: what to correct.
    `flange` (P, 4, 4) T_base_flange with the mistake undone, mm.
    """

    cause: str
    symptom: str
    do: str
    flange: np.ndarray


def pose_readings(flange: np.ndarray, nouns: Nouns = BOARD_IMAGES) -> Iterator[Reading]:
    """Every mistake that flange poses (P, 4, 4) may hold, the most frequent first."""
    rotation = flange[:, :3, :3]
    place = flange[:, :3, 3]
    yield Reading(
        "inverse",
        "the poses look inverted, T_flange_base given for T_base_flange, or the sensor and the "
        f"{nouns.target} have changed places (--kind)",
        "write T_base_flange, or name the other --kind",
        inverse(flange),
    )
    yield from _position_readings(rotation, place, nouns)
    yield from _order_readings(flange, nouns)
    if _rotates(rotation):  # orientations that never change say nothing of how they are written
        yield from _quaternion_readings(rotation, place)
        yield from _angle_readings(rotation, place)


def _rotates(rotation):
    relative = np.swapaxes(rotation[:1], 1, 2) @ rotation
    return np.linalg.norm(rotation_vector(relative), axis=1).max() > NO_ROTATION_RAD


def _position_readings(rotation, place, nouns: Nouns) -> Iterator[Reading]:
    mirror = np.diag([1.0, -1.0, 1.0])
    yield Reading(
        "mirrored",
        f"the flange frame (or the {nouns.mirrored}) looks mirrored, left-handed",
        f"convert positions and orientations to a right-handed frame, or undo {nouns.unmirror}",
        transform(mirror @ rotation @ mirror, place @ mirror),
    )
    for signs in product((1.0, -1.0), repeat=3):
        if signs != (1.0, 1.0, 1.0):
            names = _listed([f"flange_{a}_mm" for a, sign in zip(_AXES, signs) if sign < 0])
            yield Reading(
                "position-sign",
                f"the sign of {names} looks reversed",
                f"negate {names}",
                transform(rotation, place * signs),
            )
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            names = " ".join(_AXES[k] for k in order)
            yield Reading(
                "position-order",
                f"the position columns look exchanged: x y z hold {names}",
                "put the position columns in order",
                transform(rotation, place[:, np.argsort(order)]),
            )


def _order_readings(flange, nouns: Nouns) -> Iterator[Reading]:
    for step, neighbour in ((1, "before"), (-1, "after")):
        yield Reading(
            "shifted",
            f"the poses look shifted by one row: each {nouns.sample} has the pose of the {nouns.sample} {neighbour}",
            f"shift the rows back, and look for {nouns.a_sample} that was lost",
            np.roll(flange, -step, 0),
        )
    yield Reading(
        "reversed",
        f"the poses look listed in the opposite order of the {nouns.samples}",
        "reverse the rows",
        flange[::-1],
    )


def _quaternion_readings(rotation, place) -> Iterator[Reading]:
    from scipy.spatial.transform import Rotation

    recorded = Rotation.from_matrix(rotation).as_quat()  # x, y, z, w
    for cause, symptom, do, columns, signs in _quaternion_mistakes():
        true = Rotation.from_quat(recorded[:, columns] * signs).as_matrix()
        yield Reading(cause, f"flange_qw … flange_qz {symptom}", do, transform(true, place))


def _quaternion_mistakes():
    """Cause, words, advice, and which recorded number is which true one of x, y, z, w, with its sign."""
    same = [0, 1, 2, 3]
    order = "quaternion-order"
    yield (
        order,
        "look written in the order x, y, z, w",
        "write the scalar part first",
        [3, 0, 1, 2],
        1,
    )
    yield (
        order,
        "look written in an order with the scalar part in flange_qx",
        "put the scalar part into flange_qw",
        [1, 2, 3, 0],
        1,
    )
    symptom = "look inverted (the rotation of the base in the flange)"
    do = "negate flange_qx, flange_qy and flange_qz"
    yield "inverse-rotation", symptom, do, same, (-1, -1, -1, 1)
    for signs in product((1, -1), repeat=3):
        if signs not in ((1, 1, 1), (-1, -1, -1)):
            names = _listed([f"flange_q{a}" for a, sign in zip(_AXES, signs) if sign < 0])
            symptom = f"look as if {names} had the opposite sign"
            yield "quaternion-sign", symptom, f"negate {names}", same, (*signs, 1)


def _angle_readings(rotation, place) -> Iterator[Reading]:
    """Angles in another order, in another unit, or a rotation vector taken for angles."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(rotation).as_rotvec()
    with warnings.catch_warnings():
        # Of gimbal lock: such a reading does not fit then.
        warnings.simplefilter("ignore", UserWarning)
        angles = {order: Rotation.from_matrix(rotation).as_euler(order) for order in _EULER}
    mistakes = chain(_vector_mistakes(vector, angles), _order_mistakes(angles))
    for cause, symptom, do, true in mistakes:
        yield Reading(cause, symptom, do, transform(true.as_matrix(), place))


def _vector_mistakes(vector, angles):
    """Cause, words, advice and true rotations where a rotation vector, or a unit, was misread."""
    from scipy.spatial.transform import Rotation

    convert = "convert the orientation from the angles as the controller gave them"
    as_vector = "read the three numbers as a rotation vector"
    symptom = f"a rotation vector looks read as angles ({_named('xyz')})"
    yield "angle-order", symptom, as_vector, Rotation.from_rotvec(_shorter(angles["xyz"]))
    symptom = "the rotation vectors look like radians given for degrees"
    yield "angle-unit", symptom, convert, Rotation.from_rotvec(np.degrees(vector))
    for order, values in angles.items():
        name = _named(order)
        symptom = f"the angles look like radians given for degrees ({name})"
        yield "angle-unit", symptom, convert, Rotation.from_euler(order, np.degrees(values))
        symptom = f"a rotation vector looks read as angles ({name})"
        yield "angle-order", symptom, as_vector, Rotation.from_rotvec(values)
        symptom = f"angles ({name}) look read as a rotation vector"
        yield "angle-order", symptom, f"read them as {name}", Rotation.from_euler(order, vector)


def _order_mistakes(angles):
    """The same for angles that were read in another order than they were written."""
    from scipy.spatial.transform import Rotation

    for read, written in permutations(_EULER, 2):
        name = _named(written)
        symptom = (
            f"the angles look as though read in the order {_named(read)} where {name} was meant"
        )
        true = Rotation.from_euler(written, angles[read])
        yield "angle-order", symptom, f"read the angles as {name}", true


def _shorter(angles):
    """(P, 3) rad, of the two sets of angles that make one rotation the one that can be a rotation vector.

    A rotation vector is not longer than pi; its second number may exceed pi / 2, the limit of an angle.
    """
    first, second, third = angles.T
    other = np.stack([first + np.pi, np.pi - second, third + np.pi], axis=1)
    other = (other + np.pi) % (2 * np.pi) - np.pi
    is_longer = np.linalg.norm(angles, axis=1) > np.linalg.norm(other, axis=1)
    return np.where(is_longer[:, None], other, angles)


def _named(order):
    """As rotations are multiplied: extrinsic xyz is Rz Ry Rx."""
    letters = order if order.isupper() else order[::-1]
    return " ".join(f"R{letter.lower()}" for letter in letters)


def _listed(words) -> str:
    *all_but_last, last = words
    return f"{', '.join(all_but_last)} and {last}" if all_but_last else last
