"""Yaskawa Motoman MA1400, two arms on one turning axis, with a Leica laser tracker.

MATLAB variable `dataset`, 26 columns in m and rad (Rozlivek, Rustler, Stepanova, Hoffmann 2021):
0 pose, 6 turning axis, 7-12 joints S L U R B T of the right arm, 13-18 of the left one, 19-21
reflector, 22 its uncertainty in all, 23-25 for each coordinate. A pose has a row for every marker
that a camera saw, all with the same joints and reflector.
"""

from pathlib import Path

import numpy as np

from datasets.formats.native import NOMINAL, checked, dh_robot, load_matrix, recording
from datasets.recording import Recording

FILES = {
    "right": "right_hand_6x6x6",
    "left": "left_hand_6x6x6",
    "repeat-table": "rep_table1",
    "repeat-wall": "rep_wall1",
}


def read(folder: Path, variant: str) -> Recording:
    """One row a pose: the first of its rows; poses without a tracker reading are left out.

    `sigma_mm` is the tracker's own uncertainty of the point, divided by the root of 3. The repeat
    variants are one commanded pose of the right arm again and again (`repeat` = 1).
    """
    paths = checked(folder, f"leica_{FILES[variant]}_dataset.mat")
    data = load_matrix(paths[0], "dataset")
    data = data[np.unique(data[:, 0], return_index=True)[1]]
    data = data[np.isfinite(data[:, 19:23]).all(axis=1)]
    arm = slice(13, 19) if variant == "left" else slice(7, 13)
    joints = np.rad2deg(np.column_stack([data[:, 6], data[:, arm]]))
    covariates = {"pose": data[:, 0], "sigma_mm": data[:, 22] * 1000 / np.sqrt(3)}
    if variant.startswith("repeat"):
        covariates["repeat"] = np.ones(len(data))
    title = f"Motoman MA1400, {variant}, Leica tracker"
    return recording(_robot(variant), joints, data[:, 19:22] * 1000, covariates, paths, title, None)


def _robot(variant: str) -> dict:
    """Turning axis TT, then S L U R B T; what is held follows the flange and is left to the solve."""
    tilt = -15.0 if variant == "left" else 15.0
    rows = (
        (-90.0, -263.0, 0.0, tilt),
        (0.0, 1415.9, 150.0, -90.0),
        (-90.0, 0.0, 614.0, 180.0),
        (0.0, 0.0, 200.0, -90.0),
        (0.0, -640.0, 0.0, 90.0),
        (-90.0, 0.0, 30.0, 90.0),
        (0.0, 200.0, 0.0, 0.0),
    )
    side = "left" if variant == "left" else "right"
    return dh_robot(f"Motoman MA1400, {side} arm on its turning axis", NOMINAL, rows)
