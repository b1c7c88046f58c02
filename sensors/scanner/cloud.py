"""Stripe points of one scan in its frame: that of the camera, or the one in which images of a moving sensor join."""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from sensors.ball.point_errors import plane_error, stripe_error
from sensors.ball.result import BallFit
from sensors.ball.shared import Common
from sensors.scanner.errors import by_rays
from sensors.scanner.model import Scanner
from sensors.scanner.motion import Motion, Seen
from sensors.stripe.surface_bias.light_direction import light_on_ball
from sensors.stripe.surface_bias.surface_line import SurfaceLine, line_on_ball

_GRAZING = 0.1  # cosine of the incidence of sight below which the silhouette cuts the line


@dataclass(frozen=True, eq=False)
class Cloud:
    """n points of a scan: `local` (3, n) mm in the camera frame of their image, `pixels` (2, n), `steps` (n,) of the
    light planes and `image` (n,) from 0; `motion` of the images, None where neither sensor nor object moved."""

    scanner: Scanner
    local: np.ndarray
    pixels: np.ndarray
    steps: np.ndarray
    image: np.ndarray
    motion: Motion | None = None

    def subset(self, chosen: np.ndarray) -> "Cloud":
        """The same of the chosen points."""
        coordinates = {name: getattr(self, name)[..., chosen] for name in ("local", "pixels")}
        return replace(self, **coordinates, steps=self.steps[chosen], image=self.image[chosen])

    @property
    def frame(self) -> str:
        """Name of the frame of `points`."""
        return "camera" if self.motion is None else self.motion.frame

    @cached_property
    def points(self) -> np.ndarray:
        """(3, n) mm in the frame of the scan."""
        return self.local if self.motion is None else self.motion.points(self.local, self.image)

    @cached_property
    def view(self) -> np.ndarray:
        """(3, n) mm from the camera to each point, in the axes of the frame."""
        return self._common_directions(self.local)

    @property
    def stripe(self) -> np.ndarray:
        """(n,) int: points of one number are of one stripe."""
        return self.steps if self.motion is None else self.image

    @cached_property
    def error(self) -> np.ndarray:
        """(3, n) mm by which points move, in the axes of the frame, where the centre of their stripe errs by 1 px."""
        return self._common_directions(self.scanner.by_stripe(self.local, self.steps))

    @property
    def stripe_place(self) -> np.ndarray:
        """(n,) px: place along the stripe."""
        return self.pixels[1 if self.is_across_columns else 0]

    @property
    def is_across_columns(self) -> bool:
        """Whether centres are sought along the rows of the image."""
        return abs(self.scanner.scan[0]) >= abs(self.scanner.scan[1])

    def _common_directions(self, vectors):
        return vectors if self.motion is None else self.motion.directions(vectors, self.image)

    def shared_errors(self) -> dict:
        """Keyword arguments of `fit_ball` that describe the errors which the points share."""
        if self.motion is not None:
            return {"shared": self.motion.own_errors(self.scanner, self.local, self._seen)} | {
                "ordered": True
            }
        place = self.scanner.places(self.steps)
        planes = self.scanner.planes
        covariance = self.scanner.covariance
        if covariance is None:  # the planes count as exact; what a stripe's centres share remains
            covariance = np.zeros((3 * planes.shape[1],) * 2)
        stripe_errors = stripe_error(self.error, place, self.stripe_place)
        shared = plane_error(self.points, planes, place, covariance, stripe_errors)
        if self.scanner.rays is not None:
            shared = replace(shared, common=ray_error(self.scanner, self.points, place))
        if self.scanner.stripe_variance.any():
            shared = shared.with_errors(stripe_errors, self.scanner.stripe_variance)
        return {"shared": shared, "ordered": True}

    def common_covariance(self, centre: np.ndarray, used: np.ndarray) -> np.ndarray:
        """(3, 3) mm^2 of a ball's centre (3,) from errors that all images of a joined scan share; zero of another.

        used (n,) bool: points of the fit.
        """
        if self.motion is None:
            return np.zeros((3, 3))
        on_ball = self.subset(used)
        outward = on_ball.points - centre[:, None]
        outward = outward / np.linalg.norm(outward, axis=0)
        return on_ball.motion.centre_covariance(
            on_ball.scanner, on_ball.local, on_ball._seen, outward
        )

    def common_radius_variance(self, fit: BallFit) -> float:
        """mm^2, variance of a fitted radius from the same errors; zero where neither sensor nor object moves."""
        if self.motion is None:
            return 0.0
        on_ball = self.subset(fit.inliers)
        outward = on_ball.points - fit.centre[:, None]
        outward = outward / np.linalg.norm(outward, axis=0)
        return on_ball.motion.radius_variance(
            on_ball.scanner, on_ball.local, on_ball._seen, outward
        )

    def stated_variance(self, outward: np.ndarray) -> np.ndarray | None:
        """(n,) mm^2 by which points scatter along unit normals (3, n) by the stated error of each image's own pose;
        None where nothing moved."""
        if self.motion is None:
            return None
        normal_moves = np.einsum(
            "in,kin->kn", outward, self.motion.own_moves(self.points, self.image)
        )
        return np.einsum("kn,kl,ln->n", normal_moves, self.motion.own_covariance, normal_moves)

    @property
    def _seen(self) -> Seen:
        return Seen(self.pixels, self.steps, self.image)

    def surface_line(self, ball: np.ndarray, line: np.ndarray | None = None) -> SurfaceLine:
        """Shape of the stripes on a ball (4,), centre and radius in mm.

        line (3, n): width of the lines (px), a number that is not used here, and their peak (grey values): they say
        where the light of a single light plane comes from.
        """
        light = self.scanner.light
        if light is None and line is not None and self.scanner.planes.shape[1] == 1:
            light = self._light_on(ball, line)
        return self._bend(ball, light)

    def width_ratios(self, width: np.ndarray, balls: np.ndarray) -> np.ndarray:
        """(m, n) ln of the squared width (n,) px of lines over that expected on balls (m, 4), centre and radius in mm.

        nan where the surface turns away from the camera. Of a scan in which nothing moves, by a scanner whose line is
        known.
        """
        ratios = np.full((len(balls), self.points.shape[1]), np.nan)
        for row, ball in zip(ratios, balls):
            bend = self._bend(ball, None).on_light_plane
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.log(width**2 / bend.width_square(self.scanner.line))
            row[:] = np.where(bend.facing > _GRAZING, ratio, np.nan)
        return ratios

    def _light_on(self, ball: np.ndarray, line: np.ndarray) -> np.ndarray | None:
        """(3,) mm, see `light_on_ball`; the light that a line holds is its peak times its width."""
        outward = np.empty_like(self.local)
        for image in np.unique(self.image):
            is_of_image = self.image == image
            centre = ball[:3] if self.motion is None else self.motion.local(ball[:3], image)
            outward[:, is_of_image] = (self.local[:, is_of_image] - centre[:, None]) / ball[3]
        flux = line[2] * line[0] * np.abs(self._bend(ball, None).slope)
        return light_on_ball(self.scanner.planes[:, 0], outward, flux)

    def _bend(self, ball: np.ndarray, light: np.ndarray | None) -> SurfaceLine:
        if self.motion is None:
            return self._bend_at(ball[:3], ball[3], light)
        order = np.argsort(self.image, kind="stable")
        images, first = np.unique(self.image[order], return_index=True)
        surface_lines = []
        for image, rows in zip(images, np.split(order, first[1:])):
            centre = self.motion.local(ball[:3], image)
            surface_lines.append(self.subset(rows)._bend_at(centre, ball[3], light))
        original_order = np.argsort(order)
        names = [field.name for field in fields(SurfaceLine)]
        return SurfaceLine(
            *(
                np.concatenate([getattr(part, n) for part in surface_lines])[original_order]
                for n in names
            )
        )

    def _bend_at(self, centre: np.ndarray, radius: float, light: np.ndarray | None) -> SurfaceLine:
        scanner = self.scanner
        planes = scanner.planes[:, scanner.places(self.steps)]
        return line_on_ball(
            scanner.camera, centre, radius, self.pixels, planes, scanner.scan, light
        )


def ray_error(scanner: Scanner, points: np.ndarray, place: np.ndarray) -> Common:
    """Errors of points (3, n) mm in the camera frame, on the planes of columns `place` (n,), shared through the camera.

    In the frame that fits the scanner's points best; the errors of the planes are correlated with it, since boards that
    the camera misplaces place the planes.
    """
    count = len(scanner.rays)
    by_plane = scanner.rays[:, count:].reshape(count, -1, 3)
    moves = by_rays(scanner.camera, points, scanner.planes[:, place])
    return Common(moves, scanner.rays[:, :count], by_plane)
