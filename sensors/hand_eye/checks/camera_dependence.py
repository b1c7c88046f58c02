"""Whether a parameter of the camera depends on a covariate, tested next to the errors of the flange poses.

A lens that sags in its mount displaces the image with the direction of gravity, a warm camera with its temperature. The
pose error of each image absorbs the displacement, so that a calibration without this alternative blames the flange
poses. Each alternative adds columns (derivative of the pixel by the parameter, times the covariate) to the linear model
at the adjustment; the variances of the flange poses are estimated again by restricted maximum likelihood. Its estimate
is judged by the F test (Searle, Casella & McCulloch, Variance Components, 1992, sec. 6.4), with Bonferroni's bound for
the number of alternatives.

Errors of an arm are smooth functions of its pose, too. An alternative is therefore stated only if it explains a good
part of the estimated errors of the flange poses, and that of gravity only if the direction that the images tell is the
vertical: it is estimated without knowing where down is.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sensors.hand_eye.adjust import (
    Adjusted,
    grams,
    restricted_likelihood,
    solve_restricted,
)
from sensors.hand_eye.chain import Evaluation
from workbench.core.distributions import fisher
from workbench.core.least_squares.linear_algebra import solve_positive
from workbench.core.parameters import Parameter, Parameters
from workbench.core.rigid import rotation_matrix

GRAVITY = "gravity"
TARGET = "board"
_UNLIKELY = 1e-3
_EXPLAINED = 0.75  # of a sigma of the flange poses: what remains of one of the two at most
_VERTICAL = np.cos(np.deg2rad(20.0))
_SPREAD = 1e-9  # of a covariate, below which it is constant
_MIN_POSES = 6  # poses
_TYPICAL_PX = 1.0


@dataclass(frozen=True)
class CameraDependence:
    """A `parameter` (principal point, focal length or board) that depends on `covariate` (gravity or a column).

    `size_px` and `std_px`: displacement in the image for a change of the covariate by its range; for gravity from the
    optical axis along it to the axis across it. `p_value` after the number of alternatives; `before` and `after` (2,):
    1 sigma of the pose errors at the middle of the board (mm, rad) without and with it. `direction` (3,): unit vector
    in the base of the displacement, for gravity only.
    """

    parameter: str
    covariate: str
    size_px: float
    std_px: float
    p_value: float
    before: np.ndarray
    after: np.ndarray
    direction: np.ndarray | None = None

    def is_significant(self, gravity: np.ndarray) -> bool:
        """Whether chance is excluded and much of the pose errors explained; gravity (3,): its direction in the base."""
        if self.direction is not None and abs(self.direction @ gravity) < _VERTICAL:
            return False
        return self.p_value < _UNLIKELY and (self.after / self.before).min() < _EXPLAINED

    @property
    def sentence(self) -> str:
        """What depends on what, by how much, what it does to the result, and what to do."""
        size = f"{self.size_px:.2g} ± {self.std_px:.1g} px"
        if self.covariate == GRAVITY:
            cause = (
                f"the image moves with the direction of gravity in the camera frame, by {size} between a camera that "
                "looks down and one that looks sideways: the lens, the mount of the camera or the tool sags. Fix lens "
                "and mount"
            )
        elif self.parameter == TARGET:
            cause = f"the board moves against the base with {self.covariate}, by {size} over its range: fix both"
        else:
            cause = (
                f"the {self.parameter} of the camera depends on {self.covariate}, which moves the image by {size} over "
                "its range. Let the camera warm up and calibrate at the conditions of use"
            )
        sigmas = [
            f"{np.sqrt(3) * place:.2g} mm and {np.degrees(np.sqrt(3) * turn):.2g} deg"
            for place, turn in (self.before, self.after)
        ]
        return (
            f"{cause}. Without this cause the poses err by {sigmas[0]} RMS at the board, with it by {sigmas[1]}. "
            "The transform is calibrated without it, and its uncertainty counts it as errors of the flange poses"
        )


@dataclass(frozen=True)
class Conditions:
    """Conditions of each pose: `covariates`, by column (P,) values, and `gravity` (3,), its direction in the base."""

    covariates: Mapping[str, np.ndarray]
    gravity: np.ndarray


@dataclass(frozen=True)
class _WithDependence:
    """A board chain with parameters that it lacks: `columns` (k, 2, n) px."""

    chain: object
    columns: np.ndarray

    def __getattr__(self, name):
        return getattr(self.chain, name)

    def evaluate(self, values: np.ndarray, deltas=None) -> Evaluation:
        found = self.chain.evaluate(values[: len(self.chain.parameters)])
        return replace(found, shared=np.concatenate([found.shared, self.columns]))

    def extended(self, parameters: Parameters) -> Parameters:
        """The parameters (P) and those of the columns, which are free and start at zero."""
        count = len(self.columns)
        added = [Parameter(f"dependence.{k}", "px", 0.0, _TYPICAL_PX, "") for k in range(count)]
        table = Parameters.of([*parameters.table, *added])
        values = np.concatenate([parameters.values, np.zeros(count)])
        mask = np.concatenate([parameters.mask, np.ones(count, bool)])
        return replace(table, values=values).only(mask)


def camera_dependence(adjusted: Adjusted, conditions: Conditions) -> CameraDependence | None:
    """The most likely dependence in an `Adjusted` board chain; None without a significant one.

    The test of gravity is that of a camera on the flange: a stationary one always has the same direction of gravity.
    """
    chain = adjusted.chain
    used = np.unique(chain.pose)
    if len(used) < _MIN_POSES:
        return None
    chain = chain.with_families({"pose": adjusted.errors})
    candidates = candidate_columns(chain, adjusted, conditions.covariates, used)
    found = [tested(chain, adjusted, *candidate) for candidate in candidates]
    likely = [
        dependence
        for dependence in (
            replace(dependence, p_value=min(1.0, dependence.p_value * len(found)))
            for dependence in found
        )
        if dependence.is_significant(conditions.gravity)
    ]
    return min(likely, key=lambda dependence: dependence.p_value, default=None)


def candidate_columns(chain, adjusted: Adjusted, covariates, used) -> list[tuple]:
    """Rows (parameter, covariate, columns (k, 2, n) px)."""
    values = adjusted.parameters.values
    camera = chain.camera_at(values)
    evaluation = chain.evaluate(values)
    from_centre = chain.pixels + evaluation.residual - np.array([[camera.cx], [camera.cy]])
    radial = from_centre / np.sqrt(np.mean(from_centre**2))
    found = []
    if chain.kind == "in-hand":
        # axes of the camera in the base: columns of the rotation from the camera to the base
        axes = chain.flange[:, :3, :3] @ rotation_matrix(values[3:6])
        in_image_plane = axes[chain.pose, :, :2].transpose(1, 2, 0)  # (3, 2, n)
        found.append(("principal point", GRAVITY, in_image_plane))
    for name, column in covariates.items():
        extent = np.ptp(column[used])
        if not extent > _SPREAD * np.abs(column[used]).max():
            continue
        scaled = ((column - column[used].mean()) / extent)[chain.pose]
        shifts = np.zeros((2, 2, chain.pixels.shape[1]))
        shifts[0, 0] = shifts[1, 1] = scaled
        moved = evaluation.pose * scaled
        lengths = np.sqrt((moved**2).sum(1).mean(1))
        found += [
            ("principal point", name, shifts),
            ("focal length", name, scaled * radial[None]),
            (TARGET, name, moved / lengths[:, None, None]),
        ]
    return found


def tested(chain, adjusted: Adjusted, parameter, covariate, columns) -> CameraDependence:
    """One alternative: `columns` (k, 2, n) px with free coefficients."""
    extended = _WithDependence(chain, columns)
    parameters = extended.extended(adjusted.parameters)
    model_grams = grams(extended, parameters)
    variances = restricted_likelihood(extended, model_grams, parameters, adjusted.variances)
    linear = solve_restricted(extended, model_grams, parameters, variances)
    count = len(columns)
    size = linear.change[-count:]
    covariance = linear.covariance[-count:, -count:]
    degrees_of_freedom = max(6 * int((model_grams[1] > 0).sum()) - 12 - count, 1)
    ratio = float(size @ solve_positive(covariance, size)) / count
    length = float(np.linalg.norm(size))
    direction = size / max(length, 1e-300)
    return CameraDependence(
        parameter,
        covariate,
        length,
        float(np.sqrt(direction @ covariance @ direction)),
        float(fisher.sf(ratio, count, degrees_of_freedom)),
        adjusted.variances.spread,
        variances.spread,
        direction if covariate == GRAVITY else None,
    )
