"""What a hand-eye set cannot tell is not stated: sigmas, suspicions, camera, scale, pivot, bad input."""

from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hand_eye_scenes import CAMERA, HAND_EYE, LOOKS, board, camera_prior, images, off, profiles
from sensors.boards.board import Board
from sensors.boards.detection import View
from sensors.camera.calibration import calibrate_camera
from sensors.hand_eye.images import hand_eye_from_views, review_views
from sensors.hand_eye.motion import readings
from sensors.hand_eye.profiles import hand_eye_from_profiles
from sensors.hand_eye.start import align
from sensors.hand_eye.uncertainty.parameter_covariance import _reduced_normal
from workbench.core.errors import InputError
from workbench.core.rigid import inverse, transform

STILL = np.broadcast_to(LOOKS, (12, 3, 3))
SPUN = LOOKS @ Rotation.from_rotvec(np.outer(np.linspace(-1, 1, 12), [0, 0, 1])).as_matrix()


@pytest.mark.parametrize(
    ("turns", "words"), [(STILL, "never turned"), (SPUN, "about one axis only")]
)
@pytest.mark.parametrize(
    ("kind", "spin"),
    [
        ("in-hand", 1e-5),
        ("to-hand", 6e-3),
        *(
            pytest.param(kind, spin, marks=pytest.mark.long)
            for kind, spin in (("to-hand", 8e-4), ("in-hand", 3e-3))
        ),
    ],
)
def test_what_the_motions_leave_open_has_no_sigma(turns, words, kind, spin):
    """However large the robot's errors of rotation, which look like turns: place inf, turn finite and true."""
    views, flange = images(9, kind, turns=turns, spin=spin)
    found = hand_eye_from_views(views, board(), CAMERA, flange, kind)
    assert words in found.undetermined[0] and len(found.undetermined) == 1 and not found.suspicions
    for covariance, where in ((found.covariance, "sensor"), (found.target_covariance, "target")):
        std = np.sqrt(np.diag(covariance))
        assert np.isinf(std[:3]).all() and np.isfinite(std[3:]).all()
        assert np.isnan(covariance[0, 1:]).all() and np.isinf(found.std[f"{where}.x"])
    assert np.abs(off(found.sensor)[3:] / np.sqrt(np.diag(found.covariance))[3:]).max() < 4


def test_angles_that_never_change_are_not_read_in_another_order():
    flange = images(8, turns=STILL, spin=1e-5)[1]
    names = [str(k) for k in range(len(flange))]
    assert not any("angles" in words for words, _ in readings(flange, names))
    assert any("angles" in words for words, _ in readings(images(8)[1], names))


def test_information_conditional_on_a_prior_is_the_whole_less_the_prior():
    """The Schur complement is the inverse of the block of the inverse."""
    rows = np.random.default_rng(0).normal(size=(20, 5))
    precision, own = np.array([0, 0, 4.0, 0, 1.0]), np.array([True, True, False, True, False])
    whole = np.linalg.inv(rows.T @ rows + np.diag(precision))[np.ix_(own, own)]
    np.testing.assert_allclose(
        _reduced_normal(rows.T @ rows, precision, own), np.linalg.inv(whole), rtol=1e-9
    )


def test_across_the_one_axis_the_sigma_stays_where_the_frame_lies_along_it():
    """The camera's own axis is one of the flange's: its place across it is known and covered."""
    straight = transform(np.eye(3), np.array([60.0, -20, 90]))
    views, flange = images(9, turns=SPUN, spin=1e-5)
    found = hand_eye_from_views(views, board(), CAMERA, flange @ HAND_EYE @ inverse(straight))
    std = np.sqrt(np.diag(found.covariance))
    assert np.isinf(std[2]) and std[:2].max() < 5
    assert np.abs(off(found.sensor, straight)[:2] / std[:2]).max() < 4


@pytest.mark.parametrize("turns", [STILL, SPUN])
def test_profiles_leave_the_same_open(turns):
    points, pose, flange = profiles(8, turns=turns)
    found = hand_eye_from_profiles(points, pose, flange, 20.0, range_scale=False)
    assert np.isinf(np.diag(found.covariance)[:3]).all() and np.isinf(found.std["target.z"])
    assert "undetermined" in found.undetermined[0]


def test_small_turns_are_known_and_covered():
    """Turns of two degrees, forty times the robot's errors: sigmas of millimetres, and true."""
    random = np.random.default_rng(1)
    turns = LOOKS @ Rotation.from_rotvec(random.uniform(-0.035, 0.035, (12, 3))).as_matrix()
    views, flange = images(8, turns=turns, spin=1e-4)
    found = hand_eye_from_views(views, board(), CAMERA, flange)
    std = np.sqrt(np.diag(found.covariance))
    assert (
        not found.undetermined
        and np.isfinite(std).all()
        and np.abs(off(found.sensor) / std).max() < 4
    )


@pytest.mark.parametrize("turns", [STILL, SPUN])
@pytest.mark.parametrize("seed", range(2))
def test_motions_with_too_few_turns_align_as_well_as_others(turns, seed):
    """The closed form behind the suspicions finds the turn from translations where rotations do not tell it."""
    random = np.random.default_rng(seed)
    moved = transform(turns, random.uniform(-100, 100, (12, 3)))
    seen = inverse(HAND_EYE) @ inverse(moved) @ transform(np.eye(3), np.array([400.0, 0, 50]))
    found, misfit, _ = align(moved, seen)
    assert misfit < 0.5 and np.abs(off(found)[3:]).max() < 1e-3


def test_the_robots_errors_turn_about_the_board():
    """A robot that only tilts, about the board, far from the base's origin: its position has no error then.

    Taken about the base's origin, 400 mm away, the tilts would be shifts of a third of a millimetre as well.
    """
    views, flange = images(3, shift=0.01, spin=1e-3)
    found = hand_eye_from_views(views, board(), CAMERA, flange)
    assert found.robot_sigma["position_mm"] < 0.03
    assert np.radians(found.robot_sigma["rotation_deg"]) == pytest.approx(1e-3, rel=0.4)


def at_the_flange(seed):
    """Views, and flange poses whose errors of place and turn are independent at the flange."""
    views, flange = images(seed, shift=0, spin=0)
    random = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(random.normal(0, 3e-4, (12, 3))).as_matrix()
    return views, transform(
        turns @ flange[:, :3, :3], flange[:, :3, 3] + random.normal(0, 0.2, (12, 3))
    )


@pytest.mark.parametrize(
    ("pivot", "within", "sets"),
    [
        pytest.param("flange", (0.85, 1.15), 20, marks=pytest.mark.slow),
        pytest.param("flange", (0.85, 1.15), 60, marks=pytest.mark.long),
        pytest.param("board", (0.75, 1.3), 60, marks=pytest.mark.long),
    ],
)
def test_sigmas_hold_for_errors_at_the_flange(pivot, within, sets):
    """RMS of error over sigma over many sets; the robot's errors taken where they are, and where they are not."""
    views, flange = at_the_flange(300)
    reviewed = review_views(views, board(), CAMERA, flange)
    assert not reviewed.sentences  # and so that of the first set serves them all
    ratio = []
    for seed in range(300, 300 + sets):
        views, flange = at_the_flange(seed)
        found = hand_eye_from_views(views, board(), CAMERA, flange, pivot=pivot, reviewed=reviewed)
        ratio.append(off(found.sensor) / np.sqrt(np.diag(found.covariance)))
    whole = np.sqrt(np.mean(np.square(ratio)))
    assert within[0] < whole < within[1]


def grid_board():
    return Board("chessboard", 7, 5, 15.0)


def calibrated(seed, bow=0.0):
    """A calibration of CAMERA from views of a board bowed by `bow` mm, made by formula; the views and flange poses."""
    target = grid_board()
    x, y = ((target.points - target.middle[:, None]) / target.half_diagonal)[:2]
    bent = target.points + np.stack([0 * x, 0 * x, bow * (x * x + y * y)])
    views, flange = images(seed, count=16, noise=0.0, shift=0.02, spin=2e-5, points=bent)
    random = np.random.default_rng(seed)
    views = [
        View(
            f"{k}.png",
            f"{k}",
            v.index,
            v.pixels + random.normal(0, 0.05, v.pixels.shape),
            CAMERA.size,
            np.full(35, 0.05),
        )
        for k, v in enumerate(views)
    ]
    return calibrate_camera(views, target, CAMERA.size, folds=0), views, flange


def test_a_calibration_of_the_same_images_is_taken_with_its_covariance_and_bow():
    """Truth within four sigmas; every sigma of the camera by its name; no sentence on a camera's components."""
    made, views, flange = calibrated(4, bow=0.3)
    target = SimpleNamespace(
        **{name: getattr(made.board, name) for name in ("points", "middle", "half_diagonal")}
    )
    found = hand_eye_from_views(views, target, made, flange)
    assert np.abs(off(found.sensor) / np.sqrt(np.diag(found.covariance))).max() < 4
    assert found.converged and not found.undetermined and not found.suspicions
    assert not any("mode" in key for key in found.std)
    before = np.sqrt(np.diag(made.covariance))[:9]
    after = [
        found.std[f"camera.{name}"]
        for name in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    ]
    assert (after <= before * 1.001).all() and after[0] < 0.8 * before[
        0
    ]  # the robot is a ruler in depth
    assert abs(found.camera.fx - CAMERA.fx) < 4 * after[0]
    flat = hand_eye_from_views(
        views, target, made.camera, flange, camera_covariance=made.covariance[:9, :9]
    )
    assert found.noise < 0.8 * flat.noise and found.noise == pytest.approx(0.05, rel=0.1)


def test_a_camera_that_no_motion_helps_leaves_no_words_of_its_components():
    """A prior's directions that the images do not better are no news of the hand-eye."""
    views, flange = images(5)
    found = hand_eye_from_views(
        views, board(), CAMERA, flange, camera_covariance=1e-8 * camera_prior(CAMERA)
    )
    assert found.undetermined == ()


def test_a_covariance_that_is_not_finite_is_a_sentence():
    views, flange = images(5)
    with pytest.raises(InputError, match="covariance is finite"):
        hand_eye_from_views(
            views, board(), CAMERA, flange, camera_covariance=np.full((9, 9), np.nan)
        )


def test_a_board_printed_too_large_is_found_by_its_held_out_error():
    views, flange = images(6, shift=0.02, spin=3e-5)
    small = SimpleNamespace(points=board().points / 1.003)
    found = hand_eye_from_views(views, small, CAMERA, flange)
    assert (
        found.parameters["target.scale"] == pytest.approx(0.003, abs=0.0006)
        and "kept" in found.notes[0]
    )
    right = hand_eye_from_views(views, board(), CAMERA, flange)
    assert right.parameters["target.scale"] == 0 and not right.notes


def first(flange, change):
    flange = flange.copy()
    flange[3] = change(flange[3])
    return flange


BROKEN = {
    "left-handed": lambda pose: transform(np.diag([1, 1, -1.0]) @ pose[:3, :3], pose[:3, 3]),
    "right angles": lambda pose: transform(pose[:3, :3] * 1.1, pose[:3, 3]),
    "transposed": lambda pose: pose.T,
}


@pytest.mark.parametrize("word", BROKEN)
def test_matrices_that_are_no_pose_are_named(word):
    views, flange = images(7)
    with pytest.raises(InputError, match=rf"flange pose 3\b.*{word}"):
        hand_eye_from_views(views, board(), CAMERA, first(flange, BROKEN[word]))
    points, pose, flange = profiles(7)
    with pytest.raises(InputError, match=rf"flange pose 3\b.*{word}"):
        hand_eye_from_profiles(points, pose, first(flange, BROKEN[word]), 20.0)


def test_matrices_written_with_three_decimals_are_taken():
    views, flange = images(7)
    rough = np.round(flange, 3)
    assert np.abs(off(hand_eye_from_views(views, board(), CAMERA, rough).sensor)[:3]).max() < 2


def test_a_pixel_that_is_no_number_is_named():
    views, flange = images(7)
    views[2] = SimpleNamespace(
        index=views[2].index, pixels=np.where(np.arange(35) == 3, np.nan, views[2].pixels)
    )
    with pytest.raises(InputError, match="image 2: .* nan at corner 3 "):
        hand_eye_from_views(views, board(), CAMERA, flange)


@pytest.fixture(scope="module")
def one_axis():
    """A run of the command's part on images with turns about one axis."""
    from workbench.jobs.sensor.hand_eye import HandEyeRun

    views, flange = images(9, turns=SPUN, spin=1e-5)
    views = [View("", "", v.index, v.pixels, CAMERA.size, np.ones(35)) for v in views]
    made = hand_eye_from_views(views, grid_board(), CAMERA, flange)
    return HandEyeRun(
        SimpleNamespace(title="", name="one axis", measures="board-images"),
        made,
        flange,
        tuple(f"{k}.png" for k in range(12)),
        made.camera,
        None,
        grid_board(),
    )


def test_terminal_and_page_say_first_what_is_not_determined(one_axis, monkeypatch):
    from rich.console import Console

    from workbench.commands.shared import answer, sensor_tables
    from workbench.jobs.sensor import hand_eye
    from workbench.report.sensor import handeye as report

    monkeypatch.setattr(hand_eye, "provenance", lambda recording: {})
    monkeypatch.setattr(report, "_provenance", lambda recording: [])
    result = {"recording": "x", **hand_eye.as_json(one_axis)}
    console = Console(record=True, width=120, file=StringIO())
    sensor_tables.handeye(console, result)
    text = console.export_text()
    assert (
        text.startswith("Warning: the flange turned about one axis only")
        and text.count("not identifiable") == 3
    )
    assert '"std_mm": [\n      null,\n      null,\n      null\n    ]' in answer.as_text(result)
    page = report.page(one_axis)
    assert "turned about one axis only" in page.warning
    # three coordinates, and the heading of the list
    assert str(page.sections).count("not identifiable") == 4


def test_the_file_says_what_is_not_determined(one_axis, tmp_path, monkeypatch):
    import tomllib

    from workbench.jobs.sensor import hand_eye

    monkeypatch.setattr(hand_eye, "provenance", lambda recording: {})
    hand_eye.save(one_axis, tmp_path)
    result = tomllib.loads((tmp_path / "hand-eye.toml").read_text())
    assert "one axis" in result["undetermined"][0] and np.isinf(result["std_mm"]).all()
