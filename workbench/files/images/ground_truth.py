"""Errors of a result against the truth of rendered images."""

from collections.abc import Mapping, Sequence

import numpy as np

from workbench.core.rigid import nearest_rotation


def centre_errors(scans: Sequence[Mapping], truth: Mapping) -> dict:
    """RMS and maximum distance, mm, of ball centres from the true ones, after rigid alignment (least squares).

    scans: those of `scan --json`; truth: of `render --truth`. The frame of the camera is free by a
    rigid motion: a hand-eye takes it up. Balls beyond the calibrated depths do not count.
    """
    known = {
        (str(scan["scan"]), ball["ball"]): ball["centre_mm"]
        for scan in truth["scans"]
        for ball in scan["balls"]
    }
    pairs = [
        (known[key], [ball["x_mm"], ball["y_mm"], ball["z_mm"]])
        for scan in scans
        for ball in scan["balls"]
        if (key := (scan["scan"], ball["ball"])) in known and not ball["beyond_calibrated_depths"]
    ]
    if len(pairs) < 3:
        return {"balls": len(pairs), "rms_mm": None, "max_mm": None}
    true, found = np.array(pairs, float).transpose(1, 2, 0)
    middle = true.mean(1, keepdims=True)
    other = found.mean(1, keepdims=True)
    matrix = (true - middle) @ (found - other).T
    rotation = nearest_rotation(matrix)
    distance = np.linalg.norm(rotation @ (found - other) - (true - middle), axis=0)
    return {
        "balls": len(pairs),
        "rms_mm": float(np.sqrt((distance**2).mean())),
        "max_mm": float(distance.max()),
    }
