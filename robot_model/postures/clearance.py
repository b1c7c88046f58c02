"""Whether an arm is in its own way, or between its sensor and what that looks at: links as capsules."""

import numpy as np

from robot_model.chain import forward
from robot_model.robot import Robot


def joint_origins(robot: Robot, variables: np.ndarray) -> np.ndarray:
    """(J + 2, 3, n) mm, root frame: base, the frame after each joint, flange; variables (J, n) rad, mm."""
    frames = forward(robot, variables, links=True)
    base = np.repeat(robot.base[:3, 3][:, None], variables.shape[1], 1)
    return np.concatenate([base[None], frames.origin, frames.end_origin[None]])


def segment_distance(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(n,) least distance of the segments a-b and c-d, each (3, n).

    Ericson, Real-Time Collision Detection (2005), sec. 5.1.9.
    """
    u = b - a
    v = d - c
    w = a - c
    uu = np.maximum((u * u).sum(0), 1e-12)
    vv = np.maximum((v * v).sum(0), 1e-12)
    uv = (u * v).sum(0)
    uw = (u * w).sum(0)
    vw = (v * w).sum(0)
    # the nearest point of the first line to the second one; parallel lines may start anywhere
    determinant = uu * vv - uv**2
    is_parallel = determinant <= 1e-9 * uu * vv
    divisor = np.where(determinant == 0, 1, determinant)
    s = np.clip(np.where(is_parallel, 0, (uv * vw - uw * vv) / divisor), 0, 1)
    # then the nearest points of the segments to one another, each held within its ends
    t = np.clip((uv * s + vw) / vv, 0, 1)
    s = np.clip((uv * t - uw) / uu, 0, 1)
    return np.linalg.norm(w + s * u - t * v, axis=0)


def self_clearance(robot: Robot, variables: np.ndarray, radius: float) -> np.ndarray:
    """(n,) mm: least distance of the middle lines of two links that are not neighbours; inf where there are none.

    Links that hang together over less than four of their radii (mm) are neighbours: an elbow's short
    offset keeps its two arms no farther apart.
    """
    origins = joint_origins(robot, variables)
    lengths = np.linalg.norm(np.diff(origins, axis=0), axis=1).max(1)
    found = np.full(variables.shape[1], np.inf)
    for i in range(len(lengths)):
        for j in range(i + 2, len(lengths)):
            if lengths[i + 1 : j].sum() > 4 * radius and min(lengths[i], lengths[j]) > 0:
                ends = origins[i], origins[i + 1], origins[j], origins[j + 1]
                found = np.minimum(found, segment_distance(*ends))
    return found


def view_clearance(
    robot: Robot, variables: np.ndarray, eye: np.ndarray, target: np.ndarray, radius: float
) -> np.ndarray:
    """(n,) mm: least distance of lines of sight from the links that do not carry the sensor.

    eye, target (3, n) mm in the root frame; links nearer to the sensor than four radii do not count.
    """
    origins = joint_origins(robot, variables)
    lengths = np.linalg.norm(np.diff(origins, axis=0), axis=1).max(1)
    found = np.full(variables.shape[1], np.inf)
    for k in range(len(lengths)):
        # the links that carry the sensor do not block its line of sight
        if lengths[k + 1 :].sum() > 4 * radius:
            found = np.minimum(found, segment_distance(origins[k], origins[k + 1], eye, target))
    return found


def hidden_by_others(
    eye: np.ndarray, target: np.ndarray, balls: np.ndarray, radii: np.ndarray, of_target: np.ndarray
) -> np.ndarray:
    """(n,) True where another ball stands in the line of sight.

    eye, target (3, n); balls (K, 3) and radii (K,) mm in the same frame; own (n,) index of the ball looked at.
    """
    hidden = np.zeros(eye.shape[1], bool)
    for k, (centre, radius) in enumerate(zip(balls, radii)):
        place = np.repeat(centre[:, None], eye.shape[1], 1)
        hidden |= (of_target != k) & (segment_distance(eye, target, place, place) < radius)
    return hidden
