"""Flange poses of a controller and points on the flange of a stationary instrument, without joint readings."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.commands import cli
from workbench.commands.data.import_dialogue import next_command
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_vector, transform
from workbench.recordings.importing import ImportOptions, import_recording
from workbench.recordings.importing.sources.finding import find_mapping

BASE = transform(
    Rotation.from_rotvec([0.2, -0.1, 2.2]).as_matrix(), np.array([2600.0, -900.0, 310.0])
)
"""T_base_instrument."""
POINT = np.array([104.0, -30.0, 215.0])
"""Place of the reflector on the flange, mm."""


def made(count=24, seed=3, noise=0.05):
    """(n, 4, 4) flange poses, mm, and (n, 3) points in the frame of the instrument, mm."""
    rng = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(rng.normal(size=(count, 3)) * 0.5 + [np.pi, 0, 0])
    flange = transform(
        turned.as_matrix(), rng.uniform([500, -700, 300], [1300, 700, 1100], (count, 3))
    )
    in_base = np.einsum("nij,j->ni", flange[:, :3, :3], POINT) + flange[:, :3, 3]
    back = inverse(BASE)
    seen = in_base @ back[:3, :3].T + back[:3, 3]
    return flange, seen + rng.normal(size=seen.shape) * noise


def two_lists(folder, flange, seen):
    """Files with brackets as a controller and an instrument print them, without headers."""
    wxyz = Rotation.from_matrix(flange[:, :3, :3]).as_quat(scalar_first=True)
    poses = [
        f"Print{k}=[{p[0]:.2f},{p[1]:.2f},{p[2]:.2f}],[{','.join(f'{v:.6f}' for v in q)}]"
        for k, (p, q) in enumerate(zip(flange[:, :3, 3], wxyz), 1)
    ]
    points = [f"P{k}=[{','.join(f'{v:.6f}' for v in p)}]" for k, p in enumerate(seen, 1)]
    files = [folder / "robot.txt", folder / "tracker.txt"]
    for path, lines in zip(files, (poses, points)):
        path.write_text("\n".join(lines) + "\n")
    return files


def named_table(folder, flange, seen, scale=1.0):
    """One table whose headers name a pose with Euler angles and the tracker's point."""
    angles = Rotation.from_matrix(flange[:, :3, :3]).as_euler("ZYX", degrees=True)
    rows = np.hstack([flange[:, :3, 3], angles, scale * seen])
    head = "X,Y,Z,A,B,C,Tracker X,Tracker Y,Tracker Z"
    path = folder / "poses.csv"
    path.write_text("\n".join([head, *(",".join(f"{v:.6f}" for v in row) for row in rows)]) + "\n")
    return [path]


def hand_eye_of(folder, capsys):
    assert cli.run(["handeye", str(folder), "--json", "-", "--no-report"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("files", [two_lists, named_table])
def test_frame_and_tool_point_are_found(tmp_path, capsys, files):
    flange, seen = made()
    result = import_recording(files(tmp_path, flange, seen), tmp_path / "out", ImportOptions())
    assert result.recording.measures == "external-point"
    assert next_command(result.recording, tmp_path / "out").startswith("workbench handeye")
    answer = hand_eye_of(tmp_path / "out", capsys)
    assert answer["transform"] == "T_base_sensor"
    found = np.array(answer["hand_eye"]["matrix"])
    std_mm, std_deg = (np.array(answer["hand_eye"][key]) for key in ("std_mm", "std_deg"))
    assert (np.abs(found[:3, 3] - BASE[:3, 3]) < 4 * std_mm).all() and std_mm.max() < 0.3
    turned = np.rad2deg(rotation_vector(found[:3, :3] @ BASE[:3, :3].T))
    assert (np.abs(turned) < 4 * std_deg).all()
    place, std = (np.array(answer["target"][key]) for key in ("xyz_mm", "std_mm"))
    assert answer["target"]["transform"] == "measured point in the frame of the flange"
    assert (np.abs(place - POINT) < 4 * std).all()
    assert answer["held_out"]["rms_mm"] == pytest.approx(0.05 * np.sqrt(3), rel=0.4)


def test_points_in_metres(tmp_path):
    flange, seen = made()
    files = named_table(tmp_path, flange, seen, scale=1e-3)
    recording = import_recording(files, tmp_path / "out", ImportOptions()).recording
    np.testing.assert_allclose(recording.points, seen, atol=1e-2)


def test_its_own_mapping_repeats_the_import(tmp_path):
    flange, seen = made()
    files = named_table(tmp_path, flange, seen)
    import_recording(files, tmp_path / "out", ImportOptions())
    again = ["import", *map(str, files), "--map", str(tmp_path / "out" / "import.toml")]
    assert cli.run([*again, "--out", str(tmp_path / "again")]) == 0


def test_a_wrong_row_is_named_in_words_of_the_point(tmp_path):
    flange, seen = made()
    seen[7] += [30.0, -10.0, 5.0]
    result = import_recording(
        named_table(tmp_path, flange, seen), tmp_path / "out", ImportOptions()
    )
    (suspicion,) = result.suspicions
    assert "row 9" in suspicion and "the point seems to be displaced" in suspicion


def test_equal_rotations_leave_the_arrangement_open(tmp_path):
    """Without rotation a ball before a sensor and a point on the flange explain the same points."""
    flange, seen = made(noise=0.0)
    flange[:, :3, :3] = flange[0, :3, :3]
    in_base = flange[:, :3, :3] @ POINT + flange[:, :3, 3]
    back = inverse(BASE)
    seen = in_base @ back[:3, :3].T + back[:3, 3]
    with pytest.raises(InputError, match="the flange only moved and never turned"):
        import_recording(named_table(tmp_path, flange, seen), tmp_path / "out", ImportOptions())


def test_without_flange_poses_handeye_names_calibrate(tmp_path, capsys):
    assert cli.run(["new", "external-point", str(tmp_path / "arm"), "--robot", "ur10"]) == 0
    assert cli.run(["handeye", str(tmp_path / "arm"), "--no-report"]) == 2
    assert "workbench calibrate" in capsys.readouterr().err


def test_the_page_states_the_tool_point_and_no_sphere(tmp_path, capsys):
    flange, seen = made()
    import_recording(two_lists(tmp_path, flange, seen), tmp_path / "out", ImportOptions())
    assert cli.run(["handeye", str(tmp_path / "out"), "--out", str(tmp_path / "run")]) == 0
    assert "equal weight per pose" not in capsys.readouterr().out
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "Measured point in the frame of the flange" in page
    assert "from the sphere" not in page and "flange error" not in page


def test_a_quaternion_in_front_of_the_flange_position_is_the_flange_rotation(tmp_path):
    flange, seen = made()
    wxyz = Rotation.from_matrix(flange[:, :3, :3]).as_quat(scalar_first=True)
    names = [f"J{k:03d}" for k in range(len(seen))]
    files = [tmp_path / "robot.csv", tmp_path / "lt.csv"]
    heads = [",qw,qx,qy,qz,x,y,z,k", ",pt,x,y,z"]
    counts = np.arange(len(seen))[:, None]
    tables = [
        np.hstack([wxyz, flange[:, :3, 3] / 1000, 7.0 * counts]),
        np.hstack([counts + 1.0, seen / 1000]),
    ]
    for path, head, rows in zip(files, heads, tables):
        lines = [",".join([n, *(f"{v:.9f}" for v in row)]) for n, row in zip(names, rows)]
        path.write_text("\n".join([head, *lines[::-1]] if path is files[0] else [head, *lines]))
    found = find_mapping(files, ImportOptions(), tmp_path)
    assert found.mapping.flange_rotation.columns == ("qw", "qx", "qy", "qz")
    assert found.mapping.rotation is None and found.mapping.join.by == "key"
    assert found.mapping.point.columns == ("lt: x", "lt: y", "lt: z")
