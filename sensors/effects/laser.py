"""Effects on the light: the shape of the light plane, and the mirror that turns it."""

from typing import Annotated

import numpy as np
from pydantic import Field

from sensors.effects.covariates import Vector
from sensors.state import stripe_direction
from workbench.core.covariates import known
from workbench.core.effect import Effect, Grid, Variant

_POWERS = tuple((order - j, j) for order in (2, 3) for j in range(order + 1))
_LOW_ORDERS = range(1, 9)
_HIGHEST_ORDER = 400


class PlaneBow(Effect):
    """The light plane is not flat: it bends along the stripe.

    Without `apex_mm` by one curvature everywhere. With it, a place on the mirror's axis in the camera frame, the light
    fans out in a shallow cone that misses the plane by an angle. The laser stands in front of the mirror, so that the
    apex of the cone, its image, is farther away than the axis and may be displaced along it. Both are parameters,
    times the angle, since without a cone neither can be known; the distance to first order. `axis`: unit vector of the
    mirror's axis in the camera frame, along which s is measured; without it, across the optical axis in each plane.

    Without a mirror the apex is unknown. With `depth_mm` the plane is a surface of the third order about this depth:
    a polynomial in s and in the place t across it, of which the plane itself is the first order.
    """

    effect = "plane-bow"
    port = "plane"
    places = ("laser",)
    equation = (
        "f = n.X + b + k s^2, or f = n.X + b + (a s^2 - 2 h s + q) / (2 r) - d s^2 / (2 r^2); "
        "s, r = distance from the apex along the stripe and across it; or n.X + b + sum c_ij s^i t^j, i + j = 2, 3"
    )
    source = (
        "second order of a cone about its tangent plane, first order in the distance of its apex"
    )

    def __init__(
        self,
        where: str,
        apex_mm: Vector | None = None,
        axis: Vector | None = None,
        depth_mm: Annotated[float, Field(gt=0)] | None = None,
    ):
        super().__init__(where)
        self.apex_mm, self.axis, self.depth_mm = apex_mm, axis, depth_mm
        self.apex = None if apex_mm is None else np.array(apex_mm, float)[:, None]
        self.components = (4,) if apex_mm is None and depth_mm is None else (3,)

    @classmethod
    def candidates(cls, chain):
        """Of one curvature, and of a cone where the mirror is known, else of the third order."""
        for where in chain.places("laser"):
            yield Variant(cls(where), "the same all along", 0.5)
            if chain.light is not None:
                bow = cls(where, list(chain.light), list(chain.light_axis))
                yield Variant(bow, "fanning out from the laser", 0.5)
            elif chain.depth_mm > 0:
                yield Variant(cls(where, depth_mm=chain.depth_mm), "of the third order", 0.5)

    def table(self, chain):
        if self.depth_mm is not None:
            return tuple(
                self.parameter(
                    f"s{i}t{j}",
                    f"1/mm{'' if i + j == 2 else '^2'}",
                    5e-5 / self.depth_mm ** (i + j - 2),
                    f"the light plane's s^{i} t^{j}",
                )
                for i, j in _POWERS
            )
        if self.apex is None:
            return (self.parameter("curvature", "1/mm", 5e-5, "the light plane's curvature"),)
        return (
            self.parameter("angle", "rad", 0.01, "the light cone's angle"),
            self.parameter("angle_distance", "rad mm", 0.5, "the angle times the apex' distance"),
            self.parameter("angle_shift", "rad mm", 0.2, "the angle times the apex' displacement"),
            self.parameter(
                "angle_shift_square", "rad mm^2", 5.0, "the angle times its displacement's square"
            ),
        )

    def basis(self, state):
        if self.depth_mm is not None:
            place = state.points - np.array([[0.0], [0.0], [self.depth_mm]])
            direction = stripe_direction(state.planes)
            stripe_place = (direction * place).sum(0)
            fan_place = (np.cross(state.planes[:3], direction, axis=0) * place).sum(0)
            return known(np.stack([stripe_place**i * fan_place**j for i, j in _POWERS]))[:, None]
        if self.apex is None:
            return np.ones((1, 1, state.n))
        place = state.points - self.apex
        direction = stripe_direction(state.planes)
        if self.axis is not None:
            direction = np.where(np.isnan(direction), np.nan, np.array(self.axis, float)[:, None])
        stripe_place = (direction * place).sum(0)
        fan_place = np.sqrt(np.maximum((place**2).sum(0) - stripe_place**2, 1.0))
        slope = stripe_place / fan_place
        seen = np.where(np.isnan(slope), np.nan, 0.5 / fan_place)
        return known(np.stack([stripe_place * slope / 2, -(slope**2) / 2, -slope, seen]))[:, None]


class GhostLine(Effect):
    """A second, weaker line is parallel to the laser line, from a double reflection in a cover glass or a mirror.

    The copy is `offset_mm` from the line along the normal of the light plane, and is inclined by `angle_deg` to it. It
    displaces the centre of a Gaussian of 1 sigma `width_mm` that is fitted to both. The renderer draws the copy itself.
    """

    effect = "ghost-line"
    port = "plane"
    places = ("laser",)
    components = (3,)
    nonnegative = 1
    equation = (
        "db = -share * d exp(-d^2 / (4 w^2)), d = offset + s tan(angle), w = 1 sigma of the line"
    )
    source = (
        "least-squares centre of a line with a weak neighbour, first order in its share; ghost images of plane plates: "
        "Hecht, Optics, 5th ed., sec. 4.6"
    )

    def __init__(
        self,
        where: str,
        offset_mm: float = 0.3,
        angle_deg: Annotated[float, Field(gt=-45, lt=45)] = 0.0,
        width_mm: Annotated[float, Field(gt=0)] = 0.2,
    ):
        super().__init__(where)
        self.offset_mm, self.angle_deg, self.width_mm = offset_mm, angle_deg, width_mm

    @classmethod
    def candidates(cls, chain):
        """None: light planes absorb a constant displacement; the profile of the line shows it."""
        return ()

    def table(self, chain):
        return (self.parameter("share", "1", 0.1, "the brightness of the second line"),)

    def distance(self, stripe_place: np.ndarray) -> np.ndarray:
        """(n,) mm from the line to its copy at places `stripe_place` (n,) mm the stripe."""
        return self.offset_mm + np.tan(np.deg2rad(self.angle_deg)) * stripe_place

    def basis(self, state):
        distance = self.distance(known((stripe_direction(state.planes) * state.points).sum(0)))
        displaced = -distance * np.exp(-(distance**2) / (4 * self.width_mm**2))
        return np.where(np.isnan(state.planes[3]), 0.0, displaced)[None, None]


class MirrorWobble(Effect):
    """The mirror's axis nutates and runs out, at one and two cycles per revolution.

    The tilt turns the light plane's normal along the stripe (about the place where the stripe
    crosses the optical axis' plane), the run-out shifts the plane along its normal.
    """

    effect = "mirror-wobble"
    port = "plane"
    places = ("mirror",)
    components = (0, 1, 2, 3)
    equation = "dn = (A cos k phi + B sin k phi) e_stripe, db = C cos k phi + D sin k phi, k = 1, 2"
    source = "tilt and radial error motion of an axis of rotation: ISO 230-7"

    def table(self, chain):
        return tuple(
            self.parameter(
                f"{name}_{wave}{k}",
                unit,
                size,
                f"the mirror's {name}, {wave} of {k} cycles per revolution",
            )
            for k in (1, 2)
            for wave in ("cos", "sin")
            for name, unit, size in (("tilt", "rad", 1e-4), ("shift", "mm", 0.01))
        )

    def basis(self, state):
        stripe_axis = known(stripe_direction(state.planes))
        none = np.zeros(state.n)
        is_lit = (~np.isnan(state.planes[3])).astype(float)
        moves = np.stack([np.stack([*stripe_axis, none]), np.stack([none, none, none, is_lit])])
        waves = known(
            np.stack([wave(k * state.mirror) for k in (1, 2) for wave in (np.cos, np.sin)])
        )
        return (waves[:, None, None] * moves).reshape(8, 4, state.n)


class MirrorEncoderHarmonic(Effect):
    """The mirror's encoder errs periodically with its angle."""

    effect = "mirror-encoder-harmonic"
    port = "mirror"
    places = ("mirror",)
    equation = "dphi = A cos(n phi) + B sin(n phi)"
    source = "Fourier series of an encoder's error, as of a joint: Ye et al., Sensors 24, 2559 (2024), eq. 16-17"

    def __init__(self, where: str, order: Annotated[int, Field(ge=1)] = 1):
        super().__init__(where)
        self.order = order

    @property
    def reads(self):
        return ("mirror",)

    @classmethod
    def candidates(cls, chain):
        """The orders 1 to 8."""
        for where in chain.places("mirror"):
            for order in _LOW_ORDERS:
                yield Variant(cls(where, order), f"order {order}", 1 / len(_LOW_ORDERS))

    @classmethod
    def grids(cls, chain):
        """The orders above, up to the highest that the steps of the mirror sample."""
        if len(chain.mirror_angles) < 2:
            return
        step = np.median(np.diff(chain.mirror_angles))
        orders = np.arange(_LOW_ORDERS.stop, min(_HIGHEST_ORDER, int(np.pi / step)) + 1)
        even = np.full(len(orders), 1 / max(len(orders), 1))
        for where in chain.places("mirror") if len(orders) else ():
            yield Grid(cls, where, "order", "wave", "mirror", orders, even, 1e-4, "order {:g}")

    def table(self, chain):
        return tuple(
            self.parameter(
                f"{wave}{self.order}",
                "rad",
                1e-4,
                f"the mirror encoder's {wave}ine of order {self.order}",
            )
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = self.order * state.mirror
        return known(np.stack([np.cos(phase), np.sin(phase)]))[:, None]


class MirrorHysteresis(Effect):
    """The mirror lags behind its command by an angle whose sign is that of the sweep."""

    effect = "mirror-hysteresis"
    port = "mirror"
    places = ("mirror",)
    needs = ("sweep",)
    equation = "dphi = h * sweep direction"
    source = "half-gap model of a reversal error: ISO 230-2"
    reads = needs

    def table(self, chain):
        return (self.parameter("half_gap", "rad", 1e-4, "the mirror's hysteresis"),)

    def basis(self, state):
        return state.covariate("sweep")[None, None]


class FrameSync(Effect):
    """The images were taken a moment after the mirror's angle was read."""

    effect = "frame-sync"
    port = "mirror"
    places = ("time",)
    needs = ("mirror_speed_deg_s",)
    equation = "dphi = omega * dt"
    source = "first-order clock offset"
    reads = needs
    of_session = True

    def table(self, chain):
        return (self.parameter("delay", "s", 1e-3, "the delay of the images"),)

    def basis(self, state):
        return np.deg2rad(state.covariate("mirror_speed_deg_s"))[None, None]
