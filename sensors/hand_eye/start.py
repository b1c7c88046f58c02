"""Starts for hand-eye from images: board poses one image at a time, then closed forms."""

import numpy as np

from sensors.camera.model import Camera
from workbench.core.errors import InputError
from workbench.core.least_squares.linear_algebra import symmetric_eigen, thin_svd
from workbench.core.rigid import inverse, nearest_rotation, rotation_vector, transform

METHODS = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
NO_ROTATION_RAD = np.radians(0.5)  # below it a rotation is what an arm makes when it only moves
_ROUNDED_TURN = 1e-9  # rad, far below what is recorded and far above rounding
_FARTHEST_MM = 1e6  # farther off, the rounding of coordinates makes all boards coincide
_NEAR_PI = np.radians(170.0)  # near pi the axis of a relative rotation has no sign


def board_poses(
    board: np.ndarray, pixels: np.ndarray, pose: np.ndarray, camera: Camera
) -> np.ndarray:
    """(P, 4, 4) T_camera_board of each image alone: least squares of its pixels (OpenCV).

    board (3, n) mm, pixels (2, n) and the image's number pose (n,), 0..P-1. InputError where a
    image has fewer than four points.
    """
    import cv2
    from scipy.spatial.transform import Rotation

    placed = []
    for number in range(int(pose.max()) + 1):
        is_of_image = pose == number
        if is_of_image.sum() < 4:
            raise InputError(
                f"image {number}: expected at least 4 points of the board, found {is_of_image.sum()}; "
                "take the image out"
            )
        found = cv2.solvePnP(
            np.ascontiguousarray(board[:, is_of_image].T), *camera.pnp_view(pixels[:, is_of_image])
        )
        if not found[0] or not np.isfinite(found[1]).all():
            raise InputError(
                f"image {number}: expected a view of the board, found pixels that no pose explains; "
                "take the image out"
            )
        placed.append(transform(Rotation.from_rotvec(found[1][:, 0]).as_matrix(), found[2][:, 0]))
    return np.array(placed)


def closed_forms(flange: np.ndarray, seen: np.ndarray, kind: str) -> dict[str, np.ndarray]:
    """Hand-eye (4, 4) by every closed form of OpenCV that gives one, by name.

    Tsai & Lenz 1989, Park & Martin 1994, Horaud & Dornaika 1995, Andreff et al. 1999, Daniilidis
    1999; robot-world: Shah 2013, Li et al. 2010.
    """
    import cv2

    moved = flange if kind == "in-hand" else inverse(flange)
    mount_from_target = inverse(moved)
    found = {}
    for name in METHODS:
        arguments = (moved[:, :3, :3], moved[:, :3, 3], seen[:, :3, :3], seen[:, :3, 3])
        found[name] = _called(
            cv2, cv2.calibrateHandEye, arguments, getattr(cv2, f"CALIB_HAND_EYE_{name}")
        )
    for name in ("SHAH", "LI"):
        arguments = (
            seen[:, :3, :3],
            seen[:, :3, 3],
            mount_from_target[:, :3, :3],
            mount_from_target[:, :3, 3],
        )
        method = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{name}")
        found[name] = _called(cv2, cv2.calibrateRobotWorldHandEye, arguments, method)
    return {name: solution for name, solution in found.items() if solution is not None}


def _called(cv2, function, arguments, method):
    """(4, 4) or None where OpenCV finds none; what it writes on standard error about that is no use to a person."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        solution = function(*arguments, method=method)
    except cv2.error:
        return None
    finally:
        cv2.utils.logging.setLogLevel(level)
    matrix = transform(solution[-2], solution[-1][:, 0])
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3]) - 1) > 1e-3:
        return None
    if np.abs(matrix[:3, 3]).max() > _FARTHEST_MM:
        return None
    matrix[:3, :3] = nearest_rotation(matrix[:3, :3])
    return matrix if function.__name__ == "calibrateHandEye" else inverse(matrix)


def start_from_boards(flange, seen, points, kind) -> tuple[np.ndarray, float]:
    """Twelve values, sensor and board, of the best start, and its misfit, mm at the board's corners.

    Best is whose boards lie closest: the median distance from the board that is closest to all, so
    that a pose that is a blunder does not choose.
    """
    moved = flange if kind == "in-hand" else inverse(flange)
    candidates = [
        *closed_forms(flange, seen, kind).values(),
        *_without_one(moved, seen),
        *_cube_rotations(moved, seen),
    ]
    corners = _corners(points)
    scored = [(*_spread(moved @ sensor @ seen, corners), sensor) for sensor in candidates]
    misfit, board, sensor = min(scored, key=lambda row: row[0])
    return np.concatenate([_values(sensor), _values(board)]), max(misfit, 1e-3)


def nearest_labelling(
    flange: np.ndarray, seen: np.ndarray, points: np.ndarray, kind: str
) -> np.ndarray:
    """(P,) which of T readings of each image, seen (T, P, 4, 4), puts the board where the others have it.

    Each reading of the first image in turn is taken for right; that of the second which makes the
    camera rotate by the flange's angle, and so on: angles need no hand-eye (Chen, CVPR 1991).
    """
    labellings, count = seen.shape[:2]
    moved = flange if kind == "in-hand" else inverse(flange)
    alpha = np.linalg.norm(
        rotation_vector((inverse(moved)[None, :] @ moved[:, None])[..., :3, :3]), axis=-1
    )
    relative = (
        seen[:, None, :, None] @ inverse(seen)[None, :, None, :]
    )  # [reading i, reading j, i, j]
    beta = np.linalg.norm(rotation_vector(relative[..., :3, :3]), axis=-1)
    difference = np.abs(beta - alpha)
    best = [difference[:, labelling, :, 0].argmin(0) for labelling in range(labellings)]
    scores = []
    for labelling, labels in enumerate(best):
        labels[0] = labelling
        start = start_from_boards(flange, seen[labels, np.arange(count)], points, kind)
        scores.append(start[1])
    return best[int(np.argmin(scores))]


def _corners(points):
    low = points.min(1)
    high = points.max(1)
    return np.array(
        [[x, y, points[2].mean()] for x in (low[0], high[0]) for y in (low[1], high[1])]
    ).T


def _spread(placed, corners):
    """Median distance of the boards from that board which is nearest to all, and that board."""
    where = placed[:, :3, :3] @ corners + placed[:, :3, 3:]
    distance = np.sqrt(((where[:, None] - where[None]) ** 2).sum(2).mean(2))
    middle = np.median(distance, axis=1)
    best = int(np.argmin(middle))
    return float(middle[best]), placed[best]


def _values(matrix):
    return np.concatenate([matrix[:3, 3], rotation_vector(matrix[:3, :3])])


def _without_one(moved, seen):
    """Closed form without each pose: one of them is free of a blunder."""
    count = len(moved)
    return (
        [align(moved[keep], seen[keep])[0] for keep in ~np.eye(count, dtype=bool)]
        if count > 4
        else []
    )


def _cube_rotations(moved, seen):
    """The 24 rotations of a cube, each with its best translation: for motions that say little of the rotation."""
    from scipy.spatial.transform import Rotation

    rotations = Rotation.create_group("O").as_matrix()
    pairs = _pairs(moved, seen)
    return [transform(rotation, _translation(rotation, *pairs)[0]) for rotation in rotations]


def _pairs(moved, seen):
    """Relative motions of flange and camera of all pairs of poses, at most about 400."""
    i, j = np.triu_indices(len(moved), 1)
    step = max(len(i) // 400, 1)
    i, j = i[::step], j[::step]
    return inverse(moved[j]) @ moved[i], seen[j] @ inverse(seen[i])


def align(moved: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Hand-eye (4, 4) of all pairs by least squares, its misfit (mm), and angles (2, K) of flange and camera, rad.

    Rotation: the one that takes the camera's rotation vectors to the flange's (Park & Martin, IEEE
    Trans. Robot. Autom. 10 (1994)); where those have one direction only, or none, with what the
    translations say of the rest; then the translation. The misfit counts a rotation at the board's
    distance.
    """
    flange, camera = _pairs(moved, seen)
    alpha = rotation_vector(flange[:, :3, :3])
    beta = rotation_vector(camera[:, :3, :3])
    angles = np.linalg.norm(np.stack([alpha, beta]), axis=2)
    is_determined = (angles < _NEAR_PI).all(0)
    reach = np.median(np.linalg.norm(seen[:, :3, 3], axis=1))
    found = []
    is_rotating = (angles > NO_ROTATION_RAD).all(0)
    half = is_rotating & ~is_determined
    only_half = half.any() and not (is_rotating & is_determined).any()
    candidates = (
        _rotations_near_pi(half, flange, camera)
        if only_half
        else _rotation_candidates(alpha[is_determined], beta[is_determined], flange, camera)
    )
    for rotation in candidates:
        shift, translation_residual = _translation(rotation, flange, camera)
        gap = (
            _rotation_misfit(rotation, flange, camera)
            if only_half
            else (alpha - beta @ rotation.T)[is_determined]
        ) * reach
        found.append(
            (
                float(np.sqrt((gap**2).sum(1).mean() + (translation_residual**2).sum(1).mean())),
                transform(rotation, shift),
            )
        )
    misfit, best = min(found, key=lambda row: row[0])
    return best, misfit, angles


def _rotation_candidates(alpha, beta, flange, camera):
    """Rotations (3, 3) to try, of which one is near, from rotation vectors (K, 3) of flange and camera."""
    rotation = nearest_rotation((alpha.T @ beta)[None])[0]
    axes = thin_svd(alpha)[2]
    axial = alpha @ axes[0]
    if (
        np.linalg.norm(alpha, axis=1).max(initial=0) < NO_ROTATION_RAD
    ):  # flange and camera move alike
        return [nearest_rotation((flange[:, :3, 3].T @ camera[:, :3, 3])[None])[0]]
    if np.linalg.norm(alpha - np.outer(axial, axes[0]), axis=1).max() > NO_ROTATION_RAD:
        return [rotation]
    return _rotated_about_axis(_spun(axes[0]) @ rotation, axes[0], flange, camera)


def _rotations_near_pi(half, flange, camera):
    """Rotations to try where the only relative rotations are by about pi, `half` (K,) bool: axes without a sign.

    A rotation by pi about a is 2 a a' - 1, whose largest eigenvector is a up to its sign. Two axes that are far from
    parallel give a rotation for each choice of signs; of a single axis both directions are searched about it.
    """
    from scipy.spatial.transform import Rotation

    flange_axes, seen = (
        symmetric_eigen(_axis_products(motions[half]))[1][:, :, 2] for motions in (flange, camera)
    )
    other = int(np.argmin(np.abs(flange_axes @ flange_axes[0])))
    single = abs(flange_axes[other] @ flange_axes[0]) > np.cos(NO_ROTATION_RAD)
    tried = []
    for sign in (1.0, -1.0):
        if single:
            rotation = Rotation.align_vectors(sign * flange_axes[:1], seen[:1])[0].as_matrix()
            tried += _rotated_about_axis(
                _spun(flange_axes[0]) @ rotation, flange_axes[0], flange, camera
            )
            continue
        for second in (1.0, -1.0):
            axes = np.stack([sign * flange_axes[0], second * flange_axes[other]]), seen[[0, other]]
            tried.append(Rotation.align_vectors(*axes)[0].as_matrix())
    return tried


def _axis_products(motions):
    """(K, 3, 3) products a a' of the axes a of rotations by pi (K, 4, 4)."""
    rotations = motions[:, :3, :3]
    return (rotations + np.swapaxes(rotations, 1, 2)) / 4 + np.eye(3) / 2


def _rotation_misfit(rotation, flange, camera):
    """(K, 3) rad: what a hand-eye rotation leaves between the rotations of flange and camera."""
    predicted = rotation @ camera[:, :3, :3] @ rotation.T
    return rotation_vector(flange[:, :3, :3] @ np.swapaxes(predicted, 1, 2))


def _spun(axis):
    """(24, 3, 3) rotations about an axis, over a whole revolution."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(
        np.outer(np.linspace(0, 2 * np.pi, 24, endpoint=False), axis)
    ).as_matrix()


def _rotated_about_axis(rotations, axis, flange, camera):
    """The best of `rotations` (S, 3, 3), rotated about the axis by Newton's step of the translations' misfit."""
    from scipy.spatial.transform import Rotation

    rows = (flange[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (
        np.einsum("sij,kj->kis", rotations, camera[:, :3, 3]) - flange[:, :3, 3, None]
    ).reshape(len(rows), -1)
    cost = ((rows @ _solved(rows, right) - right) ** 2).sum(0)
    k = int(np.argmin(cost))
    before, middle, after = (
        cost[k - 1],
        cost[k],
        cost[(k + 1) % len(cost)],
    )  # a sine of the angle, near its lowest
    bend = before - 2 * middle + after
    step = 2 * np.pi / len(rotations) * (before - after) / (2 * bend) if bend > 0 else 0.0
    candidates = Rotation.from_rotvec(np.outer([0, step], axis)).as_matrix() @ rotations[k]
    return list(candidates)


def _translation(rotation, flange, camera):
    """Translation (3,) with (R_A - 1) t = R_X t_B - t_A, and what is left (K, 3)."""
    rows = (flange[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (camera[:, :3, 3] @ rotation.T - flange[:, :3, 3]).reshape(-1)
    shift = _solved(rows, right)
    return shift, (rows @ shift - right).reshape(-1, 3)


def _solved(rows, right):
    """Translations of least squares (3,) or (3, S) from rows R - 1 of rotations; 0 along what no rotation determines.

    The entries are about angles in rad, so that the bound of a determined direction is an angle: one relative to the
    largest angle would take the rounding of flange poses that never turn for turns.
    """
    nothing = np.zeros((3, *right.shape[1:]))
    stacked = np.concatenate([rows, holding_rows(len(rows))]), np.concatenate([right, nothing])
    return np.linalg.lstsq(*stacked, rcond=None)[0]


def holding_rows(count: int) -> np.ndarray:
    """(3, 3) rows that hold a translation at 0 where `count` rows R - 1 of rotations are rounding."""
    return _ROUNDED_TURN * np.sqrt(count) * np.eye(3)
