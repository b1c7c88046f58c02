"""Import of profiles and clouds of a ball at flange poses, and ball centres whose unit is wrong."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datasets.importers.sources.clouds import is_profile, read_cloud, without_markers
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.templates.scanner_kinds import example

RADIUS = 15.0


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("examples")
    kinds = ("profiler", "3d-camera")
    return {kind: example(kind, folder / kind, lambda text: None).recording for kind in kinds}


def written(recording, folder, scale, write, most=100):
    """Files of single poses in `folder`/scans, and poses in m with intrinsic ZYX angles in rad."""
    (folder / "scans").mkdir()
    lines = ["file,X,Y,Z,A,B,C"]
    for number in np.unique(recording.columns["pose"])[:most]:
        on = recording.columns["pose"] == number
        path = write(folder / "scans" / f"scan_{int(number):02d}", scale * recording.points[on])
        pose = recording.flange[on][0]
        angles = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")
        cells = [path.name, *(pose[:3, 3] / 1000), *angles]
        lines.append(",".join(map(str, cells)))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    return [folder / "scans", folder / "poses.csv"]


def as_text(path, points):
    """A profile with a title, decimal commas and semicolons."""
    path = path.with_suffix(".csv")
    rows = [f"{x:.5f};{z:.5f}".replace(".", ",") for x, _, z in points]
    path.write_text("\n".join(["x [mm];z [mm]", *rows]) + "\n")
    return path


def as_ply(path, points):
    import open3d

    path = path.with_suffix(".ply")
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    open3d.io.write_point_cloud(str(path), cloud)
    return path


@pytest.mark.parametrize(
    ("kind", "scale", "write"), [("profiler", 1.0, as_text), ("3d-camera", 0.001, as_ply)]
)
def test_scans_of_a_ball_with_flange_poses(kind, scale, write, recordings, tmp_path):
    recording = recordings[kind]
    sources = written(recording, tmp_path, scale, write)
    made = import_recording(sources, tmp_path / "out", ImportOptions(ball_radius_mm=RADIUS))
    assert made.recording.measures == "ball-surface"
    assert made.mapping.flange_point.unit == "m"
    assert made.mapping.flange_rotation.convention == "intrinsic ZYX"
    assert made.mapping.flange_rotation.unit == "rad"
    number, first = np.unique(made.recording.columns["pose"], return_index=True)
    expected = recording.flange[np.unique(recording.columns["pose"], return_index=True)[1]]
    assert len(number) == len(expected)
    assert np.allclose(made.recording.flange[first], expected, atol=1e-3)
    spread = np.linalg.norm(made.recording.points - recording.points.mean(0), axis=1)
    assert 5.0 < spread.max() < 60.0  # mm


def test_few_poses_have_their_convention_found_among_all(recordings, tmp_path):
    """The linear screening of conventions needs more poses; without it all are compared."""
    sources = written(recordings["3d-camera"], tmp_path, 1.0, as_ply, most=8)
    made = import_recording(sources, tmp_path / "out", ImportOptions(ball_radius_mm=RADIUS))
    assert made.mapping.flange_rotation.convention == "intrinsic ZYX"
    assert made.mapping.flange_rotation.unit == "rad" and made.mapping.flange_point.unit == "m"


def test_scans_without_radius_are_refused(recordings, tmp_path):
    sources = written(recordings["profiler"], tmp_path, 1.0, as_text)
    with pytest.raises(InputError, match="--ball-radius"):
        import_recording(sources, tmp_path / "out", ImportOptions())


def test_profiles_in_one_table_are_refused(recordings, tmp_path):
    sources = written(recordings["profiler"], tmp_path, 1.0, as_text)
    lines = [",".join(f"{row * column:g}" for column in range(25)) for row in range(60)]
    (tmp_path / "profiles.csv").write_text("\n".join(lines))
    options = ImportOptions(ball_radius_mm=RADIUS)
    with pytest.raises(InputError, match="--ball-radius 15: expected clouds or profiles"):
        import_recording([tmp_path / "profiles.csv", sources[1]], tmp_path / "out", options)


def test_poses_of_other_scans_are_refused(recordings, tmp_path):
    sources = written(recordings["3d-camera"], tmp_path, 1.0, as_ply)
    lines = sources[1].read_text().splitlines()
    names = [line.partition(",")[0] for line in lines[1:]]
    poses = [line.partition(",")[2] for line in lines[1:]]
    mixed = [f"{name},{pose}" for name, pose in zip(names, poses[7:] + poses[:7])]
    sources[1].write_text("\n".join([lines[0], *mixed]) + "\n")
    with pytest.raises(InputError, match="rows and files belong together|fit about equally"):
        import_recording(sources, tmp_path / "out", ImportOptions(ball_radius_mm=RADIUS))


@pytest.mark.parametrize(
    ("kind", "write"), [("profiler", as_text), ("3d-camera", as_ply)], ids=("profiles", "clouds")
)
def test_exchanged_poses_are_named(kind, write, recordings, tmp_path):
    sources = written(recordings[kind], tmp_path, 1.0, write)
    lines = sources[1].read_text().splitlines()
    first, second = (lines[row].split(",", 1) for row in (3, 6))
    lines[3], lines[6] = f"{first[0]},{second[1]}", f"{second[0]},{first[1]}"
    sources[1].write_text("\n".join(lines) + "\n")
    made = import_recording(sources, tmp_path / "out", ImportOptions(ball_radius_mm=RADIUS))
    (doubt,) = made.suspicions
    assert f"row 4 ({first[0]}) and row 7 ({second[0]}) look exchanged" in doubt


@pytest.mark.parametrize(
    ("kind", "write"), [("profiler", as_text), ("3d-camera", as_ply)], ids=("profiles", "clouds")
)
@pytest.mark.parametrize("stated", [14.7, RADIUS, 15.4])
def test_another_radius_is_a_doubt(kind, write, stated, recordings, tmp_path):
    sources = written(recordings[kind], tmp_path, 1.0, write)
    made = import_recording(sources, tmp_path / "out", ImportOptions(ball_radius_mm=stated))
    found = [doubt for doubt in made.suspicions if "show a ball of radius 15" in doubt]
    assert len(found) == (stated != RADIUS)


@pytest.mark.parametrize("marker", ["", "0.000", "-9999", "-2147483.648"])
def test_invalid_points_of_profiles_are_left_out(marker, tmp_path):
    rows = [f"{k / 10:.1f};{80 + k * k / 1000:.4f}" for k in range(60)]
    empty = [f"{k / 10:.1f};{marker}" for k in range(60, 90)]
    (tmp_path / "p.csv").write_text("\n".join(["x;z", *empty[:15], *rows, *empty[15:]]))
    assert is_profile(tmp_path / "p.csv")
    assert len(read_cloud(tmp_path / "p.csv", 1000)) == 60


def test_depths_without_a_marker_are_kept():
    points = np.zeros((60, 3))
    points[:, 2] = np.repeat(np.arange(-10.0, 10.0), 3)
    assert len(without_markers(points)) == 60


def test_a_table_of_three_columns_is_no_profile(tmp_path):
    rows = "\n".join(f"{k},{k},{k}" for k in range(40))
    (tmp_path / "a.csv").write_text(rows)
    assert not is_profile(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("\n".join(f"{k}\t{2 * k}" for k in range(40)))
    assert is_profile(tmp_path / "b.csv")
    assert np.array_equal(read_cloud(tmp_path / "b.csv", 100)[5], [5.0, 0.0, 10.0])


@pytest.mark.parametrize(("factor", "word"), [(1e-3, "metres"), (1 / 25.4, "inches")])
def test_ball_centres_in_another_unit_are_refused(factor, word):
    from dataclasses import replace

    from datasets.recording import Recording
    from workbench.jobs.sensor import hand_eye
    from workbench.recordings.templates import scanner_kinds

    rng = np.random.default_rng(1)
    sensor = scanner_kinds._views_of_ball(12, rng, 300.0)
    seen = scanner_kinds._SPHERE - sensor[:, :3, 3]
    seen = np.einsum("nji,nj->ni", sensor[:, :3, :3], seen)
    flange = scanner_kinds.flange_columns(sensor @ np.linalg.inv(scanner_kinds.HAND_EYE), rng)
    columns = {"sample": np.arange(1.0, 13.0), "ball": np.ones(12), **flange}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), seen.T))
    right = Recording("ball-centre", columns, {}, name="right")
    assert hand_eye.calibrate(right, None, None, lambda text: None).made.fit["rms_mm"] < 0.1
    scaled = columns | {name: factor * columns[name] for name in ("x_mm", "y_mm", "z_mm")}
    with pytest.raises(InputError, match=word):
        hand_eye.calibrate(replace(right, columns=scaled), None, None, lambda text: None)


@pytest.mark.parametrize("first", [0, 60, 2000])
def test_a_profile_of_which_few_points_are_valid(first, tmp_path):
    """A narrow ball in the field of a profiler: most depths are empty cells."""
    x = np.linspace(-50, 50, 2100)
    lines = [f"{v:.3f},{180 + k % 7 if first <= k < first + 90 else ''}" for k, v in enumerate(x)]
    (tmp_path / "p.csv").write_text("\n".join(["x,z", *lines]))
    assert is_profile(tmp_path / "p.csv")
    assert len(read_cloud(tmp_path / "p.csv", 5000)) == 90


@pytest.mark.parametrize("marker", ["-1e308", "3.4028235e38", "nan"])
def test_one_point_that_is_farther_than_any_sensor_measures_is_invalid(tmp_path, marker):
    points = np.random.default_rng(3).normal(size=(60, 3))
    lines = [" ".join(f"{value:.4f}" for value in point) for point in points]
    lines[7] = f"1.0 {marker} 118.2"
    (tmp_path / "scan.xyz").write_text("\n".join(lines) + "\n", encoding="utf-8")
    read = read_cloud(tmp_path / "scan.xyz", 1000)
    np.testing.assert_allclose(read, np.delete(points, 7, 0), atol=1e-4)
