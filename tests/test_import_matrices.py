"""Poses as elements of matrices: counted from 0 or 1, refused in a sentence, and missing columns are named."""

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.mapping.model import read_mapping
from import_scenes import degrees, pose_scene, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

JOINTS = [f"q{k}" for k in range(1, 7)]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), pose_scene("abb_irb120", 40, 5))


def measured(truth) -> np.ndarray:
    """(n, 4, 4) measured poses."""
    quaternions = np.column_stack([truth.columns[name] for name in ("qx", "qy", "qz", "qw")])
    poses = np.tile(np.eye(4), (truth.n, 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    poses[:, :3, 3] = truth.points
    return poses


def table(path, truth, first=0, poses=None):
    """Joint readings and the rows of homogeneous matrices, whose elements are counted from `first`."""
    poses = measured(truth) if poses is None else poses
    names = [f"m_{r}{c}" for r, c in product(range(first, first + 4), repeat=2)]
    return write_rows(
        path, [*JOINTS, *names], np.column_stack([degrees(truth), poses.reshape(-1, 16)])
    )


@pytest.mark.parametrize("first", [0, 1])
def test_the_elements_of_a_matrix_are_counted_from_0_or_1(first, truth, tmp_path):
    source = table(tmp_path / "poses.csv", truth, first)
    options = ImportOptions(robot="abb_irb120")
    made = import_recording([source], tmp_path / "out", options)
    expected = [f"m_{r}{first + 3}" for r in range(first, first + 3)]
    assert list(made.mapping.point.columns) == expected
    assert made.mapping.rotation.columns[0] == f"m_{first}{first}"
    assert made.recording.measures == "external-pose"


@pytest.mark.parametrize("trust_data", [False, True])
def test_matrices_that_do_not_fit_are_refused_in_a_sentence(trust_data, truth, tmp_path):
    """Columns of a matrix have no other order, so that the search for one is skipped."""
    source = table(tmp_path / "poses.csv", truth, poses=measured(truth)[::-1])
    options = ImportOptions(robot="abb_irb120", trust_data=trust_data)
    with pytest.raises(InputError, match="poses.csv"):
        import_recording([source], tmp_path / "out", options)


def test_joint_columns_that_the_table_does_not_have_are_named(truth, tmp_path):
    source = table(tmp_path / "poses.csv", truth)
    names = ", ".join(f'"axis{k}"' for k in range(1, 7))
    mapping = tmp_path / "map.toml"
    mapping.write_text(f'format = "import/1"\n[joints]\ncolumns = [{names}]\n')
    options = ImportOptions(robot="abb_irb120", mapping=read_mapping(mapping))
    with pytest.raises(InputError, match="axis1.*no such column"):
        import_recording([source], tmp_path / "out", options)
