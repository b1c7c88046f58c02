"""Errors of a linear drive that repeat with its travel: ball screws, racks and linear scales."""

from typing import Annotated

import numpy as np
from pydantic import Field

from workbench.core.effect import Effect, Grid
from workbench.core.errors import InputError

_SHORTEST_MM, _LONGEST_MM = 2.0, 500.0
"""Shortest pitch of the screws of machines, and the longest circumference of a pinion."""
_LEAST_CYCLES, _MOST_CYCLES = 2.0, 2000.0
"""Over the range of the recording: with fewer the error is a smooth function; a longer axis has a coarser drive."""
_PER_CYCLE = 2
"""Grid frequencies per cycle over the range: between two of them a wave loses a tenth of its power."""
_OF_STATED_PITCH = {1.0: 0.4, 2.0: 0.1}
"""Prior weight of one and two cycles a pitch where the robot file states the pitch; the rest is of the whole grid."""
_TYPICAL_MM = 0.02


class CyclicLeadError(Effect):
    """Joint K has a lead error that is periodic in its travel, as of a ball screw, a rack and pinion or a linear scale.

    `period` in mm of the travel q_K: the pitch of the screw, the circumference or a tooth of the pinion, or a part of
    these. A drive with errors of one and two cycles a pitch has two of these effects.
    """

    effect = "cyclic-lead-error"
    port = "joint"
    places = ("joint",)
    equation = "dq = A cos(2 pi q / period) + B sin(2 pi q / period)"
    source = "travel variation within one revolution: ISO 3408-3 (2006), there V_2pi"
    coexists = True

    def __init__(self, where: str, period: Annotated[float, Field(gt=0)]):
        super().__init__(where)
        self.period = period

    @property
    def reads(self):
        return (f"q{self.number}",)

    def option_unit(self, chain, name):
        return "mm"

    @classmethod
    def candidates(cls, chain):
        """None: `grids` has all periods."""
        return ()

    @classmethod
    def grids(cls, chain):
        """Periods from 2 to 500 mm at every prismatic joint, half of them in its range; the pitch if it is stated."""
        for where in chain.places("joint"):
            number = cls(where, 1.0).number
            if not chain.slides(number):
                continue
            span = float(np.ptp(chain.state.drive_angles[number - 1]))
            pitch = 1 / chain.robot.gear_ratio[number - 1]
            periods, weights = _periods(span, pitch)
            if len(periods):
                yield Grid(
                    cls,
                    where,
                    "period",
                    "period",
                    f"q{number}",
                    periods,
                    weights,
                    _TYPICAL_MM,
                    "period {:g} mm",
                )

    def check(self, chain):
        super().check(chain)
        if not chain.slides(self.number):
            raise InputError(
                f"{self.title}: expected a prismatic joint, found a revolute one; use transmission-harmonic instead"
            )

    def table(self, chain):
        name = f"{self.period:g}".replace(".", "_")  # a point would end the name in the key
        label = f"of joint {self.number}'s lead error of period {self.period:g} mm"
        return tuple(
            self.parameter(f"{wave}{name}", "mm", _TYPICAL_MM, f"the {word} {label}")
            for wave, word in (("cos", "cosine"), ("sin", "sine"))
        )

    def basis(self, state):
        phase = 2 * np.pi * state.drive_angles[self.number - 1] / self.period
        return np.stack([np.cos(phase), np.sin(phase)])[:, None]

    @property
    def title(self):
        return f"{self.effect} of period {self.period:g} mm at {self.where}"


def _periods(span: float, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """Periods (V,) mm, ascending, over a range of `span` mm, and the prior weight of each; the weights add up to 1.

    Evenly spaced in frequency, as likely in each octave. pitch: mm, nan where it is unknown.
    """
    first = max(_LEAST_CYCLES, span / _LONGEST_MM)
    last = min(_MOST_CYCLES, span / _SHORTEST_MM)
    if last <= first:
        return np.zeros(0), np.zeros(0)
    cycles = np.arange(last, first, -1 / _PER_CYCLE)
    periods, weights = span / cycles, 1 / cycles
    weights = weights / weights.sum()
    if np.isfinite(pitch):
        stated = abs(pitch) / np.array(list(_OF_STATED_PITCH))
        share = np.array(list(_OF_STATED_PITCH.values()))
        weights = np.concatenate([weights * (1 - share.sum()), share])
        periods = np.concatenate([periods, stated])
    order = np.argsort(periods)
    return periods[order], weights[order]


__all__ = ["CyclicLeadError"]
