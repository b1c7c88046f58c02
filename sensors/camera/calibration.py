"""A camera from images of a board: Zhang's start, a bundle with a bowed board, and what is known of the result."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sensors.camera.adjust import PARALLEL, Adjusted, adjusted, tilts
from sensors.camera.checks import (
    FieldMap,
    Halves,
    HeldOut,
    compare_halves,
    coverage,
    held_out,
    projection_uncertainty,
    rms,
)
from sensors.camera.corners import Corners
from sensors.camera.correlated_errors.displaced_lines import DisplacedLine
from sensors.camera.correlated_errors.misfit import Misfit, bundle_misfit, lines_left_out
from sensors.camera.correlated_errors.shared import (
    UNLIKELY,
    LensMap,
    PrintErrors,
    lens_map,
    print_errors,
)
from sensors.camera.curvature import Curved, curved
from sensors.camera.focal_scatter import FocalScatter, focal_scatter
from sensors.camera.model import Camera
from sensors.camera.model_choice import AUTO, ModelChoice, choose_model
from sensors.camera.start import MODELS, corner_chain, placement_groups
from sensors.camera.suspect_views import BLUNDER_RATIO
from sensors.camera.two_cameras import TwoCameras, find_two_cameras
from sensors.effects.artefact import BoardBow
from workbench.core.effect import Effect
from workbench.core.errors import InputError
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.parameters import Parameters
from workbench.core.text.uncertain import with_std

if TYPE_CHECKING:
    from sensors.boards.board import Board
    from sensors.boards.detection import Rejected, View

_BOW = f"artefact.{BoardBow.effect}."
_COVERED = 0.6
_DOUBTED = 3.0  # standard deviations
_NOTABLE_PX = 1.0  # of projection, an error that every use of the camera notices


@dataclass(frozen=True)
class Bow:
    """The board's warp: `parameters` (mm) and `std` by name; `height_mm`, `height_std_mm`: highest over
    lowest point of the board, from the plane that fits it best.
    """

    parameters: dict[str, float]
    std: dict[str, float]
    height_mm: float
    height_std_mm: float


@dataclass(frozen=True)
class CameraCalibration:
    """A camera and what is known of it.

    `fit` of the bundle and the `chain` of corners (sorted by board pose) at its solution; `views` that were used,
    `rejected` those that were not, `left_out` how many corners of a image, by its name; `undetermined` and `remarks`
    sentences, of which `notes` are no doubts of the model; `printed` errors of the board's corners, `lens` what the
    model leaves of it, `curved` where sigmas do not hold, `focal` whether the focal length is constant; `two_cameras`
    if the images are of two; `left_out_lines` of the board, whose corners contradict all others; `choice` of the model,
    None where it was stated; the checks, None where
    there are too few board poses. RMS are of the residuals of all corners used, none weighted down.
    """

    camera: Camera
    fit: BundleFit
    chain: Corners
    effects: tuple[Effect, ...]
    views: tuple["View", ...]
    board: "Board"
    rejected: tuple["Rejected", ...]
    left_out: dict[str, int]
    undetermined: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    printed: PrintErrors | None = None
    shared: Misfit | None = None
    lens: LensMap | None = None
    curved: Curved | None = None
    held_out: HeldOut | None = None
    halves: Halves | None = None
    focal: FocalScatter | None = None
    left_out_lines: tuple[DisplacedLine, ...] = ()
    two_cameras: TwoCameras | None = None
    choice: ModelChoice | None = None

    @property
    def displaced_lines(self) -> tuple[DisplacedLine, ...]:
        """Lines of the board that are displaced beyond doubt, in the fit or left out of it."""
        shared = self.shared is not None and self.shared.significant
        return (*(self.shared.errors.lines if shared else ()), *self.left_out_lines)

    @property
    def parameters(self) -> Parameters:
        return self.fit.parameters

    @property
    def std(self) -> dict[str, float]:
        """1 sigma by key (`camera.fx`, `artefact.board-bow.xx`, ...): sigmas scaled to the residuals, with priors and
        with the board's print errors; nan for what these images do not determine.
        """
        sigma = np.where(self.determined, np.sqrt(np.diag(self.covariance)), np.nan)
        return dict(zip(self.fit.table.keys, sigma.tolist()))

    @property
    def determined(self) -> np.ndarray:
        """(F,) False for free parameters that are confounded with others or whose sigma does not hold, all without an
        end of the solve.
        """
        known = self.fit.known.determined & self.fit.converged
        if self.curved is not None:
            known &= ~self.curved.members
        if not all(known[self.fit.table.index[key]] for key in ("camera.fx", "camera.fy")):
            distortion = slice(4, len(self.chain.parameters))  # distortion counts in focal lengths
            known[distortion] = False
        return known

    @property
    def covariance(self) -> np.ndarray:
        """(F, F) of the free parameters, in their order, with the errors that images share where there are any."""
        if self.shared is not None and self.shared.significant:
            return self.shared.covariance
        return self.fit.covariance if self.printed is None else self.printed.covariance

    @property
    def poses(self) -> np.ndarray:
        """(G, 6) T_camera_board of each board pose: x y z (mm), rotation vector (rad)."""
        return self.fit.values["placement"]

    @property
    def placements(self) -> list[str]:
        """(G) names."""
        return placement_groups(self.views)[1]

    @property
    def residual(self) -> np.ndarray:
        """(2, n) px, predicted minus measured."""
        return self.fit.residual[0]

    @property
    def view(self) -> np.ndarray:
        """(n,) index into `views` of each corner."""
        return self.chain.labels["view"]

    @property
    def rms_px(self) -> float:
        """As OpenCV counts: root of the mean squared distance."""
        return rms(self.residual)

    @property
    def rms_coordinate_px(self) -> float:
        """Of one coordinate: smaller by the root of two."""
        return self.rms_px / np.sqrt(2)

    @cached_property
    def view_rms_px(self) -> np.ndarray:
        """(V,) of each image, as OpenCV counts."""
        squares = np.bincount(self.view, (self.residual**2).sum(0), len(self.views))
        return np.sqrt(squares / np.bincount(self.view, minlength=len(self.views)))

    @property
    def distance_mm(self) -> float:
        """Median distance of the corners along the optical axis."""
        return float(np.median(self.chain.state.points[2]))

    @cached_property
    def uncertainty(self) -> FieldMap:
        """1 sigma of projection over the image at the boards' distance."""
        size = len(self.chain.parameters)
        return projection_uncertainty(self.camera, self.covariance[:size, :size], self.distance_mm)

    @property
    def coverage(self) -> np.ndarray:
        """(6, 8) corners in each cell of the image."""
        return coverage(self.chain.pixels, self.camera.size)

    @cached_property
    def bow(self) -> Bow | None:
        """The board's warp, None where it was not fitted."""
        keys = [key for key in self.fit.table.keys if key.startswith(_BOW)]
        if not keys:
            return None
        places = [self.fit.table.index[key] for key in keys]
        values = self.fit.table.values[places]
        covariance = self.covariance[np.ix_(places, places)]
        names = [key.removeprefix(_BOW) for key in keys]
        return Bow(
            dict(zip(names, values.tolist())),
            {name: self.std[_BOW + name] for name in names},
            *_height(self.board, values, covariance),
        )


def calibrate_camera(
    views: Sequence["View"],
    board: "Board",
    size: tuple[int, int],
    model: str = "brown",
    bow: bool = True,
    effects: Sequence[Effect] = (),
    loss: str = "huber",
    folds: int = 5,
    progress: Callable[[str], None] = lambda text: None,
) -> CameraCalibration:
    """The camera, its board's bow and all poses from views of one board.

    model: "brown" (k1 k2 p1 p2 k3), "rational" (with k4 k5 k6), "fisheye", or "auto" for the one that
    `choose_model` chooses. bow: fit the board's warp. effects:
    further ones of the sensor to be fitted. folds: of the held-out images, 0 for none of the
    checks. progress: called with one line a step. InputError where there are fewer than three
    usable board poses, where the views do not fit the board or one another.
    """
    if model not in (*MODELS, AUTO):
        raise InputError(
            f"camera model: expected {' or '.join((*MODELS, AUTO))}, found {model!r}; choose one of them"
        )
    effects = (*((BoardBow("artefact", board.flatness_mm),) if bow else ()), *effects)
    choice = choose_model(views, board, size, effects, progress) if model == AUTO else None
    model = model if choice is None else choice.chosen
    progress(f"camera, poses and bow from {len(views)} images")
    part = adjusted(views, board, size, model, effects, loss)
    calibration = CameraCalibration(
        part.chain.camera,
        part.fit,
        part.chain,
        effects,
        part.views,
        board,
        part.rejected,
        part.left_out,
    )
    printed = print_errors(part.chain, part.fit, effects)
    calibration = replace(
        calibration,
        printed=printed,
        shared=bundle_misfit(part.chain, part.fit, effects),
        lens=lens_map(part.chain, part.fit, printed),
        curved=curved(part.chain, part.fit, effects),
        focal=focal_scatter(part.chain, part.fit, effects),
        left_out_lines=lines_left_out(
            _every_corner(part, board, size, model), part.chain, part.fit, effects
        ),
        choice=choice,
    )
    if folds:
        known = part.fit.parameters
        progress("images left out in folds, compared with OpenCV")
        left_out = held_out(part.chain, effects, known, loss, folds)
        progress("one half of the images against the other")
        halves = compare_halves(part.chain, effects, known, loss, calibration.distance_mm)
        calibration = replace(calibration, held_out=left_out, halves=halves)
    calibration = replace(calibration, two_cameras=_two_cameras(calibration))
    notes = tuple(_notes(calibration, folds))
    return replace(
        calibration,
        undetermined=tuple(_undetermined(calibration)),
        notes=notes,
        remarks=(*notes, *_model_errors(calibration)),
    )


def _is_one_camera_doubted(calibration: CameraCalibration) -> bool:
    """Whether the focal length scatters, or the halves of the corners disagree."""
    focal = calibration.focal
    halves = calibration.halves
    is_focal_scattered = focal is not None and focal.significant
    is_split_unlikely = halves is not None and halves.p_value < UNLIKELY
    return is_focal_scattered or is_split_unlikely


def _two_cameras(calibration: CameraCalibration) -> TwoCameras | None:
    """Looked for only where one camera is in doubt."""
    if not _is_one_camera_doubted(calibration):
        return None
    focal = calibration.focal
    changes = np.empty(0) if focal is None else focal.changes
    names = [view.image for view in calibration.views]
    return find_two_cameras(
        calibration.chain, calibration.effects, calibration.parameters, changes, names
    )


def _every_corner(part: Adjusted, board, size, model) -> Corners:
    """All corners of the images in a fit, also those that were left out, at its solution and of its usual sigma."""
    chain = corner_chain(part.views, board, size, model)
    sigma = np.full((2, 1), np.median(part.chain.sigma))
    return replace(chain.moved(part.chain.camera, part.chain.poses), sigma=sigma)


def _height(board, values, covariance):
    """Highest over lowest point of the bowed board from its best plane, and 1 sigma of it, mm."""
    x, y = (board.points - board.middle[:, None])[:2] / board.half_diagonal
    shapes = np.stack([x * x, y * y, x * y])
    plane = np.stack([np.ones_like(x), x, y])
    on_plane = shapes @ np.linalg.pinv(plane) @ plane
    from_plane = shapes - on_plane
    height = values @ from_plane
    difference = from_plane[:, np.argmax(height)] - from_plane[:, np.argmin(height)]
    variance = difference @ covariance @ difference
    return float(np.ptp(height)), float(np.sqrt(variance))


def _undetermined(calibration: CameraCalibration) -> list[str]:
    """State what these images do not determine, or only poorly because the boards were parallel."""
    sentences = list(calibration.fit.known.sentences())
    if calibration.curved is not None:
        sentences.append(calibration.curved.sentence)
    spread = tilts(calibration.poses)
    if spread > PARALLEL:
        return sentences
    weak = not calibration.determined[calibration.fit.table.index["camera.fx"]]
    sigma = f"{calibration.std['camera.fx']:.2g} px (1 sigma)"
    known = "is confounded with its distance" if weak else f"is known to {sigma} only"
    return [
        f"the board was parallel to itself within {np.rad2deg(spread):.1f} degrees at all {len(calibration.poses)} "
        f"board poses: the focal length, which shows where it is tilted, {known}; tilt it by 20 to 45 degrees "
        "both ways",
        *sentences,
    ]


def _notes(calibration: CameraCalibration, folds: int) -> list[str]:
    """State what a user should know of the images and the fit, and no other sentence says."""
    sentences = _extrapolated(calibration)
    if calibration.choice is not None:
        sentences += [calibration.choice.sentence, *calibration.choice.extrapolation]
    if calibration.left_out:
        rows = ", ".join(f"{count} of {image}" for image, count in calibration.left_out.items())
        sentences.append(
            f"corners left out because they are more than {BLUNDER_RATIO:g} times as far off as half of all are: {rows}"
        )
    if folds and calibration.held_out is None:
        sentences.append(
            f"no image could be left out as a check: {len(calibration.poses)} board poses are too few; take more"
        )
    if not calibration.fit.converged:
        sentences.append(calibration.fit.outcome)
    return [*sentences, *_on_flatness(calibration)]


def _model_errors(calibration: CameraCalibration) -> list[str]:
    """State why the lens, the board or the images are not as the model says."""
    shared_errors = (calibration.printed, calibration.lens)
    sentences = [test.sentence for test in shared_errors if test is not None and test.significant]
    if calibration.halves is not None and calibration.halves.p_value < UNLIKELY:
        chance = f"chance does so with probability {calibration.halves.p_value:.1g}"
        sentences.append(
            f"{calibration.halves.sentence} ({chance}): the lens is "
            f"not of the model fitted, or the corners of an image share errors; {_on_sigmas(calibration)}"
        )
    if (
        calibration.shared is not None
        and calibration.shared.significant
        and not _names_shared(calibration)
    ):
        sentences.append(calibration.shared.sentence)
    if calibration.focal is not None and calibration.focal.significant:
        sentences.append(calibration.focal.sentence)
    if calibration.two_cameras is not None:
        sentences.append(calibration.two_cameras.sentence)
    return sentences


def _extrapolated(calibration: CameraCalibration) -> list[str]:
    """State where the images do not determine the lens: outside of the boards."""
    share = float((calibration.coverage > 0).mean())
    field = calibration.uncertainty.value
    worst = float(np.nanmax(field)) if np.isfinite(field).any() else np.nan
    if share >= _COVERED and not worst > _NOTABLE_PX:
        return []
    return [
        f"corners lie in {100 * share:.0f} % of the image's cells (8 x 6); in the others the lens is extrapolated. "
        f"The projection is uncertain by {np.nanmedian(field):.2g} px (1 sigma) in the median of the image and by "
        f"{worst:.2g} px at its worst place. Take images with the board at the borders and in the corners of the image"
    ]


def _names_shared(calibration: CameraCalibration) -> bool:
    """Whether print or lens are remarked on already."""
    return any(
        test is not None and test.significant for test in (calibration.printed, calibration.lens)
    )


def _on_sigmas(calibration: CameraCalibration) -> str:
    """State which errors that images share the standard deviations include."""
    if calibration.shared is not None and calibration.shared.significant:
        return f"the stated uncertainties include errors that images share ({calibration.shared.errors.names}, 1 sigma)"
    return f"neither is in the sigmas, which should be taken as {calibration.halves.ratio:.1f} times as large"


def _on_flatness(calibration: CameraCalibration) -> list[str]:
    """A sentence where the images contradict the certified flatness of the board."""
    bow = calibration.bow
    flatness = calibration.board.flatness_mm
    if bow is None or flatness is None:
        return []
    lowest_height = bow.height_mm - _DOUBTED * bow.height_std_mm
    if not lowest_height > flatness:
        return []
    return [
        f"the board's warp is {with_std(bow.height_mm, bow.height_std_mm)} mm, its certified flatness (flatness_mm) "
        f"{flatness:g} mm: the prior is wrong and biases the camera; correct or remove flatness_mm"
    ]
