"""What the motions of a hand-eye set cannot tell, and mistakes in its poses, in words."""

import warnings
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sensors.hand_eye_profiles_start import find_start
from sensors.hand_eye_start import align
from workbench.core.rigid import inverse, rotation_vector, transform

_STILL = np.radians(0.5)  # below it a turn is what an arm makes when it only moves
_BETTER = 3.0  # how much smaller the misfit must be before another reading of the poses is believed
_EULER = tuple("xyz xzy yxz yzx zxy zyx XYZ XZY YXZ YZX ZXY ZYX".split())
_POOR = 1.0  # mm; an arm repeats to hundredths and is true to tenths
_MOST = 24  # poses up to which every exchange of two is tried


def motion_sentences(flange: np.ndarray, kind: str) -> tuple[str, ...]:
    """What flange poses (P, 4, 4) leave undetermined: all turns about one axis, or none at all."""
    mount = "flange" if kind != "to-hand" else "base"
    turns = flange[:, :3, :3]
    relative = np.swapaxes(turns[:1], 1, 2) @ turns if kind != "to-hand" else turns @ np.swapaxes(turns[:1], 1, 2)
    vectors = rotation_vector(relative)
    size, axes = np.linalg.svd(vectors, full_matrices=False)[1:]
    if np.linalg.norm(vectors, axis=1).max() < _STILL:
        return (f"the flange only moved and never turned: where the sensor sits in the {mount} frame is undetermined, "
                "only how it is turned; add poses with turns about two axes",)
    if np.abs(vectors - np.outer(vectors @ axes[0], axes[0])).max() < _STILL:
        axis = ", ".join(f"{a:+.2f}" for a in axes[0])
        return (f"the flange turned about one axis only, ({axis}) of the {mount} frame: the sensor's position along it "
                "is undetermined; add turns about another axis",)
    return ()


def suspicions(flange: np.ndarray, seen: np.ndarray, kind: str) -> tuple[str, ...]:
    """Mistakes in the flange poses that would explain a misfit: exchanged rows, Euler order, units, inverse.

    Every reading of the poses is aligned with what the camera saw; one that fits three times
    better than the poses as given is named. flange (P, 4, 4), seen (P, 4, 4) T_camera_board.
    """
    def misfit(poses):
        return align(poses if kind == "in-hand" else inverse(poses), seen)[1]

    given = misfit(flange)
    best = min(((misfit(poses), words) for words, poses in readings(flange)), key=lambda row: row[0])
    if best[0] < given / _BETTER:
        return (f"{best[1]}: read so, the poses fit the pictures to {best[0]:.3g} mm instead of {given:.3g} mm",)
    return _odd_angles(align(flange if kind == "in-hand" else inverse(flange), seen)[2])


def _odd_angles(angles):
    """Flange and camera are one body: they turn by one angle, whatever the hand-eye (Chen 1991)."""
    apart = np.degrees(np.median(np.abs(angles[0] - angles[1])))
    if apart < 1:
        return ()
    return (f"flange and camera turned by different angles between the same two poses, by {apart:.1f} deg in the "
            "median: check Euler order, units, and which pose belongs to which picture",)


def readings(flange: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Other readings of flange poses (P, 4, 4), each with its words; the simple ones first."""
    turn, place = flange[:, :3, :3], flange[:, :3, 3]
    yield "the poses look inverted, T_flange_base given for T_base_flange", inverse(flange)
    yield "the positions look like metres given for millimetres", transform(turn, 1000 * place)
    yield "the positions look too large by 1000", transform(turn, place / 1000)
    yield "the poses look shifted by one row against the pictures", np.roll(flange, 1, 0)
    yield "the poses look shifted by one row against the pictures", np.roll(flange, -1, 0)
    yield from _other_angles(turn, place)
    yield from _exchanged(flange)


def _exchanged(flange):
    if len(flange) > _MOST:
        return
    for i, j in zip(*np.triu_indices(len(flange), 1)):
        order = np.arange(len(flange))
        order[[i, j]] = order[[j, i]]
        yield f"poses {i} and {j} look exchanged", flange[order]


def _other_angles(turn, place):
    """Angles in another order, or radians where degrees were meant."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of gimbal lock: such a reading does not fit then
        angles = {order: Rotation.from_matrix(turn).as_euler(order) for order in _EULER}
    for order, values in angles.items():
        name = _named(order)
        yield (f"the angles look like radians given for degrees ({name})",
               transform(Rotation.from_euler(order, np.degrees(values)).as_matrix(), place))  # fmt: skip
        for other in _EULER:
            if other != order:
                words = f"the angles look as though read in the order {name} where {_named(other)} was meant"
                yield words, transform(Rotation.from_euler(other, values).as_matrix(), place)


def _named(order):
    """As rotations are multiplied: extrinsic xyz is Rz Ry Rx."""
    letters = order if order.isupper() else order[::-1]
    return " ".join(f"R{letter.lower()}" for letter in letters)


def profile_suspicions(flange: np.ndarray, circles: np.ndarray, radius: float | None, misfit: float) -> tuple[str, ...]:
    """The same for circles (3, P) of one ball, asked only where an arm would have to be off by a millimetre.

    misfit: mm, RMS of what the poses as given leave of the circles. The search for a start is
    run for every reading, with few valleys, and the best two again with all of them.
    """
    if misfit < _POOR:
        return ()
    tried = sorted(((find_start(circles, poses, radius, 2, 60).rms, k, words, poses)
                    for k, (words, poses) in enumerate(readings(flange))), key=lambda row: row[:2])[:2]
    rows = [(find_start(circles, poses, radius).rms, words) for _, _, words, poses in tried]
    best = min(rows)
    if best[0] < misfit / _BETTER:
        return (f"{best[1]}: read so, the poses fit the circles to {best[0]:.3g} mm instead of {misfit:.3g} mm",)
    return (f"the circles do not fit the flange poses, by {misfit:.3g} mm: check Euler order, units, radius, and which "
            "pose belongs to which profile",)
