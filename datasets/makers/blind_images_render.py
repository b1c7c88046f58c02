"""A small ray tracer for blind image recordings: boards and balls, lamp, laser stripe, image noise."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter

from datasets.makers.blind_images_scanner import HEIGHT, WIDTH, Lens, Light

_SUBPIXELS = 3  # rays across a pixel
_FULL, _READ = 9_000.0, 10.0  # electrons
_BLACK = 3.0  # grey values of no light
_BLUR = 0.7  # px
_REACH = 4.5  # sigmas of the light beyond which it is dark
# Laguerre: exponential depths at which light is scattered back
_DEPTHS, _SHARES = np.polynomial.laguerre.laggauss(5)


@dataclass(frozen=True)
class Board:
    """A chessboard of inner corners `columns` x `rows`, `square` mm, at rotation (3, 3) and place (3,) in the camera
    frame. `bend` (1/mm) curvature along the direction `bend_axis` (rad) on the board, `second_bend` (1/mm) at right
    angles."""

    columns: int
    rows: int
    square: float
    rotation: np.ndarray
    place: np.ndarray
    bend: float = 0.0
    second_bend: float = 0.0
    bend_axis: float = 0.0

    def height(self, x, y):
        """mm of the surface above the flat board: an arc each way, from the middle."""
        a, b = x - (self.columns - 1) * self.square / 2, y - (self.rows - 1) * self.square / 2
        c, s = np.cos(self.bend_axis), np.sin(self.bend_axis)
        first, second = c * a + s * b, c * b - s * a
        return _sag(first, self.bend) + _sag(second, self.second_bend)

    def meet(self, rays):
        """Points (3, n) mm where rays (3, n) meet the board, nan outside it, and the albedo (n,) there."""
        local, eye = self.rotation.T @ rays, -self.rotation.T @ self.place
        height, flat = 0.0, None
        for _ in range(4 if self.bend or self.second_bend else 1):
            length = (height - eye[2]) / local[2]
            flat = eye[:2, None] + local[:2] * length
            height = self.height(*flat)
        x, y = flat / self.square
        is_on_board = (
            (x > -2) & (x < self.columns + 1) & (y > -2) & (y < self.rows + 1) & (length > 0)
        )
        printed = (x > -1) & (x < self.columns) & (y > -1) & (y < self.rows)
        dark = ((np.floor(x) + np.floor(y)) % 2 == 0) & printed
        return np.where(is_on_board, rays * length, np.nan), np.where(dark, 0.22, 0.85)

    def normals(self, points):
        side = -np.sign(self.rotation[:, 2] @ self.place)
        return np.broadcast_to((side * self.rotation[:, 2])[:, None], points.shape)


def _sag(place, curvature):
    """mm, of an arc."""
    if not curvature:
        return 0.0 * place
    return (1 - np.sqrt(1 - (curvature * place) ** 2)) / curvature


@dataclass(frozen=True)
class Balls:
    """Balls: centres (3, b) and radii (b,) mm in the camera frame; `depth` mm that light goes into them on average."""

    centres: np.ndarray
    radii: np.ndarray
    depth: float = 0.0

    def meet(self, rays):
        """Points (3, n) mm where rays (3, n) meet the nearest ball, nan outside all balls, and the albedo (n,)."""
        nearest = np.full(rays.shape[1], np.inf)
        for centre, radius in zip(self.centres.T, self.radii):
            axial = centre @ rays
            gap = ((rays * axial - centre[:, None]) ** 2).sum(0)
            with np.errstate(invalid="ignore"):
                length = axial - np.sqrt(radius**2 - gap)
            nearest = np.fmin(nearest, length)
        return np.where(
            np.isfinite(nearest), rays * np.where(np.isfinite(nearest), nearest, 0), np.nan
        ), np.full(rays.shape[1], 0.8)

    def normals(self, points):
        from_centre = points[:, None] - self.centres[:, :, None]
        distance = np.sqrt((from_centre**2).sum(0))
        nearest = np.argmin(np.abs(distance - self.radii[:, None]), axis=0)
        n = np.arange(points.shape[1])
        return from_centre[:, nearest, n] / distance[nearest, n]


@dataclass(frozen=True)
class Camera:
    """The lens, with a ray for every part of every pixel."""

    lens: Lens

    @cached_property
    def rays(self) -> np.ndarray:
        """(3, H W, parts) unit rays."""
        step = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
        u, v = (np.add.outer(np.arange(size), step).ravel() for size in (WIDTH, HEIGHT))
        made = self.lens.rays(u, v).reshape(3, HEIGHT, _SUBPIXELS, WIDTH, _SUBPIXELS)
        return np.ascontiguousarray(made.transpose(0, 1, 3, 2, 4)).reshape(
            3, HEIGHT * WIDTH, _SUBPIXELS**2
        )


@dataclass(frozen=True)
class Scene:
    """Surface in every part of every pixel of a static scene: points (3, N), normals (3, N), albedo (N,); N = parts x
    those pixels (P,) that see anything."""

    thing: Board | Balls
    pixels: np.ndarray
    rays: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray

    @classmethod
    def of(cls, camera: Camera, thing) -> "Scene":
        """A thing before the camera."""
        rays = camera.rays.reshape(3, -1)
        points, albedo = thing.meet(rays)
        seen = np.isfinite(points[0]).reshape(-1, _SUBPIXELS**2).any(1)
        subpixels = np.repeat(seen, _SUBPIXELS**2)
        points = points[:, subpixels]
        return cls(
            thing,
            np.flatnonzero(seen),
            rays[:, subpixels],
            points,
            thing.normals(points),
            albedo[subpixels],
        )

    def image(self, bright: np.ndarray, rows=None) -> np.ndarray:
        """(H, W) means over the parts of each pixel of `bright` (N,), or of those of some pixels (rows of `pixels`)."""
        flat_image = np.zeros(HEIGHT * WIDTH)
        pixels = self.pixels if rows is None else self.pixels[rows]
        flat_image[pixels] = np.nan_to_num(bright).reshape(-1, _SUBPIXELS**2).mean(1)
        return flat_image.reshape(HEIGHT, WIDTH)

    def lamp(self) -> np.ndarray:
        """(H, W) share of the full well from a lamp at the camera."""
        facing = np.maximum(-(self.rays * self.normals).sum(0), 0)
        light = self.image(self.albedo * facing)
        light[light == 0] = 0.05
        return light

    def stripe(self, light: Light, angle: float) -> np.ndarray:
        """(H, W) share of the full well from the laser at a true mirror angle (rad)."""
        middle = self.points.reshape(3, -1, _SUBPIXELS**2)[:, :, _SUBPIXELS**2 // 2]
        with np.errstate(invalid="ignore"):
            is_dark = (
                np.abs(light.plane_distance(middle, angle))
                < _REACH * light.width + 2 * self._reach() + 0.5
            )
        rows = np.flatnonzero(is_dark | np.isnan(middle[0]))
        part = (rows[:, None] * _SUBPIXELS**2 + np.arange(_SUBPIXELS**2)).ravel()
        points, normals, rays = self.points[:, part], self.normals[:, part], self.rays[:, part]
        source, _ = light.thrown(angle)
        coming = points - source[:, None]
        coming = coming / np.sqrt((coming**2).sum(0))
        facing = np.maximum(-(coming * normals).sum(0), 0)
        shape = self._profile(light, angle, points, normals, rays)
        return self.image(self.albedo[part] * facing * shape, rows)

    def _reach(self):
        return getattr(self.thing, "depth", 0.0)

    def _profile(self, light, angle, points, normals, rays):
        """(n,) of the stripe's light: at the surface, or of a glow that falls off below it."""
        depth = self._reach()
        if not depth:
            return np.exp(-0.5 * (light.plane_distance(points, angle) / light.width) ** 2)
        # what has diffused falls off with the depth below the surface, however it came in; a pixel sees the glow
        # of every depth that its ray goes through, in the light plane's light there
        further = rays / np.maximum(-(rays * normals).sum(0), 0.1)
        total = np.zeros(points.shape[1])
        for way, share in zip(_DEPTHS, _SHARES):
            glow_points = points + depth * way * further
            total += share * np.exp(
                -0.5 * (light.plane_distance(glow_points, angle) / light.width) ** 2
            )
        return total


def blurred(light: np.ndarray) -> np.ndarray:
    """The light (H, W) as the lens spreads it."""
    return gaussian_filter(light, _BLUR)


def laser(stripe: np.ndarray, rng: np.random.Generator, contrast: float = 0.1) -> np.ndarray:
    """(H, W) the stripe's light with its grains, as the lens spreads it; only where there is some is anything done."""
    lit_pixels = np.argwhere(stripe > 0)
    made = np.zeros(stripe.shape)
    if not len(lit_pixels):
        return made
    low, high = np.maximum(lit_pixels.min(0) - 6, 0), lit_pixels.max(0) + 7
    box = slice(low[0], high[0]), slice(low[1], high[1])
    grain = gaussian_filter(rng.standard_normal(stripe[box].shape), 0.8)
    grains = np.exp(contrast * grain / grain.std() - contrast**2 / 2)
    made[box] = gaussian_filter(stripe[box] * grains, _BLUR)
    return made


def developed(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(H, W) uint8 of light as shares of the full well: photons and readout are normal, thousands as they are."""
    electrons = np.maximum(light, 0) * _FULL
    noise = rng.standard_normal(light.shape, np.float32) * np.sqrt(electrons + _READ**2)
    return np.clip(np.round(_BLACK + (electrons + noise) * (255 - _BLACK) / _FULL), 0, 255).astype(
        np.uint8
    )
