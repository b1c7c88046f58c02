"""The arm as a chain of frames: forward kinematics and, for every port, the analytic derivative.

All samples at once. Arrays keep the sample on the last axis, (3, n) a vector field, because every
operation is then one long contiguous loop; a rotation matrix is its three column vectors.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from robot_model.robot import Robot

THETA, D, A, ALPHA, BETA = range(5)


@dataclass
class Frames:
    """Axes and origins of an arm with J joints, in the world frame (mm), for n samples.

    `z`, `x`, `y` (J, 3, n): the axes about which theta, alpha and beta turn (d and a shift along
    z and x); `z_origin`, `x_origin` (J, 3, n): points on them. `link` (J+2, 3, 3, n) the columns
    of the frame of each small twist (base, links, tool), `pivot` (J+2, 3, n) the point that it
    turns about and `origin` (J, 3, n) that of the frame after each joint. `tip` (J, 3, n): the foot of
    link K's common normal on the next axis, where link K ends. The pivot of a link lies midway between its tip and
    the foot of the normal before it on joint K's own axis, which a slide carries with it: both are fixed to the
    link, and neither depends on the convention. `end` (3, 3, n)
    columns of the flange, `end_origin` (3, n). `axes` (z, x, y) and `origins` (of z, of x) are
    lists of one (3, n) a joint: as the walk left them, copied only when somebody asks.
    """

    axes: tuple[list[np.ndarray], ...]
    origins: tuple[list[np.ndarray], ...]
    link: np.ndarray | None
    pivot: np.ndarray | None
    origin: np.ndarray | None
    tip: np.ndarray | None
    end: tuple[np.ndarray, np.ndarray, np.ndarray]
    end_origin: np.ndarray

    z = cached_property(lambda self: np.stack(self.axes[0]))
    x = cached_property(lambda self: np.stack(self.axes[1]))
    y = cached_property(lambda self: np.stack(self.axes[2]))
    z_origin = cached_property(lambda self: np.stack(self.origins[0]))
    x_origin = cached_property(lambda self: np.stack(self.origins[1]))

    def link_vector(self, number: int) -> np.ndarray:
        """(3, n) mm from where link K (from 1) begins to where it ends, through its pivot."""
        return 2 * (self.tip[number - 1] - self.pivot[number])

    def point(self, flange_point: np.ndarray) -> np.ndarray:
        """(3, n) world coordinates of a flange-frame point (3,) or (3, n)."""
        ex, ey, ez = self.end
        return self.end_origin + ex * flange_point[0] + ey * flange_point[1] + ez * flange_point[2]


def forward(
    robot: Robot,
    variables: np.ndarray,
    geometry: np.ndarray | None = None,
    base: tuple[np.ndarray, np.ndarray] | None = None,
    twists: dict[int, np.ndarray] | None = None,
    links: bool = False,
    cosines_and_sines: tuple[np.ndarray, np.ndarray] | None = None,
) -> Frames:
    """Frames of the arm.

    variables (J, n): joint variables, rad (mm for a prismatic joint), after sign and coupling.
    geometry (J, 5) or (J, 5, n): theta, d, a, alpha, beta (rad, mm); None: the nominal ones.
    base: rotation (3, 3) and origin (3,) of the robot's root frame in the world.
    twists: place (0 base, 1..J links, J+1 tool) -> (6, n) small twist, translation (mm) then
    rotation vector (rad), both in that place's own frame. links: also keep `link`, `pivot`, `origin`.

    Convention "distal": Rz(q+theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) (Hayati & Mirmirani 1985);
    "craig": Ry(beta) Rx(alpha) Tx(a) Rz(q+theta) Tz(d) (Craig, Introduction to Robotics, eq. 3.6).
    """
    joints, n = variables.shape
    geometry = robot.geometry if geometry is None else geometry
    ends = None
    if links or twists:
        ends = np.where(robot.prismatic[:, None], variables, 0.0), _tips(robot, geometry)
    walk = _Walk(joints, n, robot.base, base, twists or {}, ends)
    angles, shifts = _angles_and_shifts(robot, variables, geometry)
    if cosines_and_sines is None or geometry.ndim > 2 or robot.prismatic.any():
        cosines = np.cos(angles)
        sines = np.sin(angles)
    else:
        c = np.cos(geometry[:, :1])
        s = np.sin(geometry[:, :1])
        cosines = c * cosines_and_sines[0] - s * cosines_and_sines[1]
        sines = s * cosines_and_sines[0] + c * cosines_and_sines[1]
    step = walk.distal if robot.convention == "distal" else walk.craig
    twist_cosines = np.cos(geometry[:, ALPHA:])
    twist_sines = np.sin(geometry[:, ALPHA:])
    tilted = geometry[:, BETA].reshape(joints, -1).any(1)
    for k in range(joints):
        if tilted[k]:
            beta = twist_cosines[k, 1], twist_sines[k, 1]
        else:
            beta = None
        step(
            k,
            (cosines[k], sines[k]),
            (twist_cosines[k, 0], twist_sines[k, 0]),
            beta,
            shifts[k],
            geometry[k, A],
        )
    return walk.finish(robot.flange)


def _angles_and_shifts(robot, variables, geometry):
    """theta + q and d + q, (J, n) or broadcastable to it."""
    theta = geometry[:, THETA]
    d = geometry[:, D]
    if geometry.ndim == 2:
        theta = theta[:, None]
        d = d[:, None]
    if not robot.prismatic.any():
        varies = d.shape[1] > 1
        shifts = np.broadcast_to(d, variables.shape) if varies else d
        return variables + theta, shifts
    slides = robot.prismatic[:, None]
    angles = np.where(slides, 0, variables)
    shifted = np.where(slides, variables, 0)
    return angles + theta, shifted + d


def _tips(robot, geometry) -> np.ndarray:
    """(J, 3) or (J, 3, n) mm, the end of each link in the frame after its joint: the last one's is the flange."""
    tips = np.zeros((len(geometry), 3, *geometry.shape[2:]))
    if robot.convention == "craig":
        beta = geometry[1:, BETA]
        length = geometry[1:, A]
        tips[:-1, 0] = length * np.cos(beta)
        tips[:-1, 2] = -length * np.sin(beta)
    tips[-1] = robot.flange[:3, 3].reshape(3, *(1,) * (geometry.ndim - 2))
    return tips


class _Walk:
    """The state of a walk along the chain: present axes and origin, and what is kept of them.

    ends: where links are kept, how far each joint has slid (J, n) mm, and the tips of the links as of `_tips`.
    """

    def __init__(self, joints, n, root, base, twists, ends):
        if base is None:
            rotation, origin = np.eye(3), np.zeros(3)
        else:
            rotation, origin = base
        start = rotation @ root[:3, :3]
        self.axes = [np.repeat(start[:, c, None], n, 1) for c in range(3)]
        self.origin = np.repeat((rotation @ root[:3, 3] + origin)[:, None], n, 1)
        self.z, self.x, self.y, self.z_origin, self.x_origin = ([] for _ in range(5))
        links = ends is not None
        if links:
            self.link = np.empty((joints + 2, 3, 3, n))
            self.pivot = np.empty((joints + 2, 3, n))
        else:
            self.link = None
            self.pivot = None
        self.origins = np.empty((joints, 3, n)) if links else None
        self.tip = np.empty((joints, 3, n)) if links else None
        self.ends = ends
        self.twists = twists
        self.keep_link(0, self.origin)

    def distal(self, k, theta, alpha, beta, shift, length):
        self.z.append(self.axes[2])
        self.z_origin.append(self.origin)
        self.rotate(2, *theta)
        self.origin = self.origin + self.axes[2] * shift
        self.origin += self.axes[0] * length
        self.x.append(self.axes[0])
        self.x_origin.append(self.origin)
        self.rotate(0, *alpha)
        self.y.append(self.axes[1])
        if beta is not None:
            self.rotate(1, *beta)
        self.keep_joint(k)

    def craig(self, k, theta, alpha, beta, shift, length):
        self.y.append(self.axes[1])
        self.x_origin.append(self.origin)
        if beta is not None:
            self.rotate(1, *beta)
        self.x.append(self.axes[0])
        self.rotate(0, *alpha)
        self.origin = self.origin + self.axes[0] * length
        self.z.append(self.axes[2])
        self.z_origin.append(self.origin)
        self.rotate(2, *theta)
        self.origin = self.origin + self.axes[2] * shift
        self.keep_joint(k)

    def rotate(self, axis, c, s):
        """Right-multiply by an elementary rotation: mixes the other two axes."""
        i = (axis + 1) % 3
        j = (axis + 2) % 3
        first = self.axes[i]
        second = self.axes[j]
        self.axes[i], self.axes[j] = c * first, c * second
        self.axes[i] += s * second
        self.axes[j] -= s * first

    def keep_joint(self, k):
        if self.link is None:
            return
        slid, tips = self.ends
        self.origins[k] = self.origin
        self.tip[k] = self.origin + sum(axis * t for axis, t in zip(self.axes, tips[k]))
        root = self.z_origin[k] + self.z[k] * slid[k]
        pivot = (root + self.tip[k]) / 2
        self.keep_link(k + 1, pivot)

    def keep_link(self, place, pivot):
        if self.link is None:
            return
        self.link[place], self.pivot[place] = self.axes, pivot
        if place in self.twists:
            self.apply(self.twists[place], pivot)

    def apply(self, twist, pivot):
        """Move everything outward of here by an exact small twist about `pivot`."""
        shift = sum(axis * t for axis, t in zip(self.axes, twist[:3]))
        vector = sum(axis * w for axis, w in zip(self.axes, twist[3:]))
        moved = np.stack([*self.axes, self.origin - pivot])
        *self.axes, lever = rotate(vector, moved)
        self.origin = pivot + shift + lever

    def finish(self, flange):
        rotation = flange[:3, :3]
        offset = flange[:3, 3]
        if not np.array_equal(flange, np.eye(4)):
            self.origin = self.origin + sum(axis * t for axis, t in zip(self.axes, offset))
            self.axes = [
                sum(axis * r for axis, r in zip(self.axes, rotation[:, c])) for c in range(3)
            ]
        self.keep_link(len(self.z) + 1, self.origin)
        lines = (self.z, self.x, self.y), (self.z_origin, self.x_origin)
        positions = self.link, self.pivot, self.origins, self.tip
        return Frames(*lines, *positions, tuple(self.axes), self.origin)


def link_lengths(robot: Robot, number: int) -> tuple[tuple[int, ...], np.ndarray]:
    """Components of the geometry port that are lengths of link K (from 1), and their nominal values (mm).

    d and a of its row; with "craig" the length up to the next axis is the a of the next row. The d of a slide is no
    length of the link, but the zero of its reading.
    """
    after = number if robot.convention == "craig" else number - 1
    if robot.prismatic[number - 1]:
        places = []
    else:
        places = [(number - 1, D)]
    if after < robot.joints:
        places.append((after, A))
    lengths = np.array([robot.geometry[place] for place in places])
    port_indices = tuple(5 * row + column for row, column in places)
    return port_indices, lengths


def growing_lengths(
    robot: Robot, variables: np.ndarray, number: int
) -> tuple[tuple[int, ...], np.ndarray]:
    """Components of the geometry port by which link K (from 1) expands, and the lengths (k, n) that do (mm).

    Those of `link_lengths`; and the travel of a slide from the zero of its reading, for its scale or screw expands.
    variables (J, n): joint variables, rad (mm).
    """
    port_indices, nominal = link_lengths(robot, number)
    lengths = np.repeat(nominal[:, None], variables.shape[1], 1)
    if not robot.prismatic[number - 1]:
        return port_indices, lengths
    travel = variables[number - 1]
    return (5 * (number - 1) + D, *port_indices), np.vstack([travel, lengths])


def cross(a: np.ndarray, b: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
    """(..., 3, n) cross products along the axis before the last, in `out` where it is given."""
    if out is None:
        out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[..., j, :], b[..., k, :], out=out[..., i, :])
        out[..., i, :] -= a[..., k, :] * b[..., j, :]
    return out


def rotate(vector: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(..., 3, n) points turned by rotation vectors (3, n): Rodrigues' formula, exact at 0."""
    angle = np.sqrt((vector**2).sum(0))
    product = cross(vector, points)
    half = np.sinc(angle / (2 * np.pi))
    return points + np.sinc(angle / np.pi) * product + half**2 / 2 * cross(vector, product)


def geometry_rows(
    robot: Robot, frames: Frames, point: np.ndarray, port_indices: np.ndarray
) -> np.ndarray:
    """(len(port_indices), 3, n) motion of `point` per unit of geometry; component 5 k + THETA..BETA of joint k."""
    rows = np.empty((len(port_indices), 3, point.shape[1]))
    for row, port_index in zip(rows, port_indices.tolist()):
        joint, kind = divmod(port_index, 5)
        axis = frames.axes[_AXIS[kind]][joint]
        if kind in (D, A):
            row[:] = axis
        else:
            cross(axis, point - frames.origins[_ORIGIN[kind]][joint], out=row)
    return rows


_AXIS = (0, 0, 1, 1, 2)
"""theta and d go by z, a and alpha by x, beta by y; the last two stand where x does."""
_ORIGIN = (0, 0, 1, 1, 1)


def geometry_rotations(frames: Frames, port_indices: np.ndarray) -> np.ndarray:
    """(len(port_indices), 3, n) rotation of the flange, world frame, per unit of geometry (0 for d, a)."""
    axes = {THETA: frames.z, ALPHA: frames.x, BETA: frames.y}
    zero = np.zeros_like(frames.end_origin)
    return np.stack(
        [
            axes[kind][joint] if kind in axes else zero
            for joint, kind in zip(*np.divmod(port_indices, 5))
        ]
    )


def frame_rows(
    frames: Frames, point: np.ndarray, port_indices: np.ndarray, twists: dict[int, np.ndarray]
) -> np.ndarray:
    """(len(port_indices), 3, n) motion of `point` per unit of twist; component 6 place + 0..2 shift, 3..5 rotation."""
    place, kind = np.divmod(port_indices, 6)
    rows = np.empty((len(port_indices), 3, point.shape[1]))
    for p in np.unique(place):
        is_of_place = place == p
        shifts = is_of_place & (kind < 3)
        is_rotation = is_of_place & (kind >= 3)
        rows[shifts] = frames.link[p][kind[shifts]]
        if is_rotation.any():
            lever = point - _moved_pivot(frames, p, twists)
            rows[is_rotation] = cross(_place_turns(frames, p, twists)[kind[is_rotation] - 3], lever)
    return rows


def frame_rotations(
    frames: Frames, port_indices: np.ndarray, twists: dict[int, np.ndarray]
) -> np.ndarray:
    """(len(port_indices), 3, n) rotation of the flange, world frame, per unit of twist (0 for shifts)."""
    place, kind = np.divmod(port_indices, 6)
    rows = np.zeros((len(port_indices), *frames.end_origin.shape))
    for p in np.unique(place[kind >= 3]):
        is_of_place = (place == p) & (kind >= 3)
        rows[is_of_place] = _place_turns(frames, p, twists)[kind[is_of_place] - 3]
    return rows


def _moved_pivot(frames, place, twists):
    if place not in twists:
        return frames.pivot[place]
    return frames.pivot[place] + sum(
        axis * t for axis, t in zip(frames.link[place], twists[place][:3])
    )


def _place_turns(frames: Frames, place: int, twists: dict[int, np.ndarray]) -> np.ndarray:
    """(3, 3, n) world rotation per unit of each rotation-vector component: left Jacobian of SO(3)."""
    axes = frames.link[place]
    if place not in twists:
        return axes
    vector = (axes * twists[place][3:, None]).sum(0)
    product = cross(vector, axes)
    # the first terms of the series are exact to 1e-9 for the small twists of an arm (< 0.05 rad)
    return axes + product / 2 + cross(vector, product) / 6
