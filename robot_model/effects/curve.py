"""Any function of one joint's own angle: transmission errors without a stated order, encoders, worn gears."""

from dataclasses import asdict, dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field

from robot_model.effects.extrapolation import (
    distance_beyond,
    extrapolation_sigma,
    grid_points,
)
from robot_model.effects.transmission import WITHOUT_HOSE, TransmissionHarmonic
from workbench.core.effect import Effect, Variant
from workbench.core.errors import InputError

MARGIN = 0.05
"""Share of the visited span by which the domain of a curve exceeds it on either side."""
MOST_TERMS = 63
_LEAST_TERMS = 3
_TERMS = (3, 7, 15, 31, 63)
_RESOLVED = 0.6  # share of the poses that must lie in adjacent visited half waves
_OCCUPIED = 0.25  # share of all half waves that must be visited: a spectrum of what the prior bridges is the prior's
_VISITS = 2  # poses within a half wave that count as a visit
_NUMBERS_PER_TERM = 4  # measured numbers per coefficient of all curves together
_SAME_POSE = 4  # decimals of rad or mm
_MOVES = {"rad": 0.2, "mm": 20.0}  # travel below which a curve is the zero offset
_TYPICAL = {"rad": 3e-4, "mm": 0.02}
_WIDEST = 3.0  # typical sizes: what a term may be, 1 sigma
_GRID = 4096
_SIGNIFICANT_SLOPE = (
    5.0  # standard deviations: the gear constant of a robot is not doubted for less
)
_LEFT = 0.05  # share of a curve's variance below which further cycles are not stated
LEAST_SCALE = 1e-3
"""Slope from which a straight error is a reading in a wrong scale: over less than a radian, gears, encoders and gravity
make slopes of some 0.1 mrad/rad."""
_MOST_PER_MOTOR = 4  # cycles per revolution of a motor that gears and encoders make
_REPEATS = 2  # periods on the visited angles from which on a sinusoid repeats
_OVERSAMPLING = 8  # candidate orders per cycle over the domain


class JointCurve(Effect):
    """Joint K has an error that is a function of its own angle, periodic or not, such as that of a gear or an encoder.

    A cosine series on [start, end] (rad; mm of a slide) with zero slope at both ends; outside of the interval the
    curve is constant. The constant term is left to the zero offset. A domain that is a little wider than the visited
    angles leaves the slope at their ends free. The typical size of a term falls with the square root of its number,
    so that the curve is smooth unless the data say otherwise.
    """

    effect = "joint-curve"
    subsumes = (TransmissionHarmonic.effect,)
    port = "joint"
    places = ("joint",)
    stage = "joint curves"
    distinguished_by = WITHOUT_HOSE
    equation = "dq = sum_j c_j cos(j pi u), u = (q_K - start) / (end - start), j = 1 ... terms"
    source = "Hilbert-space approximation of a Gaussian process: Solin & Sarkka, Stat. Comput. 30 (2020) 419"

    def __init__(
        self,
        where: str,
        start: float,
        end: float,
        terms: Annotated[int, Field(ge=1, le=256)] = 16,
    ):
        super().__init__(where)
        if end <= start:
            raise InputError(
                f"effect '{self.effect}', options start and end: expected an end after the start, "
                f"found {start:g} and {end:g}; correct them"
            )
        self.start, self.end, self.terms = start, end, terms

    @property
    def reads(self):
        return (f"q{self.number}",)

    @classmethod
    def candidates(cls, chain):
        """At every joint that moves, at each resolution that the visited angles support.

        The torque of a cable or a spring deflects a joint by a smooth function of its angle, too: a curve of few terms.
        """
        for finest in curve_candidates(chain):
            for terms in _TERMS:
                if terms <= finest.terms:
                    curve = cls(finest.where, finest.start, finest.end, terms)
                    yield Variant(curve, f"of {terms} terms")

    def table(self, chain):
        unit = "mm" if chain.slides(self.number) else "rad"
        table = []
        for j in range(1, self.terms + 1):
            typical = _TYPICAL[unit] / np.sqrt(j)
            label = f"joint {self.number}'s error curve, term {j}"
            table.append(self.parameter(f"c{j}", unit, typical, label, _WIDEST * typical))
        return tuple(table)

    def basis(self, state):
        return self.cosines(state.drive_angles[self.number - 1])[:, None]

    def extrapolation(self, p, state, recorded=None):
        """(1, n) from the structure function of the curve on the recorded angles.

        The margins of the domain are no part of them, since the series has zero slope at its ends, whatever the data.
        """
        low, high = self.supported(recorded)
        grid = np.linspace(low, high, grid_points(self.terms))
        distance = distance_beyond(state.drive_angles[self.number - 1], low, high)
        return extrapolation_sigma(self.curve(p, grid)[None], high - low, distance)

    def supported(self, recorded=None) -> tuple[float, float]:
        """Lowest and highest recorded angle (rad; mm of a slide) in the domain, as `Effect.extrapolation` has them.

        Where they are unknown, or outside of the domain: the domain less the margins that `curve_options` adds.
        """
        margin = MARGIN / (1 + 2 * MARGIN) * (self.end - self.start)
        inner = self.start + margin, self.end - margin
        low, high = (recorded or {}).get(f"q{self.number}", inner)
        low = max(low, self.start)
        high = min(high, self.end)
        return (low, high) if low < high else inner

    def cosines(self, angle: np.ndarray) -> np.ndarray:
        """(terms, n) the terms of the series at joint variables (n,) in rad or mm."""
        u = np.clip((angle - self.start) / (self.end - self.start), 0.0, 1.0)
        return np.cos(np.pi * np.arange(1, self.terms + 1)[:, None] * u)

    def shrinkage_groups(self) -> tuple[str, ...]:
        """One group per joint and octave of the term's number: each has a prior scale of its own."""
        return tuple(f"{self.where} octave {j.bit_length()}" for j in range(1, self.terms + 1))

    def curve(self, coefficients: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """(n,) error in rad (mm) at joint variables (n,), for coefficients (terms,)."""
        return np.asarray(coefficients) @ self.cosines(np.asarray(angle, float))

    @property
    def title(self):
        return f"{self.effect} of {self.terms} terms at {self.where}"


@dataclass(frozen=True)
class Cycle:
    """A sinusoid in a curve: `order` cycles per revolution (per mm of a slide), `amplitude` in rad or mm.

    `per_motor_revolution`: the number of cycles per revolution of the motor that the order agrees with, where the
    gear ratio is known; None where it agrees with none.
    """

    order: float
    amplitude: float
    per_motor_revolution: int | None = None


def dominant_cycles(
    effect: JointCurve, coefficients: np.ndarray, count: int = 4, gear_ratio: float = np.nan
) -> list[Cycle]:
    """The sinusoids that make most of a curve on its domain, largest first.

    gear_ratio: motor revolutions per revolution of the joint, nan where it is unknown.
    """
    error = effect.curve(coefficients, _grid(effect))
    return _cycles(effect, error, count, gear_ratio)


def periodic_share(effect: JointCurve, coefficients: np.ndarray, cycles: list[Cycle]) -> float:
    """Share (0-1) of a curve's variance that is made by those of its cycles that repeat on its domain.

    Any curve has a spectrum. A sinusoid with less than two periods on the domain describes a bend, and no period.
    """
    error = effect.curve(coefficients, _grid(effect))
    angle = _grid(effect)
    min_frequency = 2 * np.pi * _REPEATS / float(np.ptp(angle))
    columns = [np.ones(_GRID)]
    for cycle in cycles:
        if cycle.order >= min_frequency:
            columns += [np.cos(cycle.order * angle), np.sin(cycle.order * angle)]
    basis = np.stack(columns, 1)
    remainder = error - basis @ np.linalg.lstsq(basis, error, rcond=None)[0]
    return float(np.clip(1 - remainder.var() / max(error.var(), 1e-300), 0.0, 1.0))


@dataclass(frozen=True)
class ReadingScale:
    """A joint reading is `factor` times the motion of its joint, with the standard deviation `std` of this factor."""

    factor: float
    std: float


def reading_scale(
    laws: np.ndarray, coefficients: np.ndarray, covariance: np.ndarray, angle: np.ndarray
) -> ReadingScale | None:
    """The scale of a reading whose error is a straight line on the visited angles (n,); None for every other error.

    laws (k, n): all terms of the error of a joint that are functions of its own angle, with coefficients (k,) and their
    covariance (k, k). The line leaves at most 5 % of the variance of the error, and its slope is significant: a long
    wave that is poorly determined is nearly a straight line, too.
    """
    centred = angle - angle.mean()
    weights = laws @ centred / max(float(centred @ centred), 1e-300)
    slope = float(weights @ coefficients)
    error = coefficients @ laws
    remainder = error - error.mean() - slope * centred
    if abs(slope) < LEAST_SCALE or remainder.var() > _LEFT * error.var():
        return None
    std = float(np.sqrt(weights @ covariance @ weights))
    if abs(slope) < _SIGNIFICANT_SLOPE * std:
        return None
    factor = 1 / (1 + slope)
    return ReadingScale(factor, factor**2 * std)


def _grid(effect: JointCurve) -> np.ndarray:
    """(_GRID,) angles of the domain without its margins."""
    margin = MARGIN * (effect.end - effect.start)
    return np.linspace(effect.start + margin, effect.end - margin, _GRID)


def _cycles(
    effect: JointCurve, error: np.ndarray, count: int = 4, gear_ratio: float = np.nan
) -> list[Cycle]:
    """The sinusoids that make most of an error (_GRID,) at the angles of `_grid`, largest first.

    Matching pursuit (Mallat & Zhang, IEEE Trans. Signal Process. 41 (1993) 3397) over sinusoids from half a cycle per
    domain to the resolution of the series; it ends where less than 5 % of the variance is left.
    """
    span = effect.end - effect.start
    angle = _grid(effect)
    remainder = error - error.mean()
    total_power = float(remainder @ remainder)
    step = 2 * np.pi / span / _OVERSAMPLING
    frequencies = np.arange(_OVERSAMPLING / 2, _OVERSAMPLING * (effect.terms / 2 + 1)) * step
    phases = np.exp(1j * frequencies[:, None] * angle)
    cycles: list[Cycle] = []
    while len(cycles) < count and float(remainder @ remainder) > _LEFT * max(total_power, 1e-300):
        best = int(np.argmax(np.abs(phases @ remainder)))
        columns = np.stack([phases[best].real, phases[best].imag, np.ones(_GRID)], 1)
        fitted = np.linalg.lstsq(columns, remainder, rcond=None)[0]
        remainder = remainder - columns @ fitted
        order = float(frequencies[best])
        of_motor = _of_motor(order, gear_ratio, np.pi / span)
        cycles.append(Cycle(order, float(np.hypot(fitted[0], fitted[1])), of_motor))
    return sorted(cycles, key=lambda cycle: -cycle.amplitude)


def _of_motor(order: float, gear_ratio: float, resolution: float) -> int | None:
    """Cycles per revolution of the motor (1 to 4) of an order that is known to `resolution`; None where none agrees."""
    if not np.isfinite(gear_ratio) or abs(gear_ratio) < 2 * resolution:
        return None
    multiple = round(order / abs(gear_ratio))
    agrees = abs(order - multiple * abs(gear_ratio)) <= resolution
    return multiple if agrees and 1 <= multiple <= _MOST_PER_MOTOR else None


def resolved_terms(angle: np.ndarray, numbers: int) -> int:
    """Terms of a curve that the visited angles (n,) and a budget of measured numbers support; 0 where none.

    3, 7, 15, 31 or 63, which are complete octaves: most poses lie in a half wave of the highest term that is visited,
    next to one that is visited, too. It is the poses that count and not the half waves: a few poses far from the others
    leave a gap, which the prior bridges, and take nothing from the resolution where the others are.
    """
    low = float(angle.min())
    high = float(angle.max())
    terms = MOST_TERMS
    while terms >= _LEAST_TERMS:
        visits = np.histogram(angle, bins=terms + 1, range=(low, high))[0]
        is_visited = np.pad(visits >= _VISITS, 1)
        has_neighbour = is_visited[:-2] | is_visited[2:]
        resolved = visits[is_visited[1:-1] & has_neighbour].sum() / visits.sum()
        is_visited_enough = resolved >= _RESOLVED and is_visited[1:-1].mean() >= _OCCUPIED
        if is_visited_enough and terms * _NUMBERS_PER_TERM <= numbers:
            return terms
        terms //= 2
    return 0


def curve_options(angle: np.ndarray, terms: int) -> dict:
    """Options of a `JointCurve` of a joint with visited angles (n,) in rad (mm)."""
    low = float(angle.min())
    high = float(angle.max())
    margin = MARGIN * (high - low)
    return {
        "start": float(np.round(low - margin, 6)),
        "end": float(np.round(high + margin, 6)),
        "terms": terms,
    }


def curve_candidates(chain) -> list[JointCurve]:
    """A curve for each joint that moves, at the resolution that the visited angles support."""
    poses = np.round(
        chain.state.drive_angles, _SAME_POSE
    )  # repeats count once, several reflectors of a pose do not
    visited = np.unique(poses, axis=1)
    rows = np.unique(np.concatenate([poses, chain.state.index[None]]), axis=1).shape[1]
    joints = chain.robot.joints
    numbers = chain.sigma.shape[0] * rows // joints
    curves = []
    for k in range(1, joints + 1):
        angle = visited[k - 1]
        if np.ptp(angle) < _MOVES["mm" if chain.slides(k) else "rad"]:
            continue
        terms = resolved_terms(angle, numbers)
        if terms:
            curves.append(JointCurve(f"joint-{k}", **curve_options(angle, terms)))
    return curves


def describe_curves(model, parameters) -> list[dict]:
    """One row per joint with an error curve: size on the visited angles and dominant cycles of its complete error.

    The complete error is the sum of all terms that are functions of the joint's own angle, such as the curve and
    transmission-error harmonics. Over less than a revolution these nearly cancel, and each alone is not determined.

    Keys: `where`, `unit` (rad or mm), `rms` (without the mean), `terms`, and `cycles`: `order` in cycles per revolution
    (per mm of a slide), `amplitude` and `per_motor_revolution` (None where unknown), largest first.
    """
    rows = []
    for effect, span in zip(model.effects, model.spans):
        if not isinstance(effect, JointCurve):
            continue
        error = _own_error(
            model, parameters, effect.number, model.chain.state.drive_angles[effect.number - 1]
        )
        ratio = model.chain.robot.gear_ratio[effect.number - 1]
        on_grid = _own_error(model, parameters, effect.number, _grid(effect))
        cycles = _cycles(effect, on_grid, gear_ratio=float(ratio))
        rows.append(
            {
                "where": effect.where,
                "unit": parameters.table[span.start].unit,
                "rms": float(error.std()),
                "terms": effect.terms,
                "cycles": [asdict(cycle) for cycle in cycles],
            }
        )
    return rows


def _own_error(model, parameters, joint: int, angle: np.ndarray) -> np.ndarray:
    """(n,) error of a joint (rad; mm of a slide) at its angles (n,): all terms that read nothing but this angle."""
    robot = model.chain.robot
    drives = np.zeros((robot.joints, len(angle)))
    drives[joint - 1] = angle
    coupling = robot.coupling
    variables = drives if coupling is None else coupling @ drives
    state = replace(model.chain.state, variables=variables)
    error = np.zeros(len(angle))
    for effect, span in zip(model.effects, model.spans):
        at_joint = effect.port == "joint" and effect.where == f"joint-{joint}"
        if at_joint and tuple(effect.reads) == (f"q{joint}",):
            error += parameters.values[span] @ effect.basis(state)[:, 0]
    return error


__all__ = [
    "Cycle",
    "JointCurve",
    "curve_options",
    "describe_curves",
    "dominant_cycles",
    "periodic_share",
    "reading_scale",
    "resolved_terms",
]
