"""`laser-spot`: the beam of a laser on the flange passes through points that lie on a sphere.

Liu, Shi & Ding, IEEE CYBER (2014) 365: a position-sensitive detector is turned about a fixed centre,
so that its middle stays on a sphere, and in every place beams are driven to its middle. The paper
works with means of common perpendiculars of pairs of beams; here the residual is what is known of a
beam: that it passes its point at no distance, with points and sphere as unknowns.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from robot_model.chain import Frames, cross
from robot_model.measurements.closure import Closure, Contact, add_delta, flange_matrices, rigid_fit
from robot_model.poses import pose_parameters, pose_values
from workbench.core.parameters import Parameter
from workbench.core.rigid import left_jacobian, rotation_matrix

# through fewer points there is always a sphere: it says nothing then
_MIN_POINTS = 5
_ROUNDS = 40


@dataclass(frozen=True)
class LaserSpot(Contact):
    """n beams that pass K points, in two components across the beam; `sphere` (K,) of each point, -1 for none.

    `facing` (K, 3, 3): columns of a frame a point, whose z is about where the point lies from its
    sphere's centre; its place on the sphere is given by two rotations from there.
    """

    sphere: np.ndarray
    facing: np.ndarray = field(repr=False)
    equations = 2

    @classmethod
    def of(cls, recording) -> "LaserSpot":
        """From a recording with columns `point` and `sphere`."""
        ids, first, index = np.unique(
            recording.columns["point"], return_index=True, return_inverse=True
        )
        _, sphere, counts = np.unique(
            recording.columns["sphere"][first], return_inverse=True, return_counts=True
        )
        bound = counts >= _MIN_POINTS
        sphere = np.where(bound, np.cumsum(bound) - 1, -1)[sphere]
        return cls(index, tuple(int(i) for i in ids), sphere, np.tile(np.eye(3), (len(ids), 1, 1)))

    @property
    def spheres(self) -> int:
        """Number of spheres that bind their points."""
        return int(self.sphere.max(initial=-1)) + 1

    def parameters(self) -> list[Parameter]:
        """The beam (z axis of a frame on the flange), then each sphere, then each point, root frame, mm and rad."""
        table = pose_parameters("tool", "beam")
        for s in range(self.spheres):
            table += [
                Parameter(
                    f"artefact.sphere{s + 1}_{axis}",
                    "mm",
                    0.0,
                    100.0,
                    f"centre {axis} of sphere {s + 1}",
                )
                for axis in "xyz"
            ]
            table.append(
                Parameter(
                    f"artefact.sphere{s + 1}_radius", "mm", 0.0, 100.0, f"radius of sphere {s + 1}"
                )
            )
        for k, bound in zip(self.ids, self.sphere >= 0):
            for name, unit, size in _place_on_sphere(k) if bound else _place_anywhere(k):
                table.append(Parameter(f"artefact.{name}", unit, 0.0, size, name.replace("_", " ")))
        return table

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(2, n) the point in the beam's frame, across the beam, mm."""
        rotation = rotation_matrix(values[3:6])
        axes = [sum(e * r for e, r in zip(frames.end, column)) for column in rotation.T]
        points, point_rows = self._points(values[6:])
        point = points[:, self.index]
        displacement = point - frames.point(values[:3])
        seen = np.stack([(axis * displacement).sum(0) for axis in axes])
        rotation_rows = rotation.T @ left_jacobian(values[3:6])
        tool_rows = np.concatenate(
            [
                np.repeat(-rotation[:, :2, None], len(self.index), 2),
                cross(seen, rotation_rows.T[:, :, None])[:, :2],
            ]
        )
        world = point_rows[:, :, self.index] * self._moves_sample(point_rows)[:, None]
        transverse = np.stack(axes[:2])
        rows = np.concatenate([tool_rows, np.einsum("acn,kcn->kan", transverse, world)])
        for port, delta in deltas.items():
            if port in ("sensor", "target"):
                seen = add_delta(seen, delta)
        spot_rows = np.repeat(np.eye(3)[:, :2, None], len(self.index), 2)
        return Closure(
            seen[:2],
            point,
            lambda moved: -np.einsum("acn,kcn->kan", transverse, moved),
            rows,
            {"sensor": spot_rows, "target": spot_rows},
            to_world=lambda seen: np.einsum("acn,an->cn", transverse, seen),
        )

    def _points(self, values):
        """(3, K) places of the points, root frame, and (P, 3, K) their derivative by `values`."""
        spheres = values[: 4 * self.spheres].reshape(-1, 4)
        points = np.zeros((3, len(self.ids)))
        rows = np.zeros((len(values), 3, len(self.ids)))
        first_row = 4 * self.spheres
        for k, s in enumerate(self.sphere):  # points, not samples: a few dozen
            if s < 0:
                points[:, k] = values[first_row : first_row + 3]
                rows[first_row : first_row + 3, :, k] = np.eye(3)
                first_row += 3
                continue
            tilt = np.array([*values[first_row : first_row + 2], 0.0])
            ray = self.facing[k] @ rotation_matrix(tilt)[:, 2]
            by_tilt = (self.facing[k] @ left_jacobian(tilt))[:, :2]
            points[:, k] = spheres[s, :3] + spheres[s, 3] * ray
            rows[4 * s : 4 * s + 3, :, k], rows[4 * s + 3, :, k] = np.eye(3), ray
            rows[first_row : first_row + 2, :, k] = spheres[s, 3] * np.cross(by_tilt.T, ray)
            first_row += 2
        return points, rows

    def _moves_sample(self, point_rows):
        """(P, n) 1 where a parameter moves the point of a sample."""
        return point_rows.any(1)[:, self.index]

    def oriented(self, frames: Frames) -> "LaserSpot":
        """The same with each bound point's frame turned to where the nominal arm sees it on its sphere."""
        facing = self.facing.copy()
        points = self._start_points(frames)[2]
        for s in range(self.spheres):
            is_on_sphere = self.sphere == s
            facing[is_on_sphere] = _facing(
                points[is_on_sphere] - _sphere_through(points[is_on_sphere])[:3]
            )
        return replace(self, facing=facing)

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """Beam and points by turns, from each axis of the flange; the spheres through the points."""
        origin, rotation, points = self._start_points(frames)
        spheres = [_sphere_through(points[self.sphere == s]) for s in range(self.spheres)]
        places = [
            points[k] if s < 0 else _tilt(self.facing[k].T @ (points[k] - spheres[s][:3]))
            for k, s in enumerate(self.sphere)
        ]
        tool = np.concatenate([pose_values(rotation, origin), *spheres, *places])
        return np.zeros(0), tool

    def _start_points(self, frames):
        """Beam origin (3,), rotation (3, 3) with z along the beam, points (K, 3): the best of three starts."""
        rotations = flange_matrices(frames)
        origins = frames.end_origin.T
        tried = [self._for_direction(rotations, origins, axis) for axis in np.eye(3)]
        return min(tried, key=lambda found: found[3])[:3]

    def _for_direction(self, rotations, origins, direction):
        """Points from beams, then the beam from the points as the flange sees them, and again."""
        origin = np.zeros(3)
        for _ in range(_ROUNDS):
            points = self._nearest_points(origins + rotations @ origin, rotations @ direction)
            seen = np.einsum("nji,nj->ni", rotations, points[self.index] - origins)
            origin = seen.mean(0)
            direction = np.linalg.svd(seen - origin, full_matrices=False)[2][0]
        displacement = seen - origin
        distance = float(
            ((displacement - np.outer(displacement @ direction, direction)) ** 2).sum()
        )
        origin = origin - (origin @ direction) * direction
        rotation, _ = rigid_fit(
            np.stack([np.zeros(3), [0.0, 0, 1]]), np.stack([np.zeros(3), direction])
        )
        return origin, rotation, points, distance

    def _nearest_points(self, origins, directions):
        """(K, 3) points nearest to the beams that pass each."""
        flat = np.eye(3) - np.einsum("ni,nj->nij", directions, directions)
        normal = np.zeros((len(self.ids), 3, 3))
        right = np.zeros((len(self.ids), 3))
        np.add.at(normal, self.index, flat)
        np.add.at(right, self.index, np.einsum("nij,nj->ni", flat, origins))
        return np.einsum("kij,kj->ki", np.linalg.pinv(normal), right)


def _place_on_sphere(k):
    return [(f"point{k}_rx", "rad", 0.1), (f"point{k}_ry", "rad", 0.1)]


def _place_anywhere(k):
    return [(f"point{k}_{axis}", "mm", 100.0) for axis in "xyz"]


def _sphere_through(points):
    """(4,) centre and radius of the sphere nearest to points (K, 3): Coope, J. Optim. Theory Appl. 76 (1993) 381."""
    system = np.column_stack([2 * points, np.ones(len(points))])
    *centre, constant = np.linalg.lstsq(system, (points**2).sum(1), rcond=None)[0]
    radius = np.sqrt(max(constant + np.dot(centre, centre), 1e-6))
    return np.array([*centre, radius])


def _facing(rays):
    """(K, 3, 3) frames whose z axes are the rays (K, 3)."""
    z = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    x = np.cross(np.eye(3)[np.abs(z).argmin(1)], z)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], -1)


def _tilt(ray):
    """(2,) turns about x and y that bring z to the ray (3,)."""
    ray = ray / np.linalg.norm(ray)
    axis = np.array([-ray[1], ray[0]])
    size = np.linalg.norm(axis)
    if size < 1e-12:
        return np.zeros(2)
    return axis / size * np.arctan2(size, ray[2])
