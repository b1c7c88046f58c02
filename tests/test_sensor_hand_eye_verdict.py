"""The verdict of `handeye` on recordings that determine little: no errors are blamed on the flange poses."""

import json
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import datasets
import hand_eye_recordings as recordings
import hand_eye_scenes
from workbench.commands import cli
from workbench.core.rigid import transform
from workbench.fitting.verdicts.hand_eye_verdict import (
    _profiles,
    flange_errors,
    handeye_verdict,
    handeye_warnings,
    rotation_error_words,
)
from workbench.jobs.sensor import hand_eye


def flat_turns(scene, random) -> np.ndarray:
    """(P, 4, 4) T_camera_board of a board that stays parallel to the image and turns about its normal only."""
    turns = Rotation.from_rotvec(
        np.outer(np.linspace(-0.6, 0.6, scene.count), [0, 0, 1])
    ).as_matrix()
    extent = np.ptp(scene.board.points[:2], axis=1) + 2 * scene.board.square_mm
    away = 1.5 * recordings.CAMERA.fx * max(extent / np.array(recordings.SIZE))
    aside = random.uniform(-0.06, 0.06, (scene.count, 2)) * away
    place = np.column_stack([aside, np.full(scene.count, away)])
    return transform(turns, place - turns @ scene.board.middle)


def answer_of(recording, folder):
    """The exit status of `handeye` on a recording, its answer and the text of the report page."""
    datasets.write(recording, folder / "recording")
    out = folder / "run"
    status = cli.run(["handeye", str(folder / "recording"), "--out", str(out)])
    page = (out / "report.html").read_text()
    return status, json.loads((out / "answer.json").read_text()), page


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """The answer on turns about one axis before a flat board, with the camera from the same images."""
    patch = pytest.MonkeyPatch()
    patch.setattr(recordings, "board_poses", flat_turns)
    patch.setitem(
        recordings.SCENES, "flat", replace(recordings.SCENES["chessboard"], count=8, noise_mm=0.05)
    )
    made = recordings.made("flat")
    patch.undo()
    return answer_of(made.recording, tmp_path_factory.mktemp("flat"))


def test_turns_about_one_axis_before_a_flat_board_are_not_determined(flat):
    status, answer, _ = flat
    assert status == 1
    assert answer["verdict"]["pass"] is False
    assert answer["verdict"]["sentence"].startswith("Not determined: ")
    assert "second axis" in answer["verdict"]["sentence"]
    assert "tilt the board" in answer["verdict"]["sentence"]


def test_what_is_undetermined_comes_first(flat):
    assert flat[1]["warnings"][0].startswith("undetermined: ")


def test_flange_poses_are_not_blamed_where_nothing_is_determined(flat):
    _, answer, page = flat
    assert set(answer["robot_sigma"].values()) == {None}
    said = " ".join([*answer["warnings"], *answer["suspicions"], answer["verdict"]["sentence"]])
    assert "flange poses are off" not in said and "do not fit the images" not in said
    assert "errors of the flange poses are not estimated" in page


def test_few_poses_are_a_warning(tmp_path):
    whole = recordings.made("chessboard").recording
    images = whole.images
    few = replace(whole, images=tuple(row for row in images if row["sample"] <= 5))
    status, answer, _ = answer_of(few, tmp_path)
    assert status == 0
    (warning,) = [text for text in answer["warnings"] if "poses" in text]
    assert warning.startswith("only 5 poses") and "at least 8" in warning


def test_a_sound_recording_has_no_such_warning(tmp_path):
    status, answer, page = answer_of(recordings.made("chessboard").recording, tmp_path)
    assert status == 0 and answer["warnings"] == []
    assert answer["robot_sigma"]["position_mm"] is not None
    assert "Not determined" not in answer["verdict"]["sentence"]
    text = (tmp_path / "run" / "hand-eye.toml").read_text()
    assert text.startswith("# matrix: 4x4 in mm") and "covariance: 6x6 of x y z (mm)" in text
    assert np.shape(tomllib.loads(text)["covariance"]) == (6, 6)


def test_errors_of_the_flange_poses_are_3d_like_the_others():
    """1 sigma of a coordinate times sqrt(3) is the RMS of the distance, as every other error of the answer."""
    place, turn = flange_errors({"position_mm": 0.1, "rotation_deg": 0.02})
    assert place == pytest.approx(0.1732, abs=1e-4) and turn == pytest.approx(0.03464, abs=1e-5)
    assert flange_errors({"position_mm": 0.1})[1] is None


@pytest.mark.parametrize(
    ("place", "turn", "words"),
    [
        (0.07, 1.7e-5, "no rotation error that is distinguishable from zero"),
        (0.07, 0.004, "0.004 deg (angle of the rotation)"),
        (0.001, 1.7e-5, "1.7e-05 deg (angle of the rotation)"),
    ],
)
def test_a_rotation_error_at_its_lower_bound_is_called_so(place, turn, words):
    assert rotation_error_words(place, turn) == words


@pytest.mark.parametrize(
    ("position", "radius", "words"),
    [
        (0.05, 0.004, "comes from the flange poses, whose estimated RMS error is 0.087 mm"),
        (0.002, 0.06, "an error of the radius of the circles (1 sigma 0.06 mm"),
    ],
)
def test_the_verdict_on_profiles_names_what_exceeds_their_noise(position, radius, words):
    errors = {"rms_mm": 0.095, "pose_rms_mm": 0.1}
    sigma = {"position_mm": position, "radius_mm": radius}
    made = SimpleNamespace(radius=12.7, held_out=errors, fit=errors, noise=0.04, robot_sigma=sigma)
    made = SimpleNamespace(**vars(made), poses=(None,) * 40, std={"sensor.x": 0.1}, misfit=None)
    assert words in _profiles(made, ()).sentence
    quiet = SimpleNamespace(**{**vars(made), "noise": 0.094})
    assert words not in _profiles(quiet, ()).sentence


@pytest.fixture(scope="module")
def exchanged():
    """The run of `handeye` on profiles whose poses are numbered from 5, with two of them exchanged."""
    points, pose, flange = hand_eye_scenes.profiles(11)
    order = np.arange(len(flange))
    order[[2, 7]] = 7, 2
    recording = recordings.of_profiles(points, pose, flange[order], first=5)
    return hand_eye.calibrate(recording, None, None, lambda text: None)


def test_an_exchange_is_named_by_the_numbers_of_the_recording(exchanged):
    assert "poses of pose 7 and pose 12 look exchanged" in exchanged.made.suspicions[0]


def test_the_verdict_agrees_with_the_first_warning(exchanged):
    """Poses that are wrong may also leave the transform undetermined; the mistake is the cause."""
    covariance = np.diag([np.inf] * 3 + [1.0] * 3)
    loose = replace(exchanged.made, covariance=covariance, undetermined=("no axis",))
    for run in (exchanged, replace(exchanged, made=loose)):
        verdict = handeye_verdict(run)
        assert not verdict.passed
        assert handeye_warnings(run)[0] in verdict.sentence


def test_a_wrong_radius_of_the_ball_is_suspected():
    """The certified radius is 0.3 mm too small, the same for all profiles; the right one is none."""
    recording = recordings.of_profiles(*hand_eye_scenes.profiles(5))
    wrong = replace(recording, balls={1: (0.0, 0.0, 0.0, 19.7)})
    run = hand_eye.calibrate(wrong, None, None, lambda text: None)
    verdict = handeye_verdict(run)
    assert not verdict.passed and "certified radius is 19.7 mm" in verdict.sentence
    assert handeye_warnings(run)[0] in verdict.sentence
    sound = replace(run, made=replace(run.made, radius=20.0))
    assert not any("certified" in warning for warning in handeye_warnings(sound))
