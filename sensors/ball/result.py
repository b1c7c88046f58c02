"""Result of the fit of a ball, and the reasons for which points were rejected."""

from dataclasses import dataclass, replace

import numpy as np

from sensors.ball.extent import shell

USED, EDGE, INCIDENCE, OUTLIER, MISSING, NOT_ON_BALL = range(6)
REASONS = {
    EDGE: "edge",
    INCIDENCE: "incidence",
    OUTLIER: "outlier",
    MISSING: "missing",
    NOT_ON_BALL: "elsewhere",
}


@dataclass(frozen=True)
class BallFit:
    """A fitted ball; false where the fit failed, and `outcome` says why.

    `centre` (3,) and `radius` mm, the second-order `bias` (4,) mm of the noise already taken
    off; `covariance` (4, 4) mm^2 of both, scaled by the residuals, 0 for a known radius;
    `sigma_scale` by which the stated sigma of the points has to be multiplied to agree with the
    residuals (their sigma in mm where none was stated); `rms` mm of the distances of the points used, over their
    degrees of freedom; `residual` (n,) mm from the surface, positive outside;
    `reason` (n,) of `REASONS`, 0 where used; `cap` rad, half angle of the cone from the
    centre that holds the points; `coverage` share of the way round the view (or the cap's middle) that is seen.
    `cut`: points used lie at the field's limit. `step` that a further iteration would make, in sigmas;
    `form` (mm, RMS) of orders two and three that the distances show beyond their noise, nan where the points are too
    few, and `form_probability` that noise alone shows as much; `free`, where the radius was known, the same ball with a
    radius of its own; `warnings` sentences on what the covariance does not hold, in `outcome` too; `radius_note` that
    one of them which says what other radii a single stripe admits, "" for more stripes.
    """

    centre: np.ndarray
    radius: float
    covariance: np.ndarray
    bias: np.ndarray
    sigma_scale: float
    rms: float
    residual: np.ndarray
    reason: np.ndarray
    cap: float
    coverage: float
    cut: bool
    ok: bool
    outcome: str
    step: float = np.nan
    form: float = np.nan
    form_probability: float = 1.0
    warnings: tuple[str, ...] = ()
    free: "BallFit | None" = None
    radius_note: str = ""

    def __bool__(self) -> bool:
        return self.ok

    def with_radius_note(self, note: str) -> "BallFit":
        """The same with a `radius_note` among its warnings."""
        if not note:
            return self
        warnings = (*self.warnings, note)
        outcome = f"{self.outcome}; {note}"
        return replace(self, warnings=warnings, outcome=outcome, radius_note=note)

    @property
    def inliers(self) -> np.ndarray:
        """(n,) True for the points used."""
        return self.reason == USED

    @property
    def rejected(self) -> dict[str, int]:
        """Number of points left out, by reason."""
        return {name: int((self.reason == code).sum()) for code, name in REASONS.items()}

    @property
    def d95(self) -> float:
        """Width, mm, of the thinnest shell about the centre that holds 95 % of the points used."""
        return shell(self.residual[self.inliers], 0.95) if self.ok else np.nan

    @property
    def peak_to_valley(self) -> float:
        """Width, mm, of the shell about the centre that holds all points used."""
        return shell(self.residual[self.inliers], 1.0) if self.ok else np.nan

    @property
    def radius_gap(self) -> float:
        """Estimated minus stated radius in standard deviations; nan where the radius was not estimated."""
        return (
            np.nan
            if self.free is None
            else float((self.free.radius - self.radius) / self.free.std[-1])
        )

    @property
    def centre_moves(self) -> float:
        """mm between the centre and that of the ball with a radius of its own; nan where there is none."""
        return (
            np.nan if self.free is None else float(np.linalg.norm(self.free.centre - self.centre))
        )

    @property
    def std(self) -> np.ndarray:
        """(4,) mm, 1 sigma of centre and radius."""
        return np.sqrt(np.diag(self.covariance))


__all__ = ["EDGE", "NOT_ON_BALL", "INCIDENCE", "MISSING", "OUTLIER", "REASONS", "USED", "BallFit"]
