"""Joint columns with units of their own: stated in the headers, stated in a mapping file, or stated nowhere."""

import numpy as np
import pytest

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.model import Group, Mapping, read_mapping
from import_scenes import SCENE, UR10, assert_same_rows, degrees, simulated, write_rows
from robot_model import load_robot
from scenes import SLIDING
from workbench.core.errors import InputError
from workbench.fitting.plausibility import check_plausibility
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.builder import Builder

POINT = ["X [mm]", "Y [mm]", "Z [mm]"]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def table(path, truth, readings, names):
    """A table of joint readings (n, 6) under the given headers, and of the points."""
    return write_rows(path, [*names, *POINT], np.hstack([readings, truth.points]))


def with_one_in_degrees(truth, joint: int):
    readings = np.deg2rad(degrees(truth))
    readings[:, joint - 1] = degrees(truth)[:, joint - 1]
    return readings


def test_units_that_headers_state_for_single_columns_are_used(tmp_path, truth):
    names = [f"q{k} [{'deg' if k == 4 else 'rad'}]" for k in range(1, 7)]
    path = table(tmp_path / "log.csv", truth, with_one_in_degrees(truth, 4), names)
    made = import_recording([path], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)
    assert made.mapping.joints.unit == ("rad", "rad", "rad", "deg", "rad", "rad")
    # the mapping that was written imports the same table again
    again = ImportOptions(mapping=read_mapping(tmp_path / "out/import.toml"), robot="ur10")
    assert_same_rows(import_recording([path], tmp_path / "again", again).recording, truth)


def test_columns_without_a_unit_are_tested_where_one_states_its_unit(tmp_path, truth):
    names = ["q1", "q2", "q3", "q4 [deg]", "q5", "q6"]
    path = table(tmp_path / "log.csv", truth, with_one_in_degrees(truth, 4), names)
    made = import_recording([path], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)


@pytest.mark.parametrize("joint", [2, 5])
def test_one_column_in_degrees_among_radians_is_named(tmp_path, truth, joint):
    path = table(tmp_path / "log.csv", truth, with_one_in_degrees(truth, joint), _achse())
    with pytest.raises(InputError, match=f"'Achse {joint}' in degrees"):
        import_recording([path], tmp_path / "out", UR10)


def _achse():
    return [f"Achse {k}" for k in range(1, 7)]


def test_two_columns_in_radians_among_degrees_are_named(tmp_path, truth):
    readings = degrees(truth)
    readings[:, 3:5] = np.deg2rad(readings[:, 3:5])
    path = table(tmp_path / "log.csv", truth, readings, _achse())
    with pytest.raises(InputError, match="'Achse 4'.*'Achse 5'"):
        import_recording([path], tmp_path / "out", UR10)


def test_a_stated_unit_that_holds_for_all_columns_but_one_is_named(tmp_path, truth):
    names = [f"q{k} [rad]" for k in range(1, 7)]
    path = table(tmp_path / "log.csv", truth, with_one_in_degrees(truth, 3), names)
    with pytest.raises(InputError, match=r"'q3 \[rad\]' in degrees"):
        import_recording([path], tmp_path / "out", UR10)


def test_the_choice_at_a_terminal_is_used(tmp_path, truth):
    path = table(tmp_path / "log.csv", truth, with_one_in_degrees(truth, 5), _achse())
    asked = []
    options = ImportOptions(robot="ur10", ask=lambda question: asked.append(question) or 0)
    assert_same_rows(import_recording([path], tmp_path / "out", options).recording, truth)
    assert len(asked) == 1


def test_coordinates_of_different_units_are_converted_by_their_headers(tmp_path, truth):
    points = truth.points / [1.0, 1000.0, 25.4]
    header = [*(f"q{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [m]", "Z [in]"]
    path = write_rows(tmp_path / "log.csv", header, np.hstack([degrees(truth), points]))
    made = import_recording([path], tmp_path / "out", UR10)
    assert_same_rows(made.recording, truth)


def test_a_list_of_units_of_another_length_is_refused(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text('[joints]\ncolumns = ["a", "b", "c"]\nunit = ["deg", "rad"]\n')
    with pytest.raises(InputError, match="3 units, one for each column, found 2"):
        read_mapping(path)


def test_a_recording_with_a_column_converted_twice_is_named(truth):
    """The reverse of a column in radians: degrees that were multiplied by 180/pi."""
    from dataclasses import replace

    from robot_model import load_robot

    columns = {**truth.columns, "q4_deg": np.rad2deg(truth.columns["q4_deg"])}
    found = check_plausibility(load_robot("ur10"), replace(truth, columns=columns))
    assert found[0].certain
    assert "q4_deg" in found[0].sentence
    assert "converted from radians" in found[0].sentence


def test_the_form_of_the_app_keeps_the_units_of_single_columns():
    from workbench.app.wizard.form import form_rows, with_cell

    keys = {"joints": {"columns": ["a", "b"], "unit": ["deg", "rad"]}}
    (row,) = [one for one in form_rows(keys, None) if one["name"] == "joints"]
    assert row["unit"] == "deg, rad" and {"title": "deg, rad", "value": "deg, rad"} in row["units"]
    assert with_cell(keys, "joints", "unit", row["unit"]) == keys
    assert with_cell(keys, "joints", "unit", "gon")["joints"]["unit"] == "gon"
    taken = with_cell(keys, "point", "columns", ["a"])
    assert taken["joints"] == {"columns": ["b"], "unit": ["rad"]}


def test_a_table_without_a_named_robot_names_robot_and_column(tmp_path, truth):
    path = table(tmp_path / "log.csv", truth, with_one_in_degrees(truth, 5), _achse())
    with pytest.raises(InputError, match="only ur10 with columns in different units.*'Achse 5'"):
        import_recording([path], tmp_path / "out", ImportOptions())


@pytest.mark.parametrize("unit", ["°C", "K", "s", "kg", "A", "V"])
def test_another_quantity_of_a_joint_is_no_reading(unit):
    assert read_header(f"J1 [{unit}]").kind != "joint"
    assert read_header("J1 [°]").kind == read_header("J1 [mm]").kind == "joint"


@pytest.mark.parametrize("unit, point, expected", [("deg", "m", "m"), ("rad", None, "mm")])
def test_the_mapping_states_the_unit_of_prismatic_joints(unit, point, expected):
    robot = load_robot(SLIDING)
    slides = robot.prismatic
    names = tuple(f"J{k}" for k in range(1, len(slides) + 1))
    mapping = Mapping(joints=Group(names, unit, None), point=Group(("X", "Y", "Z"), point, None))
    made = Builder(None, {}, robot, None).with_lengths_of_slides(mapping)
    assert slides.any()
    assert made.joints.unit == tuple(expected if slide else unit for slide in slides)
    assert Builder(None, {}, robot, None).with_lengths_of_slides(made) == made
