"""Rivals without a name: smooth functions of one or two covariates at a port.

Whatever no row of the library makes must not get the name of the row that is least bad. So beside
every named effect there stands, at every place, 'a smooth function of this covariate', with a prior
that is broad in shape and size; the evidence then charges it for every number that it spends.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from workbench.core.effect import Effect
from workbench.core.parameters import Parameter

_DEGREE, _LONG_DEGREE, _PAIR_DEGREE = 6, 9, 3
_FINE_DEGREE, _FINE_PAIR = (
    15,
    5,
)  # where but one number moves, as at a joint, a finer function can be afforded
SHARP_DEGREE = 40
"""Degree of a function that changes sharply: what is worn at a place is worn over a twentieth of the way."""
# covariates whose sign alone may matter: the side that it came from, or that it is loaded on
_SIGNED = ("move", "tau", "down", "moment")
_SHARP = (20.0, 200.0)  # of a half span: how soon a sign is fully felt


@dataclass(frozen=True)
class Function:
    """A fitted function at a site: `x` names -> grids, `value` (k, grid) in the slots' unit, `std` alike."""

    names: tuple[str, ...]
    x: np.ndarray
    value: np.ndarray
    std: np.ndarray
    unit: str


def functions(
    names: tuple[str, ...], values, spans, fine: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(V, n) functions of one or two covariates, and (V,) their prior sizes, the wavier the smaller.

    names: of the covariates; values: (n,) each; spans: (least, most) each, that the functions live on.
    Legendre polynomials on the span without the constant; products of them for two covariates; for a
    covariate with two values only itself. fine: 1 of higher degree, for a place where one number moves;
    2 of so high a degree that it may change sharply.
    """
    # beyond its span a function stays as it is at the end: what was not measured is not extrapolated
    scaled = [
        np.clip(2 * (x - a) / max(b - a, 1e-300) - 1, -1, 1) for x, (a, b) in zip(values, spans)
    ]
    if len(names) == 2:
        return _pair(
            *scaled, [_degree(name, fine) for name in names], _FINE_PAIR if fine else _PAIR_DEGREE
        )
    degree = _degree(names[0], fine)
    waves, sizes = legvander(scaled[0], degree).T[1:], 1 / np.arange(1, degree + 1)
    if names[0].startswith(_SIGNED) and spans[0][0] < 0 < spans[0][1]:
        half = (spans[0][1] - spans[0][0]) / 2
        waves = np.concatenate(
            [waves, *(np.tanh(sharp * values[0] / half)[None] for sharp in _SHARP)]
        )
        sizes = np.append(sizes, np.ones(len(_SHARP)))
    return waves, sizes


def _degree(name, fine):
    if name.startswith("approach"):
        return 1
    if name == "payload":
        return 2
    if name == "time" or name[0] == "q":
        return (_LONG_DEGREE, _FINE_DEGREE, SHARP_DEGREE)[fine]
    return _DEGREE


def _pair(a, b, most, together):
    degrees = [(i, j) for i in range(together + 1) for j in range(together + 1 - i)]
    degrees = [(i, j) for i, j in degrees if i + j > 0 and i <= most[0] and j <= most[1]]
    first, second = legvander(a, together).T, legvander(b, together).T
    waves = np.stack([first[i] * second[j] for i, j in degrees])
    return waves, np.array([1 / (i + j) for i, j in degrees])


class Smooth(Effect):
    """A smooth function of covariates at a place: what an unknown becomes in the model."""

    effect = "unknown"
    equation = "slot = sum_k c_k L_k(x), Legendre polynomials on the span of the covariate"
    source = "regression on an orthogonal basis"

    def __init__(
        self,
        where: str,
        port: str,
        names: tuple[str, ...],
        spans: tuple,
        unit: str,
        sizes: tuple,
        sharp: bool = False,
    ):
        super().__init__(where)
        self.port, self.names, self.spans, self.unit, self.sizes = port, names, spans, unit, sizes
        self.sharp = sharp

    @property
    def _fine(self) -> int:
        return 2 if self.sharp else int(len(self.sizes) == 1)

    def table(self, chain):
        _, shrink = functions(self.names, [np.zeros(1)] * len(self.names), self.spans, self._fine)
        about = "_".join(self.names)
        return tuple(
            Parameter(
                f"{self.where}.unknown.{about}_{s}_{v}",
                self.unit,
                0.0,
                size * w,
                f"the unknown at {self.where}, term {v + 1}",
                30 * size * w,
            )
            for s, size in enumerate(self.sizes)
            for v, w in enumerate(shrink)
        )

    def basis(self, state):
        waves, _ = functions(
            self.names, [state.covariate(name) for name in self.names], self.spans, self._fine
        )
        slots = len(self.sizes)
        return np.einsum("st,vn->svtn", np.eye(slots), waves).reshape(
            slots * len(waves), slots, state.n
        )


class Wave(Effect):
    """A place moves to and fro in time, `rate` rad a unit of the clock: a neighbour's cycle."""

    effect = "unknown"
    port = "frame"
    equation = "slot = a cos(rate t) + b sin(rate t)"
    source = "regression on one period"
    names = ("time",)

    def __init__(self, where: str, rate: float, units: tuple[str, ...], sizes: tuple[float, ...]):
        super().__init__(where)
        self.rate, self.units, self.sizes = rate, units, sizes

    def table(self, chain):
        return tuple(
            Parameter(
                f"{self.where}.unknown.{wave}_{self.rate:g}_{slot}",
                unit,
                0.0,
                size,
                f"the {wave} of {self.where}'s movement, slot {slot + 1}",
                30 * size,
            )
            for slot, (unit, size) in enumerate(zip(self.units, self.sizes))
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        phase = self.rate * state.covariate("time")
        slots = len(self.sizes)
        waves = np.stack([np.cos(phase), np.sin(phase)])
        return np.einsum("st,vn->svtn", np.eye(slots), waves).reshape(2 * slots, slots, state.n)
