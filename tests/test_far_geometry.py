"""A recording with the robot of a similar model: named in import, check and calibrate with the robot that fits."""

from dataclasses import replace

import numpy as np
import pytest

from import_scenes import ImportOptions, degrees, pose_scene, simulated, write_rows
from robot_model import load_robot
from workbench.commands.shared.tables import _largest_lengths
from workbench.core.errors import InputError
from workbench.fitting.checked_samples import check_samples
from workbench.fitting.plausibility.robot_files.far_geometry import find_far_geometry
from workbench.recordings.importing import import_recording
from workbench.recordings.inspection import inspect_recording


@pytest.fixture(scope="module")
def ur10e(tmp_path_factory):
    scene = pose_scene("ur10e", 40, 19, "share_of_limits = 0.4")
    made = simulated(tmp_path_factory.mktemp("scene"), scene)
    return replace(made, measures="external-point")


def log(path, truth):
    header = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
    return write_rows(path, header, np.hstack([degrees(truth), truth.points]))


def test_the_right_robot_has_no_far_lengths(ur10e):
    assert find_far_geometry(load_robot("ur10e"), ur10e) is None


def test_the_import_asks_for_the_robot_that_fits(tmp_path, ur10e):
    path = log(tmp_path / "log.csv", ur10e)
    with pytest.raises(InputError, match=r"d4 = .* instead of 163.94.*--robot ur10e"):
        import_recording([path], tmp_path / "out", ImportOptions(robot="ur10"))
    kept = ImportOptions(robot="ur10", trust_data=True)
    made = import_recording([path], tmp_path / "out", kept)
    assert any("'ur10e' fits" in text for text in made.warnings)


def test_check_states_it_in_its_verdict(ur10e):
    sentence = inspect_recording(replace(ur10e, robot={"builtin": "ur10"})).sentence
    assert "d4 = " in sentence and "'ur10e'" in sentence


def test_the_verdict_of_a_calibration_gets_it(ur10e):
    found = check_samples(replace(ur10e, robot={"builtin": "ur10"}))
    assert "d4 = " in found.far_geometry and "'ur10e'" in found.far_geometry


def test_poses_of_another_robot_name_it_too(ur10e):
    poses = replace(ur10e, measures="external-pose")
    assert find_far_geometry(load_robot("ur10"), poses).other == "ur10e"
    assert find_far_geometry(load_robot("ur10e"), poses) is None


def test_a_wrong_length_of_a_robot_file_is_stated_with_the_robot_of_the_library(ur10e):
    """A length 15 mm off in a file of one's own, which no robot of the library explains but the right one."""
    robot = load_robot("ur10e")
    geometry = robot.geometry.copy()
    geometry[2, 2] += 15.0
    found = find_far_geometry(replace(robot, geometry=geometry, name="mine"), ur10e)
    assert found.other == "ur10e"
    assert any(text.startswith("a3 = ") for text in found.parameters)


def test_the_largest_length_is_shown_although_it_is_confounded():
    def row(name, deviation, unit="mm", free=True):
        keys = {"where": "joint-4", "name": name, "unit": unit, "free": free}
        return keys | {"deviation": deviation, "identifiable": False, "std": None}

    rows = [row("d4", 10.3), row("a4", 0.2), row("theta4", 3.0, "deg"), row("d2", 0.0)]
    assert [one["name"] for one in _largest_lengths(rows)] == ["d4", "a4"]
