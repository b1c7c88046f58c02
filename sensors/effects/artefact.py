"""Effects on what is looked at: the board's flatness, the balls' certificate, and heat."""

import numpy as np

from sensors.effects.covariates import heat, heat_sizes, known, warming
from workbench.core.effect import Effect


class BoardBow(Effect):
    """The calibration board is not flat: a quadratic warp across it.

    x and y are the place from the board's middle over half its diagonal, so that a parameter is
    the height (mm, along the board's z) at the corners of a long board.
    """

    effect = "board-bow"
    port = "target"
    places = ("artefact",)
    components = (2,)
    equation = "dz = a x^2 + b y^2 + c x y"
    source = "board warp as in mrcal, where it has two terms: Kogan, https://mrcal.secretsauce.net"

    def table(self, chain):
        return tuple(
            self.parameter(name, "mm", 0.05, f"the board's bow in {name}")
            for name in ("xx", "yy", "xy")
        )

    def basis(self, state):
        x, y = known(state.board)
        return np.stack([x * x, y * y, x * y])[:, None]


class BallPosition(Effect):
    """The coordinate of ball K on the artefact's certificate is wrong by a vector."""

    effect = "ball-position"
    port = "target"
    places = ("ball",)
    equation = "ball K -> ball K + d"
    source = "one free vector a ball"

    @classmethod
    def candidates(cls, chain):
        """None: the measured centre of every ball is estimated with the baseline."""
        return ()

    def table(self, chain):
        return tuple(
            self.parameter(axis, "mm", 0.05, f"ball {self.number}'s error along {axis}")
            for axis in "xyz"
        )

    def basis(self, state):
        return np.eye(3)[:, :, None] * (state.ball == self.number).astype(float)


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


class ArtefactExpansion(Effect):
    """The board or plate grows with temperature, or with time where none was recorded."""

    effect = "artefact-expansion"
    port = "target"
    places = ("artefact",)
    equation = "X -> X (1 + c (T - T0))"
    source = "linear expansion about the artefact's origin"
    reads = ("temperature",)
    unrecorded = "temperature"

    @classmethod
    def candidates(cls, chain):
        """One, with time where no temperature is recorded."""
        return warming(cls, chain)

    def table(self, chain):
        unit, size, prior = heat_sizes(chain.state, 1e-5, self.column)
        return (self.parameter("per_unit", f"1/{unit}", size, "the artefact's expansion", prior),)

    def basis(self, state):
        return (known(state.target) * heat(state, self.column))[None]

    column = "temperature_artefact_c"
