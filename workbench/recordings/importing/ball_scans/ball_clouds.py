"""Point clouds of a ball as ball centres: one ball per cloud, found and fitted, then imported like a table.

The certified radius decides the unit of the clouds: under a wrong unit no ball of that radius is found.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.importers.mapping.model import Group
from datasets.importers.source import RawTable
from datasets.importers.sources.choice import natural_order
from datasets.importers.sources.clouds import read_cloud
from datasets.importers.units import LENGTHS
from sensors.ball.search import find_balls
from workbench.core.errors import InputError
from workbench.recordings.importing.ball_scans.scan_review import radius_suspicion

_MOST_POINTS, _KEPT_POINTS = 60_000, 600
_UNITS = ("mm", "m", "in")
_NAMES = ("ball centre x", "ball centre y", "ball centre z")
_SIGMA = "ball centre sigma"
_FEWEST = 4


def with_ball_centres(found, options, progress):
    """The same find with the ball's centre of each cloud as columns of the table, and sentences on a wrong radius.

    Raises InputError where the radius is not stated, clouds and rows do not correspond, or a cloud shows no ball.
    """
    table, clouds, notes = joint_scans(found, options)
    unit = cloud_unit(clouds, options.ball_radius_mm)
    centres, sigmas, rows_with_balls, failed, surfaces = [], [], [], [], []
    for row, path in enumerate(clouds):
        progress(f"finding the ball in {path.name}")
        ball, points = ball_in_cloud(path, unit, options.ball_radius_mm)
        if ball is None:
            failed.append(path.name)
            continue
        surfaces.append(thinned(points[:, ball.inliers]))
        centres.append(ball.centre)
        sigmas.append(float(np.sqrt(np.trace(ball.covariance[:3, :3]) / 3)))
        rows_with_balls.append(row)
    if len(rows_with_balls) < _FEWEST:
        raise InputError(
            f"{clouds[0].name}: expected a ball of radius {options.ball_radius_mm:g} mm in {_FEWEST} clouds or more, "
            f"found it in {len(rows_with_balls)} of {len(clouds)}; correct --ball-radius or check the clouds."
        )
    if failed:
        notes = (
            *notes,
            f"No ball of radius {options.ball_radius_mm:g} mm in {', '.join(failed[:5])}; left out.",
        )
    table = table.take(np.array(rows_with_balls))
    suspicion = radius_suspicion(surfaces, options.ball_radius_mm)
    if suspicion is None:
        suspicions = ()
    else:
        suspicions = (f"{table.file}: {suspicion}.",)
    extended = _extended(found, table, np.array(centres), np.array(sigmas), notes)
    return extended, suspicions


def joint_scans(found, options):
    """Rows with a scan, the files of these rows, and sentences on rows without one. Raises InputError where the radius
    or the table is missing, or rows and files do not correspond."""
    if options.ball_radius_mm is None:
        raise InputError(
            f"{found.source.clouds[0].name}: expected the certified radius of the ball, which decides the unit of the "
            "clouds, found none; add --ball-radius MM."
        )
    if found.table is None:
        raise InputError(
            f"{found.source.clouds[0].name}: expected a table with the joint readings of each cloud, found none; name "
            "it as well."
        )
    return matched_clouds(found.table, found.source.clouds)


def _extended(found, table: RawTable, centres: np.ndarray, sigmas: np.ndarray, notes):
    columns = {**table.columns, **dict(zip(_NAMES, centres.T)), _SIGMA: np.maximum(sigmas, 1e-4)}
    mapping = replace(
        found.mapping,
        measures="ball-centre",
        point=Group(_NAMES, "mm"),
        columns={**found.mapping.columns, _SIGMA: "sigma_mm"},
    )
    table = replace(table, columns=columns)
    return replace(found, table=table, mapping=mapping, warnings=(*found.warnings, *notes))


def matched_clouds(table: RawTable, clouds: Sequence[Path]):
    """Rows with a cloud and their clouds, by file names in a text column or by order. Raises InputError."""
    ordered = sorted(clouds, key=natural_order)
    by_stem = {path.stem.lower(): path for path in ordered}
    for cells in table.columns.values():
        if cells.dtype.kind == "f":
            continue
        stems = [Path(str(cell).replace("\\", "/")).stem.lower() for cell in cells]
        rows = [row for row, stem in enumerate(stems) if stem in by_stem]
        if len(rows) >= max(_FEWEST, table.n // 2):
            if len(rows) == table.n:
                notes = ()
            else:
                notes = (f"{table.n - len(rows)} rows have no cloud and are left out.",)
            files = [by_stem[stems[row]] for row in rows]
            return table.take(np.array(rows)), files, notes
    if len(ordered) != table.n:
        raise InputError(
            f"{table.file}: expected as many rows as clouds or a column with the names of the cloud files, found "
            f"{table.n} rows and {len(ordered)} clouds; add a column cloud to the table."
        )
    return table, ordered, ()


def cloud_unit(clouds: Sequence[Path], radius: float) -> str:
    """The unit in which most of the first clouds show a ball of the radius. Raises InputError where none does."""
    first_clouds = clouds[: min(3, len(clouds))]
    found = {
        unit: sum(ball_in_cloud(path, unit, radius)[0] is not None for path in first_clouds)
        for unit in _UNITS
    }
    best = max(found, key=found.get)
    if not found[best]:
        raise InputError(
            f"{first_clouds[0].name}: expected a ball of radius {radius:g} mm with coordinates in {', '.join(_UNITS)}, "
            "found none; correct --ball-radius or check the cloud."
        )
    return best


def ball_in_cloud(path: Path, unit: str, radius: float):
    """The ball with most points in a cloud, None where there is none, and the points (3, n) mm."""
    points = LENGTHS[unit] * read_cloud(path, _MOST_POINTS).T
    if np.ptp(points, axis=1).max() < radius / 2:
        return None, points  # too small to show a ball of this radius: another unit
    if np.linalg.norm(points.mean(1)) > radius:
        view = points.mean(1)
    else:
        view = np.array([0.0, 0.0, 1.0])
    try:
        balls = find_balls(points, [radius], view=view / np.linalg.norm(view))
    except InputError:
        return None, points
    return (balls[0] if balls else None), points


def thinned(points: np.ndarray) -> np.ndarray:
    """At most 600 of the points (3, n), evenly."""
    count = points.shape[1]
    return points[:, np.linspace(0, count - 1, min(count, _KEPT_POINTS)).astype(int)]
