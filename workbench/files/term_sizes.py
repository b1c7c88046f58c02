"""How far each term of a calibrated model moves the measured point, beyond what base and tool absorb."""

import numpy as np

from workbench.core.least_squares.linear_algebra import least_squares
from workbench.core.model import Model
from workbench.core.parameters import Parameters

_MOST_SAMPLES = 500  # evenly spread, of which a size is computed
_LEAST_MM = 1e-4  # a smaller term is not listed
_FRAMES = ("base.", "tool.", "sensor.", "artefact.")


def term_sizes(model: Model, parameters: Parameters, name_of) -> list[dict]:
    """A row for each term: `name` (`joint-2.gravity-compliance`), `order` of harmonics, `rms_mm`; the largest first.

    `rms_mm`: RMS 3-D change of the predicted measurement without the term, all others at their values, after a
    linear fit of base and tool to this change. name_of: effect -> its name in the catalogue.
    """
    samples = model.chain.n // model.chain.poses_per_sample
    step = -(-samples // _MOST_SAMPLES)
    thinned = model.at(np.arange(0, samples, step))
    predicted = thinned.residual(parameters)[:3]
    frames = _frame_rows(thinned, parameters)
    rows = []
    for effect, span in zip(thinned.effects, thinned.spans):
        values = parameters.values.copy()
        values[span] = parameters.nulls[span]
        change = (
            predicted - thinned.residual(Parameters(parameters.table, values, parameters.mask))[:3]
        ).T
        left = change.ravel() - frames @ least_squares(frames, change.ravel())
        size = float(np.sqrt((left.reshape(change.shape) ** 2).sum(1).mean()))
        if size >= _LEAST_MM:
            order = {"order": effect.options["order"]} if "order" in effect.options else {}
            rows.append({"name": f"{effect.where}.{name_of(effect)}", **order, "rms_mm": size})
    return sorted(rows, key=lambda row: -row["rms_mm"])


def _frame_rows(model: Model, parameters: Parameters) -> np.ndarray:
    """(3 n, F) derivative of the measurement by base, tool and points on it."""
    is_own = np.arange(len(parameters)) < len(model.chain.parameters)
    is_frame = np.array([key.startswith(_FRAMES) for key in parameters.keys])
    rows = model.linearise(parameters.only(is_own & is_frame))[1][:, :3]
    return rows.transpose(2, 1, 0).reshape(-1, len(rows))


__all__ = ["term_sizes"]
