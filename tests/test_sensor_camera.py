"""A camera from boards: fx and its sigma hold, the bow is why, blunders are named, what is unknown is said."""

import glob
from dataclasses import replace

import numpy as np
import pytest

from board_scenes import BOW, CAMERA, COLUMNS, ROWS, SQUARE, board_model
from conftest import mostly_slow, sizes
from sensors import images
from sensors.boards import detection as boards
from sensors.boards.board import Board
from sensors.boards.detection import View
from sensors.camera.calibration import calibrate_camera
from sensors.camera.checks import projection_difference, projection_uncertainty
from sensors.camera.model import Camera
from sensors.effects import CATALOGUE
from workbench.core.errors import InputError

BOARD = Board("chessboard", COLUMNS, ROWS, SQUARE)


def views_of(rng, count=20, **scene) -> tuple[list[View], object]:
    """Images of boards with 0.06 px noise, as `boards.detect` gives them, and the true parameters."""
    model, truth = board_model(rng, count, **scene)
    pixels, corners = model.chain.pixels, BOARD.count
    radius = scene.get("radius", 0.0)
    return [
        View(
            f"{k}.png",
            str(k),
            np.arange(corners),
            pixels[:, corners * k : corners * (k + 1)],
            CAMERA.size,
            np.full(corners, 0.06),
            radius,
        )
        for k in range(count)
    ], truth


def calibrated(views, board=BOARD, folds=0, **options):
    return calibrate_camera(views, board, CAMERA.size, folds=folds, **options)


def test_the_simulated_copy_of_the_published_instrument_is_found_within_its_sigmas():
    """20 boards with a bow of 50 um: fx within 3 sigma, which is below 0.1 %; the bow within its own."""
    views, truth = views_of(np.random.default_rng(0))
    made = calibrated(views)
    assert (
        abs(made.camera.fx - 3421) < 3 * made.std["camera.fx"]
        and made.std["camera.fx"] < 1e-3 * 3421
    )
    for name in ("xx", "yy", "xy"):
        gap = made.bow.parameters[name] - BOW[f"artefact.board-bow.{name}"]
        assert abs(gap) < 4 * made.bow.std[name] and made.bow.std[name] < 0.003
    assert made.rms_px == pytest.approx(0.06 * np.sqrt(2), rel=0.05)
    assert made.rms_coordinate_px == pytest.approx(0.06, rel=0.05)
    assert made.rms_px**2 == pytest.approx((made.view_rms_px**2).mean())
    assert not made.undetermined and not made.rejected and made.fit.converged


@pytest.mark.parametrize("count", sizes(40, 100))
def test_stated_sigmas_cover_the_truth(count):
    pulls = []
    for seed in range(count):
        views, truth = views_of(np.random.default_rng(1000 + seed))
        made = calibrated(views)
        pulls.append((made.parameters.values - truth.values) / np.sqrt(np.diag(made.covariance)))
    assert (np.abs(pulls) < 1).mean() == pytest.approx(0.68, abs=0.06)
    assert np.abs(np.array(pulls)[:, 0]).max() < 4


def test_without_the_bow_the_focal_length_is_off_by_tens_of_pixels():
    """By 15 and more sigmas of independent corners, at a small RMS; the stated sigma holds the uneven board."""
    for seed in range(3):
        views, _ = views_of(np.random.default_rng(seed))
        flat = calibrated(views, bow=False)
        assert (
            abs(flat.camera.fx - 3421) > max(15, 15 * flat.fit.std["camera.fx"])
            and flat.rms_px < 0.2
        )
        assert flat.shared.significant and "height of the board" in flat.shared.errors.names
        assert abs(flat.camera.fx - 3421) < 4 * flat.std["camera.fx"]
        assert flat.bow is None


def test_it_gives_what_opencv_gives_where_both_fit_the_same():
    import cv2

    views, _ = views_of(np.random.default_rng(3), 12, bow={})
    points = [BOARD.points.T.astype(np.float32)] * len(views)
    pixels = [view.pixels.T.astype(np.float32) for view in views]
    rms, matrix, distortion, *_ = cv2.calibrateCamera(points, pixels, CAMERA.size, None, None)
    ours = calibrated(views, bow=False, loss="linear")
    # float32 pixels, and OpenCV stops a little before its minimum
    assert rms * (1 - 1e-4) < ours.rms_px < rms * (1 + 1e-6)
    assert [ours.camera.fx, ours.camera.fy, ours.camera.cx, ours.camera.cy] == pytest.approx(
        [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], abs=2e-2
    )
    assert ours.camera.distortion[:4] == pytest.approx(distortion[0, :4], abs=5e-3)


def test_held_out_images_show_the_bow_that_opencv_has_not():
    views, _ = views_of(np.random.default_rng(2), 12)
    made = calibrated(views, folds=4)
    held = made.held_out
    assert held.rms_px == pytest.approx(0.085, rel=0.05) and held.halved_rms_px == pytest.approx(
        0.09, rel=0.05
    )
    assert (
        held.opencv_rms_px > 1.5 * held.rms_px
        and held.opencv_halved_rms_px > 1.5 * held.halved_rms_px
    )
    assert "with the pose of each image fitted" in held.sentence


def test_halves_differ_by_what_their_sigmas_say():
    ratios, p_values = [], []
    for seed in range(12):
        made = calibrated(views_of(np.random.default_rng(seed), 12)[0], folds=2)
        ratios.append(made.halves.ratio)
        p_values.append(made.halves.p_value)
        assert np.nanmax(made.halves.difference.value) < 6 * np.nanmax(made.halves.sigma.value)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1, abs=0.2) and min(p_values) > 1e-3


@pytest.mark.parametrize("count", sizes(15, 40))
def test_the_map_of_uncertainty_covers_the_true_projection(count):
    """Over cameras: the difference to the truth, after the best rigid motion, against the longer half axis."""
    inside = []
    for seed in range(count):
        made = calibrated(views_of(np.random.default_rng(50 + seed), 12)[0])
        gap = projection_difference(made.camera, CAMERA, made.distance_mm).value
        inside.append((gap < 1.52 * made.uncertainty.value).mean())
    # of an ellipse 68 % lie within 1.52 half axes if it is a circle, more within that of the longer half axis
    assert 0.66 < np.mean(inside) < 0.92


def test_a_turned_camera_is_no_other_camera():
    """A shift of the principal point is nearly a turn: most of it is no uncertainty of what can be observed."""
    values = np.zeros((9, 9))
    values[2, 2] = 1.0
    assert np.nanmax(projection_uncertainty(CAMERA, values, 125.0).value) < 0.15
    values[2, 2], values[:2, :2] = 0.0, 1.0  # fx and fy together: nearly a shift towards the board
    assert np.nanmax(projection_uncertainty(CAMERA, values, 125.0).value) < 0.01


def test_strong_distortion_and_a_rational_lens_are_followed():
    wide = Camera(540.0, 541.0, 330.0, 240.0, (-0.28, 0.08, 1e-3, -5e-4, 0.0), (640, 480))
    made = calibrated_wide(wide, "brown")
    assert (
        made.camera.fx == pytest.approx(540, abs=4 * made.std["camera.fx"])
        and made.std["camera.fx"] < 1
    )
    lens = Camera(
        540.0, 541.0, 330.0, 240.0, (0.4, 0.1, 1e-3, -5e-4, 0.02, 0.8, 0.2, 0.03), (640, 480)
    )
    made = calibrated_wide(lens, "rational")
    assert made.rms_px == pytest.approx(0.06 * np.sqrt(2), rel=0.05)
    assert projection_difference(made.camera, lens, made.distance_mm).value.max() < 0.5


def calibrated_wide(camera, model):
    rng = np.random.default_rng(4)
    near = np.c_[
        rng.uniform(-22, -8, 25),
        rng.uniform(-18, -6, 25),
        rng.uniform(20, 40, 25),
        rng.uniform(-0.6, 0.6, (25, 3)),
    ]
    chain = board_model(rng, 25, camera=camera, poses=near)[0].chain
    views = []
    for k in range(25):
        mine = np.flatnonzero(chain.labels["placement"] == k)
        mine = mine[(np.abs(chain.pixels[:, mine] - [[320], [240]]) < [[330], [250]]).all(0)]
        views.append(
            View(
                f"{k}.png",
                "",
                mine - 88 * k,
                chain.pixels[:, mine],
                camera.size,
                np.full(mine.size, 0.06),
            )
        )
    return calibrate_camera(views, BOARD, camera.size, model, folds=0)


def test_circles_are_predicted_where_their_ellipses_middles_are():
    """Discs of 1.2 mm radius, without noise: taken for corners they move fx by half of its sigma, and no RMS tells."""
    views, _ = views_of(np.random.default_rng(5), 12, radius=1.2, noise=0)
    made = calibrated(views, loss="linear")
    assert (
        made.camera.values[:8] == pytest.approx(CAMERA.values[:8], rel=1e-6, abs=1e-3)
        and made.rms_px < 1e-4
    )
    corners = calibrated([replace(view, radius_mm=0.0) for view in views], loss="linear")
    assert abs(corners.camera.fx - 3421) > 0.2 and corners.rms_px < 0.06


def test_a_further_effect_is_fitted_with_the_camera():
    true = {"camera.lens-residual.z3c0r": 0.4}
    views, _ = views_of(
        np.random.default_rng(6), effects=(CATALOGUE["lens-residual"]("camera"),), values=true
    )
    made = calibrated(views, effects=(CATALOGUE["lens-residual"]("camera"),))
    assert made.parameters["camera.lens-residual.z3c0r"] == pytest.approx(
        0.4, abs=4 * made.std["camera.lens-residual.z3c0r"]
    )
    assert calibrated(views).rms_px > 1.02 * made.rms_px


def test_stated_sigmas_that_are_too_small_are_made_up_for():
    """Every second image claims 0.005 px: what all have in common beyond that counts for all."""
    views, _ = views_of(np.random.default_rng(7))
    boast = [
        replace(view, sigma=view.sigma / 12) if k % 2 else replace(view, sigma=view.sigma / 6)
        for k, view in enumerate(views)
    ]
    made, plain = calibrated(boast), calibrated(views)
    assert made.fit.sigma_scale == pytest.approx(1, abs=0.1)
    assert made.camera.fx == pytest.approx(plain.camera.fx, abs=0.3 * plain.std["camera.fx"])
    assert made.std["camera.fx"] == pytest.approx(plain.std["camera.fx"], rel=0.1)


def broken(kind, views, rng):
    """Views with the fourth image spoilt."""
    view = views[3]
    grid = view.index.reshape(ROWS, COLUMNS)
    spoilt = {
        "shuffled": lambda: replace(view, index=rng.permutation(view.index)),
        "mirrored": lambda: replace(view, index=grid[:, ::-1].ravel()),
        "smeared": lambda: replace(view, pixels=view.pixels + rng.normal(0, 3, view.pixels.shape)),
        "three": lambda: replace(
            view, index=view.index[:3], pixels=view.pixels[:, :3], sigma=view.sigma[:3]
        ),
        "row": lambda: replace(
            view, index=grid[0], pixels=view.pixels[:, :COLUMNS], sigma=view.sigma[:COLUMNS]
        ),
    }
    return [*views[:3], spoilt[kind](), *views[4:]]


@pytest.mark.parametrize(
    "kind, why",
    [
        ("shuffled", "no pose of the 11 x 8 chessboard explains these corners"),
        ("mirrored", "a board seen from behind, unlike the others'"),
        ("smeared", "most of its corners are more than 6 times as far off"),
        ("three", "3 corners: a pose needs 4 or more"),
        ("row", "lie on one line"),
    ],
)
def test_a_image_that_contradicts_the_others_is_named_and_left_out(kind, why):
    rng = np.random.default_rng(8)
    views, _ = views_of(rng, 12)
    made = calibrated(broken(kind, views, rng))
    assert [one.image for one in made.rejected] == ["3.png"] and why in made.rejected[0].why
    assert len(made.views) == len(made.poses) == 11 and made.placements == [
        str(k) for k in range(12) if k != 3
    ]
    assert abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"] and made.std["camera.fx"] < 1.5


def test_single_wrong_corners_are_counted_by_image_and_spoil_nothing():
    views, _ = views_of(np.random.default_rng(9), 12)
    pixels = views[5].pixels.copy()
    pixels[:, :4] += 20
    made = calibrated([*views[:5], replace(views[5], pixels=pixels), *views[6:]])
    assert made.left_out == {"5.png": 4} and not made.rejected
    assert made.residual.shape[1] == 12 * 88 - 4
    assert any("4 of 5.png" in remark for remark in made.remarks)
    assert made.std["camera.fx"] < 1.5 and abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"]


def test_partly_seen_boards_in_any_order_and_two_images_of_one_placement():
    rng = np.random.default_rng(10)
    views, _ = views_of(rng, 12)
    part = []
    for view in views:
        some = rng.permutation(88)[: rng.integers(10, 80)]
        part.append(
            replace(
                view, index=view.index[some], pixels=view.pixels[:, some], sigma=view.sigma[some]
            )
        )
    again = replace(views[2], image="again.png")
    made = calibrated([*part, again])
    assert len(made.poses) == 12 and len(made.views) == 13
    assert abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"]


def test_parallel_boards_are_said_to_leave_the_focal_length_open():
    made = calibrated(views_of(np.random.default_rng(0), 12, tilt=1e-3)[0])
    assert (
        "was parallel to itself within" in made.undetermined[0]
        and "is confounded with its distance" in made.undetermined[0]
    )
    made = calibrated(views_of(np.random.default_rng(0), 12, tilt=0.05)[0])
    assert "is known to" in made.undetermined[0] and made.std["camera.fx"] > 5


def test_a_rational_model_that_boards_do_not_need_is_said_to_be_undetermined():
    made = calibrated(views_of(np.random.default_rng(0), 8)[0], model="rational")
    assert any("k4" in sentence for sentence in made.undetermined)
    assert abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"]


def test_a_field_that_is_hardly_covered_and_too_few_placements_for_checks_are_said():
    views, _ = views_of(np.random.default_rng(0), 3)
    small = [
        replace(v, index=v.index[m], pixels=v.pixels[:, m], sigma=v.sigma[m])
        for v in views
        for m in [(np.abs(v.pixels - [[640], [512]]) < 300).all(0)]
    ]
    made = calibrated(small, folds=5)
    assert "of the image's cells" in made.remarks[0]
    assert made.held_out is None and made.halves is None
    assert any("no image could be left out" in remark for remark in made.remarks)


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda v: v[:2], "expected the board in 3 or more board poses, found 2; take 15 to 20"),
        (lambda v: [], "expected the board in 3 or more board poses, found 0"),
        (
            lambda v: [replace(one, placement="a") for one in v],
            "expected the board in 3 or more board poses, found 1",
        ),
        (
            lambda v: [*v[:4], replace(v[4], size=(640, 480))],
            "4.png: expected a image of 1280 x 1024 pixels as the others, found 640 x 480",
        ),
        (
            lambda v: [*v[:4], replace(v[4], pixels=v[4].pixels * np.nan)],
            "4.png: expected a place in px of every corner, found nan",
        ),
        (
            lambda v: [*v[:4], replace(v[4], index=v[4].index + 1)],
            "4.png: expected corners 0 to 87 of the board, found 88",
        ),
        (
            lambda v: [replace(one, index=one.index.reshape(11, 8).T.ravel()) for one in v],
            "expected images of a 11 x 8 chessboard, .* correct the board's columns and rows",
        ),
    ],
)
def test_input_that_cannot_be_used_gets_its_sentence(change, sentence):
    views, _ = views_of(np.random.default_rng(0), 6)
    with pytest.raises(InputError, match=sentence):
        calibrated(change(views))
    with pytest.raises(
        InputError, match="expected brown or rational or fisheye or auto, found 'pinhole'"
    ):
        calibrated(views, model="pinhole")


def seen_in(folder, board):
    found = [
        boards.detect(images.read(path, path), board, path.rsplit("/", 1)[-1])
        for path in sorted(glob.glob(str(folder)))
    ]
    assert all(isinstance(one, View) for one in found)
    return found


@pytest.mark.parametrize("side, most", mostly_slow([("left", 0.31), ("right", 0.30)], 0, 1))
def test_opencvs_own_images(real, side, most):
    """No worse than OpenCV on images left out; both cameras see the same bow of the same board."""
    views = seen_in(
        real("opencv_stereo_chess") / f"{side}[01]*.jpg", Board("chessboard", 9, 6, 25.0)
    )
    made = calibrate_camera(views, Board("chessboard", 9, 6, 25.0), views[0].size)
    assert len(made.views) == 13 and made.rms_px <= most
    assert made.held_out.rms_px <= made.held_out.opencv_rms_px
    assert made.held_out.halved_rms_px <= made.held_out.opencv_halved_rms_px
    assert (
        made.bow.parameters["yy"] == pytest.approx(0.57, abs=3 * made.bow.std["yy"])
        and made.bow.std["yy"] < 0.1
    )


@pytest.mark.slow
def test_circles_of_the_line_laser_set(real):
    board = Board("circles", 7, 7, 1.0)
    views = seen_in(real("linelaser_circlegrid_zhao") / "calib_picture" / "*.jpg", board)
    made = calibrate_camera(views, board, views[0].size)
    assert made.rms_px <= 0.10 and made.held_out.rms_px <= 0.10
    assert made.held_out.rms_px <= made.held_out.opencv_rms_px and len(made.views) == 12


def test_a_certified_flat_board_makes_the_camera_more_certain():
    """Few images of a flat board: the warp takes information from the camera, the certificate gives most of it back."""
    views, _ = views_of(np.random.default_rng(4), count=5, bow={})
    free = calibrated(views)
    certified = calibrated(views, board=replace(BOARD, flatness_mm=0.005))
    flat = calibrated(views, bow=False)
    assert flat.std["camera.fx"] < certified.std["camera.fx"] < 0.97 * free.std["camera.fx"]
    assert abs(certified.camera.fx - 3421) < 3 * certified.std["camera.fx"]
    assert not any("flatness" in said for said in certified.remarks)


def test_images_that_contradict_the_certified_flatness_are_said():
    views, _ = views_of(np.random.default_rng(0))
    made = calibrated(views, board=replace(BOARD, flatness_mm=0.01))
    assert any("flatness_mm" in said for said in made.remarks)


def test_the_certified_flatness_is_read_from_the_board():
    keys = {"kind": "chessboard", "columns": 7, "rows": 5, "square_mm": 6.0, "flatness_mm": 0.02}
    assert Board.of(keys).flatness_mm == 0.02
