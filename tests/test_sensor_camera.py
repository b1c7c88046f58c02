"""A camera from boards: fx and its sigma hold, the bow is why, blunders are named, what is unknown is said."""

import glob
from dataclasses import replace

import numpy as np
import pytest

from board_scenes import BOW, CAMERA, COLUMNS, ROWS, SQUARE, board_model
from sensors import boards, pictures
from sensors.boards import Board, View
from sensors.camera import Camera
from sensors.camera_calibration import calibrate_camera
from sensors.camera_checks import projection_difference, projection_uncertainty
from sensors.corners import Corners
from sensors.effects import CATALOGUE
from workbench.core.errors import InputError
from workbench.core.rigid import rotation_matrix

BOARD = Board("chessboard", COLUMNS, ROWS, SQUARE)


def views_of(rng, count=20, **scene) -> tuple[list[View], object]:
    """Pictures of boards with 0.06 px noise, as `boards.detect` gives them, and the true parameters."""
    model, truth = board_model(rng, count, **scene)
    pixels, corners = model.chain.pixels, BOARD.count
    radius = scene.get("radius", 0.0)
    return [View(f"{k}.png", str(k), np.arange(corners), pixels[:, corners * k : corners * (k + 1)], CAMERA.size,
                 np.full(corners, 0.06), radius) for k in range(count)], truth


def calibrated(views, board=BOARD, folds=0, **options):
    return calibrate_camera(views, board, CAMERA.size, folds=folds, **options)


def test_the_twin_of_the_published_instrument_is_found_within_its_sigmas():
    """20 boards with a bow of 50 um: fx within 3 sigma, which is below 0.1 %; the bow within its own."""
    views, truth = views_of(np.random.default_rng(0))
    made = calibrated(views)
    assert abs(made.camera.fx - 3421) < 3 * made.std["camera.fx"] and made.std["camera.fx"] < 1e-3 * 3421
    for name in ("xx", "yy", "xy"):
        gap = made.bow.parameters[name] - BOW[f"artefact.board-bow.{name}"]
        assert abs(gap) < 4 * made.bow.std[name] and made.bow.std[name] < 0.003
    assert made.rms_px == pytest.approx(0.06 * np.sqrt(2), rel=0.05)
    assert made.rms_coordinate_px == pytest.approx(0.06, rel=0.05)
    assert made.rms_px**2 == pytest.approx((made.view_rms_px**2).mean())
    assert not made.undetermined and not made.rejected and made.fit.converged


@pytest.mark.slow
def test_stated_sigmas_cover_the_truth():
    pulls = []
    for seed in range(100):
        views, truth = views_of(np.random.default_rng(1000 + seed))
        made = calibrated(views)
        pulls.append((made.parameters.values - truth.values) / np.sqrt(np.diag(made.covariance)))
    assert (np.abs(pulls) < 1).mean() == pytest.approx(0.68, abs=0.06)
    assert np.abs(np.array(pulls)[:, 0]).max() < 4


def test_without_the_bow_the_focal_length_is_off_by_tens_of_pixels():
    """And by 20 and more of its stated sigmas, at an RMS that nobody would call wrong."""
    for seed in range(3):
        views, _ = views_of(np.random.default_rng(seed))
        flat = calibrated(views, bow=False)
        assert abs(flat.camera.fx - 3421) > max(15, 15 * flat.std["camera.fx"]) and flat.rms_px < 0.2
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
        [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], abs=2e-2)
    assert ours.camera.distortion[:4] == pytest.approx(distortion[0, :4], abs=5e-3)


def test_held_out_pictures_show_the_bow_that_opencv_has_not():
    views, _ = views_of(np.random.default_rng(2), 12)
    made = calibrated(views, folds=4)
    held = made.held_out
    assert held.rms_px == pytest.approx(0.085, rel=0.05) and held.halved_rms_px == pytest.approx(0.09, rel=0.05)
    assert held.opencv_rms_px > 1.5 * held.rms_px and held.opencv_halved_rms_px > 1.5 * held.halved_rms_px
    assert "after fitting the six numbers of their pose" in held.sentence


def test_halves_differ_by_what_their_sigmas_say():
    ratios, p_values = [], []
    for seed in range(12):
        made = calibrated(views_of(np.random.default_rng(seed), 12)[0], folds=2)
        ratios.append(made.halves.ratio)
        p_values.append(made.halves.p_value)
        assert np.nanmax(made.halves.difference.value) < 6 * np.nanmax(made.halves.sigma.value)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1, abs=0.2) and min(p_values) > 1e-3


@pytest.mark.slow
def test_the_map_of_uncertainty_covers_the_true_projection():
    """Over cameras: the difference to the truth, after the best rigid motion, against the longer half axis."""
    inside = []
    for seed in range(40):
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
    assert made.camera.fx == pytest.approx(540, abs=4 * made.std["camera.fx"]) and made.std["camera.fx"] < 1
    lens = Camera(540.0, 541.0, 330.0, 240.0, (0.4, 0.1, 1e-3, -5e-4, 0.02, 0.8, 0.2, 0.03), (640, 480))
    made = calibrated_wide(lens, "rational")
    assert made.rms_px == pytest.approx(0.06 * np.sqrt(2), rel=0.05)
    assert projection_difference(made.camera, lens, made.distance_mm).value.max() < 0.5


def calibrated_wide(camera, model):
    rng = np.random.default_rng(4)
    near = np.c_[rng.uniform(-22, -8, 25), rng.uniform(-18, -6, 25), rng.uniform(20, 40, 25), rng.uniform(-0.6, 0.6, (25, 3))]
    chain = board_model(rng, 25, camera=camera, poses=near)[0].chain
    views = []
    for k in range(25):
        mine = np.flatnonzero(chain.labels["placement"] == k)
        mine = mine[(np.abs(chain.pixels[:, mine] - [[320], [240]]) < [[330], [250]]).all(0)]
        views.append(View(f"{k}.png", "", mine - 88 * k, chain.pixels[:, mine], camera.size, np.full(mine.size, 0.06)))
    return calibrate_camera(views, BOARD, camera.size, model, folds=0)


def test_circles_are_predicted_where_their_ellipses_middles_are():
    """Discs of 1.2 mm radius, without noise: taken for corners they move fx by half of its sigma, and no RMS tells."""
    views, _ = views_of(np.random.default_rng(5), 12, radius=1.2, noise=0)
    made = calibrated(views, loss="linear")
    assert made.camera.values[:8] == pytest.approx(CAMERA.values[:8], rel=1e-6, abs=1e-3) and made.rms_px < 1e-4
    corners = calibrated([replace(view, radius_mm=0.0) for view in views], loss="linear")
    assert abs(corners.camera.fx - 3421) > 0.2 and corners.rms_px < 0.06


def test_a_further_effect_is_fitted_with_the_camera():
    true = {"camera.lens-residual.z3c0r": 0.4}
    views, _ = views_of(np.random.default_rng(6), effects=(CATALOGUE["lens-residual"]("camera"),), values=true)
    made = calibrated(views, effects=(CATALOGUE["lens-residual"]("camera"),))
    assert made.parameters["camera.lens-residual.z3c0r"] == pytest.approx(0.4, abs=4 * made.std["camera.lens-residual.z3c0r"])
    assert calibrated(views).rms_px > 1.02 * made.rms_px


def test_stated_sigmas_that_are_too_small_are_made_up_for():
    """Every second picture claims 0.005 px: what all have in common beyond that counts for all."""
    views, _ = views_of(np.random.default_rng(7))
    boast = [replace(view, sigma=view.sigma / 12) if k % 2 else replace(view, sigma=view.sigma / 6) for k, view in enumerate(views)]
    made, plain = calibrated(boast), calibrated(views)
    assert made.fit.sigma_scale == pytest.approx(1, abs=0.1)
    assert made.camera.fx == pytest.approx(plain.camera.fx, abs=0.3 * plain.std["camera.fx"])
    assert made.std["camera.fx"] == pytest.approx(plain.std["camera.fx"], rel=0.1)


def broken(kind, views, rng):
    """Views with the fourth picture spoilt."""
    view = views[3]
    grid = view.index.reshape(ROWS, COLUMNS)
    spoilt = {
        "shuffled": lambda: replace(view, index=rng.permutation(view.index)),
        "mirrored": lambda: replace(view, index=grid[:, ::-1].ravel()),
        "smeared": lambda: replace(view, pixels=view.pixels + rng.normal(0, 3, view.pixels.shape)),
        "three": lambda: replace(view, index=view.index[:3], pixels=view.pixels[:, :3], sigma=view.sigma[:3]),
        "row": lambda: replace(view, index=grid[0], pixels=view.pixels[:, :COLUMNS], sigma=view.sigma[:COLUMNS]),
    }
    return [*views[:3], spoilt[kind](), *views[4:]]


@pytest.mark.parametrize("kind, why", [
    ("shuffled", "no pose of the 11 x 8 chessboard explains these corners"),
    ("mirrored", "a board seen from behind, unlike the others'"),
    ("smeared", "most of its corners are more than 6 times as far off"),
    ("three", "3 corners: a pose needs 4 or more"),
    ("row", "lie on one line"),
])  # fmt: skip
def test_a_picture_that_contradicts_the_others_is_named_and_left_out(kind, why):
    rng = np.random.default_rng(8)
    views, _ = views_of(rng, 12)
    made = calibrated(broken(kind, views, rng))
    assert [one.image for one in made.rejected] == ["3.png"] and why in made.rejected[0].why
    assert len(made.views) == len(made.poses) == 11 and made.placements == [str(k) for k in range(12) if k != 3]
    assert abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"] and made.std["camera.fx"] < 1.5


def test_single_wrong_corners_are_counted_by_picture_and_spoil_nothing():
    views, _ = views_of(np.random.default_rng(9), 12)
    pixels = views[5].pixels.copy()
    pixels[:, :4] += 20
    made = calibrated([*views[:5], replace(views[5], pixels=pixels), *views[6:]])
    assert made.left_out == {"5.png": 4} and not made.rejected
    assert made.residual.shape[1] == 12 * 88 - 4
    assert any("4 of 5.png" in remark for remark in made.remarks)
    assert made.std["camera.fx"] < 1.5 and abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"]


def test_partly_seen_boards_in_any_order_and_two_pictures_of_one_placement():
    rng = np.random.default_rng(10)
    views, _ = views_of(rng, 12)
    part = []
    for view in views:
        some = rng.permutation(88)[: rng.integers(10, 80)]
        part.append(replace(view, index=view.index[some], pixels=view.pixels[:, some], sigma=view.sigma[some]))
    again = replace(views[2], image="again.png")
    made = calibrated([*part, again])
    assert len(made.poses) == 12 and len(made.views) == 13
    assert abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"]


def test_parallel_boards_are_said_to_leave_the_focal_length_open():
    made = calibrated(views_of(np.random.default_rng(0), 12, tilt=1e-3)[0])
    assert "was parallel to itself within" in made.undetermined[0] and "cannot be told from its distance" in made.undetermined[0]
    made = calibrated(views_of(np.random.default_rng(0), 12, tilt=0.05)[0])
    assert "is known to" in made.undetermined[0] and made.std["camera.fx"] > 5


def test_a_rational_model_that_boards_do_not_need_is_said_to_be_undetermined():
    made = calibrated(views_of(np.random.default_rng(0), 8)[0], model="rational")
    assert any("k4" in sentence for sentence in made.undetermined)
    assert abs(made.camera.fx - 3421) < 4 * made.std["camera.fx"]


def test_a_field_that_is_hardly_covered_and_too_few_placements_for_checks_are_said():
    views, _ = views_of(np.random.default_rng(0), 3)
    small = [replace(v, index=v.index[m], pixels=v.pixels[:, m], sigma=v.sigma[m]) for v in views
             for m in [(np.abs(v.pixels - [[640], [512]]) < 300).all(0)]]
    made = calibrated(small, folds=5)
    assert "of the picture's cells" in made.remarks[0]
    assert made.held_out is None and made.halves is None
    assert any("no picture could be left out" in remark for remark in made.remarks)


@pytest.mark.parametrize("change, sentence", [
    (lambda v: v[:2], "expected the board at 3 or more placements, found 2; take 15 to 20"),
    (lambda v: [], "expected the board at 3 or more placements, found 0"),
    (lambda v: [replace(one, placement="a") for one in v], "expected the board at 3 or more placements, found 1"),
    (lambda v: [*v[:4], replace(v[4], size=(640, 480))], "4.png: expected a picture of 1280 x 1024 pixels as the others, found 640 x 480"),
    (lambda v: [*v[:4], replace(v[4], pixels=v[4].pixels * np.nan)], "4.png: expected a place in px of every corner, found nan"),
    (lambda v: [*v[:4], replace(v[4], index=v[4].index + 1)], "4.png: expected corners 0 to 87 of the board, found 88"),
    (lambda v: [replace(one, index=one.index.reshape(11, 8).T.ravel()) for one in v], "expected pictures of a 11 x 8 chessboard, .* correct the board's columns and rows"),
])  # fmt: skip
def test_input_that_cannot_be_used_gets_its_sentence(change, sentence):
    views, _ = views_of(np.random.default_rng(0), 6)
    with pytest.raises(InputError, match=sentence):
        calibrated(change(views))
    with pytest.raises(InputError, match="expected brown or rational, found 'fisheye'"):
        calibrated(views, model="fisheye")


def seen_by(project, rng, board=BOARD, count=25, size=(1280, 1024), near=(70, 120), across=(60, 45), turns=(0.0,), noise=0.05,
            points=None, tilt=0.6):
    """Views of boards with noise through any lens: project (3, n) camera frame -> (2, n) px; 30 corners in the picture."""
    points, views = board.points if points is None else points, []
    while len(views) < count:
        turn = rotation_matrix(np.array([[*rng.uniform(-tilt, tilt, 2), 0], [0, 0, rng.choice(turns) + rng.uniform(-0.2, 0.2)]]))
        away = np.r_[rng.uniform(-1, 1, 2) * across, rng.uniform(*near)]
        there = turn[0] @ turn[1] @ (points - board.middle[:, None]) + away[:, None]
        if (there[2] < 5).any():
            continue
        pixels = project(there)
        inside = np.flatnonzero(((pixels > 3) & (pixels < np.array(size)[:, None] - 4)).all(0))
        if inside.size >= 30:
            noisy = pixels[:, inside] + rng.normal(0, noise, (2, inside.size))
            views.append(View(f"{len(views)}.png", f"p{len(views)}", inside, noisy, size, np.full(inside.size, noise)))
    return views


def fisheye(points):
    """Equidistant lens with four coefficients, as cv2.fisheye has it, f 500 px."""
    import cv2

    matrix = np.array([[500.0, 0, 640], [0, 500, 512], [0, 0, 1]])
    lens = np.array([0.02, 0.005, -0.003, 0.0005])
    return cv2.fisheye.projectPoints(points.T[:, None].copy(), np.zeros(3), np.zeros(3), matrix, lens)[0][:, 0].T


def test_a_lens_of_94_degrees_loses_no_picture():
    wide = Camera(600.0, 600.0, 640.0, 512.0, (-0.28, 0.09, 0.0, 0.0, -0.012), (1280, 1024))
    views = seen_by(wide.project, np.random.default_rng(0), Board("chessboard", 11, 8, 5.0))
    made = calibrate_camera(views, Board("chessboard", 11, 8, 5.0), wide.size, folds=0)
    assert len(made.views) == 25 and not made.left_out and not made.undetermined
    assert abs(made.camera.fx - 600) < 4 * made.std["camera.fx"] and made.std["camera.fx"] < 0.3
    assert made.lens.p_value > 0.01 and made.printed.p_value > 0.01


def test_a_shuffled_picture_through_a_wide_lens_is_still_named():
    wide = Camera(600.0, 600.0, 640.0, 512.0, (-0.28, 0.09, 0.0, 0.0, -0.012), (1280, 1024))
    rng = np.random.default_rng(0)
    views = seen_by(wide.project, rng, Board("chessboard", 11, 8, 5.0))
    views[4] = replace(views[4], index=rng.permutation(views[4].index))
    made = calibrate_camera(views, Board("chessboard", 11, 8, 5.0), wide.size, folds=0)
    assert [one.image for one in made.rejected] == ["4.png"] and "explains these corners" in made.rejected[0].why


@pytest.mark.parametrize("near, across", [((60, 120), (80, 60)), ((25, 50), (25, 20))])
def test_of_a_fisheye_the_model_is_blamed_and_not_the_pictures(near, across):
    board = Board("chessboard", 11, 8, 5.0)
    views = seen_by(fisheye, np.random.default_rng(0), board, near=near, across=across)
    made = calibrate_camera(views, board, (1280, 1024), folds=0)
    assert len(made.views) == 25 and not made.rejected
    assert sum(made.left_out.values()) < 0.05 * sum(len(view.index) for view in views)
    assert made.lens.p_value < 1e-6 and any("the lens is not of the model fitted" in one for one in made.remarks)


def test_the_map_of_the_lens_says_nothing_by_chance():
    p_values = [calibrated(views_of(np.random.default_rng(300 + k), 12)[0]).lens.p_value for k in range(40)]
    assert min(p_values) > 1e-3


def square_views(rng, bow, count=20):
    """Views of an 8 x 8 board that lay any way round, numbered with x to the right as `boards.detect` does."""
    board = Board("chessboard", 8, 8, 5.0)
    x, y = (board.points - board.middle[:, None])[:2] / board.half_diagonal
    bowed = board.points + np.stack([0 * x, 0 * x, bow[0] * x * x + bow[1] * y * y])
    views = seen_by(CAMERA.project, rng, board, count, near=(125, 165), across=(8, 6), points=bowed,
                    turns=np.arange(4) * np.pi / 2)

    def to_the_right(view):
        grid = np.full(board.count, np.nan)
        grid[view.index] = view.pixels[0]
        return np.nansum(np.diff(grid.reshape(8, 8), axis=1))

    return [max((boards.relabelled(view, board, k) for k in range(4)), key=to_the_right) for view in views], board


def test_a_square_board_is_turned_as_its_bow_tells():
    """Detection cannot tell which way round it lies: without turning, fx is off by 3 sigmas RMS and sigma is 1.7 times as large."""
    pulls, anisotropy = [], []
    for seed in range(8):
        views, board = square_views(np.random.default_rng(seed), (0.05, -0.02))
        made = calibrate_camera(views, board, CAMERA.size, folds=0)
        pulls.append((made.camera.fx - 3421) / made.std["camera.fx"])
        anisotropy.append(abs(made.bow.parameters["xx"] - made.bow.parameters["yy"]))
        assert made.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.05)
        assert not made.remarks and made.std["camera.fx"] < 0.8
    assert np.sqrt(np.mean(np.square(pulls))) < 1.7 and anisotropy == pytest.approx([0.07] * 8, abs=0.005)


def test_a_square_board_without_a_bow_stays_as_it_was_numbered():
    """Choosing turns by noise would make a bow of noise, several of its sigmas high."""
    for seed in range(4):
        views, board = square_views(np.random.default_rng(seed), (0.0, 0.0))
        made = calibrate_camera(views, board, CAMERA.size, folds=0)
        given = {view.image: view.index for view in views}
        assert all((view.index == given[view.image]).all() for view in made.views)
        assert all(abs(made.bow.parameters[name]) < 4 * made.bow.std[name] for name in ("xx", "yy", "xy"))


def printed_views(rng, sigma):
    """20 views of one board whose corners are off by `sigma` mm in the plane, and differently for every call."""
    board = Board("chessboard", 11, 8, 5.0)
    points = board.points + np.r_[rng.normal(0, sigma, (2, board.count)), np.zeros((1, board.count))]
    return seen_by(CAMERA.project, rng, board, 20, near=(115, 165), across=(8, 6), points=points), board


def test_errors_of_the_print_are_found_and_in_the_sigmas():
    """5 um a corner: cx, cy, p1, p2 were 2 to 3 of their plain sigmas off."""
    pulls, plain = [], []
    for seed in range(25):
        views, board = printed_views(np.random.default_rng(seed), 0.005)
        made = calibrate_camera(views, board, CAMERA.size, folds=0)
        assert made.printed.p_value < 1e-6 and any("off by the same in all pictures" in one for one in made.remarks)
        assert made.printed.sigma_mm == pytest.approx(0.005, rel=0.35)
        off = made.camera.values - CAMERA.values
        pulls.append(off / [made.std[f"camera.{name}"] for name in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")])
        plain.append(off / np.sqrt(np.diag(made.fit.covariance)[:9]))
        assert (np.diag(made.covariance) >= np.diag(made.fit.covariance) * (1 - 1e-9)).all()
    root = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert root.max() < 1.3 and np.sqrt(np.mean(np.square(plain), axis=0))[[2, 3, 6, 7]].min() > 1.6


@pytest.mark.slow
def test_the_test_of_the_print_is_right_under_noise_alone():
    """p values are uniform, and sigmas those of the bundle, where corners differ by noise only."""
    p_values = []
    for seed in range(200):
        views, board = printed_views(np.random.default_rng(1000 + seed), 0.0)
        p_values.append(calibrate_camera(views, board, CAMERA.size, folds=0).printed.p_value)
    assert np.mean(p_values) == pytest.approx(0.5, abs=0.08) and np.mean(np.array(p_values) < 0.1) < 0.17


def test_what_is_undetermined_has_no_sigma():
    made = calibrated(views_of(np.random.default_rng(0), 12, tilt=1e-3)[0])
    assert np.isnan(made.std["camera.fx"]) and np.isnan(made.std["camera.fy"])
    known = dict(zip(made.fit.table.keys, made.fit.known.determined))
    assert all(np.isnan(sigma) for key, sigma in made.std.items() if not known[key])
    assert np.isfinite(calibrated(views_of(np.random.default_rng(0), 12)[0]).std["camera.fx"])


def test_sigmas_that_do_not_hold_two_sigmas_away_are_not_stated():
    """Boards in one corner of the picture only: what trades distortion for the principal point is no parabola."""
    board, pulls = Board("chessboard", 11, 8, 5.0), []
    for seed in range(8):
        views = seen_by(lambda points: CAMERA.project(points + np.array([[90], [70], [0]])), np.random.default_rng(seed), board,
                        15, near=(680, 720), across=(5, 5), tilt=0.4)
        made = calibrate_camera(views, board, CAMERA.size, folds=0)
        assert made.curved is not None and any("no sigma holds for it" in one for one in made.undetermined)
        assert np.isnan(made.std["camera.cx"]) and np.isfinite(made.std["camera.fx"])
        pulls.append((made.camera.fx - 3421) / made.std["camera.fx"])
    assert np.sqrt(np.mean(np.square(pulls))) < 1.7


def test_boards_tilted_by_a_degree_or_two_give_the_focal_length_its_sigma():
    """From a start that they do not tell, one in four ended hundreds of px off in a long valley, 10 sigmas and more."""
    board, pulls = Board("chessboard", 11, 8, 5.0), []
    x, y = (board.points - board.middle[:, None])[:2] / board.half_diagonal
    points = board.points + np.stack([0 * x, 0 * x, 0.05 * (x * x + y * y)])
    for seed in (0, 1, 3, 9, 14, 15, 21, 24):
        views = seen_by(CAMERA.project, np.random.default_rng(seed), board, 12, near=(115, 160), across=(5, 5), tilt=0.03,
                        points=points, turns=np.linspace(-3, 3, 30))
        made = calibrate_camera(views, board, CAMERA.size, folds=0)
        assert made.fit.converged and abs(made.camera.fx - 3421) < 150
        pulls.append((made.camera.fx - 3421) / made.std["camera.fx"])
    assert np.sqrt(np.nanmean(np.square(pulls))) < 1.7 and np.isfinite(pulls).sum() > 4


def test_a_long_valley_is_not_taken_for_the_end():
    """Nearly frontal boards, focal length started at twice its size: short steps there are the damping's."""
    from sensors import camera_adjust, camera_start

    board = Board("chessboard", 11, 8, 5.0)
    views = seen_by(CAMERA.project, np.random.default_rng(3), board, 15, near=(115, 160), across=(5, 5), tilt=0.04)
    chain = camera_start.corner_chain(views, board, CAMERA.size)
    chosen, new = camera_start.spread(chain)
    far = Camera.of(np.r_[9000, 9000, chain.camera.values[2:]], CAMERA.size)
    poses = camera_start.first_poses(camera_start.homographies(chain, chosen, new), far.matrix)
    solved, fit = camera_adjust.adjust(chain.moved(far, poses), (CATALOGUE["board-bow"]("artefact"),))
    assert not fit.converged or abs(solved.camera.fx - 3421) < 100


def test_the_same_corners_twice_count_once():
    views, _ = views_of(np.random.default_rng(0), 12)
    made, twice = calibrated(views), calibrated([*views, replace(views[3], image="copy.png", placement="other")])
    assert [str(one) for one in twice.rejected] == ["copy.png: the same corners as 3.png, which would count twice"]
    assert twice.std == made.std and len(twice.views) == 12


def leaking(rng):
    """Views with noise of 0.02 px; those of one fold of two seen through a lens of 0.6 px more distortion at the edge."""
    views, _ = views_of(rng, 12, noise=0.02)
    bent = []
    for k, view in enumerate(views):
        away = view.pixels - np.array([[640], [512]])
        more = 0.6 * away * (away**2).sum(0) / 640**3
        bent.append(replace(view, pixels=view.pixels + (more if k % 2 else -more)))
    return bent


def test_pictures_left_out_are_not_in_the_fit_of_either_side():
    """What a fit of all pictures halves stands in full on those left out: ours and OpenCV's alike."""
    held = calibrated(leaking(np.random.default_rng(1)), folds=2, loss="linear")
    inside = held.rms_px
    assert held.held_out.rms_px > 1.4 * inside
    assert held.held_out.opencv_rms_px > 1.4 * inside
    from sensors.camera_checks import _opencv, opencv_camera

    whole, _ = _opencv(held.chain, opencv_camera(held.chain))
    assert held.held_out.opencv_rms_px > 1.3 * np.sqrt((whole**2).sum(0).mean())


def test_derivatives_of_a_circles_middle_are_those_of_its_residual():
    rng = np.random.default_rng(0)
    chain = board_model(rng, 3, radius=1.7)[0].chain
    assert isinstance(chain, Corners)
    rows = chain.evaluate(chain.camera.values, {}).family_rows("placement")
    target = chain.evaluate(chain.camera.values, {}).rows("target", np.arange(3))
    corner = replace(chain, radius=0.0).evaluate(chain.camera.values, {}).family_rows("placement")
    for k, step in enumerate([1e-4] * 3 + [1e-6] * 3):
        sides = [chain.with_families({"placement": chain.poses + sign * step * np.eye(6)[k]}) for sign in (1, -1)]
        up, down = (side.evaluate(chain.camera.values, {}).residual for side in sides)
        numeric, circle = (up - down) / (2 * step), np.abs(rows[k] - corner[k]).max()
        assert np.abs(numeric - rows[k]).max() < 0.02 * circle + 1e-6 * np.abs(rows[k]).max()
    for k in range(3):
        moved = [chain.evaluate(chain.camera.values, {"target": (np.array([k]), np.full((1, chain.pixels.shape[1]), d))})
                 for d in (1e-4, -1e-4)]
        assert (moved[0].residual - moved[1].residual) / 2e-4 == pytest.approx(target[k], abs=1e-5 * np.abs(target[k]).max())


def test_halves_that_differ_by_a_chance_below_one_in_a_hundred_are_remarked_on():
    """As those of a sensor tilted by 1 degree, p 0.005, do, where no RMS tells; with the chance beside it."""
    from scipy.stats import chi2

    from sensors.camera_calibration import _remarks

    made = calibrated(views_of(np.random.default_rng(1), 12)[0], folds=2)
    for chance, said in ((0.005, 1), (0.02, 0)):
        halves = replace(made.halves, chi_square=float(chi2.isf(chance, made.halves.numbers)))
        remarks = _remarks(replace(made, halves=halves), 2)
        assert sum(f"chance does so with probability {chance:g}" in one for one in remarks) == said == len(remarks)


def seen_in(folder, board):
    found = [boards.detect(pictures.read(path, path), board, path.rsplit("/", 1)[-1]) for path in sorted(glob.glob(str(folder)))]
    assert all(isinstance(one, View) for one in found)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("side, most", [("left", 0.31), ("right", 0.30)])
def test_opencvs_own_pictures(real, side, most):
    """No worse than OpenCV on pictures left out; both cameras see the same bow of the same board."""
    views = seen_in(real("opencv_stereo_chess") / f"{side}[01]*.jpg", Board("chessboard", 9, 6, 25.0))
    made = calibrate_camera(views, Board("chessboard", 9, 6, 25.0), views[0].size)
    assert len(made.views) == 13 and made.rms_px <= most
    assert made.held_out.rms_px <= made.held_out.opencv_rms_px
    assert made.held_out.halved_rms_px <= made.held_out.opencv_halved_rms_px
    assert made.bow.parameters["yy"] == pytest.approx(0.57, abs=3 * made.bow.std["yy"]) and made.bow.std["yy"] < 0.1


@pytest.mark.slow
def test_circles_of_the_line_laser_set(real):
    board = Board("circles", 7, 7, 1.0)
    views = seen_in(real("linelaser_circlegrid_zhao") / "calib_picture" / "*.jpg", board)
    made = calibrate_camera(views, board, views[0].size)
    assert made.rms_px <= 0.10 and made.held_out.rms_px <= 0.10
    assert made.held_out.rms_px <= made.held_out.opencv_rms_px and len(made.views) == 12
