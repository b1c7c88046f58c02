"""Import of clouds of a 3-D camera, or profiles of a laser profiler, of one ball at flange poses (kind ball-surface).

The certified radius decides the unit of the points. Units and rotation convention of the poses are tested by how well
one transform from flange to sensor keeps the ball in its place.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.importers.mapping.conversion import complete_rows, other_columns
from datasets.importers.sources.clouds import PROFILES, read_cloud
from datasets.importers.sources.clouds import is_profile as has_profile
from datasets.importers.units import LENGTHS
from datasets.recording import Recording
from sensors.ball.search import find_balls
from sensors.hand_eye.circles import Circles, find_circles
from workbench.core.errors import InputError
from workbench.recordings.importing.ball_scans.ball_clouds import (
    cloud_unit,
    matched_clouds,
    thinned,
)
from workbench.recordings.importing.ball_scans.scan_review import (
    Scans,
    pose_suspicions,
    profile_radius_suspicion,
    radius_suspicion,
    rms_mm,
    trimmed_rms_mm,
)
from workbench.recordings.importing.board_images.pose_readings import (
    flange_readings,
    pose_columns,
    reading_line,
)
from workbench.recordings.importing.interpretation.decisions import choose_reading
from workbench.recordings.importing.interpretation.fits import CandidateFit
from workbench.recordings.importing.measured_robot import Made

_FEWEST = 5
_MOST_POINTS, _TESTED_POSES = 60_000, 20
_UNITS = ("mm", "m", "in", "um")
_GOOD_MM, _GOOD_SHARE = 2.0, 0.1  # of the ball's radius
_LARGEST_CIRCLE = 1.1  # over the ball's radius
_SMALLEST_CIRCLE = 0.15
_ROTATIONS, _SPARE = 4, 3
_FEWEST_SCREENED = 6
"""Poses of clouds: 18 coordinates for the 15 numbers of the linear model."""
_SIMILAR = 100.0
"""Ratio of squared misfits: a tenth of the misfit of another rotation decides against that one."""
_TRIMMED = 4  # readings that are compared again without the worst rows
_REMEDY = "check that rows and files belong together, --ball-radius and the mapping"


def is_scan(found) -> bool:
    """Whether clouds or profiles come with flange poses and no joint readings."""
    mapping = found.mapping
    has_poses = mapping.flange_point is not None and mapping.flange_rotation is not None
    return bool(found.source.clouds) and has_poses and mapping.joints is None


def import_scans(found, options, progress) -> Made:
    """Recording, complete mapping, fits, warnings and doubts. Raises InputError where files and rows do not correspond,
    a file shows no ball, or the poses fit under no reading."""
    radius = options.ball_radius_mm
    clouds = found.source.clouds
    first = clouds[0].name
    if radius is None:
        raise InputError(
            f"{first}: expected the certified radius of the ball, which decides the unit of the points, found none; "
            "add --ball-radius MM."
        )
    rows, files, notes = matched_clouds(found.table, clouds)
    rows, dropped = complete_rows(rows, found.mapping)
    if dropped:
        raise InputError(f"{dropped[0]} Remove their files or complete the rows.")
    is_profile = is_profile_file(files[0])
    progress("finding the ball in every file")
    points = read_profiles(files, radius) if is_profile else _clouds(files, radius)
    if len(points) < _FEWEST:
        raise InputError(
            f"{first}: expected a ball in {_FEWEST} files or more, found {len(points)}; add poses."
        )
    names = [f"row {line} ({path.name})" for line, path in zip(rows.lines, files)]
    seen = _seen(points, radius, is_profile)
    undetermined = np.flatnonzero(~np.isfinite(seen).all(0))
    if len(undetermined):
        raise InputError(
            f"{files[undetermined[0]].name}: expected points that determine a ball of radius {radius:g} mm, "
            "found none; scan it again, or remove the file and its row."
        )
    scans = Scans(seen, np.empty(0), names, radius, is_profile)
    mapping, fits, warnings = _decided(found, rows, scans, options, progress)
    if not is_profile:
        warnings = [*warnings, *filter(None, [radius_suspicion(points, radius)])]
    warnings = tuple(f"{rows.file}: {suspicion}." for suspicion in warnings)
    recording = _recording(rows, mapping, points, radius, options)
    return Made(recording, mapping, fits, (*notes, *warnings), suspicions=warnings)


def is_profile_file(path: Path) -> bool:
    """Whether a file holds one profile, not a cloud."""
    return path.suffix.lower() in PROFILES and has_profile(path)


def _decided(found, rows, scans: Scans, options, progress):
    """Mapping, fits, and doubts about the poses. Raises InputError where the poses fit under no reading."""
    mapping = replace(found.mapping, measures="ball-surface", joints=None)
    readings = flange_readings(rows, mapping)
    progress(f"testing {len(readings)} readings of the flange poses")
    fits = compare_poses(readings, scans)
    lines = [reading_line(interpretation) for _, interpretation, _ in readings]
    chosen = choose_reading(lines, fits, f"{rows.file}, flange poses", options.ask, _REMEDY)
    best = dict(fits)[chosen]
    if not best.is_good and not options.trust_data:
        raise InputError(
            f"{rows.file}: expected flange poses that keep the ball in its place, found none under any reading (best "
            f"{best.words}); {_REMEDY}, or repeat with --trust-data."
        )
    _, mapping, poses = readings[chosen]
    progress("comparing flange poses and scans")
    placed = scans.with_poses(poses)
    suspicions = list(pose_suspicions(placed))
    if scans.is_profile:
        suspicions += filter(None, [profile_radius_suspicion(placed)])
    return mapping, tuple(fit for _, fit in fits), suspicions


def _seen(points, radius: float, is_profile: bool) -> np.ndarray:
    """(3, P) mm: x, z and radius of the circle of each profile, or the ball's centre in each cloud."""
    if is_profile:
        circles = profile_circles(points, radius)
        return np.concatenate([circles.centre, [circles.radius]])
    return np.stack([_centre(part, radius) for part in points], axis=1)


def _recording(rows, mapping, points, radius, options) -> Recording:
    number = np.array([part.shape[1] for part in points])
    poses = pose_columns(rows, mapping, {})
    others = other_columns(rows, mapping)
    poses |= {name: cells for name, cells in others.items() if cells.dtype.kind == "f"}
    columns = {"sample": np.arange(1.0, number.sum() + 1)}
    columns["pose"] = np.repeat(np.arange(1.0, len(points) + 1), number)
    columns["ball"] = np.ones(number.sum())
    columns |= {name: np.repeat(cells, number) for name, cells in poses.items()}
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), np.concatenate(points, axis=1)))
    return Recording(
        measures="ball-surface",
        columns=columns,
        robot={},
        sigma_mm=options.sigma_mm,
        balls={1: (0.0, 0.0, 0.0, radius)},
        name=options.name,
    )


def _clouds(files, radius) -> list[np.ndarray]:
    """(3, k) mm on the ball of every cloud. Raises InputError."""
    scale = LENGTHS[cloud_unit(files, radius)]
    clouds = []
    for path in files:
        points = scale * read_cloud(path, _MOST_POINTS).T
        distance = np.linalg.norm(points.mean(1))
        if distance > radius:
            view = points.mean(1) / distance
        else:
            view = np.array([0.0, 0.0, 1.0])
        balls = find_balls(points, [radius], view=view)
        if not balls:
            raise InputError(
                f"{path.name}: expected a ball of radius {radius:g} mm, found none; scan it again, or remove the file "
                "and its row."
            )
        clouds.append(thinned(points[:, balls[0].inliers]))
    return clouds


def read_profiles(files, radius: float) -> list[np.ndarray]:
    """(3, k) mm of every profile, in the unit under which they show sections of the ball. Raises InputError."""
    raw = [read_cloud(path, _MOST_POINTS).T for path in files]
    possible, obstacles = [], []
    for unit in _UNITS:
        scaled = [LENGTHS[unit] * thinned(part) for part in raw]
        share, obstacle = _share_of_sections(scaled, radius)
        obstacles.append(obstacle)
        if share > 0.5:
            possible.append((share, unit, scaled))
    if not possible:
        raise InputError(
            f"{files[0].name}: expected sections of a ball of radius {radius:g} mm with coordinates in "
            f"{', '.join(_UNITS)}, found none{next(filter(None, obstacles), '')}; correct --ball-radius or check the "
            "profiles."
        )
    return max(possible, key=lambda item: item[0])[2]


def _share_of_sections(profiles, radius) -> tuple[float, str]:
    """Share of the profiles whose circle has a radius that a section of the ball can have, largest near the ball's.

    Then what kept all circles from being fitted, in brackets, or "".
    """
    try:
        circles = profile_circles(profiles, _LARGEST_CIRCLE * radius)
    except InputError as error:
        obstacle = f" ({str(error).rstrip('.')})"
        return 0.0, obstacle
    except np.linalg.LinAlgError:
        return 0.0, ""
    fits = (circles.radius < _LARGEST_CIRCLE * radius) & (
        circles.radius > _SMALLEST_CIRCLE * radius
    )
    share = float((fits & (circles.rms < _SMALLEST_CIRCLE * radius)).mean())
    return share, ""


def profile_circles(profiles, largest: float) -> Circles:
    """The circle of each profile (3, k) mm, with a radius of `largest` at most. Raises InputError as `find_circles`."""
    label = np.repeat(np.arange(len(profiles)), [part.shape[1] for part in profiles])
    names = [f"profile {k + 1}" for k in range(len(profiles))]
    flat = np.concatenate(profiles, axis=1)[[0, 2]]
    return find_circles(flat, label, names, largest)


def compare_poses(readings, scans: Scans) -> list[tuple[int, CandidateFit]]:
    """Index and fit of the readings, the most probable first.

    Where none fits, a few wrong rows may be the reason: the best ones are compared without the rows that fit worst.
    """
    count = scans.seen.shape[1]
    rows = np.unique(np.linspace(0, count - 1, min(count, _TESTED_POSES)).astype(int))
    tested = replace(scans, poses=np.zeros((count, 4, 4))).take(rows)
    retained = _screened(readings, tested, rows)
    fits = [_fit(k, readings, tested, rows, rms_mm) for k in retained]
    fits.sort(key=lambda item: item[1].improbability)
    if fits and not fits[0][1].is_good:
        fits = [_fit(k, readings, tested, rows, trimmed_rms_mm) for k, _ in fits[:_TRIMMED]]
        fits.sort(key=lambda item: item[1].improbability)
    return fits


def _fit(k: int, readings, scans: Scans, rows: np.ndarray, misfit) -> tuple[int, CandidateFit]:
    """A reading and its fit; misfit: mm of scans."""
    title, _, poses = readings[k]
    rms = misfit(scans.with_poses(poses[rows]))
    scale = max(rms, 1e-3)
    degrees = 3 * len(rows) - 9
    is_good = rms < max(_GOOD_MM, _GOOD_SHARE * scans.radius)
    candidate_fit = CandidateFit(title, rms, np.nan, scale, degrees * np.log(scale), is_good)
    return k, candidate_fit


def _screened(readings, scans: Scans, rows: np.ndarray) -> list[int]:
    """Places of the readings whose rotations fit best when the sensor's rotation matrix may be any matrix: the
    problem is then linear, and no unit of length matters.

    Few poses leave few degrees of freedom, so that all rotations with a similar misfit are retained.
    """
    turn_of = [str(interpretation.flange_rotation) for _, interpretation, _ in readings]
    cost = _costs(_linear_cost, turn_of, readings, scans, rows)
    limit = sorted(cost.values())[:_ROTATIONS][-1]
    if np.isnan(list(cost.values())).any():
        if scans.is_profile or len(rows) < _FEWEST_SCREENED:
            return list(range(len(readings)))
        cost = _costs(_still_ball_cost, turn_of, readings, scans, rows)
        ordered = sorted(cost.values())
        limit = max(ordered[:_ROTATIONS][-1], _SIMILAR * ordered[0])
    return [k for k, turn in enumerate(turn_of) if cost[turn] <= limit]


def _costs(cost_of, turn_of, readings, scans: Scans, rows) -> dict[str, float]:
    """`cost_of` the scans at the poses of the first reading with each rotation."""
    cost: dict[str, float] = {}
    for turn, (_, _, poses) in zip(turn_of, readings):
        if turn not in cost:
            cost[turn] = cost_of(scans.seen, poses[rows], scans.is_profile)
    return cost


def _still_ball_cost(seen, poses, is_profile) -> float:
    """Share of the squared flange positions that no still ball explains, whatever matrix M turns the sensor's
    coordinates: R (M c + t) + p = b for centres c (3, P) and flange poses (P, 4, 4), 15 numbers in M, t and b."""
    rotation = poses[:, :3, :3]
    count = len(poses)
    by_matrix = np.einsum("pij,kp->pijk", rotation, seen).reshape(3 * count, 9)
    by_shift = rotation.reshape(3 * count, 3)
    by_ball = np.tile(np.eye(3), (count, 1))
    positions = poses[:, :3, 3] - poses[:, :3, 3].mean(0)
    design = np.hstack([by_matrix / max(np.abs(seen).max(), 1e-9), by_shift, by_ball])
    found = np.linalg.lstsq(design, -positions.ravel(), rcond=1e-10)[0]
    remainder = positions.ravel() + design @ found
    return float((remainder**2).sum() / max((positions**2).sum(), 1e-300))


def _linear_cost(seen, poses, is_profile) -> float:
    """Share of the squared coordinates that a linear model of flange poses (P, 4, 4) leaves; nan for too few poses."""
    inverse_rotation = poses[:, :3, :3].transpose(0, 2, 1)
    home = np.einsum("pij,pj->pi", inverse_rotation, poses[:, :3, 3])
    scale = max(np.abs(home).max(), 1e-9)
    rows = np.concatenate(
        [inverse_rotation.reshape(-1, 9), home / scale, np.ones((len(inverse_rotation), 1))], axis=1
    )
    measured = seen[:2].T if is_profile else seen.T
    if len(rows) <= rows.shape[1] + _SPARE:
        return np.nan
    remainder = measured - rows @ np.linalg.lstsq(rows, measured, rcond=1e-10)[0]
    return float((remainder**2).sum() / ((measured - measured.mean(0)) ** 2).sum())


def _centre(points, radius) -> np.ndarray:
    from sensors.ball.fit import fit_ball

    return fit_ball(points, radius=radius).centre
