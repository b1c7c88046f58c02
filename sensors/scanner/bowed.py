"""Light planes that are bowed: the bow becomes part of the scanner where the stripes on boards support it.

A cylindrical lens that is not square to the beam makes a shallow cone of the light. Every stripe is then bent in
proportion to the square of its length, and no light plane fits. One curvature for all steps is tried where stripes show
a relevant lack of fit, and kept where it is significant, removes a large part of the lack of fit, and predicts stripes
of board poses that were left out better.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sensors.effects.laser import PlaneBow
from sensors.scanner.calibration import ScannerCalibration
from sensors.scanner.residuals.misfit import Misfit, stripe_misfit
from workbench.core.effect import Effect
from workbench.core.text.uncertain import with_std

_MAX_REMAINING_SHARE = 0.7  # of the lack of fit
_SIGNIFICANT = 5.0  # standard deviations
_BETTER = 0.97  # of the held-out RMS

Calibrate = Callable[[Sequence[Effect]], ScannerCalibration]


def misfit_of(calibration: ScannerCalibration) -> Misfit | None:
    """Lack of fit of the stripes on boards against the light planes; None where there are too few."""
    board_stripes = calibration.stripes
    is_good = ~calibration.wrong
    labels = board_stripes.labels
    stripe = labels["placement"] * len(calibration.scanner.steps) + labels["step"]
    return stripe_misfit(
        calibration.residual_px[is_good], stripe[is_good], board_stripes.stripe_place[is_good]
    )


def calibrated_with_bow(calibrate: Calibrate) -> ScannerCalibration:
    """The calibration with flat light planes, or with one bow of the light planes where that is supported.

    calibrate: makes a calibration with further effects.
    """
    flat = calibrate(())
    misfit = misfit_of(flat)
    if misfit is None or not misfit.is_relevant:
        return flat
    bow = PlaneBow("laser")
    bowed = calibrate((bow,))
    key = bow.parameters(bowed.made.board_stripes)[0].key
    value = bowed.made.parameters[key]
    std = bowed.std[key]
    if not (abs(value) > _SIGNIFICANT * std and _is_better(flat, bowed, misfit)):
        return flat
    sentence = (
        f"the light planes are bowed, with a curvature of {with_std(value, std)} 1/mm, which is part of the scanner; "
        f"held-out stripes miss them by {bowed.left_out.rms_px:.3g} px, flat ones by {flat.left_out.rms_px:.3g} px"
    )
    return replace(bowed, sentences=(*bowed.sentences, sentence))


def _is_better(flat: ScannerCalibration, bowed: ScannerCalibration, misfit: Misfit) -> bool:
    """Whether the bow removes much of the lack of fit, and predicts board poses that were left out better."""
    if flat.left_out is None or bowed.left_out is None:
        return False
    remaining_misfit = misfit_of(bowed)
    removed = (
        remaining_misfit is not None
        and remaining_misfit.total_px < _MAX_REMAINING_SHARE * misfit.total_px
    )
    gain = bowed.left_out.rms_px < _BETTER * flat.left_out.rms_px
    return removed and bool(np.isfinite(bowed.left_out.rms_px)) and gain
