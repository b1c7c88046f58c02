"""One measured coordinate that does not belong to the joint readings while the other two do.

A coordinate of a point on the flange is linear in the nominal pose of the flange: b + r^T (o + R t), with 13 constants.
Each coordinate is therefore fitted by itself, and a coordinate that fits is not affected by another one that is wrong.
Two coordinates that fit determine the direction r of the third and the tool t, and so predict its values.
"""

from dataclasses import dataclass

import numpy as np

from datasets.samples.columns import POINT
from robot_model.chain import forward
from workbench.fitting.plausibility.suspicion import Suspicion

CAUSE = "coordinate-values"
_COEFFICIENTS = 13
_LEAST_SPARE = 15
_FITS = 0.02
"""Share of the scatter of a coordinate that plausible geometry errors leave as misfit at most."""
_FACTOR = 5.0
"""Times the misfit of the others: a wrong coordinate is far off."""
_LEVEL = 0.03
"""Share of a jump within which all deviations are multiples of it."""
_MEASURES = ("external-point", "external-pose")


@dataclass(frozen=True)
class _Coordinate:
    """A coordinate fitted by itself: RMS misfit relative to its scatter, and in mm; direction r (3,), r t^T (3, 3)."""

    misfit: float
    misfit_mm: float
    direction: np.ndarray
    products: np.ndarray


def wrong_coordinate_suspicion(robot, recording, scale_of_good_fit: float) -> Suspicion | None:
    """The one coordinate that does not fit the joint readings while each of the others does, or None.

    scale_of_good_fit: mm that noise and a sound arm leave. Points at one height fit no joint reading, and need not.
    """
    if recording.measures not in _MEASURES:
        return None
    recording = _of_one_target(recording)
    if recording.n < _COEFFICIENTS + _LEAST_SPARE:
        return None
    frames = forward(robot, robot.mixing @ recording.joints.T)
    origin = frames.end_origin
    rotation = np.stack(frames.end, axis=1)
    fitted = [_fitted(origin, rotation, recording.columns[name]) for name in POINT]
    misfits = np.array([coordinate.misfit for coordinate in fitted])
    wrong = int(np.argmax(misfits))
    others = [k for k in range(3) if k != wrong]
    largest_of_others = misfits[others].max()
    if largest_of_others > _FITS or misfits[wrong] < _FACTOR * max(largest_of_others, _FITS):
        return None
    if fitted[wrong].misfit_mm < scale_of_good_fit:
        return None
    predicted = _prediction(origin, rotation, [fitted[k] for k in others])
    values = recording.columns[POINT[wrong]]
    return _suspicion(recording, POINT[wrong], [POINT[k] for k in others], values, predicted)


def _of_one_target(recording):
    """The rows of the reflector that was measured most often."""
    if "reflector" not in recording.columns:
        return recording
    labels, counts = np.unique(recording.columns["reflector"], return_counts=True)
    return recording.select(
        np.flatnonzero(recording.columns["reflector"] == labels[counts.argmax()])
    )


def _fitted(origin, rotation, values) -> _Coordinate:
    """Least squares of values (n,) on the pose: origin (3, n) mm, rotation (3, 3, n)."""
    features = [np.ones_like(values), *(origin / 1000.0), *rotation.reshape(9, -1)]
    matrix = np.array(features).T
    solution = np.linalg.lstsq(matrix, values, rcond=1e-8)[0]
    left = values - matrix @ solution
    misfit = np.sqrt((left**2).sum() / (len(values) - _COEFFICIENTS))
    scatter = max(float(np.std(values)), 1e-9)
    direction, products = solution[1:4] / 1000.0, solution[4:].reshape(3, 3)
    return _Coordinate(float(misfit) / scatter, float(misfit), direction, products)


def _prediction(origin, rotation, others) -> np.ndarray:
    """(n,) mm: the third coordinate from the other two, up to its sign and a constant."""
    first, second = (part.direction / np.linalg.norm(part.direction) for part in others)
    direction = np.cross(first, second)
    tool = (others[0].products.T @ first + others[1].products.T @ second) / 2
    return direction @ (origin + np.einsum("ijn,j->in", rotation, tool))


def jump_of(deviations: np.ndarray) -> float:
    """The jump of which all deviations (n,) mm from one another are multiples; 0 where there is none."""
    ordered = np.sort(deviations)
    gaps = np.diff(ordered)
    largest = float(gaps.max(initial=0.0))
    wide = np.flatnonzero(gaps > 0.5 * largest)
    levels = [float(part.mean()) for part in np.split(ordered, wide + 1)]
    if len(levels) < 2:
        return 0.0
    jump = float(np.min(np.diff(levels)))
    # from the first level on: remainders from the median, half a jump from two levels, would have either sign
    remainder = ((deviations - levels[0]) / jump + 0.5) % 1.0 - 0.5
    is_multiple = np.abs(remainder - np.median(remainder)) < _LEVEL
    return jump if is_multiple.all() else 0.0


def _suspicion(recording, name, others, values, predicted) -> Suspicion:
    candidates = (values - predicted, values + predicted)  # of a right- and a left-handed frame
    jump = max(jump_of(deviations) for deviations in candidates)
    deviations = min(candidates, key=np.std)
    # an overflow brings all values into a range as wide as its jump
    is_overflow = np.ptp(values) <= (1 + _LEVEL) * jump
    if jump and is_overflow:
        found = (
            f"the values of {name} jump by multiples of {jump:.5g} mm, as of an overflow of its number format; "
            "export this column in a wider number format"
        )
        cause = "overflow"
    elif jump:
        found = (
            f"the values of {name} jump by multiples of {jump:.5g} mm between rows; check whether the column mixes "
            "values of different origins"
        )
        cause = CAUSE
    else:
        found = (
            f"the values of {name} are off by {np.std(deviations):.3g} mm (standard deviation); "
            "check source, unit, sign and order of rows of this column"
        )
        cause = CAUSE
    return Suspicion(
        f"samples.csv of recording '{recording.name}', column {name}: expected three coordinates that belong to the "
        f"joint readings, found that {' and '.join(others)} fit them each by itself, but {name} does not: {found}.",
        False,
        cause,
    )
