"""An instrument whose range is wrong by a constant: of another reflector, a target's radius, or its zero point.

Such a constant along the sight line is no error of the arm. It is estimated, linearised at the robust fit with base,
tool and plausible geometry errors, and the data are fitted again without it.
"""

from dataclasses import dataclass, replace

import numpy as np

from datasets.samples.columns import POINT
from robot_model.effects.instrument import InstrumentRangeOffset
from workbench.core.text.uncertain import with_std
from workbench.fitting.plausibility.fitting import (
    FAILURES,
    Fit,
    fit_recording,
    row_residual,
    scatter_of_points,
)
from workbench.fitting.plausibility.hypotheses.corrections import Correction, column_correction
from workbench.fitting.plausibility.linearised_fit import LinearisedFit
from workbench.fitting.plausibility.sampling import even_rows

CAUSE = InstrumentRangeOffset.effect
_MEASURED_BY_RANGE = ("external-point", "external-pose")
_ROWS, _STEPS, _ROUNDS = 240, 60, 3
_SIGNIFICANT = 6.0  # standard deviations
_SETTLED = 0.1  # standard deviations
_LARGE = 5.0
"""Times the misfit: the pose of the base takes up most of an offset, so that a mistake is far larger than that."""


@dataclass(frozen=True)
class RangeOffset:
    """All ranges are `offset` mm too long, with its standard deviation; the fit of the data without it."""

    offset: float
    std: float
    fit: Fit

    @property
    def correction(self) -> Correction:
        """The points, moved towards the instrument by the offset."""
        known = with_std(self.offset, self.std)
        return column_correction(
            CAUSE,
            "columns x_mm, y_mm, z_mm",
            f"are {known} mm too far along the sight line of an instrument at the origin of their frame",
            "check the reflector constant, the radius of the target, and whether an offset was counted twice in the "
            "instrument's software",
            lambda columns: shortened_columns(columns, self.offset),
            POINT,
        )


def shortened_columns(columns, offset: float) -> dict[str, np.ndarray]:
    """Columns x_mm, y_mm, z_mm (n,) of points moved towards the origin by an offset, mm."""
    points = np.stack([columns[name] for name in POINT])
    moved = points - offset * points / np.linalg.norm(points, axis=0)
    return dict(zip(POINT, moved))


def range_offset(robot, recording) -> RangeOffset | None:
    """The constant error of all ranges, where it is significant and larger than an instrument's; None else.

    An instrument stands outside the space in which its points lie; else the origin is that of another frame.
    """
    if recording.measures not in _MEASURED_BY_RANGE or not _is_seen_from_origin(recording):
        return None
    chosen = recording.select(even_rows(recording, _ROWS))
    offset = 0.0
    try:
        for _ in range(_ROUNDS):
            corrected = _shortened(chosen, offset)
            fit = fit_recording(robot, corrected, steps=_STEPS)
            change, std = _estimate(robot, corrected, fit)
            if abs(change) < _SETTLED * std:
                break
            offset += change
        fit = fit_recording(robot, _shortened(chosen, offset), steps=_STEPS)
    except FAILURES:
        return None
    if abs(offset) < max(_SIGNIFICANT * std, _LARGE * fit.scale):
        return None
    return RangeOffset(offset, std, fit)


def _shortened(recording, offset: float):
    return replace(
        recording, columns={**recording.columns, **shortened_columns(recording.columns, offset)}
    )


def _is_seen_from_origin(recording) -> bool:
    points = np.stack([recording.columns[name] for name in POINT])
    nearest = np.linalg.norm(points, axis=0).min()
    return bool(nearest > scatter_of_points(recording))


def _estimate(robot, recording, fit: Fit) -> tuple[float, float]:
    """mm: the offset that is left next to base, tool and geometry with its prior, and its standard deviation.

    Raises numpy.linalg.LinAlgError where base, tool and geometry make the same errors.
    """
    linear = LinearisedFit.at(robot, recording, fit)
    moved = row_residual(robot, _shortened(recording, 1.0), fit)
    derivative = (moved - row_residual(robot, recording, fit)) * linear.root
    estimate = linear.solved(derivative, np.ones((1, recording.n)))
    if estimate is None:
        raise np.linalg.LinAlgError("the poses do not determine an offset of the ranges")
    change, information = estimate
    return float(change[0]), float(information[0, 0] ** -0.5)
