"""What the motions of a hand-eye set cannot tell, and mistakes in its poses, in words."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sensors.hand_eye.mistakes import pose_readings
from sensors.hand_eye.profiles_start import find_start
from sensors.hand_eye.start import STILL
from workbench.core.linear_algebra import thin_svd
from workbench.core.rigid import rotation_vector, transform

_ERRORS = 6.0  # sigmas: errors alone, of hundreds of poses, make two of them differ by five
_BETTER = 3.0  # how much smaller the misfit must be before another reading of the poses is believed
_POOR = 1.0  # mm; an arm repeats to hundredths and is true to tenths
_MOST = 24  # poses up to which every exchange of two is tried


@dataclass(frozen=True)
class Motion:
    """What the flange's motions leave open: M shifts `sensor` (3, M), along the axes of the frame that the
    sensor sits in, with the shifts `target` (3, M) of board or ball that go with them; `sentences`."""

    sensor: np.ndarray
    target: np.ndarray
    sentences: tuple[str, ...]


def motion(flange: np.ndarray, kind: str, spin: float = 0.0) -> Motion:
    """What flange poses (P, 4, 4) leave undetermined: all turns about one axis, or none at all.

    spin: 1 sigma, rad, of the error of a pose's rotation; turns that are not larger than such errors
    make them are none.
    """
    turns = flange[:, :3, :3] if kind == "to-hand" else np.swapaxes(flange[:, :3, :3], 1, 2)
    vectors = rotation_vector(turns @ np.swapaxes(turns[:1], 1, 2))
    still, mount = max(STILL, _ERRORS * spin), "base" if kind == "to-hand" else "flange"
    axes = thin_svd(vectors)[2]
    if np.linalg.norm(vectors, axis=1).max() < still:
        return _motion(turns, np.eye(3),
                       f"the flange only moved and never turned: where the sensor sits in the {mount} frame is "
                       "undetermined, only how it is turned; add poses with turns about two axes")  # fmt: skip
    if np.linalg.norm(vectors - np.outer(vectors @ axes[0], axes[0]), axis=1).max() < still:
        axis = ", ".join(f"{a:+.2f}" for a in axes[0])
        return _motion(turns, axes[:1],
                       f"the flange turned about one axis only, ({axis}) of the {mount} frame: the sensor's position "
                       "along it is undetermined; add turns about another axis")  # fmt: skip
    return Motion(np.zeros((3, 0)), np.zeros((3, 0)), ())


def _motion(turns, axes, sentence):
    """turns (P, 3, 3): from the target's frame into that of the sensor's mount."""
    return Motion(axes.T, np.einsum("pji,mj->im", turns, axes) / len(turns), (sentence,))


def readings(flange: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Other readings of flange poses (P, 4, 4), each with its words; the simple ones first."""
    turn, place = flange[:, :3, :3], flange[:, :3, 3]
    yield "the positions look like metres given for millimetres", transform(turn, 1000 * place)
    yield "the positions look too large by 1000", transform(turn, place / 1000)
    for reading in pose_readings(flange):
        yield reading.seems, reading.flange
    yield from _exchanged(flange)


def _exchanged(flange):
    if len(flange) > _MOST:
        return
    for i, j in zip(*np.triu_indices(len(flange), 1)):
        order = np.arange(len(flange))
        order[[i, j]] = order[[j, i]]
        yield f"poses {i} and {j} look exchanged", flange[order]


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
