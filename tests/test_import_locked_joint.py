"""Joints at rest: two tables without headers, a locked joint, and units where few joints move."""

from dataclasses import replace

import numpy as np
import pytest

from datasets.importers.mapping.model import read_mapping
from import_scenes import SCENE, UR10, degrees, simulated, write_rows
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.recordings.importing import import_recording

TRUST = replace(UR10, trust_data=True)


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def locked(truth) -> np.ndarray:
    """(n, 6) readings in deg of which the fourth is constant; the measured points contradict it."""
    readings = degrees(truth)
    readings[:, 3] = 12.5
    return readings


def plain(path, rows):
    path.write_text("\n".join(" ".join(f"{v:.6f}" for v in row) for row in rows) + "\n")
    return path


def test_columns_of_two_files_without_headers_stay_together(truth, tmp_path):
    files = [plain(tmp_path / "enc.txt", locked(truth)), plain(tmp_path / "ndi.txt", truth.points)]
    with pytest.raises(InputError) as refused:
        import_recording(files, tmp_path / "out", UR10)
    example = refused.value.example
    joints = [f"enc: column {k}" for k in range(1, 7)]
    for names in (joints, [f"ndi: column {k}" for k in range(1, 4)]):
        assert f"columns = [{', '.join(f'{chr(34)}{name}{chr(34)}' for name in names)}]" in example
    (tmp_path / "map.toml").write_text(example)
    options = replace(TRUST, mapping=read_mapping(tmp_path / "map.toml"))
    made = import_recording(files, tmp_path / "out", options)
    assert list(made.mapping.joints.columns) == joints
    assert made.recording.n == truth.n


def test_a_locked_joint_is_accepted_with_trusted_data(truth, tmp_path):
    header = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    cells = np.column_stack([locked(truth), truth.points])
    table = write_rows(tmp_path / "t.csv", header, cells)
    with pytest.raises(InputError, match="'J4': is constant.*--trust-data"):
        import_recording([table], tmp_path / "out", UR10)
    made = import_recording([table], tmp_path / "out", TRUST)
    assert made.mapping.joints.unit == "deg"
    assert made.mapping.point.unit == "mm"
    assert any("is constant" in warning for warning in made.warnings)


def test_a_target_far_beyond_the_reach_of_the_arm_is_no_reading(tmp_path):
    rng = np.random.default_rng(6)
    robot = load_robot("ur10")
    readings = np.tile([10.0, -60.0, 80.0, 20.0, 50.0, 30.0], (25, 1))
    readings[:, :2] += rng.uniform(-40, 40, (25, 2))
    places = forward(robot, np.deg2rad(readings).T).end_origin.T + [2000.0, 300.0, 100.0]
    header = [*(f"J{k}" for k in range(1, 7)), "X", "Y", "Z"]
    cells = np.column_stack([readings, places + 0.05 * rng.normal(size=places.shape)])
    table = write_rows(tmp_path / "t.csv", header, cells)
    made = import_recording([table], tmp_path / "out", UR10)
    assert made.mapping.point.unit == "mm"
    assert all("point in metres" not in fit.title for fit in made.fits)
