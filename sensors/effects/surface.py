"""Effects on the measured point: range, place in the field, the surface that is lit, and the noise."""

import numpy as np

from sensors.state import OF_THE_OBSERVATION
from workbench.core.common_effects import FieldBiasLaw, LateralScaleLaw, NoiseLaw, RangeScaleLaw
from workbench.core.covariates import known
from workbench.core.effect import Effect, Variant


class RangeScale(RangeScaleLaw, Effect):
    """The range is off by a share of the distance from its middle range."""

    port = "point"

    @classmethod
    def candidates(cls, chain):
        """One, where balls of known size show it."""
        return [Variant(cls(where)) for where in chain.places("sensor") if chain.balls]


class LateralScale(LateralScaleLaw, Effect):
    """A lateral coordinate of the measured point is off by a share of itself."""

    port = "point"

    @classmethod
    def candidates(cls, chain):
        """None: camera and light plane, whose errors it combines, are calibrated."""
        return ()


class FieldBias(FieldBiasLaw, Effect):
    """The range is off by a quadratic polynomial of the place in the image."""

    port = "point"
    equation = f"{FieldBiasLaw.equation}, x and y in units of half the image's diagonal"

    @classmethod
    def candidates(cls, chain):
        """None: lens and light plane, whose errors it combines, are tested separately."""
        return ()


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
        rays = state.rays
        normals = state.normals
        inward = normals * np.sign((rays * normals).sum(0))
        is_displaced = np.ones(state.n, bool) if self.everywhere else state.ball > 0
        return np.where(is_displaced, known(np.stack([rays, inward])), 0.0)


class NoiseHeteroscedastic(NoiseLaw, Effect):
    """The spread, not the mean, depends on a covariate: a column, or incidence_deg, range_mm, u_px, v_px."""

    @property
    def needs(self):
        return () if self.covariate in OF_THE_OBSERVATION else (self.covariate,)
