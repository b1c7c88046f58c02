"""Whether base or tool moved between the samples of a fit and its test samples."""

import numpy as np

from datasets.recording import Recording
from workbench.core.least_squares.solver import solve
from workbench.core.model import Model
from workbench.core.parameters import Parameters
from workbench.fitting.cross_validation import error_summary
from workbench.fitting.plausibility.fitting import base_patterns, tool_patterns

_REDUNDANCY = 2  # coordinates for each estimated number


def refitted_errors(
    model: Model, parameters: Parameters, test: np.ndarray, recording: Recording
) -> dict[str, float]:
    """RMS 3-D error, mm, of the test samples with the base, or the tool, estimated on them: keys "base", "tool".

    test: (n,) bool. A part without enough test samples for its numbers is left out. With the part estimated, a fault of
    the arm itself remains.
    """
    tested = model.part(test)
    errors = {}
    for name, patterns in (("base", base_patterns(recording)), ("tool", tool_patterns(recording))):
        mask = parameters.matching(*patterns) if patterns else np.zeros(len(parameters), bool)
        if not mask.any() or 3 * test.sum() < _REDUNDANCY * mask.sum():
            continue
        fit = solve(tested, parameters.only(mask))
        errors[name] = error_summary(tested.residual(fit.parameters))["rms_mm"]
    return errors
