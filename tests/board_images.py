"""Boards as a camera sees them, made for tests: exact patterns through a homography, averaged over each pixel."""

import cv2
import numpy as np

from sensors.boards.board import Board

SIZE = (400, 300)
OVER = 5


def homography(board, tilt=(0.3, -0.2), turn=0.1, fill=0.75, size=SIZE, shift=(0, 0)):
    """(3, 3) board mm to px of a camera of focal length 1.5 image widths that sees the board's middle."""
    focal = 1.5 * size[0]
    extent = np.ptp(board.points[:2], axis=1) + 2 * board.square_mm
    far = focal * max(extent / (fill * np.array(size)))
    rotation = cv2.Rodrigues(np.array([*tilt, 0.0]))[0] @ cv2.Rodrigues(np.array([0, 0, turn]))[0]
    place = (
        np.array([shift[0] * far / focal, shift[1] * far / focal, far]) - rotation @ board.middle
    )
    camera = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])
    return camera @ np.column_stack([rotation[:, :2], place])


def project(h, points):
    """(2, n) px of points (2, n) mm on the board."""
    u, v, w = h @ np.vstack([points[:2], np.ones(points.shape[1])])
    return np.stack([u, v]) / w


def render(
    board,
    h,
    size=SIZE,
    blur=0.7,
    noise=0.0,
    seed=0,
    low=40,
    high=200,
    invert=False,
    background=0.9,
    radius=0.3,
    ink=None,
):
    """(H, W) uint8; `ink` overrides the pattern: a function of x, y (mm) that gives 0 or 1."""
    width, height = size
    grid = (np.arange(OVER * np.array([[height], [width]]).max()) + 0.5) / OVER - 0.5
    u, v = np.meshgrid(grid[: OVER * width], grid[: OVER * height])
    x, y, w = np.linalg.inv(h) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    bright = (ink or pattern(board, radius, background))(x / w, y / w).reshape(v.shape)
    bright = bright.reshape(height, OVER, width, OVER).mean((1, 3), dtype=np.float32)
    bright = cv2.GaussianBlur((1 - bright if invert else bright).astype(float), (0, 0), blur)
    grey = (
        low
        + (high - low) * bright
        + noise * np.random.default_rng(seed).standard_normal(bright.shape)
    )
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def pattern(board, radius=0.3, background=0.9):
    """A function of x, y (mm): 1 where the board is bright."""
    patterns = {"chessboard": _chess, "charuco": _charuco, "aprilgrid": aprilgrid_pattern}
    return patterns.get(board.kind, _circles)(board, radius, background)


def _chess(board, radius, background):
    def bright(x, y):
        i, j = np.floor(x / board.square_mm), np.floor(y / board.square_mm)
        dark = (i + j) % 2 == 0
        on = (i >= -1) & (i < board.columns) & (j >= -1) & (j < board.rows)
        return np.where(on, ~dark, background)

    return bright


def _circles(board, radius, background):
    def bright(x, y):
        x, y = x / board.square_mm, y / board.square_mm
        shifted = board.kind != "circles"
        j = np.clip(np.rint(y), 0, board.rows - 1)
        apart, start = (2, j % 2) if shifted else (1, 0)
        i = np.clip(np.rint((x - start) / apart), 0, board.columns - 1)
        return np.where(np.hypot(x - start - apart * i, y - j) < radius, 0, background)

    return bright


def _charuco(board, radius, background):
    kind = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    made = cv2.aruco.CharucoBoard(
        (board.columns + 1, board.rows + 1), board.square_mm, board.marker_mm, kind
    )
    made.setLegacyPattern(board.legacy)
    cell = 64
    texture = (
        made.generateImage(((board.columns + 1) * cell, (board.rows + 1) * cell), marginSize=0)
        > 127
    )

    def bright(x, y):
        i = np.floor((x / board.square_mm + 1) * cell).astype(int)
        j = np.floor((y / board.square_mm + 1) * cell).astype(int)
        on = (i >= 0) & (j >= 0) & (i < texture.shape[1]) & (j < texture.shape[0])
        return np.where(
            on,
            texture[np.clip(j, 0, texture.shape[0] - 1), np.clip(i, 0, texture.shape[1] - 1)],
            background,
        )

    return bright


def aprilgrid_pattern(board, radius=0.3, background=0.9, bits=2, turn=2):
    """As Kalibr draws it: tag 0 at the bottom left; bits: of the dark border; turn: quarters of the codes."""
    columns, rows = board.columns // 2, board.rows // 2
    gap = board.square_mm - board.marker_mm
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    side = 6 + 2 * bits
    tags = []
    for number in range(columns * rows):
        drawn = cv2.aruco.generateImageMarker(dictionary, number, side, borderBits=bits)
        tags.append(np.rot90(drawn, turn) > 127)
    tags = np.array(tags)

    def bright(x, y):
        i, j = np.floor((x + gap) / board.square_mm), np.floor((y + gap) / board.square_mm)
        u, v = x - i * board.square_mm, y - j * board.square_mm  # in the gap below 0
        on = (i >= 0) & (i <= columns) & (j >= 0) & (j <= rows)
        in_tag = on & (u >= 0) & (v >= 0) & (i < columns) & (j < rows)
        number = ((rows - 1 - j) * columns + i).astype(int)
        cell = [
            np.clip(np.floor(w / board.marker_mm * side), 0, side - 1).astype(int) for w in (v, u)
        ]
        code = tags[np.clip(number, 0, len(tags) - 1), cell[0], cell[1]]
        corner = on & (u < 0) & (v < 0)
        return np.where(in_tag, code, np.where(corner, 0, background))

    return bright


APRILGRID = Board.of(
    {"kind": "aprilgrid", "columns": 4, "rows": 3, "square_mm": 13.0, "marker_mm": 10.0}
)
CHESS = Board("chessboard", 9, 6, 10.0)
CIRCLES = Board("circles", 8, 6, 10.0)
ASYMMETRIC = Board("asymmetric-circles", 4, 11, 10.0)
CHARUCO = Board("charuco", 7, 5, 10.0, 7.5, "DICT_5X5_250")
