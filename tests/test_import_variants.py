"""Import of 60 variants of one recording: units, orders, Euler conventions, separators; right, or a question."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conftest import mostly_slow
from datasets.importers.mapping.rotations import EULER
from import_scenes import pose_scene, simulated
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

ROBOT = "abb_irb120"
JOINT_UNITS = {"deg": 1.0, "rad": np.pi / 180, "gon": 1 / 0.9}
LENGTH_UNITS = {"mm": 1.0, "m": 0.001, "in": 1 / 25.4}
SEPARATORS = [(",", "."), (";", ","), ("\t", "."), (" ", "."), ("\t", ","), ("|", "."), (";", ".")]
JOINTS = ["J{}", "Achse {}", "q{}", "A{}", "axis_{}", "joint_{}", "Gelenk {}"]
POINTS = ["{}", "Tracker {}", "pos_{}", "SMR {}", "Messpunkt {}"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), pose_scene(ROBOT, 40, 3))


def rotation_of(recording) -> Rotation:
    return Rotation.from_quat(np.stack([recording.columns[f"q{c}"] for c in "xyzw"], axis=1))


def rotation_columns(rotation: Rotation, form: str, unit: str) -> dict[str, np.ndarray]:
    """Columns of the rotations in a form whose header does not say which convention it is."""
    factor = JOINT_UNITS[unit]
    if form == "matrix":
        cells = rotation.as_matrix().reshape(-1, 9)
        return {f"R{i}{j}": cells[:, 3 * i + j - 4] for i in (1, 2, 3) for j in (1, 2, 3)}
    if form == "wxyz":
        return dict(zip(("q0", "q1", "q2", "q3"), np.roll(rotation.as_quat(), 1, axis=1).T))
    if form == "xyzw":
        return dict(zip(("quat0", "quat1", "quat2", "quat3"), rotation.as_quat().T))
    if form == "named":
        return dict(
            zip(("qz", "qw", "qx", "qy"), np.roll(rotation.as_quat(), 2, axis=1).T[[0, 1, 2, 3]])
        )
    if form == "vector":
        return dict(zip(("Rx", "Ry", "Rz"), factor * np.rad2deg(rotation.as_rotvec()).T))
    frame, sequence = form.split()
    letters = sequence if frame == "intrinsic" else sequence.lower()
    return dict(zip(("Rx", "Ry", "Rz"), factor * rotation.as_euler(letters, degrees=True).T))


def variants():
    """60 cases: every Euler convention, other forms, and units, names and separators that change from case to case."""
    forms = [*EULER, *EULER, "matrix", "wxyz", "xyzw", "named", "vector", "vector"]
    forms += ["matrix", "wxyz", "xyzw", "named", "vector", "vector"]
    units = list(product(JOINT_UNITS, LENGTH_UNITS, ("deg", "rad")))
    for k, form in enumerate(forms):
        joint, length, angle = units[(7 * k) % len(units)]
        separator = SEPARATORS[k % len(SEPARATORS)]
        yield pytest.param(k, form, joint, length, angle, separator, id=f"{k}-{form}")


VARIANTS = list(variants())


def write_table(path, columns, separator, decimal, comment=""):
    lines = [comment] if comment else []
    quoted = [f'"{name}"' if separator == " " else name for name in columns]
    lines.append(separator.join(quoted))
    for row in zip(*columns.values()):
        cells = [f"{value:.10g}".replace(".", decimal) for value in row]
        lines.append(separator.join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def is_same(made, truth) -> bool:
    turned = (rotation_of(made).inv() * rotation_of(truth)).magnitude().max()
    moved = np.abs(made.points - truth.points).max()
    joined = np.abs(made.joints - truth.joints).max()
    return turned < 1e-6 and moved < 1e-4 and joined < 1e-6


def table_of(recording, k, form, joint, length, angle) -> dict[str, np.ndarray]:
    joints = {
        JOINTS[k % len(JOINTS)].format(number + 1): np.rad2deg(row) * JOINT_UNITS[joint]
        for number, row in enumerate(recording.joints.T)
    }
    points = {
        POINTS[k % len(POINTS)].format("XYZ"[axis]): row * LENGTH_UNITS[length]
        for axis, row in enumerate(recording.points.T)
    }
    turns = rotation_columns(rotation_of(recording), form, angle)
    return {**joints, **points, **turns} if k % 2 else {**points, **turns, **joints}


def test_there_are_60_variants():
    assert len(VARIANTS) == 60


@pytest.mark.parametrize(
    ("k", "form", "joint", "length", "angle", "separator"), mostly_slow(VARIANTS, 12, 16)
)
def test_variant_is_right(k, form, joint, length, angle, separator, truth, tmp_path):
    path = tmp_path / "table.txt"
    columns = table_of(truth, k, form, joint, length, angle)
    write_table(path, columns, *separator, comment="# exported" if k % 3 == 0 else "")
    made = import_recording([path], tmp_path / "out", ImportOptions(robot=ROBOT))
    assert made.recording.measures == "external-pose"
    assert is_same(made.recording, truth)


@pytest.mark.parametrize(
    ("k", "form", "joint", "length", "angle", "separator"), mostly_slow(VARIANTS[::20], 0, 2)
)
def test_variant_of_few_noisy_rows_is_right_or_asked(
    k, form, joint, length, angle, separator, truth, tmp_path
):
    """Eight rows with noise of 2 mm and 1 deg do not always decide; what is taken must be right."""
    rng = np.random.default_rng(k)
    few = truth.select(np.arange(8))
    turned = rotation_of(few) * Rotation.from_rotvec(np.deg2rad(1.0) * rng.normal(size=(8, 3)))
    noisy = dict(few.columns)
    for axis in "xyz":
        noisy[f"{axis}_mm"] = noisy[f"{axis}_mm"] + 2.0 * rng.normal(size=8)
    noisy |= dict(zip(("qx", "qy", "qz", "qw"), turned.as_quat().T))
    few = replace(few, columns=noisy)
    path = tmp_path / "table.txt"
    write_table(path, table_of(few, k, form, joint, length, angle), *separator)
    try:
        made = import_recording([path], tmp_path / "out", ImportOptions(robot=ROBOT))
    except InputError as question:
        assert "--map" in str(question) or "--trust-data" in str(question)
        return
    assert is_same(made.recording, few)
