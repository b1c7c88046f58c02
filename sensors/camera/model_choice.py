"""The model of a lens, chosen by errors on held-out board poses with the one-standard-error rule.

Every model is fitted to the same images. Its error on each board pose comes from a camera of the other board poses; the
pose itself is fitted to every second corner, and the error is that of the others. Models are compared by the mean, over
board poses, of the logarithm of the ratio of their RMS errors: one image with a large error does not decide. The
simplest model is chosen whose error exceeds the smallest by less than one standard error of that mean (Breiman et al.,
Classification and Regression Trees, 1984, sec. 3.4.3), by less than three if the best model has parameters that these
images do not determine. The standard error is that of alike models, from the median absolute deviation: a model that
fails on some of the images only has a large spread, which must not excuse it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sensors.camera.adjust import Adjusted, adjusted
from sensors.camera.checks import (
    ENOUGH,
    coverage,
    fit_free,
    group_subset,
    projection_difference,
    residuals_of_halves,
)
from sensors.camera.corners import Corners
from sensors.camera.model import Camera
from sensors.camera.start import MODELS, placement_groups
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.effect import Effect
from workbench.core.errors import InputError

if TYPE_CHECKING:
    from sensors.boards.board import Board
    from sensors.boards.detection import View

ORDER = ("brown", "fisheye", "rational")
"""From simple to complex. Brown's model has one parameter more than the fisheye model, but all software reads it."""
AUTO = "auto"
"""In the place of a model: the one that `choose_model` chooses."""
_FOLDS = 5
_LIMIT_UNDETERMINED = 3.0  # standard errors
_NOTABLE_PX = 1.0
_CLOSE = 0.05  # of the error, by which models that are used alike differ


@dataclass(frozen=True)
class Candidate:
    """A model of the lens: `parameters` of the camera, `fit_px` and `held_out_px` RMS (px, as OpenCV counts; None
    where it could not be fitted), `excess` mean over board poses of ln(RMS / RMS of the best model) and its
    `standard_error`; `left_out` corners that it does not explain, and `why` it could not be fitted.
    """

    model: str
    parameters: int
    fit_px: float | None = None
    held_out_px: float | None = None
    excess: float | None = None
    standard_error: float | None = None
    left_out: int = 0
    why: str = ""


@dataclass(frozen=True)
class ModelChoice:
    """The `chosen` model, all `candidates` and the `sentence` why; `extrapolation` a sentence where the models that
    describe the images differ outside of the corners."""

    chosen: str
    candidates: tuple[Candidate, ...]
    sentence: str
    extrapolation: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Fitted:
    """A model's bundle, and its squared errors (G,) px^2 on each held-out board pose of the reference."""

    model: str
    part: Adjusted
    squares: np.ndarray


def choose_model(
    views: Sequence["View"],
    board: "Board",
    size: tuple[int, int],
    effects: Sequence[Effect] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> ModelChoice:
    """The model of the lens for these views; Brown's where the board poses are too few to hold any out.

    effects: those of the board that are fitted together with the camera. Raises InputError where no model fits.
    """
    fits: dict[str, Adjusted] = {}
    problems: dict[str, InputError] = {}
    for model in ORDER:
        progress(f"lens model {model}")
        try:
            fits[model] = adjusted(views, board, size, model, effects, "huber")
        except InputError as problem:
            problems[model] = problem
    if not fits:
        raise problems[ORDER[0]]
    reference = max(fits.values(), key=lambda part: part.chain.pixels.shape[1])
    if len(reference.chain.poses) < 2 * ENOUGH:
        chosen = next(iter(fits))
        rows = [_candidate(model, fits, None, reference, problems) for model in ORDER]
        reason = f"{len(reference.chain.poses)} board poses are too few to hold any out"
        return ModelChoice(chosen, tuple(rows), f"lens model {chosen}: {reason}")
    fitted = [
        _Fitted(model, part, _held_out_squares(part, reference, effects))
        for model, part in fits.items()
    ]
    best = min(fitted, key=lambda candidate_fit: np.log(candidate_fit.squares).mean())
    rows = [_candidate(model, fits, (fitted, best), reference, problems) for model in ORDER]
    limit = 1.0 if _is_determined(best.part) else _LIMIT_UNDETERMINED
    compared = [row for row in rows if row.excess is not None]
    equivalent = [row.model for row in compared if row.excess <= limit * row.standard_error]
    close = [row.model for row in compared if row.excess <= _CLOSE and row.model != equivalent[0]]
    extrapolation = _extrapolation([equivalent[0], *close], fits, reference.chain)
    return ModelChoice(equivalent[0], tuple(rows), _sentence(equivalent, rows), extrapolation)


def _is_determined(part: Adjusted) -> bool:
    """Whether the images determine all parameters of the camera."""
    known = part.fit.known.determined & part.fit.converged
    return bool(known[: len(part.chain.parameters)].all())


def _candidate(model, fits, comparison, reference, problems) -> Candidate:
    count = MODELS[model]
    if model not in fits:
        return Candidate(model, count, why=str(problems[model]))
    part = fits[model]
    fit_px = float(np.sqrt((part.fit.residual[0] ** 2).sum(0).mean()))
    left_out = reference.chain.pixels.shape[1] - part.chain.pixels.shape[1]
    if comparison is None:
        return Candidate(model, count, fit_px, left_out=left_out)
    fitted, best = comparison
    squares = next(
        squares_of_model.squares for squares_of_model in fitted if squares_of_model.model == model
    )
    excess = np.log(squares / best.squares) / 2
    deviation = np.median(np.abs(excess - np.median(excess)))
    error = MEDIAN_TO_SIGMA * deviation / np.sqrt(len(excess))
    return Candidate(
        model,
        count,
        fit_px,
        float(np.sqrt(squares.mean())),
        float(excess.mean()),
        float(error),
        left_out,
    )


def _held_out_squares(part: Adjusted, reference: Adjusted, effects) -> np.ndarray:
    """(G,) mean squared errors, px^2, on each board pose of the reference, corners that the model left out included."""
    names = placement_groups(reference.views)[1]
    own_names = placement_groups(part.views)[1]
    count = len(names)
    squares = np.empty(count)
    folds = min(_FOLDS, count // 2)
    for fold in range(folds):
        out = np.arange(fold, count, folds)
        held_out_names = {names[k] for k in out}
        training = [k for k, name in enumerate(own_names) if name not in held_out_names]
        chain = group_subset(part.chain, np.array(training, int))
        camera = fit_free(chain, effects, part.fit.parameters, "huber").parameters
        residual, labels = residuals_of_halves(
            _with_camera(group_subset(reference.chain, out), part.chain.camera), effects, camera
        )
        sums = np.bincount(labels, (residual**2).sum(0), len(out))
        squares[out] = sums / np.bincount(labels, minlength=len(out))
    return squares


def _with_camera(chain: Corners, camera: Camera) -> Corners:
    return chain.moved(camera, chain.poses)


def _sentence(equivalent: Sequence[str], rows: Sequence[Candidate]) -> str:
    """Why the model was chosen."""
    compared = [row for row in rows if row.excess is not None]
    best = min(compared, key=lambda row: row.excess)
    if best.model == equivalent[0]:
        why = "it has the smallest error on held-out board poses"
    else:
        why = (
            "it is the simplest whose error on held-out board poses is that of the best "
            f"({best.model}), by the one-standard-error rule"
        )
    return f"lens model {equivalent[0]}: {why}"


def _extrapolation(
    equivalent: Sequence[str], fits: dict[str, Adjusted], chain: Corners
) -> tuple[str, ...]:
    """A sentence where models of the same held-out error differ outside of the corners."""
    first = fits[equivalent[0]].chain.camera
    distance = float(np.median(chain.state.points[2]))
    largest, sentences = _NOTABLE_PX, ()
    for other in equivalent[1:]:
        difference = projection_difference(first, fits[other].chain.camera, distance)
        is_bare = _without_corners(chain, difference.x, difference.y)
        value = np.where(np.isfinite(difference.value) & is_bare, difference.value, 0.0)
        row, column = np.unravel_index(np.argmax(value), value.shape)
        if value[row, column] > largest:
            largest = value[row, column]
            sentences = (
                f"the models {equivalent[0]} and {other} describe the corners equally well and differ by "
                f"{largest:.2g} px at the pixel ({difference.x[column]:.0f}, {difference.y[row]:.0f}), where there are "
                "no corners: the lens is extrapolated there. Take images with the board at this place, or do not "
                "measure there",
            )
    return sentences


def _without_corners(chain: Corners, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(rows, columns) whether no corner lies in the cell of the image around each pixel of a grid."""
    width, height = chain.camera.size
    cells = coverage(chain.pixels, chain.camera.size)
    rows, columns = cells.shape
    row = np.minimum((y / height * rows).astype(int), rows - 1)
    column = np.minimum((x / width * columns).astype(int), columns - 1)
    return cells[np.ix_(row, column)] == 0
