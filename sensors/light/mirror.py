"""The mirror: one laser plane, deflected by a rotating face into all the light planes of a scan."""

from dataclasses import dataclass, replace

import numpy as np

from workbench.core.parameters import Parameter, Parameters
from workbench.core.rigid import left_jacobian, rotation_matrix

# What may be changed about a mirror. The first seven, with the angles known, make every family of
# planes that a face through its own axis makes: the light plane, turned about a line. The rest shows
# hardly or not at all, see `mirror_parameters`.
_TABLE = (
    ("tilt_face", "rad", 0.01, "the mirror axis' tilt about the face's normal"),
    ("tilt_across", "rad", 0.01, "the mirror axis' tilt across it"),
    ("shift_face", "mm", 1.0, "the mirror axis' place along the face's normal"),
    ("shift_across", "mm", 1.0, "the mirror axis' place across it"),
    ("beam_cone", "rad", 0.01, "the beam's tilt out of the mirror axis"),
    ("beam_turn", "rad", 0.01, "the beam's rotation about the mirror axis"),
    ("beam_shift", "mm", 1.0, "the beam's distance from the mirror axis"),
    ("gain", "1", 0.01, "the mirror's rotation per commanded rotation"),
    ("face_offset", "mm", 1.0, "the face's distance from the mirror axis"),
    ("face_zero", "rad", 0.01, "the face's rotation at angle zero"),
)
NAMES = tuple(row[0] for row in _TABLE)
GAIN = NAMES.index("gain")


@dataclass(frozen=True)
class Mirror:
    """A rotating mirror in the camera frame (mm, rad).

    The face turns about the line through `point` (3,) along the unit vector `axis` (3,); at angle 0
    its unit normal is `face` (3,), across the axis; it stands `offset` from the axis. The laser's
    light plane before the mirror is the plane `beam` (4,): unit normal and offset, n.X + b = 0.
    """

    axis: np.ndarray
    point: np.ndarray
    face: np.ndarray
    offset: float
    beam: np.ndarray

    @property
    def perpendicular(self) -> np.ndarray:
        """(3,) unit vector to which the face's normal turns first."""
        return np.cross(self.axis, self.face)

    def normals(self, angles: np.ndarray) -> np.ndarray:
        """(3, n) unit normal of the face at angles (n,) rad."""
        return np.outer(self.face, np.cos(angles)) + np.outer(self.perpendicular, np.sin(angles))

    def planes(self, angles: np.ndarray) -> np.ndarray:
        """(4, n) light planes at mirror angles (n,) rad: unit normals, offsets in mm.

        Reflection of a plane: n' = n - 2 (n.m) m and b' = b + 2 (n.m) (m.a + e), with m the normal
        of the face, a a point of the axis and e the face's offset from it. The plane turns by
        twice the mirror's angle.
        """
        normals = self.normals(angles)
        share = 2 * (self.beam[:3] @ normals)
        planes = np.empty((4, normals.shape[1]))
        planes[:3] = self.beam[:3, None] - share * normals
        planes[3] = self.beam[3] + share * (self.point @ normals + self.offset)
        return planes

    def by_normal(self, angles: np.ndarray, normal_change: np.ndarray) -> np.ndarray:
        """(..., 4, n) change of the planes for a change `normal_change` (..., 3, n) of the face's normals."""
        normals = self.normals(angles)
        beam = self.beam[:3, None]
        cosine = (beam * normals).sum(0)
        reach = self.point @ normals + self.offset
        # changes of the cosine and of the reach
        tilt = (beam * normal_change).sum(-2)
        shift = (self.point[:, None] * normal_change).sum(-2)
        rows = np.empty((*normal_change.shape[:-2], 4, len(angles)))
        rows[..., :3, :] = -2 * (tilt[..., None, :] * normals + cosine * normal_change)
        rows[..., 3, :] = 2 * (tilt * reach + cosine * shift)
        return rows

    def by_angle(self, angles: np.ndarray) -> np.ndarray:
        """(4, n) derivative of `planes` with respect to the angle."""
        return self.by_normal(angles, np.cross(self.axis, self.normals(angles).T).T)

    def by_beam(self, angles: np.ndarray, tilt: np.ndarray) -> np.ndarray:
        """(4, n) change of the planes for a change `tilt` (3,) of the beam's normal, its offset kept."""
        normals = self.normals(angles)
        share = 2 * (tilt @ normals)
        reach = self.point @ normals + self.offset
        return np.concatenate([tilt[:, None] - share * normals, [share * reach]])


def mirror_parameters() -> Parameters:
    """Keys `mirror.<name>`, changes from a start mirror, all 0 there but the gain, which is 1 there.

    With the angles known seven are determined by light planes: the axis (4) and the beam's plane (3). The
    face's angle at zero is confounded with the beam's rotation about the axis where the face
    holds the axis, and hardly elsewhere; the face's distance from the axis makes what is left of
    cos(angle) after 1, cos(2 angle) and sin(2 angle): over a few degrees nearly nothing.
    """
    table = [
        Parameter(f"mirror.{name}", unit, 0.0, size, label) for name, unit, size, label in _TABLE
    ]
    table[GAIN] = replace(table[GAIN], null=1.0)
    return Parameters.of(table)


@dataclass(frozen=True)
class MovedMirror:
    """A mirror after changes (10,) in the order of `NAMES`, and the derivative of its planes by them."""

    start: Mirror
    change: np.ndarray

    @property
    def _rotation(self):
        """(3,) rotation vector of axis and face; columns (3, 3) are the start's face, across, axis."""
        columns = np.stack([self.start.face, self.start.perpendicular, self.start.axis], 1)
        return columns @ self.change[[0, 1, 9]], columns

    @property
    def gain(self) -> float:
        return float(self.change[GAIN])

    @property
    def mirror(self) -> Mirror:
        """The mirror itself. The beam's offset is kept at its distance from the start's axis."""
        start, (vector, columns) = self.start, self._rotation
        rotation = rotation_matrix(vector)
        point = start.point + columns[:, :2] @ self.change[2:4]
        normal, _ = self._beam_normal()
        distance = start.beam[:3] @ start.point + start.beam[3] + self.change[6]
        beam = np.append(normal, distance - normal @ start.point)
        return Mirror(
            rotation @ start.axis, point, rotation @ start.face, start.offset + self.change[8], beam
        )

    def _beam_normal(self):
        """(3,) unit normal of the beam and (2, 3) its derivative by cone and rotation."""
        normal = self.start.beam[:3]
        axis = self.start.axis
        cone = axis - (axis @ normal) * normal
        cone = cone / np.linalg.norm(cone)
        directions = np.stack([cone, np.cross(axis, normal)])
        tilted = normal + self.change[4:6] @ directions
        length = np.linalg.norm(tilted)
        unit = tilted / length
        return unit, (directions - np.outer(directions @ unit, unit)) / length

    def angles(self, commanded: np.ndarray, extra: np.ndarray | float = 0.0) -> np.ndarray:
        """(n,) rad: the gain times commanded angles (n,), and what else turns the mirror."""
        return self.gain * commanded + extra

    def planes(self, commanded: np.ndarray, extra: np.ndarray | float = 0.0) -> np.ndarray:
        """(4, n) light planes at commanded angles (n,)."""
        return self.mirror.planes(self.angles(commanded, extra))

    def rows(self, commanded: np.ndarray, extra: np.ndarray | float = 0.0) -> np.ndarray:
        """(10, 4, n) derivative of the planes with respect to the changes."""
        mirror = self.mirror
        angles = self.angles(commanded, extra)
        vector, columns = self._rotation
        normals = mirror.normals(angles)
        rows = np.zeros((10, 4, len(angles)))
        rotation_rates = (
            left_jacobian(vector) @ columns
        ).T  # (3, 3): rotation per unit of tilts and zero
        rows[[0, 1, 9]] = mirror.by_normal(
            angles, np.cross(rotation_rates[:, None], normals.T).transpose(0, 2, 1)
        )
        share = 2 * (mirror.beam[:3] @ normals)
        rows[2:4, 3] = share * (columns[:, :2].T @ normals)
        _, tilts = self._beam_normal()
        for k, tilt in enumerate(tilts):
            rows[4 + k] = mirror.by_beam(angles, tilt)
            rows[4 + k, 3] -= tilt @ self.start.point
        rows[6, 3] = 1
        rows[GAIN] = mirror.by_angle(angles) * commanded
        rows[8, 3] = share
        return rows


_QUARTER = np.pi / 2  # rad
_INCIDENCE = np.pi / 4  # rad, of the beam on the face in mid-sweep
_BETTER = 0.5  # of the misfit: noise of planes alone does not decide


def start_mirror(planes: np.ndarray, commanded: np.ndarray, by_step: bool = False):
    """A mirror that makes planes (4, S), S >= 3, at commanded angles (S,), face through the axis; and the gain.

    Axis: the direction that all normals hold one angle with. Two estimates, of which that with the smaller misfit to
    the planes is taken. The shortest singular vector of the normals' differences is exact. Over a narrow sweep it is
    the direction of their noise, since normals leave the straight course by the square of the sweep only; there, the
    direction across both the mean normal and the course is near, because a fan of light holds the axis. Turn about
    it: twice the angle. Place: b_i = c - n_i.a, linear in a and c. The face's rotation at angle zero is not seen; it is
    set so that the light plane meets the face at 45 deg in mid-sweep. Gain: rotation of the mirror per
    commanded one; its sign is that of the axis.
    """
    normals = planes[:3]
    directions = np.linalg.svd(normals - normals.mean(1)[:, None])[0]
    perpendicular = np.cross(normals.mean(1), directions[:, 0])
    found = [
        _mirror_of_axis(axis, planes, commanded, by_step)
        for axis in (directions[:, 2], perpendicular / np.linalg.norm(perpendicular))
    ]
    scale = float(np.median(np.abs(planes[3])))
    return min(found, key=lambda candidate: _misfit(candidate, planes, commanded, by_step, scale))


def on_one_branch(planes: np.ndarray, commanded: np.ndarray) -> np.ndarray:
    """Commanded angles (S,) rad less multiples of 90 deg, where only then planes (4, S) are those of one mirror.

    A mirror that is turned by 90 deg sends the light into the same plane through its axis, so that angles on two
    branches may belong to neighbouring planes.
    """
    if np.ptp(commanded) < _QUARTER / 2:
        return commanded
    middle = np.angle(np.exp(4j * commanded).mean()) / 4
    middle += _QUARTER * np.round((np.median(commanded) - middle) / _QUARTER)
    wrapped = nearest_branch(commanded, middle)
    scale = float(np.median(np.abs(planes[3])))
    raw_misfit, wrapped_misfit = (
        _misfit(start_mirror(planes, angles, True), planes, angles, True, scale)
        for angles in (commanded, wrapped)
    )
    return wrapped if wrapped_misfit < _BETTER * raw_misfit else commanded


def nearest_branch(angle, middle: float):
    """Angles (rad) less the multiples of 90 deg that bring them nearest to `middle`."""
    return angle - _QUARTER * np.round((angle - middle) / _QUARTER)


def _misfit(found, planes, commanded, by_step: bool, scale: float) -> float:
    """mm, RMS difference of a mirror's planes from planes (4, S), at `scale` mm from the camera."""
    mirror, gain = found
    mirror_planes = mirror.planes(commanded * (gain if by_step else 1.0))
    mirror_planes = mirror_planes * np.sign((mirror_planes[:3] * planes[:3]).sum(0))
    weight = np.array([scale, scale, scale, 1.0])[:, None]
    return float(np.sqrt((((mirror_planes - planes) * weight) ** 2).sum(0).mean()))


def _mirror_of_axis(axis, planes, commanded, by_step: bool):
    """The mirror that turns about this axis (3,), and its gain, as of `start_mirror`."""
    normals = planes[:3]
    middle = normals.mean(1) - (axis @ normals.mean(1)) * axis
    first = middle / np.linalg.norm(middle)
    plane_angles = np.arctan2(np.cross(axis, first) @ normals, first @ normals)
    slope, at_zero = np.polyfit(commanded, plane_angles, 1)
    if slope < 0:
        axis, slope, at_zero = -axis, -slope, -at_zero
    second = np.cross(axis, first)
    gain = slope / 2
    shape = np.stack([-(first @ normals), -(second @ normals), np.ones(len(plane_angles))], 1)
    x, y, distance = np.linalg.lstsq(shape, planes[3], rcond=None)[0]
    point = x * first + y * second
    scale = gain if by_step else 1.0
    face_angle = at_zero + _INCIDENCE + scale * commanded.mean() - np.pi
    beam_angle = face_angle + scale * commanded.mean() + _INCIDENCE
    mirror = _assemble(
        axis, first, second, point, face_angle, beam_angle, axis @ normals.mean(1), distance
    )
    return mirror, gain


def _assemble(axis, first, second, point, face_angle, beam_angle, axial, distance):
    """A mirror whose face and beam stand at these turns about the axis; axial: the beam's part along it."""
    face = np.cos(face_angle) * first + np.sin(face_angle) * second
    flat = np.sqrt(max(1 - axial**2, 0.0))
    beam = flat * (np.cos(beam_angle) * first + np.sin(beam_angle) * second) + axial * axis
    return Mirror(axis, point, face, 0.0, np.append(beam, distance - beam @ point))
