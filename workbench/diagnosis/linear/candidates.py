"""Candidates compared with the residual: laws of the library, families over one option, and smooth functions.

All three are a source of hypotheses. A hypothesis is a source with the `value` of what it leaves open: nothing of a
`Candidate`, the option of a `Scan`, the names of the covariates of a function at a `Site`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from workbench.core.effect import Effect


@dataclass(frozen=True)
class Candidate:
    """One library effect at one place, as columns in addition to the baseline's.

    `effect`, `where`: words of the vocabulary. `label`: distinguishes variants ("order 2", "seated by
    gravity", "from joint 5", ""). `effects`: those that would join the model. `columns` (N, P): whitened
    derivative of the residual at the null. `typical` (P,): prior size of each parameter, in its own unit.
    `family`: candidates that differ only in an option that is searched (order, instant, the other joint) share one, and
    share its prior. `prior_weight`: of this variant, relative to the family's others. `missing_covariate`: one that the
    law needs and the recording does not hold ("temperature"), for which another stands in (time); "" where nothing is
    missing. `coexists`: whether another of the family may act at the same time (a second order), or they exclude one
    another (a gap has one law). `positive`: how many of its first parameters cannot be negative (a compliance deflects
    along its load). `load`: RMS torque or moment (N m) under which an elastic law deflects; 0 of all others. `option`,
    `word`: as of `Variant`. `is_exact`: whether it was made for the value of the option that the data determine.
    `largest`: of its first parameter, in typical sizes.
    """

    effect: str
    where: str
    label: str
    effects: tuple[Effect, ...]
    columns: np.ndarray
    typical: np.ndarray
    family: str
    prior_weight: float = 1.0
    missing_covariate: str = ""
    coexists: bool = False
    positive: int = 0
    load: float = 0.0
    option: str = ""
    word: str = ""
    is_exact: bool = False
    largest: float = np.inf
    smooth_covariates = ()

    @property
    def key(self) -> tuple:
        """Its name, the same at every solution."""
        return "candidate", self.effect, self.where, self.label

    def columns_at(self, problem, value: None = None) -> np.ndarray:
        """(N, P) whitened columns in typical sizes."""
        return self.columns * self.typical


@dataclass(frozen=True)
class Scan:
    """A family of candidates with one option on a fine grid, never held as columns all at once.

    `kind` "step": columns rows * (x > option); "wave": rows * cos(option x), rows * sin(option x); "period": those of
    2 pi x / option.
    `rows` (k, N): whitened derivatives of the components that move together (k = 1 at a joint). `x` (n,): covariate.
    `options` (V,): ascending; `prior_weight` (V,) of each, relative to the others. `typical` (k,): prior size of an
    amplitude in the port's unit. `make` gives the effects for an option. `word`: format string of the labels
    ("order {:g}", "after {:g}").
    `smooth_covariates`: the covariates it would depend on, for a smooth nonparametric family. `centred`: as of `Grid`.
    `option`: name of the option where it is a real number and no integer, else "". `is_exact`: whether it was
    made for the single value that the data determine.
    """

    effect: str
    where: str
    kind: str
    rows: np.ndarray
    x: np.ndarray
    options: np.ndarray
    prior_weight: np.ndarray
    typical: np.ndarray
    family: str
    make: Callable[[float], tuple[Effect, ...]]
    word: str = ""
    smooth_covariates: tuple[str, ...] = ()
    coexists: bool = False
    centred: bool = False
    option: str = ""
    is_exact: bool = False
    missing_covariate = ""
    positive = 0

    @property
    def key(self) -> tuple:
        """Its name, the same at every solution."""
        name = ("scan", self.effect, self.where, self.kind, self.family, self.word)
        if self.is_exact:
            return (*name, float(self.options[0]))
        return name

    def columns_at(self, problem, value: float) -> np.ndarray:
        """(N, P) whitened columns in typical sizes for one value of the option."""
        if self.kind == "step":
            waves = step_function(self.x, value, self.centred)
        else:
            waves = self.waves(np.array([value]))[0]
        return _function_columns(self, waves, problem)

    def waves(self, options: np.ndarray) -> np.ndarray:
        """(V, 2, n) cosines and sines for values (V,) of the option."""
        if self.kind == "period":
            rates = 2 * np.pi / options
        else:
            rates = options
        phase = rates[:, None] * self.x
        return np.stack([np.cos(phase), np.sin(phase)], 1)

    def cycles(self, value: float) -> float:
        """Cycles over the range of the covariate of a wave with one value of the option; 0 of a step."""
        if self.kind == "step":
            return 0.0
        if self.kind == "wave":
            phase = value * np.ptp(self.x)
        else:
            phase = 2 * np.pi * np.ptp(self.x) / value
        return float(phase / (2 * np.pi))

    def with_exact_option(self, value: float) -> "Scan":
        """The family of one value, which has the prior weight of the nearest one."""
        distance = np.abs(self.options - value)
        nearest = int(np.argmin(distance))
        weight = self.prior_weight[nearest : nearest + 1]
        options = np.array([value])
        return replace(self, options=options, prior_weight=weight, is_exact=True)


@dataclass(frozen=True)
class Site:
    """A place where something unnamed may act.

    `where`: a word of the vocabulary; `port`: the port there; `rows` (k, N): whitened derivatives of
    its k components; `unit`: of the components, one a component or one for all; `typical` (k,): the size that a
    disturbance of each component would have before measuring. `covariates`: names of those that a
    smooth function here may depend on, one at a time; `pairs`: two at a time.
    """

    where: str
    port: str
    rows: np.ndarray
    unit: str
    typical: np.ndarray
    covariates: tuple[str, ...]
    pairs: tuple[tuple[str, str], ...] = ()
    option = ""
    positive = 0

    @property
    def resolution(self) -> int:
        """Resolution of smooth functions on this recording, see `robot_model.effects.nonparametric.functions`."""
        return int(len(self.rows) == 1)

    @property
    def key(self) -> tuple:
        """Its name, the same at every solution."""
        return "site", self.where, self.port

    def columns_at(self, problem, value: tuple[str, ...]) -> np.ndarray:
        """(N, P) whitened columns, in prior sizes, of the smooth functions of the covariates named."""
        waves, sizes = problem.functions_of(value, self.resolution)
        return _function_columns(self, waves * sizes[:, None], problem)


Source = Candidate | Scan | Site


def step_function(x: np.ndarray, option: float, centred: bool) -> np.ndarray:
    """(1, n) a step of x (n,) after an option."""
    step = (x > option).astype(float)
    return (step - centred * step.mean())[None]


def _function_columns(place: Scan | Site, functions: np.ndarray, problem) -> np.ndarray:
    """(N, k V) columns of functions (V, E n) of the arm poses on every component of a place."""
    functions = functions[:, problem.ends.numbers(problem.sample)]
    scaled_rows = place.typical[:, None, None] * place.rows[:, None]
    columns = problem.ends.joined(scaled_rows * functions)
    by_number = columns.reshape(-1, len(problem.sample))
    return by_number.T
