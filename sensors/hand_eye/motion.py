"""Sentences on what the motions of a hand-eye set do not determine, and on mistakes in its poses."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sensors.hand_eye.checks.mistakes import pose_readings
from sensors.hand_eye.start import NO_ROTATION_RAD
from workbench.core.least_squares.linear_algebra import thin_svd
from workbench.core.profiler_start import find_start
from workbench.core.rigid import inverse, rotation_vector, transform

_ERRORS = 6.0  # sigmas: errors alone, of hundreds of poses, make two of them differ by five
_BETTER = 3.0  # how much smaller the misfit must be before another reading of the poses is believed
_POOR = 1.0  # mm; an arm repeats to hundredths and is true to tenths
_WRONG_ROTATION_RAD = np.radians(1.0)  # more than the errors of any arm and sensor
_AT_REST = 0.1  # mm; below it a translation is what an arm makes when it stands still
_TWISTS = np.eye(6)
_MAX_POSES = 24  # poses up to which every exchange of two is tried


@dataclass(frozen=True)
class Motion:
    """Directions that the flange's motions do not determine: M small motions that change nothing measured.

    `sensor` and `target` (6, M): translation (mm a unit) and rotation vector (rad a unit) of the sensor, along the
    axes of the frame that it sits in, and of board or ball, which goes with it; `sentences` say it in words.
    """

    sensor: np.ndarray
    target: np.ndarray
    sentences: tuple[str, ...]


def motion(flange: np.ndarray, kind: str, spin: float = 0.0, shift: float = 0.0) -> Motion:
    """Find the directions that flange poses (P, 4, 4) do not determine.

    With A the flange's motion between two poses, a hand-eye X and exp(x) X predict the same where x commutes with
    every A. spin (rad) and shift (mm): 1 sigma of the error of a pose's rotation and position; motions that are not
    larger than such errors make them are none.
    """
    moved = flange if kind != "to-hand" else inverse(flange)
    motions = inverse(moved) @ moved[:1]
    vectors = rotation_vector(motions[:, :3, :3])
    min_rotation = max(NO_ROTATION_RAD, _ERRORS * spin)
    mount = "base" if kind == "to-hand" else "flange"
    axes = thin_svd(vectors)[2]
    min_translation = max(_AT_REST, _ERRORS * shift)
    if np.linalg.norm(vectors, axis=1).max() < min_rotation and (
        found := _short_of_translations(motions, min_translation, mount)
    ):
        return _motion(moved, *found)
    largest = np.linalg.norm(vectors, axis=1).max()
    if largest < min_rotation and spin > _WRONG_ROTATION_RAD and largest > spin:
        return _motion(moved, _TWISTS[:, :3], _covered_rotations(largest, spin, mount))
    if largest < min_rotation:
        return _motion(
            moved,
            _TWISTS[:, :3],
            f"the flange only moved and never turned: where the sensor sits in the {mount} frame is "
            "undetermined, only how it is turned; add poses with turns about two axes",
        )
    if np.linalg.norm(vectors - np.outer(vectors @ axes[0], axes[0]), axis=1).max() < min_rotation:
        axis = ", ".join(f"{a:+.2f}" for a in axes[0])
        rotation_about_line = _fixed_line(motions, axes[0], min_translation)
        if rotation_about_line is not None:
            return _motion(
                moved,
                np.column_stack([_translation_along(axes[0]), rotation_about_line]),
                f"the flange rotated about one fixed line only, of direction ({axis}) in the {mount} frame: "
                "the sensor's position along this line and its rotation about it are undetermined; add "
                "rotations about another axis",
            )
        return _motion(
            moved,
            _translation_along(axes[0])[:, None],
            f"the flange turned about one axis only, ({axis}) of the {mount} frame: the sensor's position "
            "along it is undetermined; add turns about another axis",
        )
    return Motion(np.zeros((6, 0)), np.zeros((6, 0)), ())


def _covered_rotations(largest: float, spin: float, mount: str) -> str:
    """Sentence on rotations (rad) of the flange that the errors of the measured rotations cover."""
    return (
        f"the flange turned by at most {np.degrees(largest):.3g} deg, and flange and target disagree by "
        f"{np.degrees(spin):.2g} deg RMS in rotation: where the sensor sits in the {mount} frame is undetermined; "
        "check the rotations of both sets row by row, or add poses with larger turns about two axes"
    )


def _short_of_translations(motions, min_translation, mount):
    """Undetermined directions, and the sentence, of a flange that never rotated and hardly moved; None otherwise."""
    places = motions[:, :3, 3]
    line = thin_svd(places)[2][0]
    if np.linalg.norm(places, axis=1).max() < min_translation:
        return _TWISTS, (
            f"the flange never moved: neither position nor rotation of the sensor in the {mount} frame is determined; "
            "measure at different poses, with rotations about two axes"
        )
    if np.linalg.norm(places - np.outer(places @ line, line), axis=1).max() < min_translation:
        axis = ", ".join(f"{a:+.2f}" for a in line)
        return np.column_stack([_TWISTS[:, :3], np.append(np.zeros(3), line)]), (
            f"the flange moved along one line only, ({axis}) of the {mount} frame, and never rotated: the sensor's "
            "position, and its rotation about this line, are undetermined; add poses with rotations about two axes"
        )
    return None


def _fixed_line(motions, axis, min_translation):
    """(6,) small rotation about the line that all motions leave where it is; None where there is no such line."""
    rows = (motions[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = np.cross(axis, motions[:, :3, 3]).ravel()
    arm = np.linalg.lstsq(rows, right, rcond=1e-9)[0]
    gap = np.linalg.norm((rows @ arm - right).reshape(-1, 3), axis=1).max()
    return np.append(arm, axis) if gap < min_translation else None


def _translation_along(axis):
    """(6,) a translation along an axis."""
    return np.append(axis, np.zeros(3))


def _motion(moved, twists, sentence):
    """moved (P, 4, 4): from the frame of the sensor's mount into that of the target; twists (6, M) of the sensor."""
    rotation = moved[0, :3, :3]
    place = moved[0, :3, 3]
    spun = rotation @ twists[3:]
    carried = rotation @ twists[:3] + np.cross(place, spun.T).T
    return Motion(twists, np.concatenate([carried, spun]), (sentence,))


def readings(flange: np.ndarray, names: Sequence[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Other readings of flange poses (P, 4, 4) called `names`, each with its words; the simple ones first."""
    rotation = flange[:, :3, :3]
    place = flange[:, :3, 3]
    yield "the positions look like metres given for millimetres", transform(rotation, 1000 * place)
    yield "the positions look too large by 1000", transform(rotation, place / 1000)
    for reading in pose_readings(flange):
        yield reading.symptom, reading.flange
    yield from _exchanged(flange, names)


def _exchanged(flange, names):
    if len(flange) > _MAX_POSES:
        return
    for i, j in zip(*np.triu_indices(len(flange), 1)):
        order = np.arange(len(flange))
        order[[i, j]] = order[[j, i]]
        yield f"the flange poses of {names[i]} and {names[j]} look exchanged", flange[order]


def profile_suspicions(
    flange: np.ndarray,
    names: Sequence[str],
    circles: np.ndarray,
    radius: float | None,
    misfit: float,
) -> tuple[str, ...]:
    """Mistakes in flange poses (P, 4, 4), called `names`, at which circles (3, P) of one ball were measured.

    Asked only where an arm would have to be off by a millimetre. misfit: mm, RMS of what the poses as given leave of
    the circles. The search for a start is run for every reading, with few valleys, and the best two again with all of
    them.
    """
    if misfit < _POOR:
        return ()
    tried = sorted(
        (
            (find_start(circles, poses, radius, 2, 60).rms, k, words, poses)
            for k, (words, poses) in enumerate(readings(flange, names))
        ),
        key=lambda row: row[:2],
    )[:2]
    rows = [(find_start(circles, poses, radius).rms, words) for _, _, words, poses in tried]
    best = min(rows)
    if best[0] < misfit / _BETTER:
        return (
            f"{best[1]}: read so, the poses fit the circles to {best[0]:.3g} mm instead of {misfit:.3g} mm",
        )
    return (
        f"the circles do not fit the flange poses, by {misfit:.3g} mm: check Euler order, units, radius, and which "
        "pose belongs to which profile",
    )
