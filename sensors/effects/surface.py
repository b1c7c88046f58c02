"""Effects on the measured point: range, place in the field, the surface that is lit, and the noise."""

from typing import Annotated

import numpy as np
from pydantic import Field

from sensors.effects.covariates import known
from workbench.core.effect import Effect, Variant


class RangeScale(Effect):
    """The range is off by a share of the distance from its middle range."""

    effect = "range-scale"
    port = "point"
    places = ("sensor",)
    components = (2,)
    equation = "dz = c (z - z0)"
    source = "first-order range error of a triangulation sensor"

    def __init__(self, where: str, z0: float = 0.0):
        super().__init__(where)
        self.z0 = z0

    @classmethod
    def candidates(cls, chain):
        """One, where balls of known size show it."""
        return [Variant(cls(where)) for where in chain.places("sensor") if chain.balls]

    def table(self, chain):
        return (self.parameter("scale", "mm/mm", 1e-3, "the range scale"),)

    def basis(self, state):
        return known(state.points[2] - self.z0)[None, None]


class FieldBias(Effect):
    """The range is off by a quadratic polynomial of the place in the picture."""

    effect = "field-bias"
    port = "point"
    places = ("sensor",)
    components = (2,)
    equation = "dz = c1 x + c2 y + c3 x^2 + c4 x y + c5 y^2, x and y in units of half the picture's diagonal"
    source = "second-order expansion of what a camera or light-plane model leaves"

    @classmethod
    def candidates(cls, chain):
        """None: lens and light plane, whose errors it sums up, are tested by themselves."""
        return ()

    def table(self, chain):
        return tuple(
            self.parameter(name, "mm", 0.02, f"the field bias in {name}")
            for name in ("x", "y", "xx", "xy", "yy")
        )

    def basis(self, state):
        x, y = state.field
        return known(np.stack([x, y, x * x, x * y, y * y]))[:, None]


class IncidenceBias(Effect):
    """The point shifts along the ray the more obliquely the surface is seen."""

    effect = "incidence-bias"
    port = "point"
    places = ("sensor",)
    surface = ("normals",)
    equation = "dX = c tan(incidence) ray"
    source = "first order in the spot's elongation on an oblique surface; its causes: Curless & Levoy, ICCV (1995)"

    def table(self, chain):
        return (self.parameter("shift", "mm", 0.005, "the shift with the tangent of incidence"),)

    def basis(self, state):
        steepest = np.cos(
            np.deg2rad(89)
        )  # at grazing incidence nothing is seen, and nothing infinite either
        cosine = np.maximum(np.cos(state.incidence), steepest)
        return known(state.rays * np.sqrt(1 - cosine**2) / cosine)[None]


class SubsurfaceScatter(Effect):
    """Ceramic lets light in: the point lies deeper along the ray, and the ball seems smaller.

    Acts on balls alone, but for `everywhere`.
    """

    effect = "subsurface-scatter"
    port = "point"
    places = ("sensor",)
    equation = "dX = d ray - s n, n the outward normal"
    source = "Godin et al., An assessment of laser range measurement of marble surfaces, Optical 3-D (2001)"

    def __init__(self, where: str, everywhere: bool = False):
        super().__init__(where)
        self.everywhere = everywhere

    @classmethod
    def candidates(cls, chain):
        """One, where there are balls."""
        return [Variant(cls(where)) for where in chain.places("sensor") if chain.balls]

    @property
    def surface(self):
        return ("normals",) if self.everywhere else ("normals", "ball")

    def table(self, chain):
        return (
            self.parameter("depth", "mm", 0.01, "the depth that light comes back from"),
            self.parameter("shrink", "mm", 0.01, "what the ball's radius seems to lack"),
        )

    def basis(self, state):
        rays, normals = state.rays, state.normals
        inward = normals * np.sign((rays * normals).sum(0))
        mine = np.ones(state.n, bool) if self.everywhere else state.ball > 0
        return np.where(mine, known(np.stack([rays, inward])), 0.0)


class NoiseHeteroscedastic(Effect):
    """The spread, not the mean, depends on a covariate: a column, or incidence_deg, range_mm, u_px, v_px."""

    effect = "noise-heteroscedastic"
    port = "noise"
    places = ("noise",)
    equation = "log sigma -> log sigma + c (s - mean s) / spread of s"
    source = "log-linear variance model: Harvey, Econometrica 44 (1976)"

    @classmethod
    def candidates(cls, chain):
        """None: the diagnosis tests the variance apart from the mean."""
        return ()

    def __init__(
        self,
        where: str,
        covariate: str,
        mean: float = 0.0,
        spread: Annotated[float, Field(gt=0)] = 1.0,
    ):
        super().__init__(where)
        self.covariate, self.mean, self.spread = covariate, mean, spread

    @property
    def needs(self):
        return () if self.covariate in _SEEN else (self.covariate,)

    def table(self, chain):
        return (
            self.parameter(
                self.covariate, "1", 0.3, f"the growth of the noise with {self.covariate}"
            ),
        )

    def slots(self, chain):
        return (0,)

    def basis(self, state):
        seen = _SEEN.get(self.covariate)
        values = seen(state) if seen else state.covariate(self.covariate)
        return known((values - self.mean) / self.spread)[None, None]


_SEEN = {
    "incidence_deg": lambda state: np.rad2deg(state.incidence),
    "range_mm": lambda state: np.linalg.norm(state.points, axis=0),
    "u_px": lambda state: state.pixels[0],
    "v_px": lambda state: state.pixels[1],
}
"""What the state knows without a column."""
