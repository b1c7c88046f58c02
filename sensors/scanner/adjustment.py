"""The joint adjustment of a scanner: corners and stripes of all board poses, camera, bow, poses and light planes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sensors.camera.corners import Corners, camera_parameters, placements
from sensors.camera.model import Camera
from sensors.light.board_chain import BoardStripeChain
from sensors.light.mirror import NAMES, MovedMirror
from sensors.light.planes import in_tilts, moved, steps_family
from sensors.scanner.errors import BestFrameCovariance, covariance_in_best_frame
from workbench.core.effect import Effect
from workbench.core.least_squares.bundle import BundleFit, solve_bundle
from workbench.core.least_squares.linear_algebra import symmetric_eigen
from workbench.core.model import Model
from workbench.core.parameters import Parameters

_AGREES = 0.03  # by which a noise may differ from what it was taken for
_ROUNDS = 3
_WRONG = 5.0  # robust sigmas beyond which a residual of the whole adjustment is wrong
ON_BOTH = ("pixel", "ray", "target", "noise")
"""Ports of effects that corners know too; those of the others belong to the light."""


@dataclass(frozen=True)
class Adjustment:
    """A joint fit: `corners` and `board_stripes` at its solution with the noise that was found, and the fit itself.

    `free` patterns of the mirror's parameters that were fitted, () with free planes.
    """

    corners: Corners
    board_stripes: BoardStripeChain
    effects: tuple[Effect, ...]
    fit: BundleFit
    free: tuple[str, ...] = ()

    @property
    def camera(self) -> Camera:
        return self.board_stripes.camera

    @property
    def parameters(self) -> Parameters:
        return self.fit.parameters

    @property
    def chi2(self) -> float:
        """Weighted sum of squares, residuals over the noise found."""
        return self.fit.history[-1]

    def joint(self) -> np.ndarray:
        """(P + 3 S, D) factor of the covariance of the camera's values and the planes' tilts (rad) and offsets (mm)."""
        table = self.fit.table
        camera_values = self.board_stripes.camera.values
        rows = np.zeros((len(camera_values) + 3 * self.board_stripes.planes.shape[1], len(table)))
        for k, key in enumerate(camera_parameters(self.camera).keys):
            if key in table.index:
                rows[k, table.index[key]] = 1
        rows[len(camera_values) :] = self._plane_rows()
        values, vectors = symmetric_eigen(self.fit.covariance)
        return rows @ (vectors * np.sqrt(np.maximum(values, 0)))

    def best_frame(self, volume: tuple[float, float]) -> BestFrameCovariance:
        """Covariance of the planes in the frame that fits best, and of that frame."""
        return covariance_in_best_frame(
            self.camera, self.board_stripes.planes, volume, self.joint()
        )

    def _plane_rows(self):
        board_stripes = self.board_stripes
        table = self.fit.table
        steps = board_stripes.planes.shape[1]
        rows = np.zeros((3 * steps, len(table)))
        if board_stripes.mirror is None:
            rows[:, -3 * steps :] = np.eye(3 * steps)
            return rows
        by_mirror = in_tilts(
            board_stripes.planes,
            MovedMirror(board_stripes.mirror, _unmoved()).rows(board_stripes.angles),
        )
        for k, name in enumerate(NAMES):
            if (key := f"mirror.{name}") in table.index:
                rows[:, table.index[key]] = by_mirror[k].T.ravel()
        return rows


def _unmoved():
    change = np.zeros(len(NAMES))
    change[NAMES.index("gain")] = 1
    return change


def models(
    corners: Corners, board_stripes: BoardStripeChain, effects: Sequence[Effect]
) -> tuple[Model, Model]:
    """The two models; effects of the light act on stripes alone."""
    common_effects = tuple(effect for effect in effects if effect.port in ON_BOTH)
    return Model(corners, common_effects), Model(board_stripes, tuple(effects))


def stripe_model(
    board_stripes: BoardStripeChain, effects: Sequence[Effect], known: Parameters
) -> tuple[Model, Parameters]:
    """The model of stripes that start where they are, and its table with the effects' `known` values."""
    model = Model(board_stripes, tuple(effects))
    parameters = board_stripes.parameters
    return model, model.parameters.take_over(known).update(
        {key: parameters[key] for key in parameters.keys}
    )


def shared(two: Sequence[Model], known: Parameters | None, free: Sequence[str]) -> Parameters:
    """One table for both models, at the chains' start and the effects' `known` values; all free but the mirror's."""
    parameter_of_key = {p.key: p for model in two for p in model.parameters.table}
    table = Parameters.of(parameter_of_key.values())
    for model in two:
        table = table.take_over(model.parameters)
    if known is not None:
        effects = {
            key: known[key] for key in known.keys if key.count(".") > 1 and key in parameter_of_key
        }
        table = table.update(effects)
    table = table.free("*")
    if any(key.startswith("mirror.") and key.count(".") == 1 for key in parameter_of_key):
        table = table.fix(*(f"mirror.{name}" for name in NAMES if name not in free))
    return table


def solve_once(
    corners: Corners,
    board_stripes: BoardStripeChain,
    effects: Sequence[Effect],
    known: Parameters | None = None,
    free: Sequence[str] = (),
    loss: str = "linear",
) -> Adjustment:
    """One bundle from where the chains stand, with the noise that they state."""
    fit = _bundle(corners, board_stripes, effects, known, free, loss=loss)
    return at_solution(Adjustment(corners, board_stripes, tuple(effects), fit, tuple(free)))


def linearised(adjustment: Adjustment) -> Adjustment:
    """The same with the fit's residuals and covariance those of where it stands: a solve ends one step after its last
    derivative, and its chains then start again."""
    return replace(
        adjustment,
        fit=_bundle(
            adjustment.corners,
            adjustment.board_stripes,
            adjustment.effects,
            adjustment.parameters,
            adjustment.free,
            steps=0,
        ),
    )


def _bundle(corners, board_stripes, effects, known, free, **options) -> BundleFit:
    two = models(corners, board_stripes, effects)
    families = {"placement": placements(board_stripes.poses)}
    if board_stripes.mirror is None:
        families["step"] = steps_family(board_stripes.planes)
    return solve_bundle(two, shared(two, known, free), families, **options)


def at_solution(adjustment: Adjustment) -> Adjustment:
    """The chains moved to where the fit ended."""
    fit = adjustment.fit
    board_stripes = adjustment.board_stripes
    camera = Camera.of(
        fit.parameters.values[: len(board_stripes.camera.values)], board_stripes.camera.size
    )
    return replace(
        adjustment,
        corners=adjustment.corners.moved(camera, fit.values["placement"]),
        board_stripes=stripes_at_solution(board_stripes, fit, camera),
    )


def stripes_at_solution(
    board_stripes: BoardStripeChain, fit: BundleFit, camera: Camera
) -> BoardStripeChain:
    """Stripes on boards with the camera, board poses, and light planes or mirror where a fit ended."""
    mirror = None
    if board_stripes.mirror is None:
        planes = moved(board_stripes.planes, fit.values["step"])
    else:
        change = MovedMirror(
            board_stripes.mirror, np.array([fit.parameters[f"mirror.{name}"] for name in NAMES])
        )
        board_stripes = replace(board_stripes, angles=board_stripes.angles * change.gain)
        mirror = change.mirror
        planes = mirror.planes(board_stripes.angles)
    return board_stripes.moved(camera, fit.values["placement"], planes, mirror)


def adjust(
    corners: Corners,
    board_stripes: BoardStripeChain,
    effects: Sequence[Effect],
    known: Parameters | None = None,
    free: Sequence[str] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Adjustment:
    """Robust first, then without what is wrong, until the noise of stripes is what it was taken for.

    Variance components: each kind of measurement is weighted by its own residuals (Foerstner,
    Z. Vermess. 104 (1979)). Corners say themselves how well they are seen, before any stripe counts: they may turn out
    better together with the stripes, with effects that were not in the camera's model, but what they are worse by is
    where the stripes contradict them, and no noise.
    """
    adjustment = solve_once(corners, board_stripes, effects, known, free, "huber")
    corners = _without_wrong(adjustment.corners, adjustment.fit, 0)
    board_stripes = _without_wrong(adjustment.board_stripes, adjustment.fit, 1)
    progress(f"{board_stripes.n} points of stripes and {corners.pixels.shape[1]} corners are kept")
    scales = adjustment.fit.scales
    for _ in range(_ROUNDS):
        corners = replace(
            corners, sigma=corners.sigma * (scales[0] if scales[0] < 1 - _AGREES else 1)
        )
        board_stripes = replace(board_stripes, sigma=board_stripes.sigma * scales[1])
        adjustment = solve_once(corners, board_stripes, effects, adjustment.parameters, free)
        corners, board_stripes, scales = (
            adjustment.corners,
            adjustment.board_stripes,
            adjustment.fit.scales,
        )
        if scales[0] > 1 - _AGREES and abs(scales[1] - 1) < _AGREES:
            break
    return adjustment


def _without_wrong(chain, fit: BundleFit, model_index: int):
    white = np.sqrt(((fit.residual[model_index] / chain.sigma) ** 2).mean(0))
    return chain.at(white <= _WRONG * max(fit.scales[model_index], 1e-12))


def fresh_start(
    adjustment: Adjustment, planes: np.ndarray | None = None, mirror=None, angles=None
) -> BoardStripeChain:
    """The stripes of an adjustment, started at its solution with other planes or with a mirror."""
    board_stripes = (
        adjustment.board_stripes
        if angles is None
        else replace(adjustment.board_stripes, angles=angles)
    )
    planes = board_stripes.planes if planes is None else planes
    return board_stripes.moved(adjustment.camera, board_stripes.poses, planes, mirror)
