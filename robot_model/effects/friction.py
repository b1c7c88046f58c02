"""Friction and torques at a joint that gravity does not make: hysteresis, cables, springs, rounded readings."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robot_model.effects.transmission import Backlash
from robot_model.effects.unknown_masses import bar_torque
from robot_model.statics import STANDARD_GRAVITY
from workbench.core.effect import Effect, Variant
from workbench.core.errors import InputError

_WEIGHT = 0.2  # prior weight of a width, relative to backlash
_WIDTHS = (0.003, 0.01, 0.03, 0.1, 0.3)  # rad, m of a slide: where a search starts
_LAWS = {"bouc-wen": "wound up", "dahl": "wound up exponentially"}
_HALF_GAP_RAD = 3e-4
_HALF_GAP_MM = 0.03


class JointHysteresis(Effect):
    """Joint K differs from its reading by friction and wind-up, along its motion or against it.

    The spring between reading and joint is wound up by every move in the order of the samples, to z between -1 and
    1 (`workbench.core.covariates.MotionHistory`), over `width` (rad; m of a slide), 0 for the side of approach,
    which is fully wound up at once. `law`: how the spring releases after a reversal. Friction grows with the
    gravity torque; where no masses are stated, with that of uniform bars. For a small width and no growth it is the
    backlash.
    """

    effect = "joint-hysteresis"
    port = "joint"
    places = ("joint",)
    elastic = True
    equation = (
        "dq = (g + h |tau| / tau_max) z, dz/dq = (1 - |z| (1 + sign(z dq)) / 2) / width (bouc-wen) or "
        "(1 - z sign(dq)) / width (dahl)"
    )
    source = "Bouc-Wen with n = 1: Ikhouane & Rodellar, Systems with Hysteresis (2007), ch. 2; Dahl (1968)"
    family = Backlash.effect
    subsumes = (Backlash.effect,)
    by_moves = True

    def __init__(
        self,
        where: str,
        width: Annotated[float, Field(ge=0)] = 0.01,
        law: Literal["bouc-wen", "dahl"] = "bouc-wen",
    ):
        super().__init__(where)
        self.width, self.law = width, law

    @property
    def reads(self):
        return (f"move{self.number}", f"approach{self.number}")

    @classmethod
    def candidates(cls, chain):
        """At every joint that came from both sides, wound up over short and long moves, and by the side of approach."""
        for where in chain.places("joint"):
            number = int(where.rpartition("-")[2])
            if chain.varies(f"approach{number}"):
                yield Variant(cls(where, 0.0), "that grows with the load", _WEIGHT)
            moves = chain.state.covariates.get(f"move{number}", np.zeros(1))
            if not moves.min() < 0 < moves.max():
                continue
            for law, law_words in _LAWS.items():
                word = f"{law_words} within {{:g}} {cls(where).option_unit(chain, 'width')}"
                for width in _WIDTHS:
                    description = (word.format(width), _WEIGHT / len(_LAWS), "", "width", word)
                    yield Variant(cls(where, width, law), *description)

    def option_unit(self, chain, name):
        return "m" if chain.slides(self.number) else "rad"

    def table(self, chain):
        slides = chain.slides(self.number)
        unit, size = ("mm", _HALF_GAP_MM) if slides else ("rad", _HALF_GAP_RAD)
        label = f"joint {self.number}'s hysteresis"
        return (
            self.parameter("wind_up", unit, size, label),
            self.parameter("by_load", unit, size, f"{label}, part that grows with the torque"),
        )

    def basis(self, state):
        wound = self._wound_up(state)
        return np.stack([wound, wound * self._load(state)])[:, None]

    def _wound_up(self, state) -> np.ndarray:
        """(n,) the state of friction."""
        if not self.width:
            return state.covariate(f"approach{self.number}")
        return state.wound_up(self.number, self.width, self.law == "dahl")

    def _load(self, state) -> np.ndarray:
        """(n,) gravity torque over the greatest that all masses can make, without sign: the same on any samples."""
        robot = state.robot
        joint = self.number - 1
        if not robot.mass.any() and not robot.payload_mass:
            return np.abs(bar_torque(state, joint))
        reach = np.abs(robot.geometry[:, 1:3]).sum() * 1e-3
        greatest = STANDARD_GRAVITY * reach * (robot.mass[joint:].sum() + robot.payload_mass)
        return np.abs(state.torque[joint]) / max(greatest, 1.0)


class JointTorque(Effect):
    """A cable, a hose or a spring exerts a torque on joint K that is a smooth function of its own angle.

    Legendre polynomials of degree 1 to 3 on [start, end], the visited angles (rad, mm): compliance times torque. A
    constant torque is a zero offset. A spring balancer makes a harmonic of the first order: both are confounded.
    """

    effect = "joint-torque"
    port = "joint"
    places = ("joint",)
    equation = "dq = sum_j c_j P_j(q), j = 1 ... 3"
    source = "compliance times the torque of dress pack and balancer, to third order in the angle"

    def __init__(self, where: str, start: float, end: float):
        super().__init__(where)
        if end <= start:
            raise InputError(
                f"effect '{self.effect}', options start and end: expected an end after the start, "
                f"found {start:g} and {end:g}; correct them"
            )
        self.start, self.end = start, end

    @property
    def reads(self):
        return (f"q{self.number}",)

    @classmethod
    def candidates(cls, chain):
        """None: an error curve of few terms is the same function of the angle."""
        return ()

    def table(self, chain):
        if chain.slides(self.number):
            unit, size = "mm", 0.03
        else:
            unit, size = "rad", 3e-4
        label = f"joint {self.number}'s deflection by cable or spring"
        return tuple(
            self.parameter(f"p{j}", unit, size / j, f"{label}, degree {j}") for j in (1, 2, 3)
        )

    def basis(self, state):
        angle = state.drive_angles[self.number - 1]
        scaled = np.clip(2 * (angle - self.start) / (self.end - self.start) - 1, -1, 1)
        return np.polynomial.legendre.legvander(scaled, 3).T[1:, None]


class ReadingLattice(Effect):
    """The readings of joint K are rounded to a lattice, so that each joint angle has a rounding error.

    The error itself is not known; it widens the noise by the movement of the point for a step of the lattice:
    variance step^2 / 12 for a uniform error.
    """

    effect = "reading-lattice"
    port = "noise"
    places = ("joint",)
    equation = "log sigma -> log sigma + c, c for rounding errors uniform in one step"
    source = "Widrow & Kollar, Quantization Noise (2008), ch. 3"
    nonnegative = 1

    def __init__(self, where: str, step: Annotated[float, Field(gt=0)]):
        super().__init__(where)
        self.step = step

    @classmethod
    def candidates(cls, chain):
        """None: the readings themselves show it, see `lattice_step`."""
        return ()

    def port_indices(self, chain):
        return (0,)

    def table(self, chain):
        label = f"the growth of the noise by rounding of joint {self.number}"
        return (self.parameter("growth", "1", 0.3, label),)

    def basis(self, state):
        return np.ones((1, 1, state.n))


_LEAST_SHARE = 0.99  # of the readings that lie on the lattice
_MAX_DEVIATION = 0.02  # of a step, that a reading on the lattice is off by
_DECIMALS = 9
_LEAST_DISTINCT = 8


def lattice_step(readings: np.ndarray) -> float | None:
    """Step of the lattice on which readings (n,) lie, in their unit; None where there is none to be seen.

    The step is the smallest difference of distinct readings that divides all others. Readings of which few are
    distinct, such as those of a joint that stays, show none.
    """
    distinct = np.unique(np.round(readings, _DECIMALS))
    if len(distinct) < _LEAST_DISTINCT:
        return None
    gaps = np.diff(distinct)
    step = float(gaps.min())
    for _ in range(8):
        deviation = np.abs(gaps / step - np.round(gaps / step))
        if (deviation < _MAX_DEVIATION).mean() >= _LEAST_SHARE:
            return float((gaps / np.round(gaps / step)).mean())
        step = float(np.min(deviation[deviation >= _MAX_DEVIATION])) * step
        if step < 1e-7:
            return None
    return None


__all__ = ["JointHysteresis", "JointTorque", "ReadingLattice", "lattice_step"]
