"""A focal length that differs at random from image to image: a random effect of the camera, tested before a search.

A lens that is focused again, or is loose, has another focal length in each image. Nothing that was recorded predicts
it, so that no held-out error falls when it is in the model, and a search without it accepts many laws in its place.
It is random where three things hold, in the linearised problem of corners and stripes. A focal length of its own for
each board pose explains a significant part of the residual (partial F-test): it changes the perspective of the board's
corners, and its range, where the stripes cross it. It explains more than any candidate law (Schwarz' criterion). And
it explains most of what is not noise: a lens that the model does not describe bends the rows of corners of each image.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit

from sensors.camera.focal_scatter import FocalScatter, by_focal_length, focal_scatter
from sensors.effects.optics import FocusBreathing
from workbench.core.distributions import fisher
from workbench.core.effect import Effect
from workbench.diagnosis.levels import (
    DATA_FAULT_LEVEL,
    MAJORITY,
    NEGLIGIBLE_SHARE,
    NOTABLE_SHARE,
    ROUNDING,
)
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.scanner.sensor_linear import Linear, acts
from workbench.jobs.sensor.chains import Chains, at_solution

_FEWEST_POSES = 4
"""Images below which a variance between images has two degrees of freedom or fewer."""
LABEL = "random from image to image"


@dataclass(frozen=True)
class RandomFocalLength:
    """The `scatter` of focal lengths, and its `probability` against all laws of camera and board."""

    scatter: FocalScatter
    probability: float

    @property
    def finding(self) -> Finding:
        """As a finding on the data: there is no law to be fitted."""
        p_value = max(self.scatter.p_value, 1e-300)
        description = (FocusBreathing.effect, "camera", LABEL, (), p_value, self.probability)
        return Finding(*description, 0.0, 0.0)

    @property
    def parameters(self) -> tuple[dict, ...]:
        """The spread as a row of parameters."""
        row = {
            "key": f"camera.{FocusBreathing.effect}.sigma",
            "name": "sigma",
            "where": "camera",
            "label": "1 sigma of the relative focal length",
            "effect": FocusBreathing.effect,
            "value": self.scatter.share,
            "std": self.scatter.share_std,
            "unit": "1",
            "typical": 1e-3,
            "size_px": self.scatter.shift_px,
        }
        return (row,)

    def displacement(self, chains: Chains) -> np.ndarray:
        """(n,) px, 1 sigma by which it displaces each sample from its held-out prediction.

        Of corners the part that no change of their board pose makes. A board pose that is held by its corners is off
        in range by as much as the focal length, which moves its stripes.
        """
        moved = []
        for name, chain in chains.parts.items():
            evaluation = chain.evaluate(chain.parameters.values, {})
            if name == "corners":
                moved.append(np.full(chain.pixels.shape[1], np.sqrt(2) * self.scatter.visible_px))
                continue
            by_focal = by_focal_length(chain.camera, evaluation)[0]
            if name == "board_stripes":
                place = chain.poses[chain.labels["placement"], :3].T
                rows = evaluation.family_rows("placement")[:3, 0]
                by_focal = by_focal + (rows * place).sum(0)
            moved.append(self.scatter.share * np.abs(by_focal))
        return np.concatenate(moved)

    def of_stripes(self, chain) -> np.ndarray:
        """(n,) px, displacement of points of stripes by 1 sigma of the focal length of their image."""
        evaluation = chain.evaluate(chain.parameters.values, {})
        return self.scatter.share * by_focal_length(chain.camera, evaluation)[0]


def find_random_focal_length(bench) -> RandomFocalLength | None:
    """Of the images of a `SensorBench`; None where focal lengths are constant or follow a law, or the lens errs."""
    linear = Linear(bench, (), *bench.solve(()), None)
    if len(linear.chains.corners.poses) < _FEWEST_POSES:
        return None
    problem = linear.problem()
    residual = problem.orthogonalise(problem.residual)
    directions, size, _ = np.linalg.svd(
        problem.orthogonalise(linear.focal_lengths()), full_matrices=False
    )
    directions = directions[:, size > ROUNDING * size[0]]
    size = size[size > ROUNDING * size[0]]
    score = directions.T @ residual
    explained = float(score @ score)
    remaining = float(residual @ residual) - explained
    degrees = len(residual) - problem.basis.shape[1] - len(size)
    p_value = float(fisher.sf(explained / len(size) * degrees / remaining, len(size), degrees))
    lack_of_fit = remaining - degrees
    if p_value > DATA_FAULT_LEVEL or explained - len(size) < max(
        lack_of_fit, degrees * NOTABLE_SHARE
    ):
        return None
    best_law = max(_law_gains(problem, residual), default=0.0)
    own_gain = explained - len(size) * np.log(len(residual))
    probability = float(expit((own_gain - best_law) / 2))
    if probability < MAJORITY:
        return None
    first = scatter_next_to(bench, ())
    share, share_std = _likeliest_share(score, size)
    scale = share / first.share if first.share else 0.0
    scatter = replace(
        first,
        share=share,
        share_std=share_std,
        shift_px=scale * first.shift_px,
        visible_px=scale * first.visible_px,
        p_value=p_value,
    )
    return RandomFocalLength(scatter, probability)


def _law_gains(problem, residual: np.ndarray) -> Iterator[float]:
    """Fall of the sum of squares by each candidate, less what Schwarz' criterion takes for its parameters."""
    for candidate in problem.candidates:
        typical_columns = candidate.columns * candidate.typical
        basis = np.linalg.qr(problem.orthogonalise(typical_columns))[0]
        coordinates = basis.T @ residual
        gain = float((coordinates**2).sum())
        penalty = candidate.columns.shape[1] * np.log(len(residual))
        yield gain - penalty


def _likeliest_share(score: np.ndarray, size: np.ndarray) -> tuple[float, float]:
    """1 sigma of the relative focal length, and its standard error: score (k,) is N(0, 1 + size^2 share^2).

    Restricted maximum likelihood: Patterson & Thompson, Biometrika 58 (1971) 545.
    """

    def deviance(log_share):
        spread = size * np.exp(log_share)
        variance = 1 + spread**2
        return float((np.log(variance) + score**2 / variance).sum())

    widest = float(np.abs(score / size).max())
    bounds = np.log(NEGLIGIBLE_SHARE * widest), np.log(10 * widest)
    best = minimize_scalar(deviance, bounds=bounds, method="bounded")
    share = float(np.exp(best.x))
    variances = share**2 + size**-2.0
    information = 0.5 * float((variances**-2).sum())
    root_information = float(np.sqrt(information))
    share_std = 0.5 / (share * root_information)
    return share, share_std


def scatter_next_to(bench, effects: tuple[Effect, ...]) -> FocalScatter | None:
    """Scatter of the focal lengths of board poses conditional on some effects."""
    chains, fit = bench.solve(effects)
    on_corners = tuple(effect for effect in effects if acts(effect, "corners"))
    return focal_scatter(at_solution(chains, fit).corners, fit, on_corners)
