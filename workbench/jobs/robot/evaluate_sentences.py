"""Sentences of an evaluation: on fitted data, a moved instrument, and errors with base and tool estimated."""

import numpy as np

from workbench.fitting.cross_validation import error_summary

FITTED = (
    "The calibration was fitted to {share}: its errors are not held out, and say nothing about other poses. "
    "Evaluate another recording; the held-out error stands in the answer of the calibration."
)
MOVED = (
    "the instrument or the target has moved since, or errors of the model act like such a move in these poses; repeat "
    "with --refit base, tool or base-and-tool"
)
NOT_MOVED = (
    "base and tool alone do not explain it (the calibration states {held_out:.3g} mm). Look for another load, other "
    "units, another arm or a change of the arm; `workbench check` tests the recording."
)
ADVICE = (
    "the model does not describe this recording as well as its noise allows; run `workbench diagnose` on it, or "
    "calibrate with both recordings"
)
_WORSE = 1.25
"""Ratio of the errors of the calibrated and the nominal arm up to which the difference does not matter."""


def refit_sentences(
    refitted: np.ndarray, nominal: np.ndarray, fits_better: bool
) -> tuple[str, ...]:
    """Sentences on residuals (m, n) of the calibrated and the nominal arm, base and tool estimated for both.

    fits_better: whether base and tool of the calibration were used, and others explain the recording better.
    """
    refitted_rms, nominal_rms = (
        error_summary(residual)["rms_mm"] for residual in (refitted, nominal)
    )
    sentences = []
    if fits_better:
        sentences.append(
            f"With base and tool estimated on this recording it is {refitted_rms:.3g} mm: "
            "repeat with --refit base-and-tool."
        )
    if refitted_rms > _WORSE * nominal_rms:
        sentences.append(
            f"The calibrated arm is worse than the nominal one here ({refitted_rms:.3g} mm against {nominal_rms:.3g} "
            "mm with base and tool estimated on this recording): do not use the calibration in these poses."
        )
    return tuple(sentences)
