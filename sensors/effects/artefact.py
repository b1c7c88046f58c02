"""Effects on what is looked at: the board's flatness, the balls' certificate, and heat."""

from typing import Annotated

import numpy as np
from pydantic import Field

from sensors.effects.covariates import WarmUpLaw, warming
from workbench.core.common_effects import ArtefactExpansionLaw, BallPositionLaw
from workbench.core.covariates import known
from workbench.core.effect import Effect, Variant


class BoardBow(Effect):
    """The calibration board is not flat: a quadratic warp across it.

    x and y are the place from the board's middle over half its diagonal, so that a parameter is
    the height (mm, along the board's z) at the corners of a long board. `flatness_mm`: certified height of the highest
    over the lowest point; half of it is then the prior standard deviation of each parameter.
    """

    effect = "board-bow"
    port = "target"
    places = ("artefact",)
    components = (2,)
    equation = "dz = a x^2 + b y^2 + c x y"
    source = "board warp as in mrcal, where it has two terms: Kogan, https://mrcal.secretsauce.net"

    def __init__(self, where: str, flatness_mm: Annotated[float, Field(gt=0)] | None = None):
        super().__init__(where)
        self.flatness_mm = flatness_mm

    def table(self, chain):
        prior = self.flatness_mm and self.flatness_mm / 2
        return tuple(
            self.parameter(name, "mm", 0.05, f"the board's bow in {name}", prior)
            for name in ("xx", "yy", "xy")
        )

    def basis(self, state):
        x, y = known(state.board)
        return np.stack([x * x, y * y, x * y])[:, None]


class BallRadius(Effect):
    """A ball's radius on the artefact's certificate is wrong: its surface moves along the normal.

    Of ball K, or at the artefact of all balls, whether their numbers are known or not. `every`: ball K is the only one.
    An error of all radii is nearly the same as light that a ball lets in, which makes all of them seem smaller.
    """

    effect = "ball-radius"
    port = "target"
    places = ("ball", "artefact")
    surface = ("ball",)
    distinguished_by = (
        "measure the diameter of the balls by contact, or scan an opaque ball of known size"
    )
    equation = "dX = dr n"
    source = "radius of a sphere"

    def __init__(self, where: str, every: bool = False):
        super().__init__(where)
        self.every = every or where == "artefact"

    @property
    def confounded_with(self):
        """Subsurface scatter, of all balls: one ball alone is not of another material."""
        return (("subsurface-scatter", "sensor", ""),) if self.every else ()

    @classmethod
    def candidates(cls, chain):
        """Every ball with a number, and all balls; one where there is only one ball."""
        numbered = chain.places("ball")
        if len(chain.balls) == 1:
            where = numbered[0] if numbered else "artefact"
            yield Variant(cls(where, every=True))
            return
        for where in numbered:
            yield Variant(cls(where))
        if chain.balls:
            yield Variant(cls("artefact"), "all balls")

    def table(self, chain):
        whose = (
            "the radii of all balls" if self.where == "artefact" else f"ball {self.number}'s radius"
        )
        return (self.parameter("growth", "mm", 0.01, f"the error of {whose}"),)

    def basis(self, state):
        is_scaled = state.ball > 0 if self.every else state.ball == self.number
        return np.where(is_scaled, known(state.normals), 0.0)[None]


class BallForm(Effect):
    """Ball K is no sphere: its surface has lobes, spherical harmonics of degree 2 or 3 of the outward normal.

    In the axes of the camera: the ball does not rotate against the scanner from scan to scan. A parameter is the
    height of the highest lobe or nearly.
    """

    effect = "ball-form"
    port = "target"
    places = ("ball",)
    equation = "dX = sum_m a_m Y_m(n) n, Y_m real spherical harmonics of one degree"
    source = "form deviation of a sphere: ISO 10360-8; real spherical harmonics: Courant & Hilbert, vol. 1, ch. 7"

    def __init__(self, where: str, degree: Annotated[int, Field(ge=2, le=3)] = 2):
        super().__init__(where)
        self.degree = degree

    @classmethod
    def candidates(cls, chain):
        """Of the second and of the third degree, at every ball."""
        for where in chain.places("ball"):
            for degree in (2, 3):
                yield Variant(cls(where, degree), f"degree {degree}", 0.5)

    def table(self, chain):
        return tuple(
            self.parameter(f"d{self.degree}m{k}", "mm", 0.01, f"lobe {k} of ball {self.number}")
            for k in range(2 * self.degree + 1)
        )

    def basis(self, state):
        normals = known(state.normals)
        lobes = spherical_harmonics(self.degree, normals)
        return np.where(state.ball == self.number, lobes[:, None] * normals, 0.0)


def spherical_harmonics(degree: int, normals):
    """(2 degree + 1, n) real spherical harmonics of unit vectors (3, n), degree 2 or 3; largest values about 1."""
    return _second_degree(*normals) if degree == 2 else _third_degree(*normals)


def _second_degree(x, y, z):
    """(5, n) real spherical harmonics of degree 2 with largest value 1."""
    return np.stack([2 * x * y, 2 * y * z, 2 * z * x, x * x - y * y, (3 * z * z - 1) / 2])


def _third_degree(x, y, z):
    """(7, n) real spherical harmonics of degree 3 with largest values of about 1."""
    steep = 1.5 * np.sqrt(3.0)
    return np.stack(
        [
            y * (3 * x * x - y * y),
            2 * steep * x * y * z,
            y * (5 * z * z - 1),
            z * (5 * z * z - 3) / 2,
            x * (5 * z * z - 1),
            steep * z * (x * x - y * y),
            x * (x * x - 3 * y * y),
        ]
    )


class BallPosition(BallPositionLaw, Effect):
    """The coordinate of ball K on the artefact's certificate is wrong by a vector."""

    @classmethod
    def candidates(cls, chain):
        """None: the measured centre of every ball is estimated with the baseline."""
        return ()


class ArtefactExpansion(WarmUpLaw, ArtefactExpansionLaw, Effect):
    """The board or plate grows with temperature, or with time where none was recorded.

    With time linearly, or exponentially with a time constant as it warms up.
    """

    equation = "X -> X (1 + c (T - T0)); 1 - exp(-(t - t0) / tau) instead of T - T0"
    column = ArtefactExpansionLaw.column

    @classmethod
    def candidates(cls, chain):
        """One; linear with time and warm-up with time constants where no temperature is recorded."""
        return warming(cls, chain)

    def table(self, chain):
        """One coefficient of expansion."""
        unit, size, prior = self.sizes(chain, 1e-5)
        of_growth = "1" if unit == "1" else f"1/{unit}"
        return (self.parameter("per_unit", of_growth, size, "the artefact's expansion", prior),)

    def basis(self, state):
        """(1, 3, n) the nominal point times what it grows by."""
        return (known(state.target) * self.progress(state))[None]
