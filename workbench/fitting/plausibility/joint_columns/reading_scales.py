"""A joint reading in a wrong scale: encoder counts per degree, or a gear constant, wrong by a fraction of a percent.

An angle that grows too fast by a constant factor is no function that gears, springs or gravity make over a large range.
The factor of every joint is estimated, linearised at the robust fit with base, tool and plausible geometry errors, and
the most significant ones are fitted again with the column corrected.
"""

from dataclasses import dataclass, replace

import numpy as np

from datasets.samples.columns import joint_columns, joint_number
from robot_model.effects.curve import LEAST_SCALE
from workbench.core.text.uncertain import with_std
from workbench.fitting.plausibility.fitting import FAILURES, Fit, fit_recording
from workbench.fitting.plausibility.hypotheses.corrections import Correction, column_correction
from workbench.fitting.plausibility.linearised_fit import LinearisedFit
from workbench.fitting.plausibility.sampling import even_rows

CAUSE = "reading-scale"
_ROWS, _STEPS, _ROUNDS = 240, 60, 4
_MAX_SCALE_ERROR = 0.2
_SIGNIFICANT = 6.0  # standard deviations
_TESTED = 2
_SETTLED = 0.1  # standard deviations


@dataclass(frozen=True)
class Scale:
    """A column whose readings are `factor` times the angle (mm of a slide), with its standard deviation.

    `correction`: the column without the factor. `fit`: the fit under it.
    """

    column: str
    factor: float
    std: float
    fit: Fit

    @property
    def correction(self) -> Correction:
        """The column in its true scale."""
        return scale_correction(self.column, self.factor, self.std)


def scaled_readings(robot, recording) -> list[Scale]:
    """Columns whose factor differs significantly from 1, the most significant first; at most two.

    Of each alone, as if all others were right.
    """
    chosen = recording.select(even_rows(recording, _ROWS))
    try:
        fit = fit_recording(robot, chosen, steps=_STEPS)
        estimates = _estimates(robot, chosen, fit)
    except FAILURES:
        return []
    clear = [
        name
        for name, estimate in estimates.items()
        if estimate.significance > _SIGNIFICANT and not estimate.is_sinusoidal
    ]
    clear.sort(key=lambda name: -estimates[name].significance)
    found = [_refined(robot, chosen, name, estimates[name]) for name in clear[:_TESTED]]
    return [scale for scale in found if scale is not None]


def scale_correction(name: str, factor: float, std: float) -> Correction:
    """A column divided by the factor by which it is too large."""
    number = joint_number(name)
    known = with_std(factor, std)
    value = known.partition(" ")[0]
    return column_correction(
        CAUSE,
        f"column {name}",
        f"is in a wrong scale: it holds {known} times the motion of joint {number}",
        f"divide it by {value}; where a mapping states counts_per_deg, multiply that of joint {number} by {value}; "
        "else correct the gear or encoder constant of this joint in the controller or the export",
        lambda columns: {name: columns[name] / factor},
        (name,),
    )


def _refined(robot, recording, name: str, estimate: "_Estimate") -> Scale | None:
    """The factor of a column at the fit of the corrected data; None where it is insignificant or does not converge."""
    slope = 1.0
    for _ in range(_ROUNDS):
        slope *= 1 + estimate.change
        if not abs(slope - 1) < _MAX_SCALE_ERROR:
            return None
        columns = {**recording.columns, name: slope * recording.columns[name]}
        corrected = replace(recording, columns=columns)
        try:
            fit = fit_recording(robot, corrected, steps=_STEPS)
            estimate = _estimates(robot, corrected, fit)[name]
        except (*FAILURES, KeyError):
            return None
        if estimate.significance < _SETTLED:
            break
    if abs(slope - 1) < max(LEAST_SCALE, _SIGNIFICANT * estimate.std):
        return None
    return Scale(name, 1 / slope, estimate.std, fit)


@dataclass(frozen=True)
class _Estimate:
    """Relative change of a column of readings, its standard deviation, and whether a sinusoid explains as much.

    The deflection of a joint under gravity and its first-order transmission error are A cos q + B sin q.
    """

    change: float
    std: float
    is_sinusoidal: bool

    @property
    def significance(self) -> float:
        return abs(self.change) / self.std


def _estimates(robot, recording, fit: Fit) -> dict[str, _Estimate]:
    """The estimate of each column of readings that moves the target, next to the fitted model.

    One Gauss-Newton step with the weights of the fit; base, tool and geometry with its prior are estimated with it.
    """
    linear = LinearisedFit.at(robot, recording, fit)
    found = {}
    for k, name in enumerate(joint_columns(recording.columns)):
        reading = recording.joints[:, k]
        scale = linear.solved(linear.readings[k], (reading - reading.mean())[None])
        if scale is None:
            continue
        change, information = scale
        gain = float(information[0, 0] * change[0] ** 2)
        cycle = None
        if name.endswith("_deg"):
            cycle = linear.solved(linear.readings[k], np.stack([np.cos(reading), np.sin(reading)]))
        is_sinusoidal = cycle is not None and float(cycle[0] @ cycle[1] @ cycle[0]) > gain
        std = float(information[0, 0] ** -0.5)
        found[name] = _Estimate(float(change[0]), std, is_sinusoidal)
    return found
