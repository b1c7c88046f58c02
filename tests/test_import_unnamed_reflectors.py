"""Tables without headers: several reflectors in one row, and joints that stand still."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from import_scenes import SCENE, UR10, degrees, simulated
from workbench.recordings.importing import ImportOptions, import_recording

OFFSETS = np.array([[0.0, 0.0, 0.0], [120.0, 10.0, -20.0], [-30.0, 90.0, 60.0]])


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def seen(truth) -> np.ndarray:
    """(n, 3, 3) mm: three reflectors on the tool."""
    turn = Rotation.from_quat(np.stack([truth.columns[f"q{k}"] for k in "xyzw"], axis=1))
    return truth.points[:, None] + np.stack([turn.apply(offset) for offset in OFFSETS], axis=1)


def test_reflectors_in_one_row_without_headers(truth, tmp_path):
    zeros = np.zeros((truth.n, 2))
    cells = np.column_stack([seen(truth).reshape(truth.n, 9), zeros, degrees(truth)])
    np.savetxt(tmp_path / "N123.csv", cells, "%.8f")
    made = import_recording([tmp_path / "N123.csv"], tmp_path / "out", UR10)
    assert made.mapping.joints.columns == tuple(f"column {k}" for k in range(12, 18))
    assert made.mapping.reflectors["2"] == ("column 4", "column 5", "column 6")
    assert made.recording.n == 3 * truth.n
    assert made.fits[0].rms_mm < 0.1
    assert "3 reflectors on one tool" in made.warnings[0]
    assert not {"column 4", "column 9"} & set(made.unused)
    options = ImportOptions(robot="ur10", mapping=made.mapping)
    again = import_recording([tmp_path / "N123.csv"], tmp_path / "again", options)
    assert np.allclose(again.recording.points, made.recording.points)
