"""From images of scans to clouds and ball centres with their uncertainty."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from datasets.recording import Recording
from datasets.recording_files.rows import Grouped
from sensors.acceptance import Characteristic, Probed, acceptance
from sensors.ball.fit import fit_ball, with_radius_variance
from sensors.ball.result import INCIDENCE, MISSING, NOT_ON_BALL, BallFit
from sensors.ball.search import Refusal, find_balls
from sensors.boards.detection import Rejected
from sensors.images import flaw, read, stacks, unlit
from sensors.scanner.cloud import Cloud
from sensors.scanner.model import Scanner
from sensors.scanner.residuals.misfit import Misfit, stripe_misfit
from sensors.stripe.ambient import Lines, ambient_bias, chosen_images, scene_of
from sensors.stripe.centre_noise import centre_noise
from sensors.stripe.find import find_stripes
from sensors.stripe.surface_bias.centre_bias import estimate_centre_bias
from workbench.core.errors import InputError
from workbench.core.text.file_names import differ_in_case_only, file_name
from workbench.files.images.ball_names import by_sample, named
from workbench.files.images.columns import recorded_columns
from workbench.files.images.images import by_role, check_size, full_scale, path_of, streamed
from workbench.files.images.scan_surface import reconstructed
from workbench.files.spool import Made, Spool
from workbench.jobs.sensor import scanner as calibrated
from workbench.jobs.sensor.joined_scans import Motions, motions_of
from workbench.jobs.sensor.missing_balls import (
    line_width_missing,
    missing_balls,
    nearest_candidates,
    perhaps_cut,
    seen_instead,
    undetermined_few,
)
from workbench.machine.progress import paced

CLOUDS = "clouds"
INCIDENCE_DEG = 60.0
"""Points of a ball that are seen or lit more steeply are left out: there one pixel is a long way along the surface."""
ALL_ROUND = 0.5
"""Share of the way round that must be seen of a ball that counts for acceptance. The light comes from the side, so that
up to a third of the way round stays dark on a ball that nothing hides."""
_LEAST_GAIN = 0.1  # cosine between error and normal below which a distance from the ball says nothing of a centre
_BORDER = 3  # px from the edge of the image within which a stripe may be cut
_FRAMES = 16
_DRAWN = 4000
_MOST_REFUSED = 6  # candidates of a scan


@dataclass(frozen=True)
class Ball:
    """A ball found in a scan: `number` in artefact.csv (None: not known which), `fit` with the radius as
    certified where there is one, `free` with a radius of its own; `points` (3, k) mm on it, `pixels` (2, k).

    `is_beyond_volume`: most of its points are at depths for which the light planes were not calibrated. `misfit`: lack
    of fit of its stripes, None where it has too few. `frame`: name of the frame of its centre; `common` (3, 3) mm^2:
    what errors that all images of a joined scan share add to the covariance of the centre, None for another scan;
    `overexposed`: number of its points used whose line has full pixels."""

    number: int | None
    radius: float | None
    fit: BallFit
    free: BallFit
    points: np.ndarray
    pixels: np.ndarray
    is_beyond_volume: bool
    misfit: Misfit | None = None
    frame: str = "camera"
    common: np.ndarray | None = None
    overexposed: int = 0

    @property
    def is_complete(self) -> bool:
        """Whether it is seen well enough to be a measurement of the ball's form and size."""
        return (
            bool(self.fit)
            and not self.fit.cut
            and not self.is_beyond_volume
            and self.fit.coverage >= ALL_ROUND
        )


@dataclass(frozen=True)
class Scan:
    """One scan: its `row` of images.csv, number of `points` in `cloud` (a file of the run), `drawn` (3, k) mm some of
    them, stripe centres `dropped` by reason, its balls, what is to be said of them, images `rejected`, its own
    acceptance figures, the name of the `frame` in which it is stated, and candidates `refused` that are no balls, on
    points of their own."""

    name: str
    row: Mapping
    points: int
    cloud: str
    drawn: np.ndarray
    dropped: Mapping[str, int]
    balls: tuple[Ball, ...]
    outcome: str
    rejected: tuple[Rejected, ...] = ()
    accepted: tuple[Characteristic, ...] = ()
    frame: str = "camera"
    refused: tuple[Refusal, ...] = ()


@dataclass(frozen=True)
class Scans:
    """All scans of a recording, of which few are in memory; `calibration` is the scanner's run, None where a file was
    given; in `folder` waits what a long session cannot keep in memory; `cache` holds results over all scans, so
    that one pass over them is enough."""

    recording: Recording
    scanner: Scanner
    calibration: object
    scans: Sequence[Scan]
    folder: Path | None = None
    cache: dict[str, object] = field(default_factory=dict, init=False, repr=False, compare=False)


def scan(
    recording: Recording,
    scanner_file: Path | None,
    folder: Path,
    progress: Callable[[str], None],
    hand_eye_file: Path | None = None,
) -> Scans:
    """Clouds and balls of every scan of a recording.

    scanner_file: a calibrated scanner, None calibrates one from the recording's boards; folder: where
    the clouds go, one PLY file a scan. hand_eye_file: the hand-eye transform that joins images taken at several flange
    poses, None calibrates it from the recording's images of a board. Raises InputError.
    """
    groups = scans_of(recording)
    if scanner_file is None and not by_role(recording, "board-laser"):
        raise InputError(
            f"{recording.name}, images.csv, column role: expected images of a board under the laser to calibrate the "
            "scanner from, found none; name a calibrated one with --scanner, or add rows with role board-laser"
        )
    scanner_run = None if scanner_file else calibrated.calibrate(recording, progress=progress)
    scanner = scanner_run.scanner if scanner_run else calibrated.read(scanner_file)
    first = groups.rows[0]
    size = read(path_of(recording, first), f"{recording.name}/{first['image']}").size
    check_size(scanner.camera, size, recording.name, str(scanner_file or recording.name))
    (folder / CLOUDS).mkdir()
    saturation = full_scale(recording, by_role(recording, "scan"))
    motions = motions_of(recording, scanner, groups, hand_eye_file, progress)
    work = _Work(recording, scanner, folder, saturation, differ_in_case_only(groups), motions)
    results = streamed(Made(range(len(groups)), groups.at), work, paced(progress, "scan"))
    # on the same disk, but not in the folder: not every system moves a folder with an open file
    parent = folder.parent
    return Scans(recording, scanner, scanner_run, Spool(results, folder=parent), parent)


def scans_of(recording: Recording) -> Grouped:
    """Rows of images.csv by scan, in the order of their steps. InputError where there is none, or a step twice."""
    rows = by_role(recording, "scan")
    if not len(rows):
        raise InputError(
            f"{recording.name}, images.csv, column role: expected images of scans, found none; add rows "
            "with role scan"
        )
    groups = rows.by("scan", "step")
    steps = groups.rows.values("step", 0)
    same = np.diff(steps) == 0
    same[groups.starts[1:-1] - 1] = False  # the last of a scan and the first of the next
    for name in (
        "sample",
        "table_deg",
    ):  # of a joined scan, in which the sensor or the object moves
        same &= ~(np.abs(np.diff(groups.rows.values(name, np.nan))) > 0)
    if same.any():
        repeated = int(np.argmax(same))
        name, group_rows = groups.at(int(np.searchsorted(groups.starts, repeated, "right")) - 1)
        raise InputError(
            f"{recording.name}, images.csv, scan {name}: expected every step once, found step {steps[repeated]:g} "
            f"{(group_rows.values('step', 0) == steps[repeated]).sum()} times; give each image its own step or scan"
        )
    return groups


@dataclass(frozen=True)
class _Work:
    """Processing of one scan; `saturation` as in `find_stripes`.

    `same_but_case`: ids of scans that differ from another one in capitals only; `motions` of joined scans.
    """

    recording: Recording
    scanner: Scanner
    folder: Path
    saturation: float | None = None
    same_but_case: frozenset[str] = frozenset()
    motions: Motions = Motions()

    def __call__(self, named: tuple[str, list[Mapping]]) -> Scan:
        name, rows = named
        known = [row for row in rows if int(row.get("step", 0)) in self.steps]
        if not known:
            raise InputError(
                f"{self.recording.name}, images.csv, scan {name}: expected images at steps of the scanner "
                f"({min(self.steps)} to {max(self.steps)}), found none; use the scanner of this recording"
            )
        pixels, steps, image, sigma, shape, covariates, dropped, rejected = self.stripes(known)
        local, surface = reconstructed(self.scanner, pixels, steps, covariates, self.radii)
        seen = np.isfinite(local).all(0)
        motion = self.motions.of(known)
        cloud = Cloud(self.scanner, local, pixels, steps, image, motion).subset(seen)
        points = cloud.points
        file = f"{CLOUDS}/{file_name(name, name in self.same_but_case)}.ply"
        write_cloud(self.folder / file, points)
        balls, outcome, refused = self.balls(known, cloud, sigma[seen], shape[:, seen])
        unseen_count = len(rows) - len(known)
        unseen = (
            f"{unseen_count} of {len(rows)} images are at steps that the scanner has no plane for"
        )
        lost = unseen if unseen_count else ""
        count = points.shape[1]
        drawn = np.linspace(0, max(count - 1, 0), min(count, _DRAWN)).astype(int)
        uncalibrated_count = sum(ball.is_beyond_volume for ball in balls)
        depth_note = (
            f"balls beyond the depths of the boards, where the planes are not calibrated: {uncalibrated_count}"
            if uncalibrated_count
            else ""
        )
        message = "; ".join(
            filter(None, (lost, outcome if points.size else self.dark(known), depth_note, surface))
        )
        accepted = figures(self.recording, rows[0], balls)
        return Scan(
            name,
            rows[0],
            points.shape[1],
            file,
            points[:, drawn],
            dropped,
            balls,
            message,
            rejected,
            accepted,
            cloud.frame,
            refused,
        )

    def dark(self, rows) -> str:
        """Why a scan has no points, as far as its middle image tells."""
        middle = rows[len(rows) // 2]
        why = flaw(
            read(path_of(self.recording, middle), f"{self.recording.name}/{middle['image']}")
        )
        return f"no laser line was found in {len(rows)} images ({middle['image']}: {why or 'no clear line'})"

    @cached_property
    def steps(self) -> set[int]:
        return set(self.scanner.steps.tolist())

    @property
    def radii(self) -> list[float] | None:
        """mm that occur among the balls of the certificate; None without one."""
        return sorted({ball[3] for ball in self.recording.balls.values()}) or None

    def stripes(self, rows):
        """Pixels (2, n), steps (n,), image (n,) from 0, sigma (n,) px, line (4, n) (`Stripes.shape`, peak in grey
        values, 1 where clipped) and covariates of a stripe; counts of what was dropped, and images that show none."""
        paths = [path_of(self.recording, row) for row in rows]
        called = {path: f"{self.recording.name}/{row['image']}" for path, row in zip(paths, rows)}
        stripe_sets, flaws, scene, dropped, first = [], [], [], Counter(), 0
        shown = set(chosen_images(len(paths)).tolist())
        is_row_scan = self.scan_axis == "rows"
        for stack in stacks(paths, _FRAMES, called.get):
            flaws += [unlit(frame) for frame in stack]
            found = find_stripes(stack, self.scan_axis, saturation=self.saturation)
            for k, image in enumerate(stack):
                if first + k in shown:
                    is_of_frame = found.frame == k
                    lines = Lines(
                        found.pixels[:, is_of_frame], found.width[is_of_frame], is_row_scan
                    )
                    scene.append(scene_of(image, len(shown), lines))
            line = np.vstack([found.shape, found.peak, found.saturated])
            stripe_sets.append((found.pixels, first + found.frame, found.sigma, line))
            dropped.update(found.dropped)
            first += len(stack)
        pixels, frame, sigma, shape = (
            np.concatenate([part[k] for part in stripe_sets], axis=-1) for k in range(4)
        )
        if self.motions.of(rows) is None:
            scan = 0 if is_row_scan else 1
            pixels[scan] -= ambient_bias(scene, pixels, shape, is_row_scan)
        names = recorded_columns(rows)
        covariates = {name: np.array([row[name] for row in rows], float)[frame] for name in names}
        steps = np.array([int(row.get("step", 0)) for row in rows])[frame]
        lost = _rejected_images(rows, flaws, frame)
        return pixels, steps, frame, sigma, shape, covariates, dict(dropped), lost

    @property
    def scan_axis(self) -> str:
        """In which direction a centre is sought, as on the boards."""
        return "rows" if abs(self.scanner.scan[0]) >= abs(self.scanner.scan[1]) else "columns"

    def balls(self, rows, cloud: Cloud, sigma, shape):
        """The balls in the cloud of the images `rows`, named as far as they can be; sigma (n,) px of centres."""
        radii = self.radii
        points = cloud.points
        length = np.linalg.norm(cloud.error, axis=0)  # mm for one px of the stripe's centre
        columns = dict(
            sigma=self._noise(cloud, sigma) * length,
            direction=cloud.error / length,
            at_limit=self._at_limit(cloud, [int(row.get("step", 0)) for row in rows]),
        )
        trimmed = np.deg2rad(INCIDENCE_DEG)
        refused: list[Refusal] = []
        options = dict(stripe=cloud.stripe, refused=refused, incidence=trimmed, view=cloud.view)
        if self.scanner.line is not None and cloud.motion is None:
            width = np.where(shape[3], np.nan, shape[0])
            options["widths"] = lambda k, balls: cloud.subset(k).width_ratios(width[k], balls)
            options["width_scatter"] = self.scanner.line.scatter
        found = (
            find_balls(points, radii, free=True, **options, **columns) if points.shape[1] else []
        )
        numbers, outcome = named(
            self.recording, rows[0], [fit.radius for fit in found], [fit.centre for fit in found]
        )
        fitted_balls = []
        for free, number in zip(found, numbers):
            on_ball = free.reason != NOT_ON_BALL
            limit = max(trimmed, _steepest(free, cloud))
            columns_of_ball = {key: value[..., on_ball] for key, value in columns.items()} | {
                "incidence": limit
            }
            ball = self._ball(
                cloud.subset(on_ball), columns_of_ball, free, number, shape[:, on_ball]
            )
            if why := undetermined_few(ball.fit, cloud.stripe[on_ball]):
                refused.append(Refusal.of_fit(ball.fit, why))
            else:
                fitted_balls.append(ball)
        missing = self._expected(rows[0]) - len(fitted_balls) if radii else _MOST_REFUSED
        refused = nearest_candidates(refused, min(missing, _MOST_REFUSED))
        if not fitted_balls:
            outcomes = (
                seen_instead(points, cloud.stripe, refused),
                perhaps_cut(columns["at_limit"]),
            )
        else:
            outcomes = (missing_balls(self.recording, rows[0], len(fitted_balls), refused),)
        if radii and len(fitted_balls) < self._expected(rows[0]) and cloud.motion is None:
            outcomes += (line_width_missing(self.scanner, refused),)
        return tuple(fitted_balls), "; ".join(filter(None, (outcome, *outcomes))), tuple(refused)

    def _noise(self, cloud: Cloud, sigma: np.ndarray) -> np.ndarray:
        """(n,) px, 1 sigma of centres whose fits state `sigma` (n,)."""
        centre = cloud.pixels[0 if cloud.is_across_columns else 1]
        return centre_noise(centre, cloud.stripe_place, cloud.image, sigma, self.scanner.sigma_px)

    def _expected(self, row) -> int:
        """Expected number of balls in a scan, as far as it is known."""
        return 1 if by_sample(self.recording, row) is not None else len(self.recording.balls)

    def _ball(self, cloud: Cloud, columns_of_ball, free: BallFit, number, shape) -> Ball:
        """A ball from its points: fitted with the certified radius, the pull of its curvature taken off."""
        columns_of_ball = columns_of_ball | cloud.shared_errors()
        radius = self._radius(number, free.radius, self.radii)
        start = np.append(free.centre, free.radius if radius is None else radius)
        pull = estimate_centre_bias(cloud.surface_line(start, shape), shape, self.scanner.line)
        moves = cloud.error * pull.derivative[:, None]
        columns_of_ball["shared"] = columns_of_ball["shared"].with_common(moves, pull.covariance)
        straight = cloud.points - cloud.error * pull.size
        is_lit = pull.bend.incidence_cosine > np.cos(columns_of_ball["incidence"])
        fit = _fitted(straight, cloud.view, is_lit, radius, start, columns_of_ball)
        if fit and len(fit.reason) == len(is_lit):
            fit = with_radius_variance(fit, cloud.common_radius_variance(fit))
            fit = fit.with_radius_note(free.radius_note)
        is_beyond = self._is_beyond_volume(cloud.local[2])
        other = (fit if radius is None else fit.free) or free
        misfit = self._misfit(fit or free, straight, cloud)
        used = (fit or free).inliers if len((fit or free).reason) == len(is_lit) else is_lit
        common = None
        if cloud.motion is not None:
            common = cloud.common_covariance((fit or free).centre, used)
        return Ball(
            number,
            radius,
            fit or free,
            other,
            straight,
            cloud.pixels,
            is_beyond,
            misfit,
            cloud.frame,
            common,
            int((shape[3:, used] > 0).sum()),
        )

    def _misfit(self, fit, points, cloud: Cloud) -> Misfit | None:
        """Lack of fit of a ball's stripes: distances from its surface as px along the scan line."""
        if not fit or len(fit.residual) != points.shape[1]:
            return None
        error = cloud.error
        outward = (points - fit.centre[:, None]) / fit.radius
        gain = (outward * error).sum(0)  # mm of distance for one px
        used = fit.inliers & (np.abs(gain) > _LEAST_GAIN * np.linalg.norm(error, axis=0))
        stated = cloud.stated_variance(outward)
        known = None if stated is None else (stated / gain**2)[used]
        residual = (fit.residual / gain)[used]
        return stripe_misfit(residual, cloud.stripe[used], cloud.stripe_place[used], known)

    def _at_limit(self, cloud: Cloud, swept):
        """(n,) whether points lie at the edge of the image, or in the first or last plane of the steps `swept`, of a
        joined scan in its first or last image."""
        size = np.array(self.scanner.camera.size)[:, None]
        pixels, steps = cloud.pixels, cloud.steps
        edge = ((pixels < _BORDER) | (pixels > size - 1 - _BORDER)).any(0)
        if cloud.motion is not None and cloud.motion.is_closed:
            return edge
        if cloud.motion is not None:
            return edge | (cloud.image == 0) | (cloud.image == len(swept) - 1)
        return edge | ((min(swept) < max(swept)) & ((steps == min(swept)) | (steps == max(swept))))

    def _is_beyond_volume(self, depth) -> bool:
        """Whether most of these depths are outside those of the boards."""
        if self.scanner.volume is None:
            return False
        low, high = self.scanner.volume
        return bool(np.median(np.clip(depth, low, high) == depth) < 1)

    def _radius(self, number, found, radii):
        if number is not None:
            return self.recording.balls[number][3]
        return None if radii is None else min(radii, key=lambda radius: abs(radius - found))


def figures(
    recording: Recording, row: Mapping, balls: Sequence[Ball]
) -> tuple[Characteristic, ...]:
    """Acceptance figures of one scan; balls that are not seen well enough do not count."""
    known = recording.balls
    numbers = {number: k + 1 for k, number in enumerate(known)}
    table = np.array([ball[:3] for ball in known.values()]).T if known else None
    full_balls = [ball for ball in balls if ball.is_complete]
    certified = table if all(ball.number is not None for ball in full_balls) else None
    probed = [
        Probed(numbers.get(ball.number, k + 1), ball.points, ball.fit, ball.radius)
        for k, ball in enumerate(full_balls)
    ]
    return acceptance(probed, certified, temperature=row.get("temperature_c"))


def _rejected_images(rows, flaws, frame) -> tuple[Rejected, ...]:
    """Images that are overexposed, or black between two that show the line; black ends of a sweep are valid."""
    shows_line = np.bincount(frame, minlength=len(rows)) > 0
    is_between = np.r_[False, shows_line[:-1]] & np.r_[shows_line[1:], False]
    return tuple(
        Rejected(row["image"], why)
        for row, why, is_inside_sweep in zip(rows, flaws, is_between)
        if why and (is_inside_sweep or not why.startswith("all black"))
    )


def _steepest(ball: BallFit, cloud: Cloud) -> float:
    """rad, largest incidence of sight among the points of a ball that were used."""
    used = ball.inliers
    outward = cloud.points[:, used] - ball.centre[:, None]
    view = cloud.view[:, used]
    cosine = (
        -(outward * view).sum(0) / np.linalg.norm(outward, axis=0) / np.linalg.norm(view, axis=0)
    )
    return float(np.arccos(np.clip(cosine.min(initial=1.0), 0, 1)))


def _fitted(points, view, is_lit, radius, start, options) -> BallFit:
    """The ball through points (3, k) that are `is_lit` (k,): light that grazes the surface spreads over many pixels,
    which speckle makes a ragged patch."""
    options = options | {"sigma": np.where(is_lit, options["sigma"], np.nan)}
    fit = fit_ball(points, radius=radius, view=view, start=start, **options)
    return replace(fit, reason=np.where(~is_lit & (fit.reason == MISSING), INCIDENCE, fit.reason))


def write_cloud(path: Path, points: np.ndarray) -> None:
    """Points (3, n) mm as a PLY file (Open3D, binary); none where there are no points. InputError where it fails."""
    import open3d

    if not points.size:
        return
    cloud = open3d.geometry.PointCloud(
        open3d.utility.Vector3dVector(np.ascontiguousarray(points.T))
    )
    if not open3d.io.write_point_cloud(str(path), cloud):
        raise InputError(
            f"{path} cannot be written; see that the disk has room, or name another place with --out."
        )
