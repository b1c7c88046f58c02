"""Scanners of six kinds: fixed plane on a robot, galvanometer, turntable, profiler, 3-D camera (rotary mirror: elsewhere).

Fast tests use simulated stripes and the Cramer-Rao bound; slow ones run the whole chain on rendered examples.
"""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
from conftest import mostly_slow
from scanner_kinds import SIGMA_PX, bound, cloud_of, seen_stripes
from sensors.ball.fit import fit_ball
from sensors.boards.detection import View
from sensors.camera.model import Camera
from sensors.scanner.motion import twists_of
from sensors.scanner.residuals.misfit import stripe_misfit
from sensors.scanner.turntable import Turntable, is_full_revolution
from sensors.scanner.turntable_calibration import calibrate_turntable
from workbench.commands import cli
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, rotation_matrix, transform
from workbench.explanation import turntable as diagnosed_turntable
from workbench.explanation.result import CONSISTENT, Diagnosis, Experiment
from workbench.jobs.sensor import hand_eye
from workbench.jobs.sensor.joined_scans import KnownHandEye, moved_by_robot
from workbench.recordings.templates.scanner_kinds import HAND_EYE, KINDS, example
from workbench.report.diagnosis.turntable import section

RADIUS = 8.0


def _robot_motion(sigma_mm=0.0):
    turn = Rotation.from_euler("xyz", [180.0, 4.0, 20.0], degrees=True).as_matrix()
    places = np.stack([np.linspace(480, 516, 30), np.full(30, 20.0), np.full(30, 300.0)], 1)
    sensor = transform(np.broadcast_to(turn, (30, 3, 3)), places)
    known = KnownHandEye(HAND_EYE, np.zeros((6, 6)), sigma_mm)
    centre = turn @ np.array([0.0, 0.0, 127.0]) + places[15]
    return moved_by_robot(sensor @ inverse(HAND_EYE), known), centre


def _table_motion():
    table = Turntable(np.array([0.0, 0.8, -0.6]), np.array([0.0, 0.0, 128.0]))
    return table.motion(np.deg2rad(np.arange(0.0, 360.0, 5.0))), np.array([14.0, 5.0, 121.0])


@pytest.mark.parametrize("make", [_robot_motion, _table_motion])
def test_joined_stripes_reach_the_cramer_rao_bound(make):
    motion, centre = make()
    truth = seen_stripes(motion, centre, RADIUS)
    rng = np.random.default_rng(3)
    clean = cloud_of(truth, motion, np.zeros(truth.pixels.shape[1]))
    assert np.abs(np.linalg.norm(clean.points - centre[:, None], axis=0) - RADIUS).max() < 0.02
    errors, whitened = [], []
    for _ in range(30):
        noise = SIGMA_PX * rng.normal(size=truth.pixels.shape[1])
        cloud = cloud_of(truth, motion, noise)
        length = np.linalg.norm(cloud.error, axis=0)
        fit = fit_ball(
            cloud.points,
            radius=RADIUS,
            view=cloud.view,
            sigma=SIGMA_PX * length,
            direction=cloud.error / length,
            **cloud.shared_errors(),
        )
        assert fit
        error = fit.centre - centre
        errors.append(error)
        whitened.append(error @ np.linalg.solve(fit.covariance[:3, :3], error) / 3)
    rms = np.sqrt(np.mean(np.square(errors)))
    least = np.sqrt(np.trace(bound(clean, truth)) / 3)
    assert rms < 1.3 * least
    assert 0.5 < np.mean(whitened) < 1.6


def test_error_of_the_hand_eye_is_in_the_covariance_of_a_joined_centre():
    motion, centre = _robot_motion()
    spread = np.diag([0.03, 0.02, 0.04, 2e-4, 3e-4, 1e-4]) ** 2
    truth = seen_stripes(motion, centre, RADIUS)
    rng, moved = np.random.default_rng(4), []
    flange = motion.poses @ inverse(HAND_EYE)
    for _ in range(200):
        change = rng.normal(size=6) * np.sqrt(np.diag(spread))
        other = HAND_EYE.copy()
        other[:3, :3] = rotation_matrix(change[3:]) @ other[:3, :3]
        other[:3, 3] += change[:3]
        wrong = moved_by_robot(flange, KnownHandEye(other, np.zeros((6, 6))))
        cloud = cloud_of(truth, wrong, np.zeros(truth.pixels.shape[1]))
        outward = (cloud.points - centre[:, None]) / RADIUS
        distance = np.linalg.norm(cloud.points - centre[:, None], axis=0) - RADIUS
        moved.append(np.linalg.lstsq(outward.T, distance, rcond=None)[0])
    stated = moved_by_robot(flange, KnownHandEye(HAND_EYE, spread))
    cloud = cloud_of(truth, stated, np.zeros(truth.pixels.shape[1]))
    covariance = cloud.common_covariance(centre, np.ones(truth.pixels.shape[1], bool))
    assert np.allclose(np.cov(np.transpose(moved)), covariance, atol=0.2 * np.trace(covariance))


def test_bend_of_a_joined_scan_is_that_of_its_images():
    motion, centre = _robot_motion()
    truth = seen_stripes(motion, centre, RADIUS)
    cloud = cloud_of(truth, motion, np.zeros(truth.pixels.shape[1]))
    shuffled = np.random.default_rng(2).permutation(truth.pixels.shape[1])
    whole = cloud.surface_line(np.append(centre, RADIUS))
    again = cloud.subset(shuffled).surface_line(np.append(centre, RADIUS))
    assert np.allclose(again.slope, whole.slope[shuffled])
    assert np.nanmax(np.abs(whole.offset)) < 0.02  # points lie in the light plane


def test_twists_are_those_of_small_changes():
    poses = transform(rotation_matrix(np.array([[0.1, 0.2, 0.3]])), np.array([[10.0, 20.0, 30.0]]))
    twist = np.array([1.0, -2.0, 0.5, 0.01, 0.02, -0.03])
    step = 1e-5
    moved = transform(rotation_matrix(step * twist[None, 3:]), step * twist[None, :3]) @ poses
    assert np.allclose(twists_of(poses, moved, step), twist, atol=1e-6)


def test_stated_errors_of_poses_are_no_lack_of_fit():
    rng = np.random.default_rng(5)
    stripe = np.repeat(np.arange(40), 60)
    along = np.tile(np.arange(60.0), 40)
    shift = 0.1 * rng.normal(size=40)[stripe]
    residual = shift + 0.05 * rng.normal(size=stripe.size)
    assert stripe_misfit(residual, stripe, along).is_relevant
    known = np.full(stripe.size, 0.1**2)
    assert not stripe_misfit(residual, stripe, along, known).is_relevant
    assert stripe_misfit(4 * residual, stripe, along, known).is_relevant


def _board_views(camera: Camera, angles, error, rng):
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), -1).reshape(-1, 2) * 5.0
    board = np.concatenate([grid.T - [[20.0], [12.0]], np.zeros((1, 54))])
    axis, point = np.array([0.0, 0.8, -0.6]), np.array([1.0, 4.0, 130.0])
    across = Turntable(axis, point).perpendicular
    standing = np.stack([*across, axis]).T @ board + point[:, None]
    views, poses = [], []
    for k, angle in enumerate(angles + error(angles)):
        turn = rotation_matrix(angle * axis)
        seen = turn @ (standing - point[:, None]) + point[:, None]
        pixels = camera.project(seen) + 0.02 * rng.normal(size=(2, 54))
        views.append(View(f"{k}.png", str(k), np.arange(54), pixels, camera.size, np.ones(54)))
        poses.append(transform(turn @ np.stack([*across, axis]).T, point))
    return views, board, np.array(poses), axis, point


def _table_camera():
    return Camera.of([750.0, 749.3, 241.4, 188.2, -0.15, 0.1, 0.0004, -0.0006, 0.0], (480, 384))


def test_turntable_axis_and_its_periodic_error_are_found():
    rng, angles = np.random.default_rng(6), np.deg2rad(np.arange(0.0, 360.0, 15.0))
    size = np.deg2rad(0.05)
    views, board, poses, axis, point = _board_views(
        _table_camera(), angles, lambda a: size * np.sin(2 * a + 0.4), rng
    )
    made = calibrate_turntable(views, board, _table_camera(), poses, angles)
    assert np.linalg.norm(made.table.axis - axis) < 5e-4
    away = made.table.point - point
    assert np.linalg.norm(away - axis * (axis @ away)) < 0.02
    assert list(made.table.harmonics) == [2]
    assert np.hypot(*made.table.harmonics[2]) == pytest.approx(size, rel=0.15)
    assert made.after < 0.3 * made.before
    assert any("turntable-step-error" in sentence for sentence in made.sentences)


def _bare_diagnosis() -> Diagnosis:
    """A diagnosis of images in which nothing was found; parts that these tests do not read are None."""
    empty = ((), (), (), ())
    return Diagnosis(
        "r",
        "r",
        "scan-images",
        1,
        "camera",
        "px",
        CONSISTENT,
        *empty,
        None,
        (),
        Experiment("none"),
        None,
    )


@pytest.mark.parametrize(("size_deg", "verdict"), [(0.05, "explained"), (0.0, "consistent")])
def test_diagnosis_holds_the_angle_law_of_the_turntable(size_deg, verdict, monkeypatch):
    rng, angles = np.random.default_rng(16), np.deg2rad(np.arange(0.0, 360.0, 15.0))
    views, board, poses, *_ = _board_views(
        _table_camera(), angles, lambda a: np.deg2rad(size_deg) * np.cos(a + 1.0), rng
    )
    found = calibrate_turntable(views, board, _table_camera(), poses, angles)
    monkeypatch.setattr(diagnosed_turntable, "turntable_of_images", lambda *_: found)
    made = diagnosed_turntable.with_turntable(_bare_diagnosis(), None, lambda text: None)
    assert made.verdict == verdict
    answer = made._turntable()
    assert any(term["retained"] for term in answer["terms"]) == (size_deg > 0)
    assert answer["statements"] == list(found.sentences)
    assert (made.experiment.sentence != "none") == (size_deg > 0)
    blocks = section(found).blocks
    assert {block["kind"] for block in blocks} >= {"figure", "note", "table"}


def test_recordings_without_a_turntable_calibrate_no_camera():
    rows = (
        {"image": "a.png", "role": "board"},
        {"image": "b.png", "role": "scan", "table_deg": 5.0},
    )
    recording = SimpleNamespace(images=rows)
    made = _bare_diagnosis()
    assert diagnosed_turntable.with_turntable(made, recording, lambda text: None) is made


def test_turntable_without_errors_has_no_step_error():
    angles = np.deg2rad(np.arange(0.0, 360.0, 15.0))
    found = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        views, board, poses, *_ = _board_views(_table_camera(), angles, lambda a: 0 * a, rng)
        made = calibrate_turntable(views, board, _table_camera(), poses, angles)
        found.append(bool(made.table.harmonics) or made.table.gain != 1)
    assert sum(found) == 0


def test_random_step_errors_are_measured():
    angles = np.deg2rad(np.arange(0.0, 360.0, 10.0))
    rng = np.random.default_rng(8)
    size = np.deg2rad(0.03)
    views, board, poses, *_ = _board_views(
        _table_camera(), angles, lambda a: size * rng.normal(size=a.size), rng
    )
    made = calibrate_turntable(views, board, _table_camera(), poses, angles)
    assert abs(made.table.sigma - size) < 3 * made.sigma_std


def test_a_board_that_does_not_turn_with_the_table_is_refused():
    rng, angles = np.random.default_rng(9), np.deg2rad(np.arange(0.0, 120.0, 15.0))
    views, board, poses, *_ = _board_views(_table_camera(), angles, lambda a: 0 * a, rng)
    order = rng.permutation(len(views))
    views = [views[k] for k in order[:-1]] + [
        View("x.png", "x", views[0].index, views[0].pixels + 40, views[0].size, views[0].sigma)
    ]
    with pytest.raises(InputError, match="turns with the table"):
        calibrate_turntable(views, board, _table_camera(), poses[order], angles)


def test_full_revolutions_are_distinguished_from_partial_ones():
    assert is_full_revolution(np.deg2rad(np.arange(0, 360, 5)))
    assert not is_full_revolution(np.deg2rad(np.arange(0, 300, 5)))


@pytest.mark.parametrize("kind", ["profiler", "3d-camera"])
def test_sensor_with_its_own_calibration_through_the_chain(kind, tmp_path):
    made = example(kind, tmp_path / "r", lambda text: None)
    run = hand_eye.calibrate(made.recording, None, None, lambda text: None)
    assert run.made.kind == ("profiles" if kind == "profiler" else "clouds")
    std = np.sqrt(np.diag(run.made.covariance))
    error = run.made.sensor[:3, 3] - HAND_EYE[:3, 3]
    assert (np.abs(error) < 3 * std[:3]).all()
    hand_eye.save(run, tmp_path)
    for extra in ((), ("--hand-eye", str(tmp_path / "hand-eye.toml"))):
        answer = _scanned(tmp_path, f"scan{len(extra)}", tmp_path / "r", *extra)
        ball = answer["scans"][0]["balls"][0]
        away = np.array([ball[f"{axis}_mm"] for axis in "xyz"]) - made.balls[1]
        assert away @ np.linalg.solve(ball["covariance_mm2"], away) < 14.2  # chi-square, p = 0.003
        assert answer["scans"][0]["frame"] == "base"


def _scanned(folder, name, recording, *extra) -> dict:
    out = folder / name
    status = cli.run(["scan", str(recording), "--out", str(out), "--no-report", *extra])
    assert status == 0
    return json.loads((out / "answer.json").read_text())


def test_joined_scans_need_a_sample_in_every_image(tmp_path):
    folder = _tiny(tmp_path, ["scan,,1,1", "scan,,1,"])
    with pytest.raises(InputError, match="every step of a scan once"):
        datasets.read(_tiny(tmp_path / "b", ["scan,,1,1", "scan,,1,1"]))
    assert len(datasets.read(folder).images) == 3


def _tiny(folder, rows):
    """A scan-images recording of black images; rows: role, placement, scan, sample."""
    import cv2

    (folder / "i").mkdir(parents=True)
    lines = ["image,role,placement,scan,sample", "i/0.png,board,1,,"]
    lines += [f"i/{k}.png,{row}" for k, row in enumerate(rows, 1)]
    for k in range(len(lines) - 1):
        cv2.imwrite(str(folder / f"i/{k}.png"), np.full((16, 16), k, np.uint8))
    (folder / "images.csv").write_text("\n".join(lines) + "\n")
    flange = "flange_x_mm,flange_y_mm,flange_z_mm,flange_qw,flange_qx,flange_qy,flange_qz"
    (folder / "samples.csv").write_text(f"sample,{flange}\n1,500,0,300,1,0,0,0\n")
    text = 'format = "recording/1"\nmeasures = "scan-images"\n[samples]\nfile = "samples.csv"\n'
    text += '[images]\nfile = "images.csv"\n[board]\nkind = "chessboard"\ncolumns = 9\nrows = 6\n'
    (folder / "recording.toml").write_text(text + "square_mm = 5.0\n")
    return folder


@pytest.mark.parametrize("kind", mostly_slow(["fixed-plane", "galvanometer", "turntable"], 0, 2))
def test_rendered_example_through_the_whole_chain(kind, tmp_path):
    made = example(kind, tmp_path / "r", lambda text: None)
    answer = _scanned(tmp_path, "scan", tmp_path / "r")
    assert not answer["warnings"]
    for scan in answer["scans"]:
        assert {ball["ball"] for ball in scan["balls"]} == {1, 2, 3}
        found = np.array([[ball[f"{axis}_mm"] for axis in "xyz"] for ball in scan["balls"]])
        true = np.array([made.balls[ball["ball"]] for ball in scan["balls"]])
        spread = np.array([ball["std_in_best_frame_mm"] for ball in scan["balls"]])
        assert _aligned_rms(found, true) < 2 * np.sqrt((spread**2).sum(1).mean())
        if scan["frame"] != "camera":
            std = np.array([ball["std_mm"] for ball in scan["balls"]])
            assert (np.abs(found - true) < 3 * std).all()
    scanner = tmp_path / "scan" / "scanner.toml"
    again = _scanned(tmp_path, "again", tmp_path / "r", "--scanner", str(scanner))
    assert [len(scan["balls"]) for scan in again["scans"]] == [3] * len(again["scans"])
    if kind == "turntable":
        assert "[turntable]" in scanner.read_text()
        out = tmp_path / "diagnosis"
        assert cli.run(["diagnose", str(tmp_path / "r"), "--out", str(out)]) == 0
        answer = json.loads((out / "answer.json").read_text())
        assert answer["verdict"] == "explained"
        assert [term["order"] for term in answer["turntable"]["terms"] if term["retained"]] == [1]
        assert "Angles of the turntable" in (out / "report.html").read_text(encoding="utf-8")
        return
    out = tmp_path / "hand-eye"
    assert cli.run(["handeye", str(tmp_path / "r"), "--out", str(out), "--no-report"]) == 0
    found = json.loads((out / "answer.json").read_text())["hand_eye"]
    away = np.abs(np.array(found["xyz_mm"]) - HAND_EYE[:3, 3])
    assert (away < 3 * np.array(found["std_mm"])).all()


def _aligned_rms(found, true) -> float:
    """mm, RMS distance after the best rigid alignment (Kabsch)."""
    turn, _ = Rotation.align_vectors(true - true.mean(0), found - found.mean(0))
    left = turn.apply(found - found.mean(0)) - (true - true.mean(0))
    return float(np.sqrt((left**2).sum(1).mean()))


@pytest.mark.parametrize("kind", KINDS)
def test_templates_of_scanners_are_named(kind):
    from workbench.recordings.templates import KINDS as all_kinds

    assert kind in all_kinds
