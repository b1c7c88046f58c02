"""Validation of each term and of all together: figures, controls, and held-out errors."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workbench.diagnosis.levels import CONFIDENCE
from workbench.diagnosis.linear.problem import Finding


@dataclass(frozen=True)
class Control:
    """A term's gain in a permutation or circular-shift control of what it depends on.

    `kind` "permuted" or "circular shift"; `share` of the term's own gain that remains in the control, the median over
    `trials`; `p_value` of a gain as large as the term's; `passed`: whether only chance remains; None where the control
    is not applicable, for the reason `why`.
    """

    kind: str
    share: float | None
    p_value: float | None
    passed: bool | None
    trials: int = 0
    why: str = ""


@dataclass(frozen=True)
class Term:
    """A finding with its proof and its words.

    `t` of the gain, one value a pose (`held_out.significance`), `t_fall` of the fall of the error itself, and
    `t_nested` of the gain in the nested cross-validation; `gain` (mm, px) the fall of the held-out RMS that this
    term alone brings, of an arm with errors as of `nested_components`; `reselected_folds` of `searched_folds` folds
    in which the repeated search reselects most of what it makes; `size` (mm, px) RMS displacement of the measured
    point; `kept` False where a proof failed, and `reason` then says which. `parameters`: rows of
    `Bench.parameters`. `share` of the mismatch, of what is located and not modelled, or of what remains next to the
    other terms where `remainder`.
    """

    finding: Finding
    parameters: tuple[Mapping, ...] = ()
    size: float | None = None
    t: float | None = None
    t_nested: float | None = None
    gain: float | None = None
    reselected_folds: int = 0
    searched_folds: int = 0
    controls: tuple[Control, ...] = ()
    kept: bool = True
    reason: str = ""
    statement: str = ""
    share: float | None = None
    remainder: bool = False
    t_fall: float | None = None
    showing_poses: float | None = None

    @property
    def is_certain(self) -> bool:
        """Whether no other named or unnamed thing explains it as well."""
        return self.finding.probability >= CONFIDENCE or not self.finding.alternatives

    @property
    def title(self) -> str:
        """Effect, variant and place."""
        found = self.finding
        return f"{found.effect}{f' ({found.label})' if found.label else ''} at {found.where}"


@dataclass(frozen=True)
class Proof:
    """Errors of samples that no step of the selection saw, in mm or px: RMS of their 3-D (2-D) distance.

    `before` with the baseline, `after` with what the selection made of the other folds, whole and by nested search
    in each;
    `fixed` with the terms of all data, fitted on the other folds. `t` of the paired gains. `errors` (2, n): before
    and after, nan where not predicted; `fold` (n,). All of these are of one `scheme`, that can judge the terms;
    `schemes`: before, after, t, folds of every scheme, and whether it judges. `after` is at most `before`.
    `noise` and `noise_from`: what the instrument leaves, and how it is known. `lack`: lack of fit against replicates.
    `variance_factors`, before and after: mean square error of a right model on such samples over that of the noise.
    """

    before: float
    after: float
    fixed: float
    t: float
    folds: int
    noise: float
    noise_from: str
    errors: np.ndarray
    fold: np.ndarray
    schemes: tuple[Mapping, ...] = ()
    lack: Mapping | None = None
    angles: np.ndarray | None = (
        None  # (2, n) deg, rotation angles that belong to `errors`; None: no orientation
    )
    angles_rms: tuple[float, float] | None = None  # deg, before and after
    scheme: str = ""
    variance_factors: tuple[float, float] = (1.0, 1.0)

    @property
    def expected(self) -> float:
        """RMS held-out error of a right model, mm or px: noise, and the uncertainty of its parameters."""
        return float(np.sqrt(self.variance_factors[1])) * self.noise

    @property
    def unexplained(self) -> tuple[float, float]:
        """Mean squared errors before and after beyond noise and uncertainty of the parameters, mm^2 or px^2; >= 0."""
        pairs = (self.before, self.after)
        errors = zip(pairs, self.variance_factors)
        before, after = (max(error**2 - f * self.noise**2, 0.0) for error, f in errors)
        return before, after
