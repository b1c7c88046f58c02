"""Hand-eye from clouds of a ball and from ball centres at flange poses; clouds are not taken for profiles."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
from sensors.hand_eye.centres import Centres, hand_eye_from_centres
from workbench.commands import cli
from workbench.commands.data.import_dialogue import next_command
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_vector, transform
from workbench.jobs.sensor import hand_eye
from workbench.recordings.importing import ImportOptions, import_recording

RADIUS, BALL = 20.0, np.array([600.0, 120.0, 40.0])
HAND_EYE = transform(
    Rotation.from_rotvec([0.3, -0.8, 1.9]).as_matrix(), np.array([35.0, -20.0, 90.0])
)


def poses(count, seed, one_axis=False):
    """(P, 4, 4) T_base_flange from which the sensor sees the ball at about 250 mm."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        turn = rng.normal(size=3) * 0.35
        turn = np.array([0, 0, turn[2]]) if one_axis else turn
        sensor = Rotation.from_rotvec(turn) * Rotation.from_rotvec([np.pi, 0, 0])
        seen = np.array([*rng.uniform(-20, 20, 2), rng.uniform(230, 270)])
        place = BALL - sensor.as_matrix() @ seen
        made.append(transform(sensor.as_matrix(), place) @ inverse(HAND_EYE))
    return np.array(made)


def centres(flange, seed=0, noise=0.02):
    sensor = np.linalg.inv(flange @ HAND_EYE)
    seen = np.einsum("nij,j->in", sensor[:, :3, :3], BALL) + sensor[:, :3, 3].T
    return seen + noise * np.random.default_rng(seed).normal(size=seen.shape)


def error(found):
    """(6,) mm and rad of a hand-eye from the truth."""
    turn = found[:3, :3] @ HAND_EYE[:3, :3].T
    return np.concatenate([found[:3, 3] - HAND_EYE[:3, 3], rotation_vector(turn)])


def test_centres_find_the_truth_within_their_sigmas():
    """Over 40 sets about 68 % of the six numbers lie within one sigma."""
    inside = []
    for seed in range(40):
        flange = poses(9, seed)
        ball = np.zeros(9, int)
        found = hand_eye_from_centres(Centres(centres(flange, seed), flange, ball), RADIUS)
        inside.append(np.abs(error(found.sensor)) < np.sqrt(np.diag(found.covariance)))
        assert found.converged and not found.undetermined
    assert np.mean(inside) == pytest.approx(0.68, abs=0.09)


def test_rotations_about_one_axis_do_not_determine_it():
    flange = poses(8, 1, one_axis=True)
    found = hand_eye_from_centres(Centres(centres(flange), flange, np.zeros(8, int)), RADIUS)
    assert found.undetermined and not np.isfinite(found.covariance).all()


def surface(flange, unit=1.0, seed=0, table=True):
    """A recording of clouds: points on the ball's side that faces the camera, and of a table under it."""
    rng = np.random.default_rng(seed)
    seen = centres(flange, seed, 0.0)
    rows = []
    for k, middle in enumerate(seen.T):
        away = rng.normal(size=(3, 600))
        away /= np.linalg.norm(away, axis=0)
        away = away[:, (away * middle[:, None]).sum(0) < -0.5 * np.linalg.norm(middle)]
        points = middle[:, None] + RADIUS * away
        if table:
            flat = np.stack([*rng.uniform(-60, 60, (2, 300)), np.full(300, middle[2] + 30)])
            points = np.hstack([points, flat])
        points = unit * (points + 0.02 * rng.normal(size=points.shape))
        rows.append((k, points))
    return rows


def written(folder, flange, rows, kind="ball-surface"):
    """The recording on disk."""
    folder.mkdir()
    names = "flange_x_mm,flange_y_mm,flange_z_mm,flange_qw,flange_qx,flange_qy,flange_qz"
    lines = [f"sample,pose,ball,x_mm,y_mm,z_mm,{names}"]
    for k, points in rows:
        x, y, z, w = Rotation.from_matrix(flange[k, :3, :3]).as_quat()
        place = (
            ",".join(f"{v:.6f}" for v in (*flange[k, :3, 3],)) + f",{w:.9f},{x:.9f},{y:.9f},{z:.9f}"
        )
        for point in points.T:
            lines.append(f"{len(lines)},{k},1," + ",".join(f"{v:.6f}" for v in point) + f",{place}")
    (folder / "samples.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "artefact.csv").write_text(
        f"ball,x_mm,y_mm,z_mm,radius_mm\n1,0,0,0,{RADIUS}\n", encoding="utf-8"
    )
    (folder / "recording.toml").write_text(
        f'format = "recording/1"\nmeasures = "{kind}"\n[samples]\nfile = "samples.csv"\n'
        '[artefact]\nfile = "artefact.csv"\n',
        encoding="utf-8",
    )
    return folder


def test_clouds_of_a_ball_give_the_hand_eye_and_are_not_taken_for_profiles(tmp_path, capsys):
    flange = poses(8, 3)
    folder = written(tmp_path / "clouds", flange, surface(flange))
    target = tmp_path / "answer.json"
    status = cli.run(
        ["handeye", str(folder), "--json", str(target), "--out", str(tmp_path / "run")]
    )
    capsys.readouterr()
    assert status == 0
    answer = json.loads(target.read_text(encoding="utf-8"))
    assert answer["kind"] == "clouds"
    assert np.abs(error(np.array(answer["hand_eye"]["matrix"]))[:3]).max() < 0.1
    assert answer["held_out"]["rms_mm"] < 0.1


def test_clouds_in_metres_are_refused_with_the_remedy(tmp_path):
    flange = poses(6, 4)
    folder = written(tmp_path / "metres", flange, surface(flange, 0.001, table=False))
    with pytest.raises(InputError, match="metres"):
        hand_eye.calibrate(datasets.read(folder), None, None, lambda text: None)


def test_ball_centres_with_flange_poses_and_no_joints_give_the_hand_eye(tmp_path):
    flange = poses(9, 5)
    seen = centres(flange, 5)
    folder = written(
        tmp_path / "centres", flange, [(k, seen[:, k : k + 1]) for k in range(9)], "ball-centre"
    )
    run = hand_eye.calibrate(datasets.read(folder), None, None, lambda text: None)
    made = hand_eye.as_json(run)
    std = np.concatenate([made["hand_eye"]["std_mm"], np.deg2rad(made["hand_eye"]["std_deg"])])
    assert (np.abs(error(np.array(made["hand_eye"]["matrix"]))) < 4 * std).all()
    assert made["verdict"]["sentence"]
    assert made["radius_mm"] is None  # the centres do not depend on it


def table_of(path, flange, seen):
    """A table of flange poses and ball centres in the frame of the sensor."""
    turns = Rotation.from_matrix(flange[:, :3, :3]).as_quat()
    rows = np.column_stack([flange[:, :3, 3], turns, seen.T])
    header = [*(f"flange_{name}" for name in ("x", "y", "z", "qx", "qy", "qz", "qw"))]
    header += ["ball_x", "ball_y", "ball_z"]
    lines = [",".join(header), *(",".join(f"{v:.9g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("scale", [1.0, 0.001])
def test_a_table_of_flange_poses_and_ball_centres_is_imported_for_handeye(scale, tmp_path):
    flange = poses(12, 5)
    seen = centres(flange, 5)
    path = table_of(tmp_path / "t.csv", flange, scale * seen)
    made = import_recording([path], tmp_path / "out", ImportOptions())
    assert made.recording.measures == "ball-centre"
    assert next_command(made.recording, tmp_path / "out").startswith("workbench handeye")
    np.testing.assert_allclose(made.recording.points.T, seen, atol=1e-4)
    run = hand_eye.calibrate(datasets.read(tmp_path / "out"), None, None, lambda text: None)
    assert np.abs(error(run.made.sensor)[:3]).max() < 0.1


def test_points_that_no_hand_eye_transform_keeps_in_place_are_refused(tmp_path):
    flange = poses(12, 5)
    seen = np.random.default_rng(1).normal(scale=50, size=(3, 12))
    path = table_of(tmp_path / "t.csv", flange, seen)
    with pytest.raises(InputError, match="poses of the flange.*`workbench handeye`"):
        import_recording([path], tmp_path / "out", ImportOptions(robot="ur10"))
