"""The mapping that an import writes repeats it, also from another directory and after the folder was moved."""

import numpy as np
import pytest

from datasets.importers.mapping.model import read_mapping
from import_scenes import SCENE, degrees, simulated, write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def dh_table(path):
    nominal = load_robot("ur10")
    rows = []
    for k, (theta, d, a, alpha, _) in enumerate(nominal.geometry, 1):
        rows.append([k, np.rad2deg(theta), d, a, np.rad2deg(alpha)])
    return write_rows(path, ["joint", "theta [deg]", "d [mm]", "a [mm]", "alpha [deg]"], rows)


def measured(path, truth):
    names = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
    return write_rows(path, names, np.column_stack([degrees(truth), truth.points]))


def test_a_moved_mapping_keeps_its_robot(truth, tmp_path, monkeypatch):
    """The robot is named relative to the mapping file: the original table may be gone."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robots").mkdir()
    table = dh_table(tmp_path / "robots" / "arm.csv")
    source = measured(tmp_path / "monday.csv", truth)
    first = import_recording([source], tmp_path / "monday", ImportOptions(robot="robots/arm.csv"))
    elsewhere = tmp_path / "archive"
    elsewhere.mkdir()
    (tmp_path / "monday").rename(elsewhere / "monday")
    table.unlink()
    monkeypatch.chdir(elsewhere)
    mapping = read_mapping(elsewhere / "monday" / "import.toml")
    second = import_recording([source], tmp_path / "again", ImportOptions(mapping=mapping))
    third = read_mapping(tmp_path / "again" / "import.toml")
    assert third.robot == str(tmp_path / "again" / "robot.toml")
    np.testing.assert_array_equal(first.recording.joints, second.recording.joints)
    assert second.recording.robot == first.recording.robot


def test_a_built_in_robot_is_kept_by_name(truth, tmp_path):
    source = measured(tmp_path / "monday.csv", truth)
    import_recording([source], tmp_path / "out", ImportOptions(robot="ur10"))
    assert read_mapping(tmp_path / "out" / "import.toml").robot == "ur10"


def test_a_recording_is_named_after_its_folder(truth, tmp_path):
    source = measured(tmp_path / "monday.csv", truth)
    made = import_recording([source], tmp_path / "cell 3", ImportOptions(robot="ur10"))
    assert made.recording.name == "cell 3"
    assert "name" not in (tmp_path / "cell 3" / "recording.toml").read_text()


def test_a_refusal_names_the_folder_and_not_import(truth, tmp_path):
    rows = np.column_stack([degrees(truth), truth.points])
    rows[5:9, 6] += 60.0
    names = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
    source = write_rows(tmp_path / "odd.csv", names, rows)
    try:
        made = import_recording([source], tmp_path / "cell 4", ImportOptions(robot="ur10"))
        said = " ".join(made.warnings)
    except InputError as problem:
        said = str(problem)
    assert "'import'" not in said


def test_a_robot_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "import.toml").write_text('format = "import/1"\nrobot = []\n', encoding="utf-8")
    with pytest.raises(InputError, match="import.toml, key robot"):
        read_mapping(tmp_path / "import.toml")
