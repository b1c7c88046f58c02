"""Tables of joint readings alone: touches of fixed points, one file for each, and logs that touch nothing."""

import numpy as np
import pytest

from robot_model import load_robot
from scenes import ABB
from test_touch_point import touches
from workbench.commands.data.import_dialogue import next_command
from workbench.core.errors import InputError
from workbench.fitting.plausibility.check import check_plausibility
from workbench.recordings.importing import ImportOptions, import_recording

ARM = ImportOptions(robot="abb_irb120")
EACH = 14


@pytest.fixture(scope="module")
def touched():
    """Touches of two points with 0.1 mm by an arm whose joints 2, 3 and 5 are off by 0.7 to 1.5 deg."""
    robot = load_robot(ABB)
    geometry = robot.geometry.copy()
    geometry[[1, 2, 4], 0] += np.deg2rad([1.0, -1.5, 0.7])
    return touches(robot, geometry, 0.1, seed=4, each=EACH, points=2)


def written(folder, readings, unit=1.0, head=None):
    """A file for each part of the readings (n, 6) deg, without headers."""
    paths = []
    for number, part in enumerate(readings):
        path = folder / f"hole_{number}.csv"
        rows = [",".join(f"{unit * value:.9e}" for value in row) for row in part]
        path.write_text("\n".join(([head] if head else []) + rows) + "\n")
        paths.append(path)
    return paths


def joints(recording):
    return np.rad2deg(recording.joints).reshape(-1, EACH, 6)


@pytest.mark.parametrize("unit", [1.0, np.pi / 180])
@pytest.mark.parametrize("head", [None, "J1,J2,J3,J4,J5,J6"])
def test_each_file_is_a_point(tmp_path, touched, unit, head):
    paths = written(tmp_path, joints(touched), unit, head)
    result = import_recording(paths, tmp_path / "out", ARM)
    recording = result.recording
    assert recording.measures == "touch-point" and recording.n == 2 * EACH
    assert recording.columns["point"].tolist() == [1.0] * EACH + [2.0] * EACH
    np.testing.assert_allclose(recording.joints, touched.joints, atol=1e-6)
    assert result.mapping.joints.unit == ("deg" if unit == 1 else "rad")
    assert any(
        "read as touches of one fixed point for each file" in said for said in result.warnings
    )
    assert next_command(recording, tmp_path / "out").startswith("workbench calibrate")


def test_one_file(tmp_path, touched):
    paths = written(tmp_path, joints(touched)[:1])
    result = import_recording(paths, tmp_path / "out", ARM)
    assert (result.recording.columns["point"] == 1).all()
    assert any("touches of one fixed point:" in said for said in result.warnings)


@pytest.mark.parametrize("kind", ["random", "straight path", "wrist", "one joint"])
def test_a_log_that_touches_nothing_needs_a_measurement(tmp_path, kind):
    rng = np.random.default_rng(8)
    readings = rng.uniform(-70, 70, (25, 6))
    if kind == "straight path":
        share = np.linspace(0, 1, 25)[:, None]
        readings = np.array([10.0, -20, 15, 30, -40, 25]) + share * [60, 35, -30, 40, 50, -70]
    if kind == "wrist":
        readings[:, :3] = [10.0, -20.0, 15.0]
    if kind == "one joint":
        readings[:, 1:] = readings[0, 1:]
    with pytest.raises(
        InputError, match="expected columns with a? ?(joint readings|measured point)"
    ):
        import_recording(written(tmp_path, [readings]), tmp_path / "out", ARM)


def test_a_column_next_to_the_readings_is_a_measurement(tmp_path, touched):
    """Only joint readings are taken for touches: the temperature next to them may be anything without a header."""
    readings = joints(touched)[0]
    readings = np.column_stack([readings, np.random.default_rng(1).uniform(20, 30, EACH)])
    with pytest.raises(InputError):
        import_recording(written(tmp_path, [readings]), tmp_path / "out", ARM)


def test_readings_that_hardly_move_the_arm_explain_no_touches():
    """A tip stays near its point in any unit that makes the motion small; the misfit counts in relation to the motion."""
    robot = load_robot(ABB)
    inaccurate = touches(robot, robot.geometry, 4.0, seed=4, each=EACH, points=2)
    (doubt,) = check_plausibility(robot, inaccurate)
    assert not doubt.certain and doubt.cause == "unexplained"
