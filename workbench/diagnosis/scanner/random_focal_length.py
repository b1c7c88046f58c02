"""A focal length that differs at random from image to image: a random effect of the camera, tested before a search.

A lens that is focused again, or is loose, has another focal length in each image. Nothing that was recorded predicts
it, so that no held-out error falls when it is in the model, and a search without it accepts many laws in its place.
It is random where three things hold. The focal lengths of the board poses scatter by more than their uncertainties
(`sensors.camera.focal_scatter`). A focal length of its own for each board pose explains the corners better than any
law of camera and board and than all of them together (focus breathing, drift, lens, window, bow). And what it leaves
is mostly noise: a lens that the model does not describe bends the rows of corners of each image.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from sensors.camera.focal_scatter import (
    FocalScatter,
    ReducedCorners,
    by_focal_length,
    focal_scatter,
)
from sensors.effects import CATALOGUE
from sensors.effects.optics import FocusBreathing
from workbench.core.effect import Effect
from workbench.diagnosis.levels import MAJORITY
from workbench.diagnosis.linear.problem import Finding
from workbench.diagnosis.robot.library import variants
from workbench.diagnosis.scanner.sensor_linear import acts
from workbench.jobs.sensor.chains import Chains, at_solution

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
        about = (FocusBreathing.effect, "camera", LABEL, (), p_value, self.probability)
        return Finding(*about, 0.0, 0.0)

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
            here = chain.evaluate(chain.parameters.values, {})
            if name == "corners":
                moved.append(np.full(chain.pixels.shape[1], np.sqrt(2) * self.scatter.visible_px))
                continue
            by_focal = by_focal_length(chain.camera, here)[0]
            if name == "board_stripes":
                place = chain.poses[chain.labels["placement"], :3].T
                by_focal = by_focal + (here.family_rows("placement")[:3, 0] * place).sum(0)
            moved.append(self.scatter.share * np.abs(by_focal))
        return np.concatenate(moved)

    def of_stripes(self, chain) -> np.ndarray:
        """(n,) px, displacement of points of stripes by 1 sigma of the focal length of their image."""
        here = chain.evaluate(chain.parameters.values, {})
        return self.scatter.share * by_focal_length(chain.camera, here)[0]


def find_random_focal_length(bench) -> RandomFocalLength | None:
    """Of the corners of a `SensorBench`; None where focal lengths are constant or follow a law, or the lens errs."""
    chains, fit = bench.solve(())
    corners = at_solution(chains, fit).corners
    found = focal_scatter(corners, fit, ())
    if found is None or not found.significant:
        return None
    own = ReducedCorners.of(corners, fit, ())
    own_criterion = _criterion(own, own.squares(np.inf), len(own.focal) - 1)
    laws = _laws_of_corners(bench)
    law_criterion = min(
        _of_laws(corners, fit, chosen) for chosen in (*((law,) for law in laws), laws)
    )
    probability = float(expit((law_criterion - own_criterion) / 2))
    sigma = float(np.sqrt((np.asarray(corners.sigma) ** 2).mean()))
    is_noise = found.noise_px**2 - sigma**2 < found.visible_px**2
    return RandomFocalLength(found, probability) if is_noise and probability > MAJORITY else None


def _of_laws(corners, fit, laws: tuple[Effect, ...]) -> float:
    """Schwarz' criterion of corners with one focal length and some laws."""
    reduced = ReducedCorners.of(corners, fit, laws)
    count = sum(len(law.parameters(corners)) for law in laws)
    return _criterion(reduced, reduced.squares(), count)


def _criterion(reduced: ReducedCorners, squares: float, parameters: int) -> float:
    """Bayesian information criterion: Schwarz, Annals of Statistics 6 (1978) 461."""
    return squares + parameters * float(np.log(reduced.count))


def scatter_next_to(bench, effects: tuple[Effect, ...]) -> FocalScatter | None:
    """Scatter of the focal lengths of board poses conditional on some effects."""
    chains, fit = bench.solve(effects)
    on_corners = tuple(effect for effect in effects if acts(effect, "corners"))
    return focal_scatter(at_solution(chains, fit).corners, fit, on_corners)


def _laws_of_corners(bench) -> tuple[Effect, ...]:
    """Of each effect of camera and board on corners the variant with most parameters."""
    most: dict[str, tuple[int, Effect]] = {}
    for variant in variants(CATALOGUE, bench.kind):
        effect = variant.effect
        if effect.coexists or not acts(effect, "corners") or effect.port == "noise":
            continue
        count = len(effect.parameters(bench.chains.corners))
        if count > most.get(effect.effect, (0, effect))[0]:
            most[effect.effect] = count, effect
    return tuple(effect for _, effect in most.values())
