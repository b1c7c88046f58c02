"""Another ABB IRB 120, touched with a portable measuring arm (Wu, Yang, Chen, Ren, T-ASE 2015).

MATLAB files: joints in degrees, points in mm. 36 calibration configurations with three points of
the tool each, 10 test configurations of the first of these points, and 30 test configurations of
a point that the calibration did not measure: 1.2 mm from the first one, so that it has to be a
reflector of its own and its place on the tool can only come from the 30 rows themselves.
"""

from pathlib import Path

import numpy as np

from datasets.formats.native import IRB120, checked, load_matrix, recording
from datasets.recording import Recording

PROBE_MM = 0.1
"""1 sigma of a coordinate: the three points keep their distance to 0.1 mm."""
FILE_AFFIXES = ("Cali", "Test", "Test"), ("", "", "2")


def read(folder: Path, variant: str) -> Recording:
    """Column `set`: 0 calibration, 1 test, 2 second test; `pose` numbers the 76 configurations."""
    names = [
        f"{a}{quantity}{b}.mat"
        for a, b in zip(*FILE_AFFIXES)
        for quantity in ("JointAngles", "Position")
    ]
    paths = checked(folder, *names)
    loaded = [load_matrix(path, path.stem) for path in paths]
    joints, points = loaded[0::2], loaded[1::2]
    reflector_counts = [len(p) // len(q) for q, p in zip(joints, points)]
    q = np.concatenate([np.repeat(a, k, axis=0) for a, k in zip(joints, reflector_counts)])
    pose = np.repeat(
        np.arange(1, sum(map(len, joints)) + 1),
        np.repeat(reflector_counts, [len(a) for a in joints]),
    )
    tests = np.repeat([1, 4], [len(points[1]), len(points[2])])
    reflector = np.concatenate([np.tile([1, 2, 3], len(joints[0])), tests])
    part = np.repeat([0, 1, 2], [len(p) for p in points])
    covariates = {"pose": pose, "reflector": reflector, "set": part}
    return recording(
        IRB120,
        q,
        np.concatenate(points),
        covariates,
        paths,
        "ABB IRB 120, portable measuring arm",
        PROBE_MM,
    )
