"""Tables of a simulated arm for tests of the import."""

import numpy as np

from workbench.jobs.robot.simulate import simulate
from workbench.recordings.importing import ImportOptions

PLACES = """
[base]
xyz_mm = [2300.0, -700.0, 400.0]
rpy_deg = [1.0, -2.0, 70.0]
[tool]
xyz_mm = [10.0, 40.0, 130.0]
rpy_deg = [20.0, 30.0, -60.0]
[errors]
length_mm = 0.2
angle_deg = 0.05
"""
"""Base, tool and deviations of the arm in every scene."""


def pose_scene(robot: str, samples: int, seed: int, more: str = "") -> str:
    """A scene file of external poses; `more`: further keys at its top level."""
    return f'''robot = "{robot}"
measures = "external-pose"
samples = {samples}
seed = {seed}
sigma_mm = 0.02
{more}{PLACES}'''


def simulated(folder, scene: str):
    """The recording that a scene makes; its file lies in `folder`."""
    path = folder / "scene.toml"
    path.write_text(scene)
    return simulate(path)


SCENE = pose_scene("ur10", 36, 8, "share_of_limits = 0.4")
UR10 = ImportOptions(robot="ur10")


def degrees(truth) -> np.ndarray:
    return np.rad2deg(truth.joints)


def write_rows(path, header, rows, separator=","):
    lines = [separator.join(header)]
    lines += [
        separator.join(f"{v:.10g}" if not isinstance(v, str) else v for v in row) for row in rows
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def tracker(path, truth, unit=1.0, names=("X [mm]", "Y [mm]", "Z [mm]")):
    return write_rows(path, names, truth.points * unit)


def assert_same_rows(made, truth, joints=1e-5, points=1e-3):
    assert np.abs(np.rad2deg(made.joints - truth.joints)).max() < joints
    assert np.abs(made.points - truth.points).max() < points
