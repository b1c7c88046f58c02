"""Figures of a run and of the run before it."""

import numpy as np

from workbench.app.data.opened import Opened
from workbench.app.data.residuals import HELD_OUT
from workbench.app.edits.session import CALIBRATE, CAMERA, HAND_EYE

_ORIENTATION = "held-out orientation RMS (deg)"
_COMPARED = {
    CALIBRATE: (
        ("samples", "samples"),
        ("RMS of the fit (mm)", "fit"),
        ("held-out RMS (mm)", "held_out"),
        (_ORIENTATION, "held_out", "rotation_rms_deg"),
    ),
    CAMERA: (("images used", "views"), ("corners", "corners"), ("RMS (px)", "rms_px")),
    HAND_EYE: (
        ("poses", "poses"),
        ("poses used", "poses_used"),
        ("RMS of the fit (px)", "fit", "rms_px"),
        ("held-out RMS (px)", "held_out", "rms_px"),
        ("RMS of the fit (mm)", "fit"),
        ("held-out RMS (mm)", "held_out"),
        ("held-out board or ball position (mm)", "held_out", "centre_mm"),
        ("held-out board rotation (deg)", "held_out", "turn_deg"),
    ),
}
_UNKNOWN = "–"
_BASELINE = {"rms_mm": "before_mm", "rotation_rms_deg": "before_deg"}


def comparison_rows(previous: Opened, newest: Opened, command: str) -> list[dict]:
    """One row a figure: name, before, after. command: of the session, which decides the figures."""
    rows = []
    for name, *keys in _COMPARED[command]:
        before, after = (_figure(run.answer, *keys) for run in (previous, newest))
        if (before, after) != (_UNKNOWN, _UNKNOWN):  # not of this kind of recording
            rows.append({"name": name, "before": before, "after": after})
    return rows + _shared_rows(previous, newest)


def _shared_rows(previous: Opened, newest: Opened) -> list[dict]:
    """Held-out RMS of the samples that are in both runs; [] where both have the same samples.

    Without large residuals the RMS of all samples falls, also where no other sample is predicted better.
    """
    runs = (previous, newest)
    if any(run.residuals is None or run.samples is not run.recording for run in runs):
        return []  # ball centres from images are numbered again by each run
    lengths = [run.residuals.lengths.get(HELD_OUT) for run in runs]
    if any(length is None for length in lengths):
        return []
    numbers = [run.residuals.sample for run in runs]
    if np.array_equal(*numbers):
        return []
    shared, first, second = np.intersect1d(*numbers, return_indices=True)
    pairs = np.stack([lengths[0][first], lengths[1][second]])
    pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
    if not pairs.size:
        return []
    before, after = np.sqrt((pairs**2).mean(axis=1))
    name = f"held-out RMS of the {pairs.shape[1]:,} samples in both runs (mm)"
    return [{"name": name, "before": f"{before:.4g}", "after": f"{after:.4g}"}]


def _figure(answer, key: str, inner: str = "rms_mm") -> str:
    """A figure of a run for people; of a diagnosis the one of its baseline, which the next run is compared with."""
    value = answer.get(key)
    if isinstance(value, dict):
        value = value.get(inner, value.get(_BASELINE.get(inner)))
    if value is None:
        return _UNKNOWN
    return f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
