"""Effects on what is looked at: the board's flatness, the balls' certificate, and heat."""

from typing import Annotated

import numpy as np
from pydantic import Field

from sensors.effects.covariates import warming
from workbench.core.common_effects import ArtefactExpansionLaw, BallPositionLaw
from workbench.core.covariates import known
from workbench.core.effect import Effect


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
    """The radius of ball K on the artefact's certificate is wrong: its surface moves along the normal."""

    effect = "ball-radius"
    port = "target"
    places = ("ball",)
    equation = "dX = dr n"
    source = "radius of a sphere"

    def table(self, chain):
        return (self.parameter("growth", "mm", 0.01, f"the error of ball {self.number}'s radius"),)

    def basis(self, state):
        return np.where(state.ball == self.number, known(state.normals), 0.0)[None]


class BallPosition(BallPositionLaw, Effect):
    """The coordinate of ball K on the artefact's certificate is wrong by a vector."""

    @classmethod
    def candidates(cls, chain):
        """None: the measured centre of every ball is estimated with the baseline."""
        return ()


class ArtefactExpansion(ArtefactExpansionLaw, Effect):
    """The board or plate grows with temperature, or with time where none was recorded."""

    @classmethod
    def candidates(cls, chain):
        """One, with time where no temperature is recorded."""
        return warming(cls, chain)
