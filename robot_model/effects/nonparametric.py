"""Smooth functions of covariates at a place: terms without a physical law, which a diagnosis can add to a model.

A term is a linear combination of fixed functions of one or two covariates. Its parameters are the coefficients, so
that it is solved, stored and used like every other effect.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.polynomial.legendre import legvander
from pydantic import Field

from robot_model.derived_covariates import covariate
from robot_model.effects.extrapolation import (
    distance_beyond,
    extrapolation_sigma,
    grid_points,
)
from robot_model.effects.instrument import sight_directions
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter

PLACES = ("joint", "link", "base", "tool", "sensor", "instrument")
SHARP_DEGREE = 40
"""Degree of a function that changes sharply: wear at one place extends over a twentieth of the range."""
_DEGREE = 6
_LONG_DEGREE = 9
_PAIR_DEGREE = 3
# Only one number moves at a joint, so that a finer function can be afforded there.
_FINE_DEGREE, _FINE_PAIR = 15, 5
# Covariates whose sign alone may matter: the side of approach, or the side that is loaded.
_SIGNED = ("move", "tau", "down", "moment")
# Shares of a half span after which a sign is fully felt.
_SHARPNESS = (20.0, 200.0)
_COARSE = 17  # grid points of the covariate over which a structure function is averaged

Port = Literal["joint", "frame", "geometry", "sensor"]
Span = Annotated[list[float], Field(min_length=2, max_length=2)]


def functions(
    names: tuple[str, ...], values, spans, fine: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(V, n) functions of one or two covariates, and (V,) their prior sizes, which fall with the degree.

    names: of the covariates; values: (n,) each; spans: (least, most) each, the range of the functions.
    Legendre polynomials on the span without the constant; products of them for two covariates; for a
    covariate with two values only itself. fine: 1 of higher degree, for a place where one number moves;
    2 of so high a degree that the function may change sharply. Beyond its span a function keeps its value at
    the end: it does not extrapolate.
    """
    scaled = [
        np.clip(2 * (x - low) / max(high - low, 1e-300) - 1, -1, 1)
        for x, (low, high) in zip(values, spans)
    ]
    if len(names) == 2:
        degrees = [_degree(name, fine) for name in names]
        return _pair(*scaled, degrees, _FINE_PAIR if fine else _PAIR_DEGREE)
    degree = _degree(names[0], fine)
    waves = legvander(scaled[0], degree).T[1:]
    sizes = 1 / np.arange(1, degree + 1)
    low, high = spans[0]
    if names[0].startswith(_SIGNED) and low < 0 < high:
        half = (high - low) / 2
        signs = [np.tanh(sharpness * values[0] / half)[None] for sharpness in _SHARPNESS]
        waves = np.concatenate([waves, *signs])
        sizes = np.append(sizes, np.ones(len(_SHARPNESS)))
    return waves, sizes


def _degree(name: str, fine: int) -> int:
    if name.startswith("approach"):
        return 1
    if name == "payload":
        return 2
    if name == "time" or name[0] == "q":
        return (_LONG_DEGREE, _FINE_DEGREE, SHARP_DEGREE)[fine]
    return _DEGREE


def _pair(a, b, max_degree, max_sum):
    """(V, n) products of Legendre polynomials of a and b (n,), and their prior sizes (V,).

    max_degree: the degree of each; max_sum: that of a product.
    """
    first, second = np.indices((max_sum + 1, max_sum + 1)).reshape(2, -1)
    degree = first + second
    is_kept = (
        (degree > 0) & (degree <= max_sum) & (first <= max_degree[0]) & (second <= max_degree[1])
    )
    first, second = first[is_kept], second[is_kept]
    of_a = legvander(a, max_sum).T
    of_b = legvander(b, max_sum).T
    return of_a[first] * of_b[second], 1 / degree[is_kept]


class SmoothFunction(Effect):
    """A part of the machine errs by a smooth function of one or two covariates, without a physical law.

    `names` of the covariates, recorded or derived from the readings; `spans` their lowest and highest value; `unit` of
    the port's components; `sizes` expected size of each component before measuring; `sharp`: the function may change
    sharply.
    """

    effect = "unknown"
    port = "joint"  # that of a term is its own option
    places = PLACES
    equation = "component = sum_k c_k L_k(x), Legendre polynomials on the span of the covariate"
    source = "regression on an orthogonal basis"

    def __init__(
        self,
        where: str,
        port: Port,
        names: list[str],
        spans: list[Span],
        unit: str,
        sizes: list[float],
        sharp: bool = False,
    ):
        super().__init__(where)
        if not 1 <= len(names) <= 2 or len(spans) != len(names):
            raise InputError(
                f"{self.effect} at {where}, options names and spans: expected one or two covariates with a "
                f"span each, found {len(names)} and {len(spans)}; correct them"
            )
        self.port, self.names, self.unit, self.sharp = port, tuple(names), unit, sharp
        self.spans = tuple((float(low), float(high)) for low, high in spans)
        self.sizes = tuple(float(size) for size in sizes)

    @classmethod
    def candidates(cls, chain):
        """None: a search for smooth functions has its own list of places and covariates."""
        return ()

    @property
    def options(self) -> dict:
        """Its constructor's options as lists, which every file format holds."""
        return {
            "port": self.port,
            "names": list(self.names),
            "spans": [list(span) for span in self.spans],
            "unit": self.unit,
            "sizes": list(self.sizes),
            "sharp": self.sharp,
        }

    @property
    def title(self) -> str:
        return f"smooth function of {' and '.join(self.names)} at {self.where}"

    @property
    def _fine(self) -> int:
        if self.sharp:
            return 2
        return int(len(self.sizes) == 1)

    def table(self, chain):
        """One coefficient a component and function; its prior falls with the degree of the function."""
        zeros = [np.zeros(1)] * len(self.names)
        _, shrink = functions(self.names, zeros, self.spans, self._fine)
        names_of_key = "_".join(self.names)
        return tuple(
            Parameter(
                f"{self.where}.unknown.{names_of_key}_{component}_{term}",
                self.unit,
                0.0,
                size * share,
                f"the smooth function at {self.where}, term {term + 1}",
                30 * size * share,
            )
            for component, size in enumerate(self.sizes)
            for term, share in enumerate(shrink)
        )

    def port_indices(self, chain):
        """All components of the place, or the first ones where it has more components than sizes."""
        return super().port_indices(chain)[: len(self.sizes)]

    def basis(self, state):
        """(components x functions, components, n); the components of an instrument are azimuth, elevation and range."""
        waves = self._waves([covariate(state, name) for name in self.names])
        if self.where != "instrument":
            return waves
        return np.einsum("pkn,kcn->pcn", waves, sight_directions(state.measured))

    def extrapolation(self, p, state, recorded=None):
        """(components, n) from the structure functions along each covariate, whose spans are what was recorded."""
        squares = np.zeros((len(self.sizes), state.n))
        for axis, ((low, high), name) in enumerate(zip(self.spans, self.names)):
            distance = distance_beyond(covariate(state, name), low, high)
            if distance.any():
                values = self._on_grid(p, axis)
                squares += extrapolation_sigma(values, high - low, distance) ** 2
        return np.sqrt(squares)

    def _on_grid(self, p, axis: int) -> np.ndarray:
        """(components, G) on a grid over the span; (components, F, G) for two covariates, the last one along `axis`."""
        grids = [np.linspace(low, high, _COARSE) for low, high in self.spans]
        grids[axis] = np.linspace(*self.spans[axis], grid_points(SHARP_DEGREE))
        values = np.meshgrid(*grids, indexing="ij")
        waves = self._waves([coordinates.ravel() for coordinates in values])
        shaped = np.tensordot(p, waves, 1).reshape(len(self.sizes), *values[0].shape)
        return np.moveaxis(shaped, 1 + axis, -1)

    def _waves(self, values) -> np.ndarray:
        """(components x functions, components, n) of covariates (n,) each."""
        waves, _ = functions(self.names, values, self.spans, self._fine)
        count = len(self.sizes)
        components = np.einsum("st,vn->svtn", np.eye(count), waves)
        return components.reshape(count * len(waves), count, waves.shape[1])


class PeriodicMotion(Effect):
    """The base moves periodically in time, `rate` rad per unit of the clock, like a cycle of a neighbouring machine."""

    effect = "unknown"
    port = "frame"
    places = ("base",)
    equation = "component = a cos(rate t) + b sin(rate t)"
    source = "regression on one period"
    names = ("time",)

    def __init__(self, where: str, rate: float, units: list[str], sizes: list[float]):
        super().__init__(where)
        self.rate, self.units = float(rate), tuple(units)
        self.sizes = tuple(float(size) for size in sizes)

    @classmethod
    def candidates(cls, chain):
        """None: the rate is searched for on a fine grid."""
        return ()

    def option_unit(self, chain, name):
        return "rad/s" if "time_s" in chain.state.covariates else "rad/sample"

    @property
    def options(self) -> dict:
        """Its constructor's options as lists, which every file format holds."""
        return {"rate": self.rate, "units": list(self.units), "sizes": list(self.sizes)}

    def table(self, chain):
        """A cosine and a sine amplitude a component."""
        rate = f"{self.rate:g}".replace(".", "_")  # a point would end the name in the key
        return tuple(
            Parameter(
                f"{self.where}.unknown.{wave}_{rate}_{component}",
                unit,
                0.0,
                size,
                f"the {wave} of {self.where}'s movement, component {component + 1}",
                30 * size,
            )
            for component, (unit, size) in enumerate(zip(self.units, self.sizes))
            for wave in ("cos", "sin")
        )

    def basis(self, state):
        """(2 x components, components, n)."""
        return self._waves(covariate(state, "time"))

    def extrapolation(self, p, state, recorded=None):
        """(components, n) from the structure function over the recorded time: the rate is known only within it."""
        low, high = (recorded or {}).get("time", (-np.inf, np.inf))
        distance = distance_beyond(covariate(state, "time"), low, high)
        if not distance.any():
            return None
        cycles = int(self.rate * (high - low) / np.pi) + 1
        grid = np.linspace(low, high, grid_points(cycles))
        values = np.tensordot(p, self._waves(grid), 1)
        return extrapolation_sigma(values, high - low, distance)

    def _waves(self, time: np.ndarray) -> np.ndarray:
        """(2 x components, components, n) at times (n,)."""
        count = len(self.sizes)
        waves = np.stack([np.cos(self.rate * time), np.sin(self.rate * time)])
        components = np.einsum("st,vn->svtn", np.eye(count), waves)
        return components.reshape(2 * count, count, len(time))


__all__ = ["SHARP_DEGREE", "PeriodicMotion", "SmoothFunction", "functions"]
