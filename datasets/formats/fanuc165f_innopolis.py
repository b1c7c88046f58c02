"""FANUC R-2000iC/165F with a laser tracker: 24 configurations, ten measurements each, three markers.

MATLAB file: q (240, 6) rad, mA mB mC (240, 3) m. The file's third joint is already free of the
coupling to the second one that FANUC controllers display.
"""

from pathlib import Path

import numpy as np

from datasets.formats.native import NOMINAL, checked, dh_robot, load_matrix, recording
from datasets.recording import Recording

REPEAT_MM = 0.05
"""1 sigma of a coordinate when a configuration is measured again."""


def read(folder: Path, variant: str) -> Recording:
    """`repeat` is the configuration, 1-24; `pose` the static pose, 1-240; reflectors 1-3 are markers A-C."""
    paths = checked(folder, "calibration_dataset.mat")
    q = np.rad2deg(load_matrix(paths[0], "q"))
    markers = np.stack([load_matrix(paths[0], name) for name in ("mA", "mB", "mC")], axis=1) * 1000
    new = np.r_[True, np.any(np.abs(np.diff(q, axis=0)) > 1e-4, axis=1)]
    pose = np.arange(1, len(q) + 1)
    covariates = {
        "pose": np.repeat(pose, 3),
        "repeat": np.repeat(np.cumsum(new), 3),
        "reflector": np.tile([1, 2, 3], len(q)),
    }
    return recording(
        _robot(),
        np.repeat(q, 3, axis=0),
        markers.reshape(-1, 3),
        covariates,
        paths,
        "FANUC R-2000iC/165F, laser tracker",
        REPEAT_MM,
    )


def _robot() -> dict:
    rows = (
        (0.0, 670.0, 312.0, -90.0),
        (-90.0, 0.0, 1075.0, 0.0),
        (0.0, 0.0, 225.0, -90.0),
        (0.0, 1280.0, 0.0, 90.0),
        (0.0, 0.0, 0.0, -90.0),
        (0.0, 215.0, 0.0, 0.0),
    )
    return dh_robot("FANUC R-2000iC/165F", NOMINAL, rows, sign=(1, 1, -1, -1, -1, -1))
