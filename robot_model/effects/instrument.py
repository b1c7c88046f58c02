"""Effects of an external instrument, such as a laser tracker: its sight line is part of the measuring chain.

The instrument stands at the origin of the external frame, as it does where its own coordinates are recorded.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from workbench.core.effect import Effect, Grid, Variant

_METRE = 1e-3  # m per mm
_LOW_ORDERS, _LOW, _HIGHEST = 2, 0.5, 60
"""Eccentric scales make one and two cycles a revolution, and have half of the prior; the highest order tested."""
_TYPICAL_RAD = 2e-5  # amplitude of an error of an angle encoder: 60 um at 3 m


def sight_lines(state) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (3, n) from the instrument to the measured points, external frame, and ranges (n,) in m."""
    length = np.linalg.norm(state.measured, axis=0)
    return state.measured / np.maximum(length, 1e-9), length * _METRE


def sight_directions(points: np.ndarray) -> np.ndarray:
    """(3, 3, n) motion of points (3, n) per unit of azimuth, elevation (mm/rad) and range, by axis."""
    x, y, z = points
    level = np.maximum(np.hypot(x, y), 1e-9)
    length = np.maximum(np.hypot(level, z), 1e-9)
    azimuth = np.stack([-y, x, np.zeros_like(z)])
    elevation = np.stack([-z * x / level, -z * y / level, level])
    return np.stack([azimuth, elevation, points / length])


def sight_covariates(points: np.ndarray) -> dict[str, np.ndarray]:
    """Azimuth and elevation (rad) and range (m) of points (3, n) mm, by name."""
    level = np.hypot(*points[:2])
    azimuth = np.arctan2(points[1], points[0])
    middle = np.arctan2(np.sin(azimuth).mean(), np.cos(azimuth).mean())
    unwrapped = middle + np.angle(np.exp(1j * (azimuth - middle)))  # without a jump by a revolution
    return {
        "sight_azimuth": unwrapped,
        "sight_elevation": np.arctan2(points[2], level),
        "sight_range": np.hypot(level, points[2]) * _METRE,
    }


class _AngleHarmonic:
    """Base class of the error curves of the two angle encoders of an instrument."""

    port = "sensor"
    of_session = True
    places = ("instrument",)
    coexists = True
    angle = "azimuth"

    def __init__(self, where: str, order: Annotated[float, Field(gt=0)] = 1):
        super().__init__(where)
        self.order = order

    @classmethod
    def candidates(cls, chain):
        """None: `grids` has all orders."""
        return ()

    @classmethod
    def grids(cls, chain):
        """The orders 1 to 60, where the instrument stands outside the space in which the points lie."""
        name = f"sight_{cls.angle}"
        if not chain.places("instrument") or name not in chain.state.covariates:
            return
        orders = np.arange(1.0, _HIGHEST + 1)
        is_low = orders <= _LOW_ORDERS
        masses = np.where(is_low, _LOW / is_low.sum(), (1 - _LOW) / (~is_low).sum())
        factor = sight_directions(chain.state.measured)[cls._row()][None]
        description = ("order", "wave", name, orders, masses, _TYPICAL_RAD, "order {:g}", factor)
        yield Grid(cls, "instrument", *description)

    @classmethod
    def _row(cls) -> int:
        return ("azimuth", "elevation").index(cls.angle)

    def port_indices(self, chain):
        return (0, 1, 2)

    def table(self, chain):
        label = f"the error of the instrument's {self.angle}"
        order = f"{self.order:g}".replace(".", "_")
        return tuple(
            self.parameter(f"{wave}{order}", "rad", _TYPICAL_RAD, f"{label}, {wave}")
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = self.order * sight_covariates(state.measured)[f"sight_{self.angle}"]
        waves = np.stack([np.cos(phase), np.sin(phase)])
        return waves[:, None] * sight_directions(state.measured)[self._row()]


class AzimuthHarmonic(_AngleHarmonic, Effect):
    """The azimuth encoder of the instrument has an error that is periodic in its angle."""

    effect = "azimuth-harmonic"
    angle = "azimuth"
    equation = "d azimuth = A cos(n azimuth) + B sin(n azimuth)"
    source = "eccentricity and subdivision error of angle encoders: Muralikrishnan et al., Precis. Eng. 44 (2016)"


class ElevationHarmonic(_AngleHarmonic, Effect):
    """The elevation encoder of the instrument has an error that is periodic in its angle."""

    effect = "elevation-harmonic"
    angle = "elevation"
    equation = "d elevation = A cos(n elevation) + B sin(n elevation)"
    source = AzimuthHarmonic.source


class SightLineRefraction(Effect):
    """The sight line of the instrument is bent by a gradient of the air's temperature.

    Three numbers: the gradient of the refractive index across space, which shifts a point across the sight line with
    the square of the range.
    """

    effect = "sight-line-refraction"
    port = "sensor"
    of_session = True
    places = ("instrument",)
    equation = "dp = r^2 / 2 (G - u (u.G)), u the sight line, r the range"
    source = (
        "curvature of a ray in a linear index gradient: Born & Wolf, Principles of Optics, sec. 3.2"
    )

    def port_indices(self, chain):
        return (0, 1, 2)

    def table(self, chain):
        return tuple(
            self.parameter(f"gradient_{a}", "mm/m^2", 0.01, f"the gradient of the air along {a}")
            for a in "xyz"
        )

    def basis(self, state):
        sight, distance = sight_lines(state)
        transverse = np.eye(3)[:, :, None] - sight[:, None] * sight[None]
        return transverse * distance**2 / 2


class InstrumentRange(Effect):
    """The instrument's range is wrong by a share of the distance: its scale or the refractive index of the air.

    About the robot's root, as the base pose takes up the rest. On an arm without slides the same share of all lengths
    has the same effect, so that a recording does not distinguish them. The reading of a slide is a length standard.
    """

    effect = "range-scale"
    port = "sensor"
    places = ("instrument",)
    equation = "dp = c p, p from the robot's root"
    source = "first-order scale error of an interferometer or distance meter: ISO 10360-10"

    @classmethod
    def candidates(cls, chain):
        """Variants if an external instrument measures. Without slides all lengths of the arm have the same effect."""
        return [Variant(cls(where)) for where in chain.places("instrument")]

    def port_indices(self, chain):
        return (0, 1, 2)

    def table(self, chain):
        return (self.parameter("scale", "1", 2e-5, "the scale of the instrument's range"),)

    def basis(self, state):
        # of the nominal arm: measured points hold the errors themselves, and a share of these explains them
        return (state.root_rotation @ state.frames.point(state.target))[None]


class InstrumentRangeOffset(Effect):
    """The instrument's range is wrong by a constant: its zero point, or the constant of another reflector.

    The base pose takes up the mean of the shift; what remains grows with the spread of the sight lines.
    """

    effect = "range-offset"
    port = "sensor"
    of_session = True
    places = ("instrument",)
    equation = "dp = c u, u the sight line"
    source = "zero error of a distance meter (additive constant): ISO 10360-10, annex B"

    @classmethod
    def candidates(cls, chain):
        """At the instrument, where it stands outside the space in which the points lie."""
        if chain.places("instrument") and "sight_azimuth" in chain.state.covariates:
            yield Variant(cls("instrument"))

    def port_indices(self, chain):
        return (0, 1, 2)

    def table(self, chain):
        return (
            self.parameter("offset", "mm", 0.05, "the constant error of the instrument's range"),
        )

    def basis(self, state):
        return sight_lines(state)[0][None]


class ReflectorIncidence(Effect):
    """The centre of a reflector on the tool shifts with the direction from which the instrument sees it.

    A polynomial of degree 2 in the sight line in the flange frame, eight numbers along each axis of the flange; the
    squares of a unit vector add up to 1. `reflector`: its number in the recording; 0 for all of them.
    """

    effect = "reflector-incidence"
    port = "target"
    places = ("tool",)
    equation = "dp = B s + C (s_x^2, s_y^2, s_x s_y, s_x s_z, s_y s_z), s towards the instrument in the flange frame"
    source = "centring error of a retroreflector: ISO 10360-10, annex B; Muralikrishnan et al., Precis. Eng. 44 (2016)"
    coexists = True
    of_session = True

    def __init__(self, where: str, reflector: Annotated[int, Field(ge=0)] = 0):
        super().__init__(where)
        self.reflector = reflector

    @classmethod
    def candidates(cls, chain):
        """Variants for every reflector, where an external instrument measures."""
        numbers = np.unique(chain.state.index)
        if not chain.places("instrument"):
            return
        for number in numbers if len(numbers) > 1 else [0]:
            label = f"of reflector {number}" if number else ""
            yield Variant(cls("tool", int(number)), label, 1 / len(numbers))

    def port_indices(self, chain):
        return (0, 1, 2)

    def table(self, chain):
        subject = f"reflector {self.reflector}" if self.reflector else "the reflector"
        key = f"r{self.reflector}_" if self.reflector else ""
        powers = ("x", "y", "z", "xx", "yy", "xy", "xz", "yz")
        names = [f"{a}_by_{power}" for a in "xyz" for power in powers]
        return tuple(
            self.parameter(
                key + name, "mm", 0.05, f"the centre of {subject}, {name.replace('_', ' ')}"
            )
            for name in names
        )

    def basis(self, state):
        sight, _ = sight_lines(state)
        root = state.root_rotation.T @ -sight
        seen = np.einsum("cin,in->cn", state.frames.link[-1], root)
        first = [0, 1, 0, 0, 1]
        second = [0, 1, 1, 2, 2]
        factors = np.concatenate([seen, seen[first] * seen[second]])
        if self.reflector:
            factors = factors * (state.index == self.reflector)
        return np.einsum("at,fn->aftn", np.eye(3), factors).reshape(24, 3, state.n)


class AngularNoise(Effect):
    """The noise grows with the distance from the instrument, as that of its angles does.

    The logarithm of sigma is linear in that of the range; 1 is proportional. `reference_m` is the range at which sigma
    is as stated.
    """

    effect = "angular-noise"
    port = "noise"
    places = ("noise",)
    equation = "log sigma -> log sigma + c log(r / r_0)"
    source = "angle encoders of a tracker: ISO 10360-10; log-linear variance: Harvey, Econometrica 44 (1976)"
    nonnegative = 1

    def __init__(self, where: str, reference_m: Annotated[float, Field(gt=0)] = 1.0):
        super().__init__(where)
        self.reference_m = reference_m

    @classmethod
    def candidates(cls, chain):
        """None: noise that depends on a covariate is tested on the residual of all accepted terms."""
        return ()

    def port_indices(self, chain):
        return (0,)

    def table(self, chain):
        return (self.parameter("exponent", "1", 0.5, "the exponent of the noise with range"),)

    def basis(self, state):
        _, distance = sight_lines(state)
        return np.log(np.maximum(distance, 1e-9) / self.reference_m)[None, None]


__all__ = [
    "AngularNoise",
    "AzimuthHarmonic",
    "ElevationHarmonic",
    "InstrumentRange",
    "ReflectorIncidence",
    "SightLineRefraction",
    "sight_covariates",
    "sight_directions",
    "sight_lines",
]
