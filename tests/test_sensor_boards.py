"""Boards in images: found to a small part of a pixel with an honest σ, or rejected with the right reason."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from board_images import (
    APRILGRID,
    ASYMMETRIC,
    CHARUCO,
    CHESS,
    CIRCLES,
    SIZE,
    aprilgrid_pattern,
    homography,
    project,
    render,
)
from sensors.boards import circles
from sensors.boards import finders as board_finders
from sensors.boards.board import Board
from sensors.boards.detection import Rejected, View, detect, relabelled
from sensors.camera.model import Camera
from workbench.core.errors import InputError

BOARDS = pytest.mark.parametrize(
    "board", [CHESS, CIRCLES, ASYMMETRIC, CHARUCO], ids=lambda b: b.kind
)


def truth(board, h, view):
    """(2, k) px where the view's corners, or the centres of the ellipses of its discs, really are."""
    if board.marks == "corners":
        return project(h, board.points[:, view.index])
    focal, width, height = 1.5 * view.size[0], *view.size
    camera = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    frame = np.linalg.inv(camera) @ h
    centres = frame @ np.vstack([board.points[:2, view.index], np.ones(len(view.index))])
    u, v, w = camera @ (
        centres + circles.centre_shift(centres, np.cross(frame[:, 0], frame[:, 1]), view.radius_mm)
    )
    return np.stack([u, v]) / w


@BOARDS
@pytest.mark.parametrize(("blur", "noise"), [(0.7, 2.0), (0.9, 6.0)])
def test_places_and_their_sigma(board, blur, noise):
    """The error is what σ says, and a corner is three times better than OpenCV's 0.03 px at little noise."""
    h = homography(board, tilt=(0.35, -0.3), turn=0.2)
    view = detect(render(board, h, blur=blur, noise=noise), board)
    assert isinstance(view, View) and len(view.index) == board.count
    error = view.pixels - truth(board, h, view)
    assert np.sqrt(np.mean(error**2)) < 0.006 * noise
    assert 0.4 < np.sqrt(np.mean((error / view.sigma) ** 2)) < 1.5
    assert view.size == SIZE


@pytest.mark.parametrize("bits", [1, 2])
@pytest.mark.parametrize("turn", [0, 2])
def test_places_on_an_aprilgrid(bits, turn):
    """Tags with a border of one or two modules, their codes either way up: the same corners, and an honest σ."""
    h = homography(APRILGRID, tilt=(0.3, -0.25), turn=2.8, size=(800, 600))
    ink = aprilgrid_pattern(APRILGRID, bits=bits, turn=turn)
    view = detect(render(APRILGRID, h, size=(800, 600), noise=2.0, ink=ink), APRILGRID)
    assert isinstance(view, View) and len(view.index) == APRILGRID.count == 48
    error = view.pixels - truth(APRILGRID, h, view)
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert 0.4 < np.sqrt(np.mean((error / view.sigma) ** 2)) < 1.5


def test_an_aprilgrid_that_is_partly_covered():
    h = homography(APRILGRID, size=(800, 600))
    image = render(APRILGRID, h, size=(800, 600), noise=1.0)
    left, right = np.rint(project(h, APRILGRID.points[:, [8, 11]])[0]).astype(int)
    image[:, left - 6 : right + 20] = 120
    view = detect(image, APRILGRID)
    assert isinstance(view, View) and 12 <= len(view.index) < 48
    assert np.abs(view.pixels - truth(APRILGRID, h, view)).max() < 0.2


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"columns": 3, "rows": 4}, "tags of a board with 4 columns and 4 rows or more found"),
        ({"columns": 5, "rows": 3}, "with 4 columns"),
        ({"square_mm": 19.0}, "correct square_mm and marker_mm"),
    ],
)
def test_an_aprilgrid_of_another_size_is_named(changed, words):
    keys = {"kind": "aprilgrid", "columns": 4, "rows": 3, "square_mm": 13.0, "marker_mm": 10.0}
    image = render(APRILGRID, homography(APRILGRID, size=(800, 600)), size=(800, 600), noise=1.0)
    found = detect(image, Board.of(keys | changed))
    assert isinstance(found, Rejected) and words in found.why


@BOARDS
def test_white_on_dark(board):
    """All is found as well; of a chessboard in negative the dark first square is at the other end."""
    h = homography(board)
    view = detect(render(board, h, noise=2, invert=True), board)
    if board.kind == "chessboard":
        view = replace(view, index=board.count - 1 - view.index)
    assert len(set(view.index)) == board.count
    assert np.sqrt(np.mean((view.pixels - truth(board, h, view)) ** 2)) < 0.02


@BOARDS
@pytest.mark.parametrize("turn", [0.1, 1.7, 3.0, -1.4])
def test_origin_is_the_same_from_every_side(board, turn):
    """A board whose origin shows has one; another's x axis points to the right as far as it can."""
    h = homography(board, turn=turn, fill=0.6)
    view = detect(render(board, h, noise=1), board)
    fits = [
        np.abs(relabelled(view, board, k).index - view.index).max() == 0
        for k in range(board.rotational_symmetry)
    ]
    assert fits[0] and not any(fits[1:])
    gaps = [
        np.abs(v.pixels - truth(board, h, v)).max()
        for v in (relabelled(view, board, k) for k in range(board.rotational_symmetry))
    ]
    assert min(gaps) < 0.1
    if board.rotational_symmetry == 1:
        return
    grid = np.full((2, board.count), np.nan)
    grid[:, view.index] = view.pixels
    right = grid.reshape(2, board.rows, board.columns)[0]
    assert np.nanmean(np.diff(right, axis=1)) > 0 or abs(np.sin(turn)) > 0.9


@pytest.mark.parametrize("board", [CIRCLES, ASYMMETRIC], ids=lambda b: b.kind)
def test_centre_of_a_disc_is_not_the_centre_of_its_ellipse(board):
    """Seen at 45 degrees the shift is many σ; with it the centres fit as well as the image is sampled (0.01 px)."""
    h = homography(board, tilt=(0.2, 0.75), fill=0.7)
    view = detect(render(board, h, noise=0.5), board)
    plain = np.sqrt(np.mean((view.pixels - project(h, board.points[:, view.index])) ** 2))
    shifted = np.sqrt(np.mean((view.pixels - truth(board, h, view)) ** 2))
    assert plain > 2 * shifted and shifted < 0.01
    assert view.radius_mm == pytest.approx(3.0, rel=0.02)


def test_centre_shift_agrees_with_the_fitted_ellipse():
    """The ellipse through 200 projected points of the rim has the centre that the formula says."""
    normal = np.array([0.3, -0.5, -0.81])
    normal /= np.linalg.norm(normal)
    first = np.cross(normal, [0, 0, 1.0]) / np.linalg.norm(np.cross(normal, [0, 0, 1.0]))
    centre, turn = (
        np.array([[20.0], [-10.0], [150.0]]),
        np.linspace(0, 2 * np.pi, 200, endpoint=False),
    )
    rim = centre + 8 * (
        np.outer(first, np.cos(turn)) + np.outer(np.cross(normal, first), np.sin(turn))
    )
    fitted = cv2.fitEllipseDirect((1000 * rim[:2] / rim[2]).T.astype(np.float32))[0]
    moved = centre + circles.centre_shift(centre, normal, 8.0)
    np.testing.assert_allclose(1000 * (moved[:2] / moved[2])[:, 0], fitted, atol=2e-3)
    assert np.hypot(*(1000 * (moved - centre)[:2, 0] / 150)) > 0.05


def test_charuco_may_be_cut_and_covered():
    h = homography(CHARUCO, shift=(90, 0))
    image = render(CHARUCO, h, noise=2)
    image[: SIZE[1] // 3, : SIZE[0] // 2] = 120
    view = detect(image, CHARUCO)
    assert 8 <= len(view.index) < 28
    assert np.abs(view.pixels - truth(CHARUCO, h, view)).max() < 0.1


@BOARDS
def test_two_boards_are_said_to_be_two(board):
    """Which of them is meant, nothing says."""
    two = np.hstack(
        [
            render(board, homography(board, turn=turn), noise=2, seed=k)
            for k, turn in enumerate((0.1, 0.4))
        ]
    )
    found = detect(two, board)
    assert (
        isinstance(found, Rejected)
        and f"two boards of {board.columns} x {board.rows} {board.marks} found" in found.why
    )


@pytest.mark.parametrize("shape", [(300, 400, 3), (300, 400, 1), (300,)])
def test_only_grey_arrays_are_looked_at(shape):
    with pytest.raises(
        InputError,
        match=r"image: expected grey values \(H, W\) of 8 or 16 bits, found uint8 of shape",
    ):
        detect(np.zeros(shape, np.uint8), CHESS)
    with pytest.raises(InputError, match="found int64 of shape"):
        detect(np.zeros((300, 400), np.int64), CHESS)


def test_coarse_places_are_those_of_the_image_that_was_shrunk(monkeypatch):
    """A pixel of the image made half as large is centred between two: without that all corners lie half a pixel off."""
    monkeypatch.setattr(board_finders, "LARGE", SIZE[0] // 2)
    h = homography(CHESS)
    image = render(CHESS, h, noise=1)
    for first in (True, False):
        if not first:
            monkeypatch.setattr(cv2, "findChessboardCornersSB", lambda *a, **k: (False, None))
        off = board_finders.find(image, CHESS).pixels - project(h, CHESS.points)
        assert np.abs(off.mean(1)).max() < 0.15 and np.abs(off).max() < 0.4


@pytest.mark.parametrize("what", ["covered", "smeared"])
def test_a_corner_that_is_not_sharp_is_left_out_and_the_others_kept(what):
    h = homography(CHESS)
    image, places = render(CHESS, h, noise=2), project(h, CHESS.points)
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    for k in (20, 31):
        here = np.hypot(u - places[0, k], v - places[1, k]) < 9
        half = np.where(u > places[0, k] - 2, 30, image)
        changed = half if what == "covered" else cv2.GaussianBlur(image, (0, 0), 5)
        view = detect(np.where(here, changed, image).astype(np.uint8), CHESS)
        np.testing.assert_array_equal(view.index, np.delete(np.arange(54), k))
        assert np.abs(view.pixels - places[:, view.index]).max() < 0.05


def test_older_finder_steps_in_where_the_first_one_fails(monkeypatch):
    """Which of OpenCV's two finders met the corners moves where they are fitted by less than their σ."""
    image = render(CHESS, homography(CHESS), noise=2)
    first = detect(image, CHESS)
    monkeypatch.setattr(cv2, "findChessboardCornersSB", lambda *a, **k: (False, None))
    second = detect(image, CHESS)
    np.testing.assert_array_equal(first.index, second.index)
    assert np.all(np.abs(first.pixels - second.pixels) < 0.5 * first.sigma)


def without(board, *, columns=0, rows=0):
    return replace(board, columns=board.columns + columns, rows=board.rows + rows)


@pytest.mark.parametrize(
    ("shown", "expected", "size"),
    [
        (CHESS, without(CHESS, columns=-1), (9, 6)),
        (CHESS, without(CHESS, columns=1), (9, 6)),
        (CHESS, without(CHESS, rows=-1), (9, 6)),
        (CHESS, without(CHESS, rows=1), (9, 6)),
        (CIRCLES, without(CIRCLES, columns=-1), (8, 6)),
        (CIRCLES, without(CIRCLES, rows=1), (8, 6)),
        (ASYMMETRIC, without(ASYMMETRIC, rows=-1), (4, 11)),
        (ASYMMETRIC, without(ASYMMETRIC, columns=1), (4, 11)),
        (ASYMMETRIC, replace(ASYMMETRIC, columns=11, rows=4), (4, 11)),
        (CHARUCO, replace(CHARUCO, columns=5, rows=7), (7, 5)),
        (CHARUCO, without(CHARUCO, columns=1), (7, 5)),
    ],
    ids=lambda v: v.title if isinstance(v, Board) else "",
)
def test_wrong_size_of_board_says_which_would_fit(shown, expected, size):
    found = detect(render(shown, homography(shown), noise=2), expected, "a.png")
    assert isinstance(found, Rejected) and found.found == size
    assert (
        f"{size[0]} x {size[1]} {shown.marks} found, {expected.columns} x {expected.rows} expected"
        in str(found)
    )
    assert f"if the board has {size[0]} x {size[1]}, correct columns and rows" in found.why


@pytest.mark.parametrize(
    ("board", "shift", "seen"),
    [
        (CHESS, (115, 0), "7 x 6 corners"),
        (CHESS, (0, 105), "9 x 4 corners"),
        (CIRCLES, (115, 0), "6 x 6 circles"),
        (CIRCLES, (0, 105), "8 x 5 circles"),
    ],
)
def test_cut_board_is_said_to_be_cut(board, shift, seen):
    found = detect(render(board, homography(board, shift=shift), noise=2), board)
    assert isinstance(found, Rejected) and found.found is None
    assert found.why.startswith(seen) and found.why.endswith("the board is cut by the image's edge")


def swapped_kind(board):
    return replace(board, kind="circles" if board.kind != "circles" else "asymmetric-circles")


@pytest.mark.parametrize(
    ("shown", "expected", "why"),
    [
        (CIRCLES, CHESS, "no chessboard found"),
        (CHESS, CIRCLES, "no grid of circles found"),
        (CHESS, CHARUCO, "no marker of DICT_5X5_250"),
        (CHARUCO, replace(CHARUCO, legacy=True), "legacy = false"),
        (CHARUCO, replace(CHARUCO, dictionary="DICT_4X4_250"), "no marker of DICT_4X4_250"),
        (
            ASYMMETRIC,
            swapped_kind(ASYMMETRIC),
            "an asymmetric grid of 4 x 11 circles found: correct asymmetric",
        ),
        (
            CIRCLES,
            swapped_kind(CIRCLES),
            "a symmetric grid of 8 x 6 circles found: correct asymmetric",
        ),
    ],
)
def test_another_kind_of_board_is_named(shown, expected, why):
    found = detect(render(shown, homography(shown), noise=2), expected)
    assert isinstance(found, Rejected) and why in found.why


def test_stripe_without_a_board_and_flawed_images_are_rejected():
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    stripe = (20 + 200 * np.exp(-0.5 * ((v - 140 - 0.05 * u) / 2) ** 2)).astype(np.uint8)
    assert detect(stripe, CHESS).why.startswith("no chessboard found (covered, ")
    assert "no grid of circles found" in detect(stripe, CIRCLES).why
    assert detect(np.zeros(SIZE[::-1], np.uint8), CHESS).why.startswith("all black")
    bright = render(CHESS, homography(CHESS, fill=0.4), low=250, high=520)
    assert detect(bright, CHESS).why.startswith("saturated")


def test_sixteen_bits_and_half_saturated_boards_are_found():
    h = homography(CHESS)
    deep = render(CHESS, h, noise=1).astype(np.uint16) * 16
    view = detect(deep, CHESS)
    assert np.abs(view.pixels - truth(CHESS, h, view)).max() < 0.03
    view = detect(render(CHESS, h, noise=2, high=330, background=0.3), CHESS)
    assert np.abs(view.pixels - truth(CHESS, h, view)).max() < 0.06


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"kind": "checkers"}, "expected one of chessboard, charuco, circles"),
        ({"columns": 1}, "keys columns and rows"),
        ({"columns": 2, "rows": 2}, "6 in all, found 2 and 2"),
        ({"kind": "charuco"}, "keys marker_mm and dictionary"),
    ],
)
def test_impossible_board_gets_its_sentence(keys, words):
    with pytest.raises(InputError, match=words):
        Board.of({"kind": "chessboard", "columns": 9, "rows": 6, "square_mm": 5.0} | keys)


def test_board_of_keys_and_its_points():
    board = Board.of(
        {
            "kind": "circles",
            "asymmetric": True,
            "columns": 4,
            "rows": 11,
            "square_mm": 20.0,
            "fixed_to": "tool",
        }
    )
    assert board.kind == "asymmetric-circles" and board.points.shape == (3, 44)
    np.testing.assert_array_equal(
        board.points[:, [0, 1, 4, 43]].T, [[0, 0, 0], [40, 0, 0], [20, 20, 0], [120, 200, 0]]
    )
    assert CHESS.half_diagonal == pytest.approx(np.hypot(80, 50) / 2)
    turns = [
        b.rotational_symmetry
        for b in (
            CHESS,
            replace(CHESS, columns=8),
            replace(CHESS, rows=9),
            replace(CHESS, columns=6),
            CIRCLES,
            replace(CIRCLES, rows=8),
            ASYMMETRIC,
            replace(ASYMMETRIC, rows=10),
            CHARUCO,
        )
    ]
    assert turns == [1, 2, 2, 4, 2, 4, 1, 2, 1]


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_the_middle_of_a_disc_through_a_strong_lens(tilt):
    """The centre of area of discs whose edges OpenCV projects, against both shifts of a circle's centre."""
    camera = Camera(372.0, 373.0, 243.0, 176.0, (-0.24, 0.07, 3e-4, 5e-4, 0.0), (480, 360))
    turn = cv2.Rodrigues(np.array([0.2, tilt, 0.1]))[0]
    centres = turn @ np.array([[-80.0, 0.0, 70.0], [40.0, -60.0, 50.0], [0, 0, 0.0]]) + [
        [0],
        [0],
        [200.0],
    ]
    normals, radius = np.tile(turn[:, 2:], 3), 7.0
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    middle = []
    for centre in centres.T:
        edge = centre[:, None] + radius * (
            turn[:, :1] * np.cos(angle) + turn[:, 1:2] * np.sin(angle)
        )
        seen = cv2.projectPoints(
            edge.T.copy(), np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
        )[0]
        moments = cv2.moments((seen - seen.mean(0)).astype(np.float32))
        area = np.array([moments["m10"], moments["m01"]]) / moments["m00"]
        middle.append(seen.mean(0)[0] + area)
    aimed = centres + circles.centre_shift(centres, normals, radius)
    shift = circles.lens_shift(camera, aimed, normals, radius)
    gap = np.array(middle).T - camera.project(aimed)
    assert np.abs(gap).max() > 0.03
    assert np.abs(gap - shift).max() < 0.05 * np.abs(gap).max()
