"""Configuration data of KUKA, ABB and FANUC programs choose the joint readings that a pose takes."""

import numpy as np
import pytest

from counted_robots import FILES, arm, counted, drawn, program, sides_of
from datasets.importers.mapping.model import mapping_from_keys, write_mapping
from robot_model import load_robot
from robot_model.controller_conventions import parts_like_controller
from workbench.core.errors import InputError
from workbench.files.targets import read_programme, target_warnings
from workbench.jobs.robot.compensation.stated_configuration import with_stated_configuration

MAKERS = ["KUKA", "ABB", "FANUC"]
SIGNS, ZEROS = (1, 1, -1, 1, -1, -1), (0.0, 90.0, -90.0, 0.0, 0.0, 180.0)
"""Readings of a robot file of its own: signs * (those of the controller) + zeros."""


def written(maker, readings, folder):
    path = folder / FILES[maker]
    path.write_text(program(maker, readings))
    return path


def own(readings):
    return readings * SIGNS + ZEROS


def same_turn(found, wanted):
    """Largest difference in deg, whole revolutions aside."""
    return np.abs((np.rad2deg(found) - wanted + 180) % 360 - 180).max()


def one_side(maker, n, sides=(False, True, False)):
    """(n, 6) deg: readings of the controller in one configuration."""
    found = drawn(maker, 400)
    return found[(sides_of(maker, found) == sides).all(1)][:n]


@pytest.mark.parametrize("maker", MAKERS)
def test_the_readings_are_those_that_the_program_was_taught_with(maker, tmp_path):
    taught, robot = drawn(maker, 12), counted(maker)
    assert len(np.unique(sides_of(maker, taught), axis=0)) >= 3
    programme = read_programme(written(maker, taught, tmp_path), robot)
    made, (sentence,) = with_stated_configuration(programme, arm(robot))
    np.testing.assert_allclose(np.rad2deg(made.readings), taught, atol=1e-2)
    assert (
        "12 of 12 positions" in sentence and not made.anywhere and not target_warnings(made, robot)
    )


def test_data_that_no_readings_fulfil_are_named(tmp_path):
    path = written("KUKA", drawn("KUKA", 3), tmp_path)
    lines = path.read_text().split("\n")
    # axes 1 and 4 on the other side, and the rest as it was
    turn = int(lines[3].split("T ")[1].rstrip("}"))
    lines[3] = lines[3].replace(f"T {turn}}}", f"T {turn ^ 0b001001}}}")
    path.write_text("\n".join(lines))
    robot = counted("KUKA")
    made, said = with_stated_configuration(read_programme(path, robot), arm(robot))
    assert made.anywhere and "2 of 3 positions" in said[0]
    assert "reach position 2: another configuration is taken" in said[1]


@pytest.mark.parametrize("maker", MAKERS)
def test_builtin_robots_count_like_their_controllers(maker):
    assert parts_like_controller(counted(maker), maker) == (True, True)
    others = [other for other in MAKERS if other != maker]
    assert not any(all(parts_like_controller(counted(other), maker)) for other in others)
    assert not all(parts_like_controller(load_robot("staubli_tx60"), maker))
    assert parts_like_controller(counted(maker, (1, 1, 1, 1, -1, 1)), maker) == (True, False)


@pytest.mark.parametrize("maker", MAKERS)
def test_a_recording_in_one_configuration_tells_what_the_data_mean(maker, tmp_path):
    robot, taught = counted(maker, SIGNS, ZEROS), one_side(maker, 20)
    programme = read_programme(written(maker, taught[:8], tmp_path), robot)
    made, said = with_stated_configuration(programme, arm(robot, own(taught[8:])))
    assert same_turn(made.readings, own(taught[:8])) < 1e-2
    assert not made.anywhere and f"than a controller of {maker}" in said[1]


@pytest.mark.parametrize("maker", MAKERS)
def test_data_that_may_mean_several_configurations_are_asked_for(maker, tmp_path):
    robot, taught = counted(maker, SIGNS, ZEROS), one_side(maker, 8)
    programme = read_programme(written(maker, taught, tmp_path), robot)
    for recorded, words in (
        (own(drawn(maker, 60)), "of their possible meanings fit"),
        (None, "none"),
    ):
        with pytest.raises(InputError, match=rf"{words}.*\[controller\].*--start"):
            with_stated_configuration(programme, arm(robot, recorded))


def test_a_wrist_that_counts_otherwise_leaves_the_arm_known(tmp_path):
    """The recording has both shoulders, which the data of this robot still distinguish."""
    signs = (1, 1, 1, 1, -1, 1)
    robot, every = counted("FANUC", signs), drawn("FANUC", 400)
    taught = every[~sides_of("FANUC", every)[:, 2]]
    assert len(np.unique(sides_of("FANUC", taught[:8]), axis=0)) >= 2
    programme = read_programme(written("FANUC", taught[:8], tmp_path), robot)
    made, said = with_stated_configuration(programme, arm(robot, taught[8:60] * signs))
    assert same_turn(made.readings, taught[:8] * signs) < 1e-2 and len(said) == 2


@pytest.mark.parametrize("maker", MAKERS)
def test_a_mapping_states_how_the_controller_counts(maker, tmp_path):
    robot, taught = counted(maker, SIGNS, ZEROS), drawn(maker, 12)
    zeros = [float(-sign * zero) for sign, zero in zip(SIGNS, ZEROS)]
    controller = {"joint_signs": list(SIGNS), "joint_zeros_deg": zeros}
    mapping = mapping_from_keys({"format": "import/1", "controller": controller}, "map.toml")
    write_mapping(mapping, tmp_path / "map.toml")
    path = written(maker, taught, tmp_path)
    programme = read_programme(path, robot, tmp_path / "map.toml")
    made, said = with_stated_configuration(programme, arm(robot))
    np.testing.assert_allclose(np.rad2deg(made.readings), own(taught), atol=1e-2)
    assert "12 of 12 positions" in said[0] and len(said) == 1


@pytest.mark.parametrize(
    "keys", [{}, {"joint_signs": [1, 1, 1]}, {"joint_signs": [2] * 6}, {"signs": [1] * 6}, 3]
)
def test_a_section_that_cannot_be_is_refused(keys):
    with pytest.raises(InputError, match=r"map.toml, \[controller\].*expected.*found"):
        mapping_from_keys({"format": "import/1", "controller": keys}, "map.toml")
