"""Effects on the way from the surface to the pixel: lens, heat, and a window before the camera."""

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from sensors.effects.covariates import WarmUpLaw, warming
from workbench.core.covariates import known
from workbench.core.effect import Effect, Variant

_STEP = 0.05  # rad, of the difference quotients by the tilt of a window


class LensResidual(Effect):
    """The lens distorts in ways that Brown's coefficients do not hold.

    Every polynomial (du, dv) of the place in the image up to `degree`, less those that focal
    lengths, principal point, k1, p1, p2 and the board's pose make: with w = du + i dv and
    z = x + i y, the powers z^a conj(z)^b carry the angular orders a - b, and on the unit circle
    those of different order are orthogonal; of one order, the lower powers are subtracted.
    A parameter is the largest displacement on that circle or, where powers are subtracted, nearly.
    """

    effect = "lens-residual"
    port = "pixel"
    places = ("camera",)
    equation = "du + i dv = sum_ab c_ab z^a conj(z)^b, without what k1 k2 p1 p2 k3 and a pose make"
    source = (
        "orthogonal circle polynomials in complex form: Born & Wolf, Principles of Optics, 7th ed., sec. 9.2; "
        "z = field angle over half the image's diagonal"
    )

    def __init__(self, where: str, degree: Annotated[int, Field(ge=1, le=4)] = 3):
        super().__init__(where)
        self.degree = degree

    @classmethod
    def candidates(cls, chain):
        """Of the third and of the fourth degree."""
        for where in chain.places("camera"):
            yield Variant(cls(where), "third degree", 0.5)
            yield Variant(cls(where, 4), "fourth degree", 0.5)

    @cached_property
    def terms(self) -> tuple[tuple[int, int, bool], ...]:
        """(a, b, turned by a right angle) of each parameter."""
        powers = [(d - b, b) for d in range(1, self.degree + 1) for b in range(d + 1)]
        return tuple(
            (a, b, turned)
            for a, b in powers
            for turned in (False, True)
            if (a, b, turned) not in _TAKEN
        )

    def table(self, chain):
        return tuple(
            self.parameter(
                f"z{a}c{b}{'i' if turned else 'r'}",
                "px",
                0.05,
                f"the lens residual z^{a} conj(z)^{b}",
            )
            for a, b, turned in self.terms
        )

    def basis(self, state):
        x, y = state.field
        z = x + 1j * y
        r2 = x * x + y * y
        waves = np.stack(
            [_circle(z, r2, a, b) * (1j if turned else 1) for a, b, turned in self.terms]
        )
        return known(np.stack([waves.real, waves.imag], axis=1))


# degrees 1 and 2: scale, turn and aspect; decentring (p1, p2) and the board's tilt. Degree 3: k1.
_TAKEN = {
    (1, 0, False),
    (1, 0, True),
    (0, 1, False),
    (2, 0, False),
    (2, 0, True),
    (1, 1, False),
    (1, 1, True),
    (2, 1, False),
}
# what makes z^a conj(z)^b orthogonal on the unit circle to the lower powers of its angular order:
# replaces the first r^2 of the pair, by (angular order, number of pairs)
_RADIAL = {(1, 1): (1.0, -2 / 3), (0, 2): (1.0, -1.0, 1 / 6), (2, 1): (1.0, -3 / 4)}


def _circle(z, r2, a, b):
    """Complex polynomial of leading power z^a conj(z)^b."""
    order = a - b
    pairs = min(a, b)
    angular = z**order if order >= 0 else np.conj(z) ** -order
    unit_radial = (1.0,) + (0.0,) * pairs
    radial = _RADIAL.get((abs(order), pairs), unit_radial)
    return angular * np.polyval(radial, r2)


class CameraThermalDrift(WarmUpLaw, Effect):
    """Focal length and principal point move with temperature, or with time where none was recorded.

    With time linearly, or exponentially with a time constant as the camera warms up.
    """

    effect = "camera-thermal-drift"
    port = "pixel"
    places = ("camera",)
    equation = (
        "du = (c (u - cx) + d) (T - T0), dv likewise; 1 - exp(-(t - t0) / tau) instead of T - T0"
    )
    source = "first-order warm-up drift of the intrinsics: Handel, ACCV (2007)"
    reads = ("temperature",)
    unrecorded = "temperature"
    column = "temperature_camera_c"

    @classmethod
    def candidates(cls, chain):
        """One; linear with time and warm-up with time constants where no temperature is recorded."""
        return warming(cls, chain)

    def table(self, chain):
        unit, size, prior = self.sizes(chain, 1e-5)
        shift = 1e3 * size
        wide = prior and 1e3 * prior
        of_focal, of_shift = ("1", "px") if unit == "1" else (f"1/{unit}", f"px/{unit}")
        return (
            self.parameter("focal", of_focal, size, "the focal length's growth", prior),
            self.parameter("x", of_shift, shift, "the principal point's drift in x", wide),
            self.parameter("y", of_shift, shift, "the principal point's drift in y", wide),
        )

    def basis(self, state):
        camera = state.camera
        displacement = known(state.pixels - np.array([[camera.cx], [camera.cy]]))
        shift_rows = np.broadcast_to(np.eye(2)[:, :, None], (2, *displacement.shape))
        return np.concatenate([displacement[None], shift_rows]) * self.progress(state)


class WindowRefraction(Effect):
    """A plane window stands before the lens, across the optical axis but for `tilt_deg`.

    It moves every ray sideways, parallel to itself, by what grows with the angle; the ray's change
    of direction that reaches the same point is that shift over the range. Linear in the thickness,
    and nothing without it: the index (of air to glass) and the tilt about x and y show only through
    the thickness, so they are options. The leading term is a camera that stands (1 - 1/N) t further back; only what
    goes with the cube of the angle can be seen.

    With `unknown_tilt` the tilt is estimated too, by its products with the thickness up to the second order, about
    `tilt_deg`. A tilted window is astigmatic, which shows much more.
    """

    effect = "window-refraction"
    port = "ray"
    places = ("camera",)
    nonnegative = 1
    equation = "dray = -t (tan a - tan a') e / range, sin a = N sin a'"
    source = (
        "plane-parallel plate: Born & Wolf, Principles of Optics, 7th ed., sec. 4.6; Snell's law"
    )

    def __init__(
        self,
        where: str,
        index: Annotated[float, Field(gt=1, le=4)] = 1.5,
        tilt_deg: Annotated[list[float], Field(min_length=2, max_length=2)] = [0.0, 0.0],  # noqa: B006
        unknown_tilt: bool = False,
    ):
        super().__init__(where)
        self.index, self.tilt_deg, self.tilt = index, tilt_deg, np.deg2rad(tilt_deg)
        self.unknown_tilt = unknown_tilt

    @classmethod
    def candidates(cls, chain):
        """Across the optical axis, and with an unknown tilt."""
        for where in chain.places("camera"):
            yield Variant(cls(where), "across the axis", 0.5)
            yield Variant(cls(where, unknown_tilt=True), "tilted", 0.5)

    def table(self, chain):
        thickness = self.parameter("thickness", "mm", 1.0, "the window's thickness")
        if not self.unknown_tilt:
            return (thickness,)
        label = "the window's thickness times its tilt about"
        first = [self.parameter(k, "mm rad", 0.3, f"{label} {k}") for k in "xy"]
        second = [self.parameter(k, "mm rad^2", 0.1, f"{label} {k}") for k in ("xx", "xy", "yy")]
        return (thickness, *first, *second)

    def basis(self, state):
        if not self.unknown_tilt:
            return known(self._by_thickness(state, self.tilt))[None]
        return known(np.stack(self._expanded(state)))

    def _by_thickness(self, state, tilt) -> np.ndarray:
        """(3, n) change of the ray per mm of a window with a tilt (2,) rad."""
        normal = np.array([np.tan(tilt[1]), -np.tan(tilt[0]), 1.0])
        normal /= np.linalg.norm(normal)
        rays = state.rays
        cosine = normal @ rays
        tangential = rays - normal[:, None] * cosine
        cosine_inside = np.sqrt(self.index**2 - 1 + cosine**2)  # N cos a'
        shift = -tangential * (1 / cosine - 1 / cosine_inside)
        return shift / np.linalg.norm(state.points, axis=0)

    def _expanded(self, state) -> list[np.ndarray]:
        """Taylor's series in the tilt to the second order: (3, n) by 1, x, y, x^2, x y and y^2."""

        def at(x, y):
            return self._by_thickness(state, self.tilt + _STEP * np.array([x, y]))

        middle, left_of_centre, right, low, high = (
            at(0, 0),
            at(-1, 0),
            at(1, 0),
            at(0, -1),
            at(0, 1),
        )
        mixed = at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)
        return [
            middle,
            (right - left_of_centre) / (2 * _STEP),
            (high - low) / (2 * _STEP),
            (right - 2 * middle + left_of_centre) / (2 * _STEP**2),
            mixed / (4 * _STEP**2),
            (high - 2 * middle + low) / (2 * _STEP**2),
        ]


class FocusBreathing(Effect):
    """The focal length depends on the focus distance, as of a lens that focuses on the object: it breathes.

    Each image has one focal length. z is the depth of what the lens is focused on: the middle of the board, or the mean
    of the balls of a scan. `z0` mm is the depth at which the focal length is that of the camera. Of a focal length
    that differs from board pose to board pose without a law, `sensors.camera.focal_scatter` tells.
    """

    effect = "focus-breathing"
    port = "pixel"
    places = ("camera",)
    equation = (
        "du = c (z - z0) (u - cx), dv likewise; f(z) = f (1 + c (z - z0)), z = the focus distance"
    )
    source = "focal length as a function of focus: Willson, CMU-RI-TR-94-03 (1994), ch. 6"

    def __init__(self, where: str, z0: float = 0.0):
        super().__init__(where)
        self.z0 = z0

    @classmethod
    def candidates(cls, chain):
        """One, about the mean depth of the boards: far from it, first order would not describe the change."""
        return [Variant(cls(where, chain.depth_mm)) for where in chain.places("camera")]

    def table(self, chain):
        label = "the focal length's relative change with the focus distance"
        return (self.parameter("slope", "1/mm", 1e-5, label),)

    def basis(self, state):
        camera = state.camera
        displacement = state.pixels - np.array([[camera.cx], [camera.cy]])
        return known((state.focus_depth - self.z0) * displacement)[None]


class Blooming(Effect):
    """The centre of the laser line shifts with its brightness and its width, as light overflows from full pixels.

    The shift is along the line of pixels in which a centre is measured: a row of the image, or a column with `along`
    "columns". `line_brightness` and `line_width` are the logarithms of both, less those of a usual line. A clipped or
    asymmetric line shifts alike.
    """

    effect = "blooming"
    port = "pixel"
    places = ("camera",)
    needs = ("line_brightness", "line_width")
    equation = "du = a ln(brightness / usual brightness) + b ln(width / usual width)"
    source = (
        "first order in what overflows from a full well: Janesick, Scientific CCDs (2001), ch. 4"
    )
    reads = needs
    of_session = True

    def __init__(self, where: str, along: Literal["rows", "columns"] = "rows"):
        super().__init__(where)
        self.along = along
        self.components = (0,) if along == "rows" else (1,)

    @classmethod
    def candidates(cls, chain):
        """One, where centres depend on brightness or width of the line along single stripes."""
        if all(chain.varies(name) for name in cls.needs):
            for where in chain.places("camera"):
                yield Variant(cls(where, chain.line_along))

    def table(self, chain):
        return (
            self.parameter("brightness", "px", 0.1, "the shift by brightness"),
            self.parameter("width", "px", 0.3, "the shift by width"),
        )

    def basis(self, state):
        has_light = ~np.isnan(state.planes[3])
        if not has_light.any():  # corners are seen without the laser
            return np.zeros((2, 1, state.n))
        rows = [np.where(has_light, state.covariate(name), 0.0) for name in self.needs]
        return np.stack(rows)[:, None]
