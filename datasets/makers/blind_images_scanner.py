"""The true scanner of a blind image recording: lens, laser with a planar or conical fan, and rotating mirror.

Independent geometry in millimetres and radians, camera frame (x right, y down, z forward); it
shares no code and no law with the workbench. Every effect is modelled at its physical origin: a cone
instead of a plane, a mirror face that tilts during its rotation, a lens that is not rotationally symmetric.
"""

from dataclasses import dataclass, field

import numpy as np

WIDTH, HEIGHT = 640, 512
_COARSE = 8  # px between places at which the lens is inverted; a spline does the rest


@dataclass(frozen=True)
class Lens:
    """Focal lengths and centre (px), Brown's k1 k2 p1 p2; `glass` (6,) px at the image's corner: cubes across and
    down, each way, and a trefoil (two), which no centred nor decentred lens of round elements makes."""

    focal: tuple[float, float]
    centre: tuple[float, float]
    brown: tuple[float, float, float, float]
    glass: np.ndarray = field(default_factory=lambda: np.zeros(6))

    def project(self, flat: np.ndarray) -> np.ndarray:
        """(2, ...) px of x/z and y/z."""
        x, y = flat
        k1, k2, p1, p2 = self.brown
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2 * r2
        seen_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        seen_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        u = self.focal[0] * seen_x + self.centre[0]
        v = self.focal[1] * seen_y + self.centre[1]
        shift_u, shift_v = self._glass_shift(np.array(u), np.array(v))
        return np.stack([u + shift_u, v + shift_v])

    def _glass_shift(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shift in px by the glass before the lens: polynomials of the place in the image."""
        a = (u - WIDTH / 2) / (WIDTH / 2)
        b = (v - HEIGHT / 2) / (WIDTH / 2)
        g = self.glass
        hyperbola = a * a - b * b
        saddle = 2 * a * b
        shift_u = g[0] * a**3 + g[1] * a * b * b + g[4] * hyperbola + g[5] * saddle
        shift_v = g[2] * b**3 + g[3] * b * a * a - g[4] * saddle + g[5] * hyperbola
        return shift_u, shift_v

    def rays(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(3, V, U) unit rays through every pair of columns u (U,) and rows v (V,) px, both ascending."""
        from scipy.interpolate import RectBivariateSpline

        rough_u = np.arange(u[0] - 2 * _COARSE, u[-1] + 3 * _COARSE, _COARSE)
        rough_v = np.arange(v[0] - 2 * _COARSE, v[-1] + 3 * _COARSE, _COARSE)
        wanted = np.stack(np.meshgrid(rough_u, rough_v))
        flat = (wanted - np.reshape(self.centre, (2, 1, 1))) / np.reshape(self.focal, (2, 1, 1))
        for _ in range(25):
            flat = flat + (wanted - self.project(flat)) / np.reshape(self.focal, (2, 1, 1))
        fine = [RectBivariateSpline(rough_v, rough_u, plane)(v, u) for plane in flat]
        ray = np.stack([*fine, np.ones_like(fine[0])])
        return ray / np.sqrt((ray**2).sum(0))


@dataclass(frozen=True)
class Light:
    """A laser line, deflected by a rotating mirror.

    The laser stands at `source` (3,) and fans out across `normal` (3,); with a `cone` angle (rad) the fan is
    a cone: every ray of it leaves at that angle from the plane. The mirror turns about `axis` through
    `pivot`; at angle 0 its face's normal is `face`, and it stands `offset` from the axis. `wobble` (amplitude rad,
    run-out mm, turns, phase): the face leans along the axis and steps back and forth as it turns. `encoder`
    (amplitude rad, order, phase): the disc on the axis is off centre. `late` s after the angle was read the image is
    taken. `width` mm, 1 sigma.
    """

    source: np.ndarray
    normal: np.ndarray
    axis: np.ndarray
    pivot: np.ndarray
    face: np.ndarray
    offset: float
    width: float = 0.15
    cone: float = 0.0
    wobble: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 0.0)
    encoder: tuple[float, float, float] = (0.0, 1.0, 0.0)
    late: float = 0.0

    def truly(self, commanded: float, speed: float) -> float:
        """Mirror angle (rad) when the image is taken; speed rad/s."""
        amplitude, order, phase = self.encoder
        return (
            commanded + np.arcsin(amplitude * np.sin(order * commanded + phase)) + speed * self.late
        )

    def thrown(self, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Source and normal of the fan as the mirror shows them at its true angle."""
        lean, step, turns, phase = self.wobble
        wave = np.cos(turns * angle + phase)
        # the face is rotated about the axis, then leans towards it with the wave
        perpendicular = np.cross(self.axis, self.face)
        face = self.face * np.cos(angle) + perpendicular * np.sin(angle)
        face = face * np.cos(lean * wave) + self.axis * np.sin(lean * wave)
        # mirror images of a point and of a direction
        depth = face @ (self.source - self.pivot) - self.offset - step * wave
        source = self.source - 2 * depth * face
        normal = self.normal - 2 * (self.normal @ face) * face
        return source, normal

    def plane_distance(self, points: np.ndarray, angle: float) -> np.ndarray:
        """(n,) mm from points (3, n) to the light."""
        source, normal = self.thrown(angle)
        out = points - source[:, None]
        return normal @ out - np.sin(self.cone) * np.sqrt((out**2).sum(0))


def light_of(rng: np.random.Generator) -> Light:
    """A mirror next to the camera that sweeps the field at about 125 mm, with random lengths."""
    lateral, reach = rng.uniform(64, 74), rng.uniform(120, 130)
    pivot = np.array([lateral, rng.uniform(-3, 3), rng.uniform(-4, 4)])
    to_field = np.array([-lateral, 0.0, reach]) / np.hypot(lateral, reach)
    coming = np.array([-1.0, 0.0, 0.0])
    tilt = rng.uniform(-0.01, 0.01, 2)
    axis = np.array([tilt[0], 1.0, tilt[1]])
    axis = axis / np.linalg.norm(axis)
    face = to_field - coming
    face = face - axis * (axis @ face)
    normal = np.array([rng.uniform(-0.004, 0.004), rng.uniform(-0.004, 0.004), 1.0])
    source = pivot - coming * rng.uniform(55, 70)
    normal, face = normal / np.linalg.norm(normal), face / np.linalg.norm(face)
    return Light(source, normal, axis, pivot, face, rng.uniform(0.5, 3.0))


def lens_of(rng: np.random.Generator) -> Lens:
    """A camera of about 60 degrees."""
    focal = rng.uniform(540, 600)
    middle = (WIDTH / 2 - 0.5 + rng.uniform(-8, 8), HEIGHT / 2 - 0.5 + rng.uniform(-8, 8))
    brown = (rng.uniform(-0.12, -0.04), rng.uniform(0.0, 0.05), *rng.uniform(-6e-4, 6e-4, 2))
    return Lens((focal, focal * rng.uniform(0.997, 1.003)), middle, brown)
