"""Profiles of a ball with joint readings (kind ball-surface), imported like a table with one row for each point."""

from dataclasses import replace

import numpy as np

from datasets.importers.mapping.model import Group
from datasets.importers.source import RawTable
from datasets.recording import Recording
from sensors.hand_eye.circles import Circles
from workbench.files.images.flange import flange_poses
from workbench.recordings.importing.ball_scans.ball_clouds import joint_scans
from workbench.recordings.importing.ball_scans.scan_review import Scans, profile_radius_suspicion
from workbench.recordings.importing.ball_scans.surface_scans import profile_circles, read_profiles
from workbench.recordings.importing.measured_robot import Made, import_table
from workbench.recordings.importing.robots import check_balls

_POINT = ("profile x", "profile y", "profile z")
_FILE = "number of the profile"
_TESTED = 24  # points of a profile by which units and robot are decided


def import_profiles(found, options, progress) -> Made:
    """The ball-surface recording of profiles of one ball with joint readings.

    found, options: `Found` and `ImportOptions` of the import. Raises InputError where rows and files do not correspond,
    a file shows no section of the ball, or as `import_table`.
    """
    table, files, notes = joint_scans(found, options)
    progress("finding the ball in every profile")
    points = read_profiles(files, options.ball_radius_mm)
    circles = profile_circles(points, options.ball_radius_mm)
    on_ball = np.split(circles.used, np.cumsum([part.shape[1] for part in points])[:-1])
    points = [part[:, used] for part, used in zip(points, on_ball)]
    found_mapping = found.mapping
    mapping = replace(
        found_mapping,
        measures="ball-surface",
        point=Group(_POINT, "mm"),
        columns={**found_mapping.columns, _FILE: "pose"},
    )
    _check_balls(table, mapping, options)
    warnings = (*found.warnings, *notes, *circles.why)
    by_point = replace(found, table=_point_rows(table, points), mapping=mapping, warnings=warnings)
    made = import_table(by_point, options, progress)
    recording, rows = _with_all_points(made.recording, points)
    suspicions = _radius_suspicions(table, circles, recording, rows, options.ball_radius_mm)
    kept = replace(
        made.mapping,
        measures=found_mapping.measures,
        point=found_mapping.point,
        columns=found_mapping.columns,
    )
    return replace(made, recording=recording, mapping=kept).with_suspicions(suspicions)


def _check_balls(table: RawTable, mapping, options) -> None:
    """Raises InputError where the column of balls names one whose place is not known."""
    column = next((name for name, target in mapping.columns.items() if target == "ball"), None)
    if column is not None:
        numbers = np.unique(table.numbers(column)).astype(int).tolist()
        check_balls(options.artefact, table.file, numbers)


def _point_rows(table: RawTable, points) -> RawTable:
    """The table with some points of each profile: a row of joint readings for each of them."""
    chosen = [_evenly(part) for part in points]
    rows = np.repeat(np.arange(table.n), [part.shape[1] for part in chosen])
    repeated = table.take(rows)
    columns = {**repeated.columns, **dict(zip(_POINT, np.concatenate(chosen, axis=1)))}
    columns[_FILE] = rows + 1.0
    return replace(repeated, columns=columns)


def _evenly(part: np.ndarray) -> np.ndarray:
    count = part.shape[1]
    return part[:, np.linspace(0, count - 1, min(count, _TESTED)).astype(int)]


def _with_all_points(tested: Recording, points) -> tuple[Recording, np.ndarray]:
    """The recording with every point of its profiles, and (P,) the row of the table of each profile."""
    number, first = np.unique(tested.columns["pose"], return_index=True)
    rows = number.astype(int) - 1
    points_of_rows = [points[row] for row in rows]
    count = [part.shape[1] for part in points_of_rows]
    columns = {name: np.repeat(cells[first], count) for name, cells in tested.columns.items()}
    columns["sample"] = np.arange(1.0, sum(count) + 1)
    columns |= dict(zip(("x_mm", "y_mm", "z_mm"), np.concatenate(points_of_rows, axis=1)))
    return replace(tested, columns=columns), rows


def _radius_suspicions(
    table: RawTable, circles: Circles, recording, rows, radius
) -> tuple[str, ...]:
    """A sentence where the profiles show a ball of another radius at the poses of the nominal arm.

    Of several balls the one with most profiles is tested: the test knows one place.
    """
    # by the number of the profile: two profiles with equal joint readings are one pose, but two circles
    first = np.unique(recording.columns["pose"], return_index=True)[1]
    balls, number = np.unique(recording.columns["ball"][first], return_inverse=True)
    of_ball = number == np.bincount(number, minlength=len(balls)).argmax()
    first, rows = first[of_ball], rows[of_ball]
    seen = np.concatenate([circles.centre, [circles.radius]])[:, rows]
    names = [f"row {line}" for line in table.lines[rows]]
    scans = Scans(seen, flange_poses(recording)[first], names, radius, is_profile=True)
    suspicion = profile_radius_suspicion(scans)
    if suspicion is None:
        return ()
    return (f"{table.file}: {suspicion}.",)
