"""Result of a calibration: parameters with their identifiability, residuals, provenance."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from workbench.core.least_squares.identifiability import Identifiability, identifiability
from workbench.core.least_squares.single_parameters import SingleParameters
from workbench.core.least_squares.solver import Fit
from workbench.core.model import Model
from workbench.core.parameters import Parameters

_STATED = 20.0


@dataclass(frozen=True)
class Stage:
    """One step of a plan: which effects join, what is free, and why.

    Attributes:
        name: Of the stage, as in the table of a calibration.
        why: Reason for it, as a sentence.
        effects: (effect, where, options) rows of the effects that join the model.
        free: Shell patterns of the keys of the parameters that are estimated.
        loss: "linear", or the name of a robust loss.
        canonical: True leaves out of the solve what earlier parameters already make.
        earn: True keeps the stage only where it lowers the held-out error.
        steps: Largest number of steps of the solve.
        hold: (pattern, value) of parameters that the whole plan takes as known, in their own units.
        choose: Gives further rows of effects, from the model and the parameters that the stages before have fitted.

    Examples:
        >>> rows = (("joint-compliance", "joint-2", {}),)
        >>> stage = wb.Stage("compliance", "joints deflect under gravity", effects=rows)
        >>> stage.earn
        True
    """

    name: str
    why: str
    effects: tuple[tuple[str, str, dict], ...] = ()
    free: tuple[str, ...] = ("*",)
    loss: str = "linear"
    canonical: bool = True
    earn: bool = True
    steps: int = 50
    hold: tuple[tuple[str, float], ...] = ()
    choose: Callable | None = None

    def chosen_for(self, model: Model, parameters: Parameters) -> "Stage":
        """The stage with the effects that it chooses on the samples of a fitted model."""
        if self.choose is None:
            return self
        effects = (*self.effects, *self.choose(model, parameters))
        return replace(self, effects=effects, choose=None)


@dataclass(frozen=True)
class Solution:
    """Result of a solve.

    Attributes:
        parameters: At the minimum, with the free mask of the solve (F parameters free); lengths in mm, angles in rad.
        fit: Residuals (m, n), normal matrix and outcome of the last solve.
        all_known: What the data determine of all parameters that a stage freed, also of those then held because
            others make them.
        provenance: Versions, hash of the data, date.
        scores: (F, F) outer products of the poses' gradients; None where every pose has one sample.
        shrunk: Keys of terms of a series, which their common prior makes identifiable.
        at_zero: Keys of parameters that cannot be negative and are held at zero, since their estimate is.

    Examples:
        >>> from workbench.jobs.robot.calibrate import calibrate
        >>> from workbench.fitting.calibration_plans.plans import read_plan
        >>> stages = read_plan("ye-mdh")
        >>> solution = calibrate(wb.load_example("elastic-arm"), stages, folds=4).solution
        >>> solution.residual.shape, solution.converged
        ((3, 300), True)
        >>> key = solution.known.keys[0]
        >>> key, solution.std[key] < 1.0
        ('base.x', True)
    """

    parameters: Parameters
    fit: Fit
    all_known: Identifiability
    provenance: Mapping[str, str]
    scores: np.ndarray | None = None
    shrunk: frozenset[str] = frozenset()
    at_zero: frozenset[str] = frozenset()

    @property
    def residual(self) -> np.ndarray:
        """(m, n) predicted minus measured: mm, rad."""
        return self.fit.residual

    @property
    def history(self) -> tuple[float, ...]:
        """Cost after each step."""
        return self.fit.history

    @property
    def outcome(self) -> str:
        """Why the solve ended, as a sentence."""
        return self.fit.outcome

    @property
    def converged(self) -> bool:
        """Whether the solve reached a minimum."""
        return self.fit.converged

    @property
    def noise_scale(self) -> float:
        """Residuals over their stated sigmas, with the statement counted as `_STATED` degrees of freedom.

        A few residuals that happen to be small do not make an instrument better than it is (inverse
        gamma prior on the variance: Gelman et al., Bayesian Data Analysis, 3rd ed., sec. 2.6).
        """
        degrees = self.fit.degrees
        return float(np.sqrt((self.fit.sigma_scale**2 * degrees + _STATED) / (degrees + _STATED)))

    @cached_property
    def known(self) -> Identifiability:
        """Rank, null space and covariance at the solution."""
        return identifiability(self.fit.normal, self.parameters, self.noise_scale)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(F, F) of the free parameters, own units.

        Samples of one pose share what the model gets wrong there. Where poses have several, the
        covariance is never below the sandwich over poses (Liang & Zeger, Biometrika 73, 1986).
        """
        covariance_alone = self.known.covariance
        if self.scores is None:
            return covariance_alone
        robust = covariance_alone @ self.scores @ covariance_alone
        wider = np.sqrt(np.maximum(np.diag(robust) / np.diag(covariance_alone), 1))
        return covariance_alone * np.outer(wider, wider)

    @cached_property
    def std(self) -> dict[str, float]:
        """1 sigma of every free parameter."""
        return dict(zip(self.known.keys, np.sqrt(np.diag(self.covariance)).tolist()))

    @property
    def null_sentences(self) -> tuple[str, ...]:
        """Parameters that are not identifiable, in words."""
        return tuple(self.single.sentences())

    @cached_property
    def single(self) -> SingleParameters:
        """The estimated parameters of all stages that are identifiable individually, not only in combinations."""
        return SingleParameters.of(self.all_known, self.parameters)

    @cached_property
    def identified(self) -> int:
        """Number of combinations of the free parameters that the data determine."""
        return SingleParameters.of(self.known, self.parameters).combinations

    @property
    def determined(self) -> frozenset[str]:
        """Keys of free parameters that have an estimate of their own."""
        if self.redundancy <= 0:
            return frozenset()
        determined_keys = zip(self.single.known.keys, self.single.determined & self.single.free)
        return (
            frozenset(key for key, is_determined in determined_keys if is_determined) | self.shrunk
        )

    @cached_property
    def marginal_std(self) -> dict[str, float]:
        """1 sigma of every free parameter; also what is held for others is then uncertain by its prior."""
        from_held_parameters = self.single.from_held()
        return {
            key: float(np.sqrt(std**2 + from_held_parameters.get(key, 0.0)))
            for key, std in self.std.items()
        }

    @property
    def redundancy(self) -> int:
        """Measured numbers beyond the free parameters; without any, no sigma can be stated."""
        return self.fit.residual.size - len(self.fit.normal)
