"""Stripes on balls of known size in a recording's scans, averaged in short blocks as those on boards are."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from datasets.recording import Recording
from sensors.ball.fit import fit_ball
from sensors.ball.search import find_balls
from sensors.images import stacks
from sensors.light.ball_stripes import Balls
from sensors.light.board_chain import BoardStripeChain
from sensors.light.planes import light_origin
from sensors.scanner.calibration import ScannerCalibration
from sensors.scanner.model import Scanner
from sensors.scanner.residuals.line_dependence import line_covariates
from sensors.stripe.find import find_stripes
from sensors.stripe.surface_bias.brightness import brightness_law
from sensors.stripe.surface_bias.surface_line import line_on_ball
from workbench.files.images.ball_names import named
from workbench.files.images.columns import recorded_columns
from workbench.files.images.images import by_role, full_scale, path_of
from workbench.jobs.sensor.joined_scans import is_joined
from workbench.jobs.sensor.scan import INCIDENCE_DEG, scans_of

_FRAMES = 16
_FEWEST = 40  # points on a ball that tell anything
_STEEP = np.cos(np.deg2rad(INCIDENCE_DEG))


@dataclass(frozen=True)
class _Arc:
    """Points of one ball of one scan: pixels (2, k), steps (k,), sigma (k,), what images.csv says; the ball."""

    pixels: np.ndarray
    step: np.ndarray
    sigma: np.ndarray
    covariates: Mapping[str, np.ndarray]
    centre: np.ndarray
    radius: float
    number: int


def balls_of(
    recording: Recording,
    calibration: ScannerCalibration,
    board_stripes: BoardStripeChain,
    size: int,
    progress: Callable[[str], None],
) -> tuple[Balls | None, tuple[str, ...]]:
    """Blocks of `size` points of the balls in all scans, and the scans' names; None where no ball is certified or seen.

    They are found with the calibrated scanner `made`, of free planes; the chain starts with the
    planes of `board_stripes`.
    """
    if not recording.balls or not by_role(recording, "scan"):
        return None, ()
    groups = scans_of(recording)
    depth = full_scale(recording, by_role(recording, "scan"))
    mirror = board_stripes.mirror
    light = light_origin(board_stripes.planes) if mirror is None else mirror.point
    arcs, scans = [], []
    for name, rows in groups.items():
        if is_joined(rows):
            continue  # the sensor or the object moves in it: its errors are not those of the sensor alone
        progress(f"balls in scan {name}")
        found = _arcs(recording, calibration.scanner, rows, depth, light)
        arcs += found
        scans += [name] * len(found)
    if not arcs:
        return None, ()
    chain = replace(
        _chain(arcs, calibration.scanner, board_stripes),
        scan_of=np.unique(scans, return_inverse=True)[1],
    )
    return _blocks(chain, size), tuple(scans)


def _arcs(recording, scanner: Scanner, rows, depth, light) -> list[_Arc]:
    """Balls of one scan; `light` (3,) mm where the light plane comes from, None where that is unknown."""
    rows = [row for row in rows if int(row.get("step", 0)) in set(scanner.steps.tolist())]
    if not rows:
        return []
    pixels, step, sigma, shape, covariates = _stripes(recording, scanner, rows, depth)
    plain = replace(scanner, effects=())
    points = plain.reconstruct(pixels, step)
    radii = sorted({ball[3] for ball in recording.balls.values()})
    found = find_balls(points, radii, free=True, incidence=np.deg2rad(INCIDENCE_DEG), stripe=step)
    numbers, _ = named(
        recording, rows[0], [fit.radius for fit in found], [fit.centre for fit in found]
    )
    arcs = []
    for fit, number in zip(found, numbers):
        if number:
            radius = recording.balls[number][3]
        else:
            radius = min(radii, key=lambda r: abs(r - fit.radius))
        seen = {"pixels": pixels, "step": step, "sigma": sigma, "covariates": covariates}
        arc = _arc(plain, seen, shape, points, fit, radius, number or 0, light)
        arcs += [] if arc is None else [arc]
    return arcs


def _stripes(recording, scanner, rows, depth):
    """Pixels (2, n), steps, sigma (n,), line (3, n) (as of `SurfaceLine.centre_bias`, and peak in grey values) and
    covariates (n,) of a scan's stripes."""
    paths = [path_of(recording, row) for row in rows]
    if abs(scanner.scan[0]) >= abs(scanner.scan[1]):
        scan_axis = "rows"
    else:
        scan_axis = "columns"
    blocks, first = [], 0
    for stack in stacks(paths, _FRAMES, {p: str(row["image"]) for p, row in zip(paths, rows)}.get):
        found = find_stripes(stack, scan_axis, saturation=depth)
        line = np.vstack([found.shape, found.peak])
        blocks.append((found.pixels, first + found.frame, found.sigma, line))
        first += len(stack)
    pixels, frame, sigma, shape = (
        np.concatenate([part[k] for part in blocks], axis=-1) for k in range(4)
    )
    names = recorded_columns(rows)
    covariates = {name: np.array([row[name] for row in rows], float)[frame] for name in names}
    covariates |= line_covariates(shape[:2])
    steps = np.array([int(row.get("step", 0)) for row in rows])[frame]
    return pixels, steps, sigma, shape, covariates


def _arc(scanner, seen, shape, points, fit, radius, number, light) -> _Arc | None:
    """A ball's points without those seen or lit too steeply, their centres straightened; None where few are left."""
    is_usable = (np.abs(fit.residual) < 0.05 * radius) & np.isfinite(points).all(0)
    pixels = seen["pixels"][:, is_usable]
    step = seen["step"][is_usable]
    matt = line_on_ball(
        scanner.camera,
        fit.centre,
        fit.radius,
        pixels,
        scanner.planes[:, scanner.places(step)],
        scanner.scan,
        light,
    )
    width, ratio, peak = shape[:, is_usable]
    bend = brightness_law(matt, width, peak).applied(matt)
    pull = np.nan_to_num(bend.centre_bias(bend.line_shape(width), width, ratio))
    outward = points[:, is_usable] - fit.centre[:, None]
    facing = (
        -(outward * points[:, is_usable]).sum(0)
        / np.linalg.norm(outward, axis=0)
        / np.linalg.norm(points[:, is_usable], axis=0)
    )
    good = (bend.incidence_cosine > _STEEP) & (facing > _STEEP)
    if good.sum() < _FEWEST:
        return None
    straight = pixels - scanner.scan[:, None] * pull
    place = scanner.places(step)
    refitted = fit_ball(scanner.reconstruct(straight[:, good], step[good]), radius=radius)
    if not refitted:
        return None
    inliers = np.flatnonzero(good)[refitted.inliers]
    covariates = {name: column[is_usable][inliers] for name, column in seen["covariates"].items()}
    return _Arc(
        straight[:, inliers],
        place[inliers],
        seen["sigma"][is_usable][inliers],
        covariates,
        refitted.centre,
        radius,
        number,
    )


def _chain(arcs, scanner: Scanner, board_stripes: BoardStripeChain) -> Balls:
    names = set.intersection(*(set(arc.covariates) for arc in arcs))
    ball = np.repeat(np.arange(len(arcs)), [len(arc.step) for arc in arcs])
    step = np.concatenate([arc.step for arc in arcs])
    return Balls(
        scanner.camera,
        np.concatenate([arc.pixels for arc in arcs], 1),
        {"ball": ball, "step": step},
        np.stack([arc.centre for arc in arcs]),
        np.array([arc.radius for arc in arcs]),
        np.array([arc.number for arc in arcs]),
        board_stripes.planes,
        board_stripes.scan,
        np.concatenate([arc.sigma for arc in arcs])[None],
        board_stripes.mirror,
        board_stripes.angles,
        None,
        {name: np.concatenate([arc.covariates[name] for arc in arcs]) for name in sorted(names)},
    )


def _blocks(chain: Balls, size: int) -> Balls:
    """Neighbours along one arc as one point: their mean, moved along the scan line until its residual is theirs."""
    position = chain.pixels[1] * chain.scan[0] + chain.pixels[0] * chain.scan[1]
    arc = chain.labels["ball"] * chain.planes.shape[1] + chain.labels["step"]
    order = np.lexsort((position, arc))
    new = np.flatnonzero(np.diff(arc[order], prepend=-1))
    rank = np.arange(chain.n) - np.repeat(new, np.diff(new, append=chain.n))
    block = np.empty(chain.n, int)
    _, block[order] = np.unique(np.stack([arc[order], rank // size]), axis=1, return_inverse=True)
    weights = chain.sigma[0] ** -2
    total = np.bincount(block, weights)

    def mean(values):
        return np.bincount(block, weights * values) / total

    first = np.unique(block, return_index=True)[1]
    values = chain.parameters.values
    labels = {name: label[first] for name, label in chain.labels.items()}
    joined = replace(
        chain,
        pixels=np.stack([mean(row) for row in chain.pixels]),
        sigma=total[None] ** -0.5,
        labels=labels,
        covariates={name: mean(column) for name, column in chain.covariates.items()},
    )
    missing = mean(chain.evaluate(values, {}).residual[0] * chain.gain) / joined.gain
    missing = missing - joined.evaluate(values, {}).residual[0]
    side = np.sign((joined.at_start.by_pixel * joined.scan).sum(0))
    return replace(joined, pixels=joined.pixels + joined.scan * (missing * side))
