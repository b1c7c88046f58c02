"""Plausibility checks of units and ball numbers.

A rule applies only if the values are physically impossible, or if the recording would otherwise be
useless. `small_range = true` under [samples] in
recording.toml says that the arm really moved so little, and silences the rules about units.
"""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from datasets.errors import InputError, complaint
from datasets.formats.table import Table
from datasets.recording_files.arms import nominal_reach
from datasets.samples.checks import Context, points_of
from datasets.samples.columns import joint_columns
from datasets.samples.joint_limits import limit_warnings
from datasets.trust import accepted_by_option, naming_option

TURN = 2 * np.pi
TOOL_MM = 1000.0
"""No reflector is expected farther from the flange."""

FEW_ROWS, MOST_NAMED = 0.3, 8
"""Share of the rows up to which far points are mistakes of single cells, and how many samples a message names."""

MOST_BALLS = 16
"""Number of rows of one static pose that are compared with each other."""


def joints_are_degrees(table: Table, context: Context) -> None:
    """Readings that all lie within one revolution of 2 pi are radians.

    An arm whose every joint stays within 6.3 degrees of zero is stretched out and hardly moves;
    no calibration comes from that. Needs three rows and some motion, so that a recording at the
    arm's zero pose passes.
    """
    names = [c for c in joint_columns(table.columns) if c.endswith("_deg")]
    if context.small_range or len(names) < 3 or len(table.rows) < 3:
        return
    q = np.stack([table.columns[c] for c in names])
    if np.abs(q).max() <= TURN and np.sum(np.ptp(q, axis=1) > 0.02) >= 3:
        raise complaint(
            f"{table.called}, columns {names[0]} … {names[-1]}",
            "joint readings in degrees",
            f"no reading beyond {np.abs(q).max():.3g}, as if in radians",
            "multiply them by 57.29578, or write small_range = true under [samples] if the arm "
            "really stayed that close to zero",
        )


def motion_fits_joints(table: Table, context: Context) -> None:
    """Points in an external frame cannot move farther than the joints can carry them.

    A rotation of dq moves no point by more than reach * dq; twice the sum over the joints is the bound.
    """
    points, reach = points_of(table), nominal_reach(context.robot)
    names = [c for c in joint_columns(table.columns) if c.endswith("_deg")]
    is_external = context.measures in ("external-point", "external-pose", "partial-pose")
    if context.small_range or points is None or not is_external or not np.isfinite(reach):
        return
    if len(names) < len(joint_columns(table.columns)):
        return
    moving = _moving(table)
    if moving.sum() < 3:
        return
    dq = sum(np.ptp(table.columns[c][moving]) for c in names) * np.pi / 180
    spread, bound = np.ptp(points[moving], axis=0).max(), 2 * (reach + TOOL_MM) * dq + 2 * TOOL_MM
    if spread > bound:
        _single_far_cells(table, points, moving, 2 * (reach + TOOL_MM))
        raise complaint(
            f"{table.called}, columns {names[0]} … {names[-1]}",
            "joint readings in degrees that explain the points",
            f"points that move by {spread:.0f} mm where these joints reach {bound:.0f} mm",
            "convert the joints from radians to degrees, or the points to mm",
        )


def _single_far_cells(table: Table, points: np.ndarray, moving: np.ndarray, limit: float) -> None:
    """Cells of a few rows that are farther from the median of their column than the arm can carry a point, in mm."""
    is_far = moving[:, None] & (np.abs(points - np.median(points[moving], axis=0)) > limit)
    rows = np.flatnonzero(is_far.any(axis=1))
    if not 0 < len(rows) < FEW_ROWS * moving.sum():
        return
    names = [
        name for name, is_named in zip(("x_mm", "y_mm", "z_mm"), is_far.any(axis=0)) if is_named
    ]
    samples = table.columns["sample"][rows].astype(int)
    shown = ", ".join(map(str, samples[:MOST_NAMED])) + (" ..." if len(rows) > MOST_NAMED else "")
    row, column = np.argwhere(is_far)[0]
    raise complaint(
        f"{table.called}, column{'s' * (len(names) > 1)} {', '.join(names)}, samples {shown}",
        "points that the arm can reach, as in the other rows",
        f"{len(rows)} of {moving.sum()} rows more than {limit:.0f} mm away from them, such as "
        f"{points[row, column]:.8g} where the median of the column is {np.median(points[moving, column]):.6g}: a "
        "decimal point or comma is lost, or the unit is another one",
        "correct these cells, and others of the same column that may be less far off",
    )


def points_are_millimetres(table: Table, context: Context) -> None:
    """Points of a moving arm that stay within 20 "mm", 1/50 of what its joints do, are metres.

    In the sensor frame: a ball whose centre is always closer than 1 mm, or closer than its own
    radius with a spread below 1 mm, would have the sensor inside it.
    """
    points = points_of(table)
    if context.small_range or points is None or len(points) < 3:
        return
    largest = np.abs(points).max()
    if context.balls and largest < 1 < min(b[3] for b in context.balls.values()):
        raise _metres(table, largest, "no ball surrounds the sensor's origin")
    reach, moving = nominal_reach(context.robot), _moving(table)
    is_external = context.measures in ("external-point", "external-pose", "partial-pose")
    if not is_external or not np.isfinite(reach) or largest > 20 or moving.sum() < 3:
        return
    angles_deg = [
        np.ptp(table.columns[c][moving])
        for c in joint_columns(table.columns)[:3]
        if c.endswith("_deg")
    ]
    spread = np.ptp(points[moving], axis=0).max()
    if angles_deg and spread < reach * np.deg2rad(max(angles_deg)) / 50:
        raise _metres(
            table,
            spread,
            f"an arm with a reach of {reach:.0f} mm rotated by {max(angles_deg):.0f} deg",
        )


def _metres(table: Table, size: float, expected: str) -> InputError:
    return complaint(
        f"{table.called}, columns x_mm, y_mm, z_mm",
        "points in mm",
        f"points within {size:.3g} although {expected}, as if in metres",
        "multiply them by 1000, or write small_range = true under [samples] if they are right",
    )


def balls_keep_their_distance(table: Table, context: Context) -> None:
    """Distances of balls seen from one static pose agree with the artefact."""
    if context.measures != "ball-centre" or "pose" not in table.columns or len(context.balls) < 2:
        return
    points, ball, pose = points_of(table), table.columns["ball"].astype(int), table.columns["pose"]
    order = np.argsort(pose, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(pose[order])) + 1):
        for i, j in combinations(rows[:MOST_BALLS], 2):
            if ball[i] != ball[j]:
                _check_distance(table, context, points, ball, i, j)


def _check_distance(table: Table, context: Context, points, ball, i: int, j: int) -> None:
    measured, nominal = (
        np.linalg.norm(points[i] - points[j]),
        _distances(context.balls, ball[i], ball[j]),
    )
    slack = max(2.0, 0.01 * nominal, 10 * (context.sigma_mm or 0))
    if abs(measured - nominal) > slack:
        raise complaint(
            table.where(max(i, j), "ball"),
            f"{nominal:.2f} mm between balls {ball[i]} and {ball[j]} as in artefact.csv",
            f"{measured:.2f} mm between rows {table.rows[min(i, j)]} and {table.rows[max(i, j)]}",
            _swap(context.balls, measured, slack, "correct the ball numbers or artefact.csv"),
        )


def _swap(balls: Mapping, measured: float, slack: float, default: str) -> str:
    fits = [
        f"{a} and {b}"
        for a, b in combinations(sorted(balls), 2)
        if abs(_distances(balls, a, b) - measured) < slack
    ]
    swapped = (
        f"if these are balls {' or '.join(fits)}, two balls are swapped: correct the column ball"
    )
    return swapped if fits else default


def _distances(balls: Mapping, a: int, b: int) -> float:
    return float(np.linalg.norm(np.subtract(balls[a][:3], balls[b][:3])))


def _moving(table: Table) -> np.ndarray:
    fixed = table.columns.get("fixed_to")
    return np.ones(len(table.rows), bool) if fixed is None else fixed == "tool"


RULES = (joints_are_degrees, motion_fits_joints, points_are_millimetres, balls_keep_their_distance)


def check_plausible(table: Table, context: Context) -> tuple[str, ...]:
    """Run every rule; sentences on what is unusual and accepted.

    Raises InputError for the first rule that is broken. Where `context.trust_data`, it becomes a warning instead.
    """
    warnings = list(limit_warnings(table, context))
    for rule in RULES:
        try:
            rule(table, context)
        except InputError as problem:
            if not context.trust_data:
                raise InputError(naming_option(str(problem))) from None
            warnings.append(accepted_by_option(str(problem)))
    return tuple(warnings)
