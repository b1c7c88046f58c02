"""A scanner from images of a board, without and with the laser: camera, bow, poses, light planes and mirror."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from sensors.light.board_chain import BoardStripeChain
from sensors.light.board_stripes import BoardStripes, on_the_board, thinned, wrong_points
from sensors.light.mirror_choice import FEWEST, MirrorCheck, try_mirror
from sensors.light.planes import plane_through, plane_variance
from sensors.light.shared_errors import SharedStripeErrors
from sensors.light.stationary_lines import Centres, StationaryLine, find_stationary_lines
from sensors.light.straight import straightened, unshaded
from sensors.scanner.adjustment import Adjustment, adjust
from sensors.scanner.check import LeftOut, leave_out, residuals
from sensors.scanner.errors import BestFrameCovariance, field_points
from sensors.scanner.model import Scanner
from sensors.scanner.residuals.line_dependence import LineDependence, line_dependence
from sensors.scanner.residuals.rejected_points import RejectedPoints, rejected_points
from sensors.scanner.shared import own_noise, with_shared_errors
from sensors.stripe.surface_bias.surface_line import LineShape
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.effect import Effect
from workbench.core.errors import InputError

if TYPE_CHECKING:
    from sensors.boards.board import Board
    from sensors.boards.detection import View
    from sensors.camera.calibration import CameraCalibration

Progress = Callable[[str], None]
_FEWEST_POINTS = 20
_FEWEST_PLACEMENTS = 2
_FRAME_TAKES = 3  # planes below which six numbers of a frame make up for all of theirs
_NO_BOARD = "no board: no usable image of the board in their pose"
_OFF_BOARD = "off the board"
_FIXED = "next to a line that stays at one place of the image: a scratch or a reflection"
_NO_PLANE = "their step's plane is not determined: fewer than two board poses, or one line"
_WRONG = "wrong: far from their stripe centreline or from its light plane"
_NO_ROTATION_RAD = 1e-6  # rad, below which commanded angles say nothing of how the mirror turns
_LINE = 0.02  # second over first spread of a step's points below which they lie on one line, and make no plane


@dataclass(frozen=True)
class ScannerCalibration:
    """A scanner and what is known of it.

    `start` the camera calibration from corners alone; `made` the adjustment in the result, `free`
    that with free planes (the same where no mirror was fitted or supported); `stripes` all points on
    the board that were used or judged, `residual_px`, `residual_mm` (n,) of them against the
    result and `wrong` (n,) those left out; `rms_px`, `rms_mm` (S,) of each step's good points;
    `sigma_plane_mm` (S,) RMS over the working volume of each plane's 1 sigma in the camera's frame,
    most of which is that frame's own and moves nothing against anything else: `best_frame` says what is
    left without it; the errors that points of a stripe share (`made.board_stripes.together`) are in both;
    `dropped` numbers of points, by reason; `volume` nearest and farthest depth, mm; `sentences` what was
    dropped, what is not determined and what was refused; `commanded` (S,) rad mirror angles of the steps as
    images.csv states them, None where it does not; `lines` of the image that were taken for the laser line;
    `dependence` of centres on the width and brightness of the line, None where these are unknown; `rejected`: where
    the wrong points lie.
    """

    scanner: Scanner
    start: "CameraCalibration"
    made: Adjustment
    free: Adjustment
    mirror: MirrorCheck | None
    left_out: LeftOut | None
    placements: tuple[str, ...]
    stripes: BoardStripeChain
    residual_px: np.ndarray
    residual_mm: np.ndarray
    wrong: np.ndarray
    rms_px: np.ndarray
    rms_mm: np.ndarray
    sigma_plane_mm: np.ndarray
    best_frame: BestFrameCovariance
    dropped: Mapping[str, int]
    volume: tuple[float, float]
    sentences: tuple[str, ...] = field(default_factory=tuple)
    commanded: np.ndarray | None = None
    lines: tuple[StationaryLine, ...] = ()
    dependence: LineDependence | None = None
    rejected: RejectedPoints = RejectedPoints(0.0, "sensor", (), 1.0)

    @property
    def camera(self):
        """The camera of the joint adjustment."""
        return self.scanner.camera

    @property
    def poses(self) -> np.ndarray:
        """(G, 6) T_camera_board of each of `placements`."""
        return self.made.board_stripes.poses

    @property
    def sigma_apart_mm(self) -> np.ndarray:
        """(S,) mm, as `sigma_plane_mm` but in the frame that fits best: what planes err by against one another."""
        return _over_volume(self.made, self.best_frame.planes, self.volume)

    @property
    def sigma_stated_mm(self) -> np.ndarray:
        """(S,) mm, `sigma_apart_mm` of three planes or more. Of fewer, the frame that fits best absorbs all errors:
        then `sigma_plane_mm`."""
        return (
            self.sigma_apart_mm if len(self.scanner.steps) >= _FRAME_TAKES else self.sigma_plane_mm
        )

    @property
    def std(self) -> dict[str, float]:
        """1 sigma by key of every parameter of the adjustment."""
        return self.made.fit.std

    @property
    def sigma_stripe_px(self) -> float:
        """Noise of a stripe's centre as its residuals show it, root of the mean square."""
        return float(np.sqrt((self.residual_px[~self.wrong] ** 2).mean()))

    @property
    def sigma_corner_px(self) -> float:
        """Noise of one coordinate of a corner, as its residuals show it."""
        return float(np.sqrt((self.made.fit.residual[0] ** 2).mean()))


def calibrate_scanner(
    views: Sequence["View"],
    stripes: BoardStripes,
    board: "Board",
    size: tuple[int, int],
    *,
    camera: "CameraCalibration | None" = None,
    model: str = "brown",
    effects: Sequence[Effect] = (),
    mirror: bool = True,
    check: bool = True,
    provenance: Mapping | None = None,
    progress: Progress = lambda text: None,
) -> ScannerCalibration:
    """One adjustment of corners and stripes of all board poses, each residual in pixels.

    views: images of the board without laser; stripes: points of the laser's line on it, with the
    board pose and the mirror's step of each. camera: a calibration of these views, made here where not given.
    effects: further ones of the sensor to be fitted (those of `camera` always are); those of the mirror
    act only where the mirror is tried: free planes hold them already. mirror: try the
    physical mirror where there are five steps or more. check: leave board poses out.
    InputError where no stripe is on a board, or no plane is determined.
    """
    if camera is None:
        from sensors.camera.calibration import calibrate_camera

        camera = calibrate_camera(views, board, size, model, progress=progress)
    found = _prepared(camera, stripes, board)
    all_effects = (*camera.effects, *effects)
    progress(
        f"light planes of {len(found.steps)} steps from {found.all_stripes.n} points of stripes"
    )
    thin, _ = thinned(found.all_stripes.at(~found.wrong))
    static_effects = tuple(
        effect for effect in all_effects if effect.where != "mirror" and effect.port != "mirror"
    )
    corners = replace(camera.chain, sigma=camera.chain.sigma * camera.fit.scales[0])
    free = with_shared_errors(
        adjust(corners, thin, static_effects, camera.parameters, progress=progress)
    )
    adjustment = free
    checked = None
    if mirror and len(found.steps) >= FEWEST:
        by_step = found.commanded is None or np.ptp(found.commanded) < _NO_ROTATION_RAD
        numbers = found.steps.astype(float) if by_step else found.commanded
        tried, checked = try_mirror(free, numbers, by_step, found.volume, all_effects, progress)
        if checked.supported:
            found, tried = _unshaded(found, tried, checked.mirror.point)
            adjustment = with_shared_errors(tried)
    held_out = leave_out(adjustment, found.all_stripes, progress) if check else None
    return _result(camera, found, free, adjustment, checked, held_out, provenance)


def _unshaded(found: "_Found", tried: Adjustment, light):
    """Stripes less what the light's slope on tilted boards pulls them by, where a mirror says where it comes from."""
    at_poses = replace(found.all_stripes, poses=tried.board_stripes.poses)
    shift = unshaded(at_poses, found.line.plane_width_mm, light).pixels
    board_stripes = replace(
        tried.board_stripes,
        pixels=unshaded(tried.board_stripes, found.line.plane_width_mm, light).pixels,
    )
    return replace(found, all_stripes=replace(found.all_stripes, pixels=shift)), replace(
        tried, board_stripes=board_stripes
    )


def _scanner(
    adjustment: Adjustment, found: "_Found", plane_covariances, centre, provenance
) -> Scanner:
    """The scanner of an adjustment; centre: px, noise of a stripe's centre."""
    stripes = adjustment.board_stripes
    return Scanner(
        adjustment.camera,
        found.steps,
        stripes.planes,
        stripes.mirror,
        None if stripes.mirror is None else stripes.angles,
        _effects(adjustment),
        centre,
        plane_covariances.planes,
        found.volume,
        found.all_stripes.scan[:, 0],
        dict(provenance or {}),
        plane_covariances.frame,
        stripes.shared_errors.named,
        camera_covariance=_camera_covariance(adjustment),
        rays=plane_covariances.rays,
        line=found.line if found.line.plane_width_mm > 0 else None,
    )


def _result(camera, found, free, adjustment, checked, held_out, provenance) -> ScannerCalibration:
    stripes = adjustment.board_stripes
    last = replace(found.all_stripes, angles=stripes.angles)
    last = last.moved(adjustment.camera, stripes.poses, stripes.planes, stripes.mirror)
    pixels, millimetres = residuals(adjustment, last)
    is_good = ~found.wrong & (
        np.abs(pixels) <= 5 * MEDIAN_TO_SIGMA * np.median(np.abs(pixels[~found.wrong]))
    )
    dropped = {**found.dropped, _WRONG: int((~is_good).sum())}
    plane_covariances = adjustment.best_frame(found.volume)
    centre = _centre_noise(last.at(is_good), pixels[is_good])
    scanner = _scanner(adjustment, found, plane_covariances, centre, provenance)
    about_fit = (
        *camera.undetermined,
        *_on_mirror(checked),
        *_on_shared(adjustment, centre),
        *_on_fit(adjustment),
    )
    step = last.labels["step"]
    rms = [_rms(values, step, is_good, len(found.steps)) for values in (pixels, millimetres)]
    return ScannerCalibration(
        scanner,
        camera,
        adjustment,
        free,
        checked,
        held_out,
        tuple(camera.placements),
        last,
        pixels,
        millimetres,
        ~is_good,
        *rms,
        _sigma_planes(adjustment, found.volume),
        plane_covariances,
        dropped,
        found.volume,
        (*_on_dropped(dropped), *about_fit),
        found.commanded,
        found.lines,
        _dependence(found, last, pixels, is_good),
        rejected_points(last, ~is_good, found.shape),
    )


def _dependence(found: "_Found", last: BoardStripeChain, pixels, is_good) -> LineDependence | None:
    """Of the residuals (n,) px of the points that are `good` (n,) bool."""
    if found.shape is None:
        return None
    stripe = last.labels["placement"] * len(found.steps) + last.labels["step"]
    return line_dependence(
        pixels[is_good], stripe[is_good], last.stripe_place[is_good], found.shape[:, is_good]
    )


def _on_shared(adjustment, centre):
    shared_errors = adjustment.board_stripes.shared_errors
    return [shared_errors.sentence, *shared_errors.too_much(centre)]


def _centre_noise(board_stripes, residual):
    """px, 1 sigma of single centres of stripes, without what they share; of all where there are too few to tell."""
    variance = own_noise(
        residual,
        np.ones(board_stripes.n),
        SharedStripeErrors.of(board_stripes.labels, board_stripes.stripe_place),
    )
    return float(np.sqrt(variance if np.isfinite(variance) else (residual**2).mean()))


def _rms(values, step, is_good, count):
    """(S,) root of the mean square of the good ones of each step."""
    number = np.maximum(np.bincount(step[is_good], minlength=count), 1)
    return np.sqrt(np.bincount(step[is_good], values[is_good] ** 2, count) / number)


@dataclass(frozen=True)
class _Found:
    """Stripe points on boards, sorted out: the chain at its start, its steps (S,) and their commanded angles, and
    `line` as of `straightened`; `shape` (2, n) as of `BoardStripes`."""

    all_stripes: BoardStripeChain
    wrong: np.ndarray
    steps: np.ndarray
    commanded: np.ndarray | None
    dropped: dict[str, int]
    line: LineShape
    lines: tuple[StationaryLine, ...] = ()
    shape: np.ndarray | None = None

    @property
    def volume(self) -> tuple[float, float]:
        """Depths (mm) between which all but 2 % of the points were seen."""
        low, high = np.quantile(self.all_stripes.at_start.hits[2], [0.01, 0.99])
        return float(low), float(high)


def _prepared(camera, stripes: BoardStripes, board) -> _Found:
    """Points whose board pose is known, that lie on the board, at steps whose plane they determine."""
    dropped: dict[str, int] = {}
    names = np.array(camera.placements)
    retained = _retained(stripes, np.isin(stripes.placement, names), dropped, _NO_BOARD)
    order = np.argsort(names)
    group = order[np.searchsorted(names[order], retained.placement)]
    at_start = _chain(camera, retained, board, group).at_start
    is_on_board = on_the_board(board, at_start.on_board) & (at_start.depth > 0)
    retained = _retained(retained, is_on_board, dropped, _OFF_BOARD)
    group, hits = group[is_on_board], at_start.hits[:, is_on_board]
    _refuse_none(
        retained,
        "points of the laser's line on a board that was seen",
        dropped,
        "see that `placement` of board and board-laser images agree",
    )
    lines, displaced = _stationary(camera, retained, group, hits[2])
    retained = _retained(retained, ~displaced, dropped, _FIXED)
    group, hits = group[~displaced], hits[:, ~displaced]
    _refuse_none(
        retained,
        "points of a laser line that moves in the image with the board",
        dropped,
        "clean optics and mirror, or shield stray light, and take the images again",
    )
    steps, step = np.unique(retained.step, return_inverse=True)
    planes, fine = _start_planes(hits, group, step, len(steps))
    is_on_board = fine[step]
    retained = _retained(retained, is_on_board, dropped, _NO_PLANE)
    group = group[is_on_board]
    _refuse_none(
        retained,
        f"a step seen in {_FEWEST_PLACEMENTS} board poses at different depths",
        dropped,
        "move the board and take more images",
    )
    steps = steps[fine]
    all_stripes = _chain(
        camera, retained, board, group, np.searchsorted(steps, retained.step), planes[:, fine]
    )
    all_stripes, line = straightened(all_stripes, retained.shape)
    return _Found(
        all_stripes,
        wrong_points(all_stripes, all_stripes.at_start),
        steps,
        retained.angles(steps),
        dropped,
        line,
        lines,
        retained.shape,
    )


def _stationary(camera, stripes, group, depth):
    """Lines that stay at one place of the image, and (n,) which points lie next to them; depth (n,) mm there."""
    image = group * (int(stripes.step.max(initial=0)) + 1) + stripes.step
    centres = Centres(stripes.pixels, stripes.scan[:, 0], stripes.step, image, depth)
    return find_stationary_lines(centres, camera.camera.fx)


def _refuse_none(stripes, expected, dropped, remedy):
    if not stripes.n:
        counts = (
            ", ".join(f"{number} points: {why}" for why, number in dropped.items())
            or "no point at all"
        )
        raise InputError(f"stripes on boards: expected {expected}, found none ({counts}); {remedy}")


def _retained(stripes, keep, dropped, why):
    if (~keep).any():
        dropped[why] = int((~keep).sum())
    return stripes.at(keep)


def _chain(camera, stripes, board, group, step=None, planes=None) -> BoardStripeChain:
    """The stripe chain; without planes it only knows where rays meet boards."""
    step = np.zeros(stripes.n, int) if step is None else step
    planes = np.zeros((4, 1)) if planes is None else planes
    return BoardStripeChain(
        camera.camera,
        stripes.pixels,
        {"placement": group, "step": step},
        camera.poses,
        planes,
        board.middle[:2],
        board.half_diagonal,
        stripes.scan,
        stripes.sigma[None],
        covariates=stripes.covariates,
    )


def _start_planes(points, group, step, count):
    """(4, S) planes through the points of each step, and (S,) whether they are determined."""
    planes = np.zeros((4, count))
    fine = np.zeros(count, bool)
    order = np.argsort(step, kind="stable")
    for k, points_of_step in enumerate(
        np.split(order, np.cumsum(np.bincount(step, minlength=count))[:-1])
    ):
        if (
            len(points_of_step) < _FEWEST_POINTS
            or len(np.unique(group[points_of_step])) < _FEWEST_PLACEMENTS
        ):
            continue
        planes[:, k], spread = plane_through(points[:, points_of_step])
        fine[k] = spread[1] > _LINE * spread[0] and planes[3, k] != 0
    return planes, fine


def _camera_covariance(adjustment: Adjustment) -> np.ndarray:
    """(V, V) of the camera's values."""
    factor = adjustment.joint()[: len(adjustment.camera.values)]
    return factor @ factor.T


def _effects(adjustment: Adjustment):
    """Effects that act on every scan, with their parameters; the board's own stay with the board."""
    retained = []
    for effect in adjustment.effects:
        if effect.port in ("target", "noise"):
            continue
        start = f"{effect.where}.{effect.effect}."
        names = [p.key for p in effect.parameters(adjustment.board_stripes)]
        retained.append(
            (
                effect,
                np.array([adjustment.parameters[name] for name in names if name.startswith(start)]),
            )
        )
    return tuple(retained)


def _sigma_planes(adjustment: Adjustment, volume) -> np.ndarray:
    """(S,) mm in the camera's frame as it stands, RMS over the working volume."""
    joint = adjustment.joint()[len(adjustment.camera.values) :]
    return _over_volume(adjustment, joint @ joint.T, volume)


def _over_volume(adjustment, covariance, volume):
    """(S,) mm, RMS over the working volume, of planes with a covariance (3 S, 3 S)."""
    planes = adjustment.board_stripes.planes
    points, step = field_points(adjustment.camera, planes, *volume)
    variance = plane_variance(planes, points, step, covariance)
    count = np.bincount(step, minlength=planes.shape[1])
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.bincount(step, variance, planes.shape[1]) / count)


def _on_dropped(dropped):
    return [
        f"{number} points of stripes were left out: {why}"
        for why, number in dropped.items()
        if number
    ]


def _on_mirror(check: MirrorCheck | None):
    if check is None:
        return []
    first = (
        f"one mirror ({len(check.fitted)} parameters) instead of independent light planes: chi-square increases by "
        f"{check.excess:.0f} with {check.degrees} degrees of freedom (p = {check.probability:.2g} for a true mirror); "
        f"the planes differ by {check.difference_mm:.4f} mm RMS, by chance {check.expected_mm:.4f} mm; {check.verdict}"
    )
    return [first, *check.sentences]


def _on_fit(adjustment: Adjustment):
    return [] if adjustment.fit.converged else [adjustment.fit.outcome]
