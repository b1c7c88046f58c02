"""From images to what a diagnosis of the sensor looks at: corners, stripes on boards, stripes on balls.

Found, cleaned and averaged once by the workbench's own calibration, with bow and free light planes,
which hide next to nothing; what noise each kind of measurement has is then read from its third divided
differences between neighbours. A smooth effect leaves none there, so a planted one does not pass for noise.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import Recording
from sensors.boards.detection import detect_all
from sensors.camera.calibration import calibrate_camera
from sensors.camera.corners import Corners
from sensors.camera.correlated_errors.displaced_lines import DisplacedLine
from sensors.camera.model import Camera
from sensors.camera.model_choice import AUTO
from sensors.effects.optics import Blooming
from sensors.light.ball_stripes import Balls
from sensors.light.board_chain import BoardStripeChain
from sensors.light.board_stripes import thinned
from sensors.light.grouping import groups
from sensors.light.mirror import on_one_branch, start_mirror
from sensors.light.mirror_choice import FEWEST
from sensors.scanner.adjustment import stripes_at_solution
from sensors.scanner.calibration import calibrate_scanner
from sensors.scanner.residuals.line_dependence import LineDependence, line_covariates
from sensors.scanner.residuals.rejected_points import RejectedPoints
from sensors.stripe.asymmetry import Profiles, asymmetry
from sensors.stripe.second_line import SecondLine, second_line
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.least_squares.bundle import BundleFit
from workbench.core.model import Model
from workbench.files.images.images import by_role
from workbench.fitting.verdicts.line_doubts import LineDoubt, line_doubts
from workbench.jobs.sensor import scanner as scanners

MOST_STRIPES = 6_000
"""Points of stripes on boards in all: some tens a stripe, which carry everything that is smooth along it."""
_MIN_DIFFERENCES = 30  # third differences that tell a noise
_WRONG = 4.0
_MIN_ROTATION = 1e-6  # rad
_ODD = 0.05  # of one, by which a mirror's turn may differ from the commanded one
_ROUNDS = 4  # each leaves the square of what the last one missed by
_FARTHEST = 20.0  # px that one round moves a stripe
_LENS_MARGIN = 1.02  # of the distance from the principal point
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Chains:
    """The measurements of a sensor, each chain started at a fit; `board_stripes`, `balls` None where there are none.

    With a mirror where the angles were commanded, else with free planes; `gain_free`: what was
    commanded is no angle of the mirror, whose turn a command is then unknown. `placements`, `scans` names; `lines` of
    the board that the calibration of the camera found displaced; `dependence` of stripe centres on the width and
    brightness of the line, None where these are unknown; `line_doubts`: what is in doubt about that line;
    `second_line` next to it where its profile is asymmetric, else None; `rejected` points of it; `beyond_lens` number
    of stripe points left out because the camera model does not reach them, see `within_lens`.
    """

    corners: Corners
    board_stripes: BoardStripeChain | None = None
    balls: Balls | None = None
    placements: tuple[str, ...] = ()
    scans: tuple[str, ...] = ()
    gain_free: bool = False
    lines: tuple[DisplacedLine, ...] = ()
    dependence: LineDependence | None = None
    line_doubts: tuple[LineDoubt, ...] = ()
    second_line: SecondLine | None = None
    rejected: RejectedPoints | None = None
    beyond_lens: int = 0

    @property
    def parts(self) -> dict[str, Corners | BoardStripeChain | Balls]:
        """The chains that there are, in the order in which their coordinates stand in a problem."""
        named_chains = {
            "corners": self.corners,
            "board_stripes": self.board_stripes,
            "balls": self.balls,
        }
        return {name: chain for name, chain in named_chains.items() if chain is not None}

    @property
    def counts(self) -> tuple[int, ...]:
        """Samples of each part."""
        return tuple(chain.pixels.shape[1] for chain in self.parts.values())


def read(recording: Recording, progress: Progress = lambda text: None) -> Chains:
    """Corners, stripes and balls of a recording of kind board-images or scan-images. Raises InputError."""
    from workbench.jobs.sensor.ball_chains import balls_of

    by_role(recording, "board")
    found = detect_all(
        recording, lambda done, total, name: progress(f"board in image {done} of {total}")
    )
    camera = calibrate_camera(
        found.views, found.board, found.size, AUTO, folds=0, progress=progress
    )
    profiles: list[Profiles] = []
    stripes = _stripes(recording, camera, progress, profiles)
    if stripes is None:
        return noisy(_of_camera(camera))
    calibration = calibrate_scanner(
        camera.views,
        stripes,
        camera.board,
        camera.camera.size,
        camera=camera,
        mirror=False,
        check=False,
        progress=progress,
    )
    board_stripes, _ = thinned(calibration.free.board_stripes, MOST_STRIPES)
    size = max(1, round(calibration.stripes.n / max(board_stripes.n, 1)))
    board_stripes, gain_free = with_mirror(
        board_stripes, _commanded(stripes, calibration.scanner.steps)
    )
    balls, scans = balls_of(recording, calibration, board_stripes, size, progress)
    is_reached = within_lens(board_stripes.camera, board_stripes.pixels)
    board_stripes = board_stripes.at(is_reached)
    depends = calibration.dependence is not None and calibration.dependence.is_relevant
    board_stripes, balls = with_line_covariates(board_stripes, balls, depends)
    chains = Chains(
        calibration.free.corners, board_stripes, balls, calibration.placements, scans, gain_free
    )
    all_profiles = Profiles.joined(profiles) if profiles else None
    shape = asymmetry(all_profiles) if profiles else None
    is_asymmetric = shape is not None and shape.is_relevant(calibration.scanner.sigma_px)
    return noisy(
        replace(
            chains,
            lines=camera.displaced_lines,
            dependence=calibration.dependence,
            line_doubts=tuple(line_doubts(calibration, shape)),
            second_line=second_line(all_profiles) if is_asymmetric else None,
            rejected=calibration.rejected,
            beyond_lens=int((~is_reached).sum()),
        )
    )


def _of_camera(camera) -> Chains:
    """Those of a recording without stripes."""
    names = tuple(camera.placements)
    return Chains(camera.chain, placements=names, lines=camera.displaced_lines)


def within_lens(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """(n,) whether the camera model gives rays for pixels (2, n) and for those farther from its principal point.

    A distortion polynomial turns back beyond the corners of boards that determined it; there it has no ray. The margin
    is 2 % of the distance from it: a solve that moves the camera a little keeps the ray.
    """
    middle = camera.matrix[:2, 2:]
    outer = middle + _LENS_MARGIN * (pixels - middle)
    return np.isfinite(camera.rays(pixels)).all(0) & np.isfinite(camera.rays(outer)).all(0)


def with_line_covariates(board_stripes: BoardStripeChain, balls: Balls | None, depends: bool):
    """Stripes on boards and on balls with brightness and width of the line about their means on boards.

    depends: whether centres depend on them, else without these covariates: on a symmetric line no effect reads them.
    """
    of_boards = board_stripes.covariates
    means = {name: float(of_boards[name].mean()) for name in Blooming.needs if name in of_boards}

    def of(chain):
        changed = {name: chain.covariates[name] - mean for name, mean in means.items() if depends}
        kept = {
            name: column for name, column in chain.covariates.items() if name not in Blooming.needs
        }
        return replace(chain, covariates=kept | changed)

    return of(board_stripes), None if balls is None else of(balls)


def _stripes(recording, camera, progress, profiles: list[Profiles]):
    """Stripes on the boards that were seen, None where no image was taken under the laser.

    profiles: given the profiles of the line.
    """
    seen = {view.placement: view for view in camera.views}
    rows: dict[str, list[Mapping]] = {}
    for row in by_role(recording, "board-laser"):
        if str(row["placement"]) in seen:
            rows.setdefault(str(row["placement"]), []).append(row)
    if not rows:
        return None
    usable = [(seen[name], taken) for name, taken in rows.items()]
    found = scanners.board_stripes(recording, usable, camera.board, progress, None, profiles)
    if found.shape is None:
        return found
    return replace(found, covariates={**found.covariates, **line_covariates(found.shape)})


def _commanded(stripes, steps) -> np.ndarray | None:
    """(S,) rad of the steps as commanded, None where images.csv does not say."""
    selected = stripes.at(np.isin(stripes.step, steps))
    angles = selected.angles(steps)
    if angles is None or np.ptp(angles) < _MIN_ROTATION:
        return None
    return angles


def with_mirror(
    board_stripes: BoardStripeChain, commanded: np.ndarray | None
) -> tuple[BoardStripeChain, bool]:
    """The stripes on one mirror's planes, where angles (S,) rad were commanded, and whether its gain is unknown."""
    if commanded is None or board_stripes.planes.shape[1] < FEWEST:
        return board_stripes, False
    count = np.bincount(board_stripes.labels["step"], minlength=board_stripes.planes.shape[1])
    well = count >= np.median(count) / 2
    well = well if well.sum() >= FEWEST else np.ones_like(well)
    commanded = on_one_branch(board_stripes.planes, commanded)
    mirror, gain = start_mirror(board_stripes.planes[:, well], commanded[well])
    angles = commanded
    odd = abs(gain - 1) > _ODD
    if odd:
        mirror, gain = start_mirror(board_stripes.planes[:, well], commanded[well], True)
        angles = commanded * gain
    started = replace(board_stripes, angles=angles)
    return started.moved(
        board_stripes.camera, board_stripes.poses, mirror.planes(angles), mirror
    ), odd


def at_solution(chains: Chains, fit: BundleFit) -> Chains:
    """The chains started where a fit ended: camera, poses, balls, light planes or mirror."""
    camera = Camera.of(
        fit.parameters.values[: len(chains.corners.camera.values)], chains.corners.camera.size
    )
    moved_chains: dict = {"corners": chains.corners.moved(camera, fit.values["placement"])}
    if chains.board_stripes is None:
        return replace(chains, **moved_chains)
    stripes = stripes_at_solution(chains.board_stripes, fit, camera)
    moved_chains["board_stripes"] = stripes
    if chains.balls is not None:
        balls = replace(chains.balls, angles=stripes.angles)
        moved_chains["balls"] = balls.moved(
            camera, fit.values["ball"], stripes.planes, stripes.mirror
        )
    return replace(chains, **moved_chains)


def measured(
    chain, effects, values: Mapping[str, float], noise
) -> Corners | BoardStripeChain | Balls:
    """The chain with pixels for which its residual, with `effects` at `values` (by key), is `noise` (m, n) px."""
    table = Model(chain, effects).parameters
    table = table.update({key: value for key, value in values.items() if key in table.index})
    state = chain.state
    for _ in range(_ROUNDS):
        evaluation = Model(chain, effects).evaluate(table)
        miss = evaluation.residual - noise
        if len(miss) == 2:
            chain = replace(chain, pixels=chain.pixels + miss, _kept_state=state)
        else:
            slope = (evaluation.by_pixel * chain.scan).sum(0) / chain.gain
            chain = replace(
                chain,
                pixels=chain.pixels + chain.scan * np.clip(-miss / slope, -_FARTHEST, _FARTHEST),
            )
    if len(miss) == 2:
        return replace(chain, _kept_state=None)
    return chain


def noiseless(chain) -> Corners | BoardStripeChain | Balls:
    """The chain with the pixels that it predicts where it starts.

    What a function of the measured place does contains that measurement's own noise: where the
    baseline makes all the rest of it, the noise is left, and fits itself.
    """
    return measured(chain, (), {}, 0.0)


def noisy(chains: Chains) -> Chains:
    """The same with each kind's sigma scaled to the noise that third differences of its residuals show."""
    scaled = {}
    for name, chain in chains.parts.items():
        scale = noise_scale(chain, name)
        scaled[name] = (
            chain if scale is None else replace(chain, sigma=np.asarray(chain.sigma) * scale)
        )
    return replace(chains, **scaled)


def noise_scale(chain, name: str) -> float | None:
    """Ratio of a chain's noise to its stated sigma; None if there are too few neighbours.

    Divided third differences along the rows of a board, or along a stripe, over their own noise under the stated
    sigmas; those beyond four sigmas by their median do not count.
    """
    residual = chain.evaluate(chain.parameters.values, {}).residual
    sigma = np.broadcast_to(chain.sigma, residual.shape)
    line, position = _lines(chain, name)
    order = np.lexsort((position, line))
    four = order[np.arange(len(order) - 3)[:, None] + np.arange(4)]
    four = four[line[four[:, 0]] == line[four[:, 3]]]
    third = _third_differences(residual, sigma, position, four)
    if third.size < _MIN_DIFFERENCES:
        return None
    usual = MEDIAN_TO_SIGMA * np.median(np.abs(third))
    return float(np.sqrt((third[np.abs(third) <= _WRONG * usual] ** 2).mean()))


def _third_differences(residual, sigma, position, four: np.ndarray) -> np.ndarray:
    """(m, k) divided differences of residuals (m, n) with noise `sigma` (m, n) over samples `four` (k, 4) of one line,
    divided by their own noise.

    Places (n,) along a line are uneven where points were dropped: with equal weights a slope or a curvature of
    the residual would pass for noise. Weights: 1 over the product of the distances from the other three places.
    """
    place = position[four]
    spacing = place[:, :, None] - place[:, None]
    spacing[:, range(4), range(4)] = 1.0
    product = spacing.prod(2)
    usable = (product != 0).all(1)
    weight = 1 / product[usable]
    four = four[usable]
    weight = weight / np.linalg.norm(weight, axis=1, keepdims=True)
    difference = (weight * residual[:, four]).sum(-1)
    return difference / np.sqrt(((weight * sigma[:, four]) ** 2).sum(-1))


def _lines(chain, name):
    """(n,) which row of a board, or stripe, each sample is on, and (n,) its place along it."""
    if name == "corners":
        row = np.round(
            chain.points[1]
            / max(np.diff(np.unique(np.round(chain.points[1], 6))).min(initial=1.0), 1e-9)
        )
        view = chain.labels.get("view", chain.labels["placement"])
        return groups(view, (row - row.min()).astype(int))[0], chain.points[0]
    position = chain.pixels[1] * chain.scan[0] + chain.pixels[0] * chain.scan[1]
    return groups(
        chain.labels["placement" if name == "board_stripes" else "ball"], chain.labels["step"]
    )[0], position
