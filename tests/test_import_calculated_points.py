"""Points that a controller calculated from its own calibrated kinematics, in tables of a simulated arm."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
from datasets.importers.mapping.model import Group, Mapping
from import_scenes import UR10, degrees, pose_scene, simulated, write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.fitting.checked_samples import check_samples
from workbench.recordings.importing import import_recording
from workbench.recordings.importing.calculated_points import guessed_robot

JOINTS = [f"j{k}" for k in range(1, 7)]
SCENE = pose_scene("ur10", 50, 31, "share_of_limits = 0.4").replace(
    "sigma_mm = 0.02", "sigma_mm = 1e-6"
)


@pytest.fixture(scope="module")
def calculated(tmp_path_factory):
    """Poses without noise of an arm whose lengths and angles differ from the nominal ones."""
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def table(path, calculated, more=(), measured=None):
    """Readings and positions with the digits of a controller, and columns of an instrument."""
    columns = [np.round(degrees(calculated), 4), np.round(calculated.points, 3)]
    if measured is not None:
        columns.append(measured)
    return write_rows(path, [*JOINTS, "px", "py", "pz", *more], np.column_stack(columns))


def measured_by_a_tracker(calculated) -> np.ndarray:
    """(n, 3) mm: the same positions in another frame, with noise."""
    noise = np.random.default_rng(4).normal(scale=0.05, size=calculated.points.shape)
    turn = Rotation.from_euler("xyz", [10, -20, 130], degrees=True)
    return turn.apply(calculated.points) + [500.0, -1500.0, 200.0] + noise


def test_points_of_calibrated_kinematics_are_a_doubt(calculated, tmp_path):
    path = table(tmp_path / "t.csv", calculated)
    made = import_recording([path], tmp_path / "out", UR10)
    (doubt,) = [text for text in made.suspicions if "the controller calculated" in text]
    assert "other lengths and angles than the nominal ones" in doubt


def test_a_second_point_of_the_table_is_offered(calculated, tmp_path):
    names = ("bx", "by", "bz")
    path = table(tmp_path / "t.csv", calculated, names, measured_by_a_tracker(calculated))
    with pytest.raises(InputError, match="bx, by, bz fit as a measured point.*external-point"):
        import_recording([path], tmp_path / "out", UR10)
    stated = replace(UR10, mapping=Mapping(point=Group(names)))
    made = import_recording([path], tmp_path / "out", stated)
    assert made.mapping.point.columns == names
    assert not any("calculated" in text for text in made.warnings)


def test_measured_points_raise_no_doubt(calculated, tmp_path):
    rows = np.column_stack([degrees(calculated), measured_by_a_tracker(calculated)])
    path = write_rows(tmp_path / "t.csv", [*JOINTS, "px", "py", "pz"], rows)
    made = import_recording([path], tmp_path / "out", UR10)
    assert not any("calculated" in text for text in made.warnings)


def test_doubts_of_the_import_are_repeated_by_later_commands(calculated, tmp_path):
    """The recording alone does not show who calculated its points; written again, it still says so."""
    path = table(tmp_path / "t.csv", calculated)
    import_recording([path], tmp_path / "out", UR10)
    read = datasets.read(tmp_path / "out")
    assert any("the controller calculated" in text for text in read.warnings)
    assert any("the controller calculated" in text for text in check_samples(read).warnings)
    again = datasets.read(datasets.write(read, tmp_path / "again"))
    assert again.warnings == read.warnings


def test_a_robot_that_nobody_named_is_a_guess(calculated):
    """Its lengths differ from the data: poses of a controller are then those of another arm."""
    builder = SimpleNamespace(robot=load_robot("ur10"), table=SimpleNamespace(file="t.csv"))
    (sentence,) = guessed_robot(builder, calculated, (), UR10)
    misfit = float(re.search(r"a misfit of (\S+) mm at its nominal lengths", sentence)[1])
    assert "is a guess" in sentence and 0.1 < misfit < 50
    with pytest.raises(InputError, match="is a guess.*the controller calculated.*--trust-data"):
        guessed_robot(builder, calculated, ("The points: the controller calculated.",), UR10)
