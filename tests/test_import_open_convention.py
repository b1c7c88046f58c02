"""Tables of a robot whose Denavit-Hartenberg convention is open: mistakes and few rows of a simulated arm."""

import numpy as np
import pytest

from import_scenes import write_rows
from robot_model import load_robot
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.robots import robot_candidates
from workbench.recordings.templates.contact import TrueArm, touching_point

HEADER = [*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
ARM = """joint,theta,d [mm],a [mm],alpha [deg]
1,q1,430,120,-90
2,q2-90,0,610,0
3,q3,0,95,-90
4,q4,575,0,90
5,q5,0,0,-90
6,q6,110,0,0
"""
BALL = np.array([800.0, 200.0, 250.0])
TOOL = np.array([40.0, -25.0, 160.0])


@pytest.fixture(scope="module")
def robot_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.csv"
    path.write_text(ARM)
    return path


def true_arm(robot_file, rng) -> TrueArm:
    """The arm of the table in the standard convention, with small errors of its geometry."""
    titles = robot_candidates(str(robot_file), "rows")
    keys = next(keys for title, keys in titles.items() if "standard" in title)
    return TrueArm.of(load_robot(keys, "arm"), rng, length_mm=0.1, angle_deg=0.01)


def rows_of_a_tracker(robot_file, count: int) -> np.ndarray:
    """(n, 9): readings in deg and the tool in a tracker's frame, mm."""
    rng = np.random.default_rng(17)
    arm = true_arm(robot_file, rng)
    readings = np.deg2rad(rng.uniform(-50, 50, (count, 6)))
    turn, origin = arm.flange(readings)
    points = origin + turn @ TOOL + [2000.0, -400.0, 700.0]
    return np.column_stack([np.rad2deg(readings), points + rng.normal(scale=0.05, size=(count, 3))])


def rows_of_a_sensor(robot_file, count: int) -> np.ndarray:
    """(n, 9): readings in deg and a fixed ball in the field of a sensor on the flange, mm."""
    rng = np.random.default_rng(23)
    arm = true_arm(robot_file, rng)
    readings = arm.poses_with(count, rng, touching_point(TOOL, BALL), sigma_mm=12.0)
    turn, origin = arm.flange(readings)
    points = np.einsum("nji,nj->ni", turn, BALL - origin) - TOOL
    return np.column_stack([np.rad2deg(readings), points + rng.normal(scale=0.05, size=(count, 3))])


def imported(folder, robot_file, rows, trust_data=False):
    path = write_rows(folder / "rows.csv", HEADER, rows)
    options = ImportOptions(robot=str(robot_file), trust_data=trust_data)
    return import_recording([path], folder / "out", options)


def test_columns_exchanged_from_a_row_on_are_named(robot_file, tmp_path):
    rows = rows_of_a_tracker(robot_file, 50)
    rows[25:, [6, 7]] = rows[25:, [7, 6]]
    with pytest.raises(
        InputError, match="exchanged columns in rows 27 to 51.*under convention standard"
    ):
        imported(tmp_path, robot_file, rows)


def test_a_left_handed_sensor_frame_is_named_without_units(robot_file, tmp_path):
    rows = rows_of_a_sensor(robot_file, 50)
    rows[:, 8] *= -1
    header = [*(f"J{k}" for k in range(1, 7)), "ball_x", "ball_y", "ball_z"]
    path = write_rows(tmp_path / "rows.csv", header, rows)
    with pytest.raises(InputError, match="left-handed.*under convention standard"):
        import_recording([path], tmp_path / "out", ImportOptions(robot=str(robot_file)))


def test_few_rows_decide_the_convention_with_base_and_tool_alone(robot_file, tmp_path):
    made = imported(tmp_path, robot_file, rows_of_a_tracker(robot_file, 9), trust_data=True)
    assert any("rows are too few to test it with geometry errors" in text for text in made.warnings)
    assert made.recording.robot["convention"] == "standard"


def test_the_message_says_how_to_state_the_convention(robot_file, tmp_path):
    rows = rows_of_a_tracker(robot_file, 40)
    rows[:, 6:] = np.random.default_rng(2).normal(scale=300, size=(40, 3))
    with pytest.raises(InputError, match='"modified" .Craig. or "standard" into the name'):
        imported(tmp_path, robot_file, rows)
