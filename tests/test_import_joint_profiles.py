"""Profiles of a ball with joint readings only: import, hand-eye and zeros of the joints of an arm with known errors."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.core.rigid import transform
from workbench.jobs.robot.calibrate import calibrate
from workbench.recordings.importing import ImportOptions, import_recording

RADIUS, NOISE = 20.0, 0.01
BALL = np.array([420.0, 160.0, 310.0])
HAND_EYE = transform(
    Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix(), np.array([40.0, -25.0, 70.0])
)
ZERO_ERRORS_DEG = np.array([0.0, 0.15, -0.2, 0.1, 0.0, 0.0])


def flange_poses(joints_deg):
    robot = load_robot("ur5")
    frames = forward(robot, robot.mixing @ np.radians(joints_deg).T)
    return transform(np.stack(frames.end, -1).transpose(1, 0, 2), frames.end_origin.T)


def ball_in_sensor(joints_deg, zero_errors_deg):
    """(3,) mm, as the true arm holds the profiler."""
    sensor = flange_poses((joints_deg + zero_errors_deg)[None])[0] @ HAND_EYE
    return sensor[:3, :3].T @ (BALL - sensor[:3, 3])


def away(joints_deg, zero_errors_deg, aim):
    return ball_in_sensor(joints_deg, zero_errors_deg) - aim


def measured_poses(count, rng, zero_errors_deg):
    """Joint readings (count, 6) in degrees, and profiles (k, 2) mm, of an arm whose zeros are off."""
    joints, profiles = [], []
    while len(joints) < count:
        aim = rng.uniform([-20, -0.7 * RADIUS, 120], [20, 0.7 * RADIUS, 250])
        start = rng.uniform([-60, -130, -130, -180, -150, -180], [60, -20, 130, 180, 150, 180])
        found = least_squares(away, start, args=(zero_errors_deg, aim), max_nfev=40)
        if found.cost > 1e-6 or np.abs(found.x).max() > 350:
            continue
        x, y, z = ball_in_sensor(found.x, zero_errors_deg)
        radius = np.sqrt(RADIUS**2 - y**2)
        angle = np.linspace(-0.45, 0.45, 60) * np.pi
        circle = np.stack([x + radius * np.sin(angle), z - radius * np.cos(angle)], axis=1)
        joints.append(found.x)
        profiles.append(circle + rng.normal(0, NOISE, circle.shape))
    return np.array(joints), profiles


@pytest.fixture(scope="module")
def measured():
    return measured_poses(30, np.random.default_rng(3), ZERO_ERRORS_DEG)


def written(folder, joints, profiles, scale=1.0):
    (folder / "profiles").mkdir()
    names = [f"p{k:03d}.csv" for k in range(len(profiles))]
    for name, profile in zip(names, profiles):
        rows = "\n".join(f"{x:.6f},{z:.6f}" for x, z in scale * profile)
        (folder / "profiles" / name).write_text(f"x,z\n{rows}\n")
    rows = [",".join([name, *(f"{q:.6f}" for q in row)]) for name, row in zip(names, joints)]
    header = "file,J1,J2,J3,J4,J5,J6"
    (folder / "joints.csv").write_text("\n".join([header, *rows]) + "\n")
    return [folder / "profiles", folder / "joints.csv"]


@pytest.mark.parametrize(
    ("unit", "scale"), [("deg", 1.0), ("rad", 1.0), ("deg", 1e-3)], ids=("mm", "radians", "metres")
)
def test_profiles_and_joint_readings_calibrate_an_arm(unit, scale, measured, tmp_path):
    joints, profiles = measured
    readings = joints if unit == "deg" else np.radians(joints)
    sources = written(tmp_path, readings, profiles, scale)
    options = ImportOptions(robot="ur5", ball_radius_mm=RADIUS)
    made = import_recording(sources, tmp_path / "out", options)
    assert made.recording.measures == "ball-surface" and not made.suspicions
    assert made.mapping.joints.unit == unit
    first = np.unique(made.recording.poses, return_index=True)[1]
    assert np.allclose(made.recording.joints[first], np.radians(joints), atol=1e-5)
    again = import_recording(
        sources, tmp_path / "again", ImportOptions(mapping=made.mapping, ball_radius_mm=RADIUS)
    )
    assert np.array_equal(again.recording.points, made.recording.points)
    calibration = calibrate(made.recording)
    noise_of_scan = NOISE * np.sqrt(3 / 60)  # three numbers of 60 points
    assert 0.8 * noise_of_scan < calibration.held_out["rms_mm"] < 1.3 * noise_of_scan


def test_a_wrong_radius_of_profiles_is_a_doubt(tmp_path):
    sources = written(tmp_path, *measured_poses(16, np.random.default_rng(4), np.zeros(6)))
    made = import_recording(
        sources, tmp_path / "out", ImportOptions(robot="ur5", ball_radius_mm=RADIUS + 0.4)
    )
    assert any("the profiles show a ball of radius 20 mm" in doubt for doubt in made.suspicions)


def test_profiles_of_other_rows_are_refused(measured, tmp_path):
    joints, profiles = measured
    sources = written(tmp_path, np.roll(joints[:12], 5, axis=0), profiles[:12])
    with pytest.raises(InputError, match="joints.csv"):
        import_recording(
            sources, tmp_path / "out", ImportOptions(robot="ur5", ball_radius_mm=RADIUS)
        )


def test_a_row_with_the_joint_readings_of_another_is_no_internal_error(measured, tmp_path):
    """Two profiles with equal readings are two circles, also where the readings of one are wrong."""
    joints, profiles = measured
    wrong = joints[:12].copy()
    wrong[7] = wrong[3]
    sources = written(tmp_path, wrong, profiles[:12])
    options = ImportOptions(robot="ur5", ball_radius_mm=RADIUS)
    try:
        made = import_recording(sources, tmp_path / "out", options)
    except InputError as problem:
        assert "joints.csv" in str(problem)
    else:
        assert made.suspicions


def artefact_table(path, centres):
    rows = [f"{k},{x:.4f},{y:.4f},{z:.4f},{RADIUS}" for k, (x, y, z) in enumerate(centres, start=1)]
    path.write_text("\n".join(["ball,x_mm,y_mm,z_mm,radius_mm", *rows]) + "\n")
    return path


def with_ball_column(folder, numbers):
    """The table of joint readings with the number of the ball of each profile."""
    path = folder / "joints.csv"
    head, *rows = path.read_text().splitlines()
    rows = [f"{row},{number}" for row, number in zip(rows, numbers)]
    path.write_text("\n".join([f"{head},ball", *rows]) + "\n")


@pytest.mark.parametrize("radius", [RADIUS, None])
def test_profiles_of_several_balls_have_the_places_of_an_artefact(measured, tmp_path, radius):
    """The radius may be that of the artefact's file.

    The scanner sees the second ball where another pose of the base would have the first: a rotation about its axis.
    """
    joints, profiles = measured
    numbers = np.arange(len(joints)) % 2 + 1
    rotated = joints.copy()
    rotated[:, 0] += np.where(numbers == 2, 25.0, 0.0)
    centre = Rotation.from_euler("z", 25.0, degrees=True).apply(BALL)
    sources = written(tmp_path, rotated, profiles)
    with_ball_column(tmp_path, numbers)
    artefact = artefact_table(tmp_path / "artefact.csv", [np.zeros(3), centre - BALL])
    options = ImportOptions(robot="ur5", ball_radius_mm=radius, artefact=artefact)
    made = import_recording(sources, tmp_path / "out", options)
    assert not made.suspicions and set(made.recording.balls) == {1, 2}
    first = np.unique(made.recording.poses, return_index=True)[1]
    assert np.array_equal(made.recording.ball[first], numbers)
    assert made.recording.balls[2][:3] == pytest.approx(centre - BALL, abs=1e-3)


@pytest.mark.parametrize("has_file", [True, False])
def test_a_ball_without_a_place_is_named(measured, tmp_path, has_file):
    joints, profiles = measured
    sources = written(tmp_path, joints, profiles)
    with_ball_column(tmp_path, np.arange(len(joints)) % 2 + 1)
    artefact = artefact_table(tmp_path / "artefact.csv", [np.zeros(3)]) if has_file else None
    options = ImportOptions(robot="ur5", ball_radius_mm=RADIUS, artefact=artefact)
    expected = "found none for ball 2" if has_file else "found balls 1, 2 and no such file"
    with pytest.raises(InputError, match=expected):
        import_recording(sources, tmp_path / "out", options)
