"""ABB IRB 120 with a FARO laser tracker: 1000 configurations, three reflectors on the tool, three near the base.

Text files, one row a configuration in order of acquisition: joints in degrees, points in mm in
the tracker's frame. `irb120_faro` takes the commanded joints, `irb120_faro:read-back` what the
controller answered right after the move returned.
"""

from pathlib import Path

import numpy as np

from datasets.formats.native import IRB120, checked, recording
from datasets.recording import Recording

TRACKER_MM = 0.005
"""1 sigma of a coordinate: reflectors on one tool keep their distance to 4-7 um."""
LOST_MM = 0.5
"""Largest distance of a base reflector from its median; farther points are lost or wrong reflectors."""
JOINTS = {"": "commanded_joints_deg.txt", "read-back": "measured_joints.txt"}


def read(folder: Path, variant: str) -> Recording:
    """Reflectors 1-3 on the tool and 4-6 fixed to the base; `pose` is the configuration.

    Base reflectors that were lost (all zeros) or jumped are left out.
    """
    names = [
        JOINTS[variant],
        *(f"measured_{p}_{k}.txt" for p in ("SMR", "base") for k in (1, 2, 3)),
    ]
    paths = checked(folder, *names)
    joints, *points = (np.loadtxt(path, ndmin=2) for path in paths)
    seen = np.stack(points, axis=1)
    keep = np.concatenate([np.ones((len(joints), 3), bool), _found(seen[:, 3:])], axis=1)
    pose, reflector = np.nonzero(keep)
    covariates = {
        "pose": pose + 1,
        "reflector": reflector + 1,
        "fixed_to": np.where(reflector < 3, "tool", "base"),
    }
    title = "ABB IRB 120, FARO tracker, " + ("read-back joints" if variant else "commanded joints")
    return recording(
        IRB120, joints[pose], seen[pose, reflector], covariates, paths, title, TRACKER_MM
    )


def _found(base: np.ndarray) -> np.ndarray:
    """(n, 3) bool: base reflectors (n, 3 reflectors, 3) that are there and near their median."""
    is_measured = np.any(base != 0, axis=2)
    middle = np.stack([np.median(base[is_measured[:, k], k], axis=0) for k in range(3)])
    return is_measured & (np.abs(base - middle).max(axis=2) <= LOST_MM)
