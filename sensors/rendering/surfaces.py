"""Surfaces before the scanner: boards, balls and meshes, and their intersections with rays, to the nanometre.

Everything is in the camera frame, mm. A surface answers three questions: how far along rays from
the camera (`meet`), what it is like at points of it (`normals`, `albedo`), and whether it stands
between points and a light (`blocks`).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sensors.camera.model import Camera
from sensors.rendering.patterns import Pattern
from sensors.rendering.ports import Moment
from workbench.core.rigid import rotation_matrix

_CLEAR = 1e-3  # mm: what is nearer than this to a point is the surface that the point lies on
_ROUNDS = (
    3  # each leaves a thousandth of the last one's gap on a board that is warped by a thousandth
)


@dataclass(frozen=True)
class BoardSurface:
    """A printed board at `pose` (6,) T_camera_board, warped by what acts on the port `target`."""

    pattern: Pattern
    pose: np.ndarray
    camera: Camera
    moment: Moment = Moment()
    number = 0

    @cached_property
    def rotation(self) -> np.ndarray:
        return rotation_matrix(self.pose[3:])

    def meet(self, rays: np.ndarray) -> np.ndarray:
        """(n,) mm along unit rays (3, n) from the camera; nan beyond the board's edge."""
        local_rays = self.rotation.T @ rays
        start = -self.rotation.T @ self.pose[:3]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat, distance = _at_height(local_rays, start, 0.0)
            moved = np.zeros((3, 1))
            for _ in range(_ROUNDS if self._warped else 0):
                moved = self._moved(flat - moved[:2])
                flat, distance = _at_height(local_rays, start, moved[2])
            is_on_board = self.pattern.contains(*(flat - moved[:2])) & (distance > 0)
        return np.where(is_on_board, distance, np.nan)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(3, n) unit normal, towards the camera."""
        normal = self.rotation[:, 2] * -np.sign(self.rotation[:, 2] @ self.pose[:3])
        return np.broadcast_to(normal[:, None], points.shape)

    def albedo(self, points: np.ndarray, width: np.ndarray | float) -> np.ndarray:
        """(n,) reflectance 0 to 1, averaged over `width` mm."""
        flat = (self.rotation.T @ (points - self.pose[:3, None]))[:2]
        return self.pattern.albedo(*self._nominal(flat), width)

    def blocks(self, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(n,) bool: nothing hides behind a board in these scenes."""
        return np.zeros(points.shape[1], bool)

    @property
    def _warped(self) -> bool:
        return self.moment.causes.acts_on("target")

    def _share(self, flat):
        return (flat - self.pattern.middle[:, None]) / self.pattern.half_diagonal

    def _moved(self, flat):
        """(3, n) displacement of the board's points of nominal place (2, n)."""
        target = np.vstack([flat, np.zeros(flat.shape[1])])
        state = self.moment.state(
            self.camera, flat.shape[1], board=self._share(flat), target=target
        )
        return self.moment.causes.delta("target", state)

    def _nominal(self, flat):
        """Nominal place of true places (2, n): the displacement is that of the place sought."""
        sought = flat
        for _ in range(2 if self._warped else 0):
            displacement = self._moved(sought)[:2]
            if not displacement.any():
                break
            sought = flat - displacement
        return sought


def _at_height(local_rays, start, height):
    """(2, n) places at z = height of rays (3, n) from `start` (3,), all in the board's frame, and how far along."""
    distance = (height - start[2]) / local_rays[2]
    return start[:2, None] + local_rays[:2] * distance, distance


@dataclass(frozen=True)
class Gloss:
    """Specular reflection: `share` of a white surface's light at the middle of the highlight, Blinn's `exponent`."""

    share: float = 0.0
    exponent: float = 50.0

    def reflected(
        self, to_source: np.ndarray, to_camera: np.ndarray, normals: np.ndarray
    ) -> np.ndarray:
        """(n,) of light that comes from unit directions `to_source` (3, n) and leaves along `to_camera` (3, n).

        Blinn, SIGGRAPH 1977: the cosine between the normal and the half vector, to a power.
        """
        half = to_source + to_camera
        half /= np.maximum(np.linalg.norm(half, axis=0), 1e-300)
        return self.share * np.maximum((half * normals).sum(0), 0) ** self.exponent


MATT = Gloss()


@dataclass(frozen=True)
class BallSurface:
    """A ball: `centre` (3,) and `radius` as they truly are; `number` as on the certificate, from 1."""

    centre: np.ndarray
    radius: float
    number: int
    white: float = 0.8
    gloss: Gloss = MATT

    def meet(self, rays: np.ndarray) -> np.ndarray:
        """(n,) mm along unit rays (3, n) from the camera."""
        entry, _ = self._cut(np.zeros((3, 1)), rays)
        return np.where(entry > 0, entry, np.nan)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(3, n) outward unit normals."""
        out = points - self.centre[:, None]
        return out / np.linalg.norm(out, axis=0)

    def albedo(self, points: np.ndarray, width: np.ndarray | float) -> np.ndarray:
        return np.full(points.shape[1], self.white)

    def blocks(self, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(n,) bool: the ball stands between points (3, n) and the way along unit vectors (3, n)."""
        with np.errstate(invalid="ignore"):
            return self._cut(points, direction)[1] > _CLEAR

    def _cut(self, start, rays):
        """(n,) distances to where rays enter and leave; nan where they miss.

        From the foot of the perpendicular: the form that does not lose digits for a distant ball
        (Haines et al., Ray Tracing Gems (2019), ch. 7).
        """
        gap = self.centre[:, None] - start
        axial = (gap * rays).sum(0)
        perpendicular = gap - rays * axial
        with np.errstate(invalid="ignore"):
            half = np.sqrt(self.radius**2 - (perpendicular**2).sum(0))
        return axial - half, axial + half


@dataclass(frozen=True)
class MeshSurface:
    """Triangles: `vertices` (v, 3) mm in the camera frame and `triangles` (t, 3) of their numbers."""

    vertices: np.ndarray
    triangles: np.ndarray
    white: float = 0.8
    number = 0

    @cached_property
    def _scene(self):
        import open3d as o3d

        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(self.vertices.astype(np.float32), self.triangles.astype(np.uint32))
        return scene

    @cached_property
    def _faces(self) -> tuple[np.ndarray, np.ndarray]:
        """(3, t) unit normals and (t,) offsets of the triangles' planes, in double precision."""
        corners = self.vertices[self.triangles].astype(float)
        a, b, c = corners.transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return normals.T, -(normals * a).sum(1)

    def meet(self, rays: np.ndarray) -> np.ndarray:
        """(n,) mm along unit rays (3, n): the triangle from Open3D's single precision, the cut from double."""
        hit = self._cast(np.zeros((3, 1)), rays)
        is_hit = hit >= 0
        normals, offsets = self._faces
        face = np.where(is_hit, hit, 0)
        distance = -offsets[face] / (normals[:, face] * rays).sum(0)
        return np.where(is_hit, distance, np.nan)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(3, n) unit normals of the triangles that are seen at these points, towards the camera."""
        rays = points / np.linalg.norm(points, axis=0)
        face = np.maximum(self._cast(np.zeros((3, 1)), rays), 0)
        normals = self._faces[0][:, face]
        return normals * -np.sign((normals * rays).sum(0))

    def albedo(self, points: np.ndarray, width: np.ndarray | float) -> np.ndarray:
        return np.full(points.shape[1], self.white)

    def blocks(self, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(n,) bool: some triangle stands between points (3, n) and the way along unit vectors (3, n)."""
        return self._cast(points + 10 * _CLEAR * direction, direction) >= 0

    def _cast(self, start, rays):
        """(n,) number of the first triangle, -1 where there is none."""
        ray_table = np.concatenate([np.broadcast_to(start, rays.shape), rays]).T.astype(np.float32)
        found = (
            self._scene.cast_rays(np.nan_to_num(ray_table))["primitive_ids"]
            .numpy()
            .astype(np.int64)
        )
        return np.where(found == self._scene.INVALID_ID, -1, found)


Surface = BoardSurface | BallSurface | MeshSurface


def true_balls(
    centres: np.ndarray, radii: np.ndarray, camera: Camera, moment: Moment
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (3, b) and radii (b,) with what acts on the balls of a certificate, artefact frame.

    An effect on the port `target` moves a surface's point; moved alike on both sides it is the
    centre that moves, moved oppositely it is the radius that grows.
    """
    side = np.tile([[0.0], [0.0], [1.0]], centres.shape[1])
    near_side = _target_shift(centres, side, camera, moment)
    far_side = _target_shift(centres, -side, camera, moment)
    return centres + (near_side + far_side) / 2, radii + (near_side - far_side)[2] / 2


def _target_shift(centres, normals, camera: Camera, moment: Moment) -> np.ndarray:
    """(3, b) mm by which the effects move the balls' surface where it has these normals (3, b)."""
    n = centres.shape[1]
    number = np.arange(1, n + 1)
    state = moment.state(camera, n, normals=normals, target=centres, ball=number)
    return moment.causes.delta("target", state)
