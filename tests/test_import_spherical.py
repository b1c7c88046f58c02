"""Import of points in spherical coordinates: units, vertical angle and direction of the azimuth by the fit to the robot."""

import numpy as np
import pytest

from datasets.importers.mapping.columns import spherical
from datasets.importers.mapping.model import mapping_from_keys, read_mapping
from import_scenes import assert_same_rows, degrees, pose_scene, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording

JOINTS = [f"J{k} [deg]" for k in range(1, 7)]


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    scene = pose_scene("ur10", 40, 31, "share_of_limits = 0.4").replace(
        "external-pose", "external-point"
    )
    return simulated(tmp_path_factory.mktemp("scene"), scene)


def sphere(points) -> np.ndarray:
    """(3, n) range, azimuth (rad, counterclockwise), elevation (rad) of points (n, 3), the frame turned about z."""
    turn = 0.7
    x = np.cos(turn) * points[:, 0] - np.sin(turn) * points[:, 1]
    y = np.sin(turn) * points[:, 0] + np.cos(turn) * points[:, 1]
    distance = np.linalg.norm(points, axis=1)
    return np.stack([distance, np.arctan2(y, x), np.arcsin(points[:, 2] / distance)])


def write(path, truth, names, columns, separator=","):
    rows = np.column_stack([degrees(truth), *columns])
    lines = [separator.join([*JOINTS, *names])]
    lines += [separator.join(f"{value:.9f}" for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def distances(points) -> np.ndarray:
    return np.linalg.norm(points[:, None] - points[None], axis=2)


VARIANTS = {
    "tracker in mm and deg": (
        ("Range [mm]", "Azimuth [deg]", "Elevation [deg]"),
        lambda r, a, e: (r, np.rad2deg(a), np.rad2deg(e)),
        "spherical elevation deg counterclockwise",
    ),
    "tracker in m and rad, nothing stated": (
        ("Distance", "Azimuth", "Elevation"),
        lambda r, a, e: (r / 1000, a, e),
        "spherical elevation rad counterclockwise",
    ),
    "total station in gon, zenith, clockwise": (
        ("SD [m]", "Hz [gon]", "V [gon]"),
        lambda r, a, e: (r / 1000, (-a % (2 * np.pi)) * 200 / np.pi, (np.pi / 2 - e) * 200 / np.pi),
        "spherical zenith gon clockwise",
    ),
    "German headers, zenith, clockwise": (
        ("Schrägstrecke (mm)", "Horizontalwinkel", "Zenitwinkel"),
        lambda r, a, e: (r, np.rad2deg(-a), 90 - np.rad2deg(e)),
        "spherical zenith deg clockwise",
    ),
    "inches, vertical angle without a name": (
        ("tracker_range", "tracker_az", "tracker_vertical_angle"),
        lambda r, a, e: (r / 25.4, np.rad2deg(a), np.rad2deg(e)),
        "spherical elevation deg counterclockwise",
    ),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_the_convention_is_found_on_the_robot(truth, tmp_path, name):
    names, written, convention = VARIANTS[name]
    points = truth.points.T if truth.points.shape[0] == 3 else truth.points
    table = write(tmp_path / "tracker.csv", truth, names, written(*sphere(points)))
    made = import_recording([table], tmp_path / "made", ImportOptions(robot="ur10"))
    assert made.mapping.point.convention == convention
    assert made.recording.measures == "external-point" and made.unused == ()
    found = made.recording.points
    np.testing.assert_allclose(distances(found), distances(points), atol=1e-3)
    again = read_mapping(tmp_path / "made" / "import.toml")
    assert again.point == made.mapping.point


def test_a_mapping_may_state_the_whole_convention(truth, tmp_path):
    names, written, convention = VARIANTS["tracker in mm and deg"]
    table = write(tmp_path / "tracker.csv", truth, ("a", "b", "c"), written(*sphere(truth.points)))
    keys = {"point": {"columns": ["a", "b", "c"], "unit": "mm", "convention": convention}}
    options = ImportOptions(robot="ur10", mapping=mapping_from_keys(keys, "map.toml"))
    made = import_recording([table], tmp_path / "made", options)
    np.testing.assert_allclose(distances(made.recording.points), distances(truth.points), atol=1e-3)


def test_a_stated_convention_that_contradicts_the_robot_is_refused(truth, tmp_path):
    names, written, _ = VARIANTS["tracker in mm and deg"]
    table = write(tmp_path / "tracker.csv", truth, names, written(*sphere(truth.points)))
    columns = list(names)
    keys = {
        "point": {"columns": columns, "unit": "mm", "convention": "spherical zenith deg clockwise"}
    }
    options = ImportOptions(robot="ur10", mapping=mapping_from_keys(keys, "map.toml"))
    with pytest.raises(InputError, match="spherical elevation deg counterclockwise"):
        import_recording([table], tmp_path / "made", options)


def test_cartesian_columns_go_before_spherical_ones(truth, tmp_path):
    names, written, _ = VARIANTS["tracker in mm and deg"]
    columns = (*truth.points.T, *written(*sphere(truth.points)))
    table = write(tmp_path / "tracker.csv", truth, ("X [mm]", "Y [mm]", "Z [mm]", *names), columns)
    made = import_recording([table], tmp_path / "made", ImportOptions(robot="ur10"))
    assert made.mapping.point.convention is None
    assert_same_rows(made.recording, truth)


def test_points_of_a_sphere():
    values = np.array([[2.0, 2.0, 1.0], [0.0, 90.0, 45.0], [0.0, 0.0, 90.0]])
    made = spherical.points_of(values, "spherical elevation deg counterclockwise")
    np.testing.assert_allclose(made, [[2, 0, 0], [0, 2, 0], [0, 0, 1]], atol=1e-12)
    clockwise = spherical.points_of(values, "spherical elevation deg clockwise")
    np.testing.assert_allclose(clockwise[1], -made[1], atol=1e-12)
    zenith = np.array([[1.0], [0.0], [100.0]])
    np.testing.assert_allclose(
        spherical.points_of(zenith, "spherical zenith gon clockwise"), [[1], [0], [0]], atol=1e-12
    )


def test_a_convention_states_what_it_names_and_leaves_the_rest_open():
    assert spherical.completions("spherical elevation deg") == [
        "spherical elevation deg counterclockwise",
        "spherical elevation deg clockwise",
    ]
    assert len(spherical.completions("spherical")) == 12
    assert set(spherical.completions("spherical")) <= set(spherical.CONVENTIONS)


def test_a_rotation_convention_of_a_point_is_refused():
    keys = {"point": {"columns": ["a", "b", "c"], "convention": "intrinsic XYZ"}}
    with pytest.raises(InputError, match="spherical elevation deg counterclockwise"):
        mapping_from_keys(keys, "map.toml")


def test_a_column_that_joins_two_tables_is_used(truth, tmp_path):
    names, written, _ = VARIANTS["total station in gon, zenith, clockwise"]
    number = np.arange(1.0, truth.n + 1)
    joints = write_rows(
        tmp_path / "robot.csv", ("Nr", *JOINTS), np.column_stack([number, degrees(truth)])
    )
    measured = np.column_stack([number, *written(*sphere(truth.points))])[::-1]
    station = write_rows(tmp_path / "station.csv", ("Nr", *names), measured)
    made = import_recording([joints, station], tmp_path / "made", ImportOptions(robot="ur10"))
    assert made.unused == () and made.mapping.join.key == "Nr"
    found = made.recording.points
    order = np.argsort(made.recording.columns["q1_deg"])
    wanted = np.argsort(degrees(truth)[:, 0])
    np.testing.assert_allclose(distances(found[order]), distances(truth.points[wanted]), atol=1e-3)
