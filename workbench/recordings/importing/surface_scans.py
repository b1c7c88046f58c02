"""Import of clouds of a 3-D camera, or profiles of a laser profiler, of one ball at flange poses (kind ball-surface).

The certified radius decides the unit of the points. Units and rotation convention of the poses are tested by how well
one transform from flange to sensor keeps the ball in its place.
"""

from dataclasses import replace

import numpy as np

from datasets.importers.mapping.conversion import complete_rows, other_columns
from datasets.importers.sources.clouds import PROFILES, read_cloud
from datasets.importers.units import LENGTHS
from datasets.recording import Recording
from sensors.ball.search import find_balls
from sensors.hand_eye.centres import Centres, hand_eye_from_centres
from sensors.hand_eye.circles import find_circles
from sensors.hand_eye.profiles_start import find_start
from workbench.core.errors import InputError
from workbench.recordings.importing.ball_clouds import cloud_unit, matched_clouds
from workbench.recordings.importing.board_poses import flange_readings, pose_columns, reading_line
from workbench.recordings.importing.decisions import choose_reading
from workbench.recordings.importing.fits import CandidateFit

_FEWEST = 5
_MOST_POINTS, _KEPT_POINTS, _TESTED_POSES = 60_000, 600, 20
_UNITS = ("mm", "m", "in", "um")
_GOOD_MM, _GOOD_SHARE = 2.0, 0.1  # of the ball's radius
_LARGEST_CIRCLE = 1.1  # over the ball's radius
_SMALLEST_CIRCLE = 0.15
_VALLEYS, _STEPS = 4, 40
_ROTATIONS, _SPARE = 4, 3
_REMEDY = "check that rows and files belong together, --ball-radius and the mapping"


def is_scan(found) -> bool:
    """Whether clouds or profiles come with flange poses and no joint readings."""
    mapping = found.mapping
    has_poses = mapping.flange_point is not None and mapping.flange_rotation is not None
    return bool(found.source.clouds) and has_poses and mapping.joints is None


def import_scans(found, options, progress):
    """Recording, complete mapping, fits and warnings. Raises InputError where files and rows do not correspond, a file
    shows no ball, or the poses fit under no reading."""
    radius = options.ball_radius_mm
    first = found.source.clouds[0].name
    if radius is None:
        raise InputError(
            f"{first}: expected the certified radius of the ball, which decides the unit of the points, found none; "
            "add --ball-radius MM."
        )
    rows, files, said = matched_clouds(found.table, found.source.clouds)
    rows, dropped = complete_rows(rows, found.mapping)
    if dropped:
        raise InputError(f"{dropped[0]} Remove their files or complete the rows.")
    is_profile = files[0].suffix.lower() in PROFILES
    progress("finding the ball in every file")
    points = _profiles(files, radius) if is_profile else _clouds(files, radius)
    if len(points) < _FEWEST:
        raise InputError(
            f"{first}: expected a ball in {_FEWEST} files or more, found {len(points)}; add poses."
        )
    mapping = replace(found.mapping, measures="ball-surface", joints=None)
    readings = flange_readings(rows, mapping)
    progress(f"testing {len(readings)} readings of the flange poses")
    fits = _compared(readings, points, radius, is_profile)
    lines = [reading_line(made) for _, made, _ in readings]
    chosen = choose_reading(lines, fits, f"{rows.file}, flange poses", options.ask, _REMEDY)
    best = dict(fits)[chosen]
    if not best.is_good and not options.trust_data:
        raise InputError(
            f"{rows.file}: expected flange poses that keep the ball in its place, found none under any reading (best "
            f"{best.words}); {_REMEDY}, or repeat with --trust-data."
        )
    mapping = readings[chosen][1]
    recording = _recording(rows, mapping, points, radius, options)
    return recording, mapping, tuple(fit for _, fit in fits), said


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


def _thinned(points: np.ndarray) -> np.ndarray:
    count = points.shape[1]
    return points[:, np.linspace(0, count - 1, min(count, _KEPT_POINTS)).astype(int)]


def _clouds(files, radius) -> list[np.ndarray]:
    """(3, k) mm on the ball of every cloud. Raises InputError."""
    scale = LENGTHS[cloud_unit(files, radius)]
    made = []
    for path in files:
        points = scale * read_cloud(path, _MOST_POINTS).T
        away = np.linalg.norm(points.mean(1))
        view = points.mean(1) / away if away > radius else np.array([0.0, 0.0, 1.0])
        balls = find_balls(points, [radius], view=view)
        if not balls:
            raise InputError(
                f"{path.name}: expected a ball of radius {radius:g} mm, found none; scan it again, or remove the file "
                "and its row."
            )
        made.append(_thinned(points[:, balls[0].inliers]))
    return made


def _profiles(files, radius) -> list[np.ndarray]:
    """(3, k) mm of every profile, in the unit under which they show sections of the ball. Raises InputError."""
    raw = [read_cloud(path, _MOST_POINTS).T for path in files]
    possible = []
    for unit in _UNITS:
        scaled = [LENGTHS[unit] * _thinned(part) for part in raw]
        share = _share_of_sections(scaled, radius)
        if share > 0.5:
            possible.append((share, unit, scaled))
    if not possible:
        raise InputError(
            f"{files[0].name}: expected sections of a ball of radius {radius:g} mm with coordinates in "
            f"{', '.join(_UNITS)}, found none; correct --ball-radius or check the profiles."
        )
    return max(possible, key=lambda item: item[0])[2]


def _share_of_sections(profiles, radius) -> float:
    """Share of the profiles whose circle has a radius that a section of the ball can have, largest near the ball's."""
    try:
        circles = _circles(profiles, _LARGEST_CIRCLE * radius)
    except (InputError, np.linalg.LinAlgError):
        return 0.0
    fits = (circles.radius < _LARGEST_CIRCLE * radius) & (
        circles.radius > _SMALLEST_CIRCLE * radius
    )
    return float((fits & (circles.rms < _SMALLEST_CIRCLE * radius)).mean())


def _circles(profiles, largest):
    label = np.repeat(np.arange(len(profiles)), [part.shape[1] for part in profiles])
    return find_circles(np.concatenate(profiles, axis=1)[[0, 2]], label, len(profiles), largest)


def _compared(readings, points, radius, is_profile) -> list[tuple[int, CandidateFit]]:
    """Index and fit of the readings, the most probable first."""
    rows = np.unique(np.linspace(0, len(points) - 1, min(len(points), _TESTED_POSES)).astype(int))
    some = [points[row] for row in rows]
    if is_profile:
        circles = _circles(some, radius)
        seen = np.concatenate([circles.centre, [circles.radius]])
    else:
        seen = np.stack([_centre(part, radius) for part in some], axis=1)
    fits = []
    for k in _screened(readings, seen, rows, is_profile):
        title, _, poses = readings[k]
        rms = _left(seen, poses[rows], radius, is_profile)
        scale = max(rms, 1e-3)
        degrees = 3 * len(rows) - 9
        is_good = rms < max(_GOOD_MM, _GOOD_SHARE * radius)
        fit = CandidateFit(title, rms, np.nan, scale, degrees * np.log(scale), is_good)
        fits.append((k, fit))
    return sorted(fits, key=lambda item: item[1].improbability)


def _screened(readings, seen, rows, is_profile) -> list[int]:
    """Places of the readings whose rotations fit best when the sensor's rotation matrix may be any matrix: the
    problem is then linear, and no unit of length matters."""
    cost: dict[str, float] = {}
    turn_of = [str(made.flange_rotation) for _, made, _ in readings]
    for turn, (_, _, poses) in zip(turn_of, readings):
        if turn not in cost:
            cost[turn] = _linear_cost(seen, poses[rows], is_profile)
    kept = sorted(cost, key=cost.get)[:_ROTATIONS]
    return [k for k, turn in enumerate(turn_of) if turn in kept]


def _linear_cost(seen, poses, is_profile) -> float:
    """Share of the measured coordinates that a linear model of flange poses (P, 4, 4) leaves, per degree of freedom."""
    back = poses[:, :3, :3].transpose(0, 2, 1)
    home = np.einsum("pij,pj->pi", back, poses[:, :3, 3])
    scale = max(np.abs(home).max(), 1e-9)
    rows = np.concatenate([back.reshape(-1, 9), home / scale, np.ones((len(back), 1))], axis=1)
    measured = seen[:2].T if is_profile else seen.T
    if len(rows) <= rows.shape[1] + _SPARE:
        return 0.0
    left = measured - rows @ np.linalg.lstsq(rows, measured, rcond=1e-10)[0]
    return float((left**2).sum() / ((measured - measured.mean(0)) ** 2).sum())


def _centre(points, radius) -> np.ndarray:
    from sensors.ball.fit import fit_ball

    return fit_ball(points, radius=radius).centre


def _left(seen, poses, radius, is_profile) -> float:
    """RMS mm by which the ball moves under one reading."""
    if is_profile:
        return find_start(seen, poses, radius, best=_VALLEYS, steps=_STEPS).rms
    data = Centres(seen, poses, np.zeros(len(poses), int))
    return float(hand_eye_from_centres(data, radius).fit["rms_mm"])
