"""Robot programmes as tables: targets of `workbench compensate` read, and corrected ones written as CSV."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.errors import complaint
from datasets.formats.table import Table
from datasets.importers.mapping.model import read_mapping
from datasets.importers.mapping.placements import Controller
from datasets.importers.sources.programs.robot_programs import CONFIGURATION
from datasets.importers.user_tables import read_targets
from datasets.samples.checks import physical_bounds
from datasets.samples.columns import POINT, QUATERNION, joint_columns
from robot_model.chain import forward
from robot_model.measurements.closure import flange_matrices
from robot_model.robot import Robot
from robot_model.state import reading_names, sliding
from workbench.core.rigid import transform
from workbench.core.text.csv_text import csv_text

LIMIT_SLACK = 1e-6
CORRECTION_COLUMNS = ("correction_mm", "expanded_uncertainty_mm", "reached", "refused")
"""Columns of a corrected table, by which it is recognised."""


@dataclass(frozen=True)
class Programme:
    """n targets: `readings` (n, R) rad, mm; `poses` (n, 4, 4) T_root_flange mm, None where joints are the target;
    `anywhere`: poses alone, so that any posture will do; `is_configured`: stated configurations chose `readings`.
    `is_joint` (n,) bool: targets of a robot program that are joint readings, where others are poses; None elsewhere.
    `controller`: how the controller of the program counts the joints, where a mapping states it.
    """

    table: Table
    readings: np.ndarray
    poses: np.ndarray | None
    covariates: Mapping[str, np.ndarray]
    anywhere: bool = False
    is_configured: bool = False
    is_joint: np.ndarray | None = None
    controller: Controller | None = None


def read_programme(path: Path, robot: Robot, mapping: Path | None = None) -> Programme:
    """Targets of a table in any form that `workbench import` reads.

    Either joint readings (q1_deg ... as in samples.csv), or flange poses in the robot's root frame
    (x_mm y_mm z_mm qw qx qy qz), or both: then the pose is the target and the readings are where to
    start looking, which chooses the posture. Other numeric columns (payload_kg, ...) are covariates.
    mapping: file that states columns, units and conventions of a table with other headers.
    Raises InputError with file, row and column.
    """
    path = Path(path)
    stated = None if mapping is None else read_mapping(mapping)
    tables = read_targets(path, sliding(robot).tolist(), stated)
    programmes = [_programme(path, table, robot) for table in tables]
    if len(programmes) == 1:
        programme = programmes[0]
    else:
        programme = _joined(*programmes, robot)
    if stated is None:
        return programme
    return replace(programme, controller=stated.controller)


def _programme(path: Path, table: Table, robot: Robot) -> Programme:
    """The targets of one table. Raises InputError."""
    joints = joint_columns(table.columns)
    wants = set(POINT + QUATERNION) & set(table.columns)
    if wants and len(wants) < 7:
        missing = sorted(set(POINT + QUATERNION) - wants)[0]
        raise complaint(
            f"{path.name}, column {missing}",
            "all of x_mm y_mm z_mm qw qx qy qz for a pose",
            "no such column",
            "add it, or give joint readings alone",
        )
    if not joints and not wants:
        raise _unknown_columns(path.name, table.columns, robot)
    if joints:
        readings = _readings(table, joints, robot)
    else:
        readings = np.tile(_home(robot), (len(table.rows), 1))
    known = {"sample", *joints, *POINT, *QUATERNION}
    covariates = {}
    for k, v in table.columns.items():
        if k not in known and v.dtype.kind == "f":
            covariates[k] = v
    _check_covariates(table, covariates)
    return Programme(
        table, readings, _poses(table) if wants else None, covariates, anywhere=not joints
    )


def _joined(joints: Programme, poses: Programme, robot: Robot) -> Programme:
    """Joint readings and poses of one robot program in the order of its lines.

    A pose starts at the joint readings before it, because a program keeps the configuration of the arm.
    """
    lines = np.concatenate([joints.table.rows, poses.table.rows])
    is_joint = np.repeat([True, False], [len(joints.readings), len(poses.readings)])
    readings = np.concatenate([joints.readings, poses.readings])
    frames = forward(robot, robot.mixing @ joints.readings.T)
    end_origin_pose = transform(flange_matrices(frames), frames.end_origin.T)
    matrices = np.concatenate([end_origin_pose, poses.poses])
    order = np.argsort(lines, kind="stable")
    readings, is_joint = readings[order], is_joint[order]
    last = np.maximum.accumulate(np.where(is_joint, np.arange(len(order)), -1))
    readings = np.where((last >= 0)[:, None], readings[last], readings)
    columns = {}
    for name in {**joints.table.columns, **poses.table.columns}:
        cells = [part.table.columns.get(name) for part in (joints, poses)]
        is_text = any(part.dtype.kind != "f" for part in cells if part is not None)
        filled = [_gaps(part, cell, is_text) for part, cell in zip((joints, poses), cells)]
        columns[name] = np.concatenate(filled)[order]
    table = Table(joints.table.called, columns, lines[order])
    return Programme(table, readings, matrices[order], {}, anywhere=True, is_joint=is_joint)


def _gaps(part: Programme, cells: np.ndarray | None, is_text: bool) -> np.ndarray:
    """The cells of a column, or as many empty ones."""
    if cells is not None:
        return cells
    return np.full(len(part.readings), "" if is_text else np.nan)


def _unknown_columns(called: str, columns, robot: Robot):
    """The InputError for a table without joint and pose columns, with the names that this robot's table has."""
    names = [
        f"q{k}_{'mm' if slides else 'deg'}" for k, slides in enumerate(sliding(robot).tolist(), 1)
    ]
    known = {"sample", "note"}
    others = [name for name in columns if name not in known]
    shown = ", ".join(others[:6]) + (", ..." if len(others) > 6 else "")
    return complaint(
        called,
        f"joint columns {names[0]} ... {names[-1]}, or pose columns x_mm y_mm z_mm qw qx qy qz",
        f"none of them; not recognised: {shown or 'no column at all'}",
        f"rename the columns of the joint readings to {', '.join(names)}",
    )


def _check_covariates(table, covariates) -> None:
    """InputError for the first cell that is no finite number, or that no load or temperature can be."""
    for name, values in covariates.items():
        for row in np.flatnonzero(~np.isfinite(values)):
            raise complaint(
                table.where(row, name), "a finite number", f"{values[row]}", "correct it"
            )
    physical_bounds(table)


def _readings(table, joints, robot):
    if len(joints) != robot.mixing.shape[1]:
        raise complaint(
            table.called,
            f"{robot.mixing.shape[1]} joint columns as {robot.name} has",
            f"{len(joints)}: {', '.join(joints)}",
            _joint_remedy(joints, robot),
        )
    for name, slides in zip(joints, sliding(robot).tolist()):
        if name.endswith("_mm") != slides:
            raise complaint(
                f"{table.called}, column {name}",
                f"{'mm, since this joint slides' if slides else 'deg, since this joint rotates'}",
                name.rpartition("_")[2],
                "correct the header and the numbers",
            )
    factors = np.where(sliding(robot), 1.0, np.pi / 180)
    readings = np.stack([table.columns[name] for name in joints], 1) * factors
    low, high = robot.limits.T
    for row, column in np.argwhere(~np.isfinite(readings)):
        raise complaint(
            table.where(row, joints[column]),
            "a finite number",
            f"{readings[row, column]}",
            "correct it",
        )
    for row, column in np.argwhere(
        (readings < low - LIMIT_SLACK) | (readings > high + LIMIT_SLACK)
    ):
        allowed = f"{low[column] / factors[column]:g} to {high[column] / factors[column]:g}"
        raise complaint(
            table.where(row, joints[column]),
            f"{allowed}, the joint's limits",
            f"{readings[row, column] / factors[column]:g}",
            "correct the target",
        )
    return readings


def _joint_remedy(joints, robot: Robot) -> str:
    """Which joints have no column, or which columns are too many."""
    expected = reading_names(robot)
    missing = [name for name in expected if name.partition("_")[0] not in _numbers(joints)]
    if missing:
        return f"add {', '.join(missing)}"
    return f"remove {', '.join(name for name in joints if name not in expected)}"


def _numbers(joints) -> set[str]:
    """The joints of these columns: q1, q2, ..."""
    return {name.partition("_")[0] for name in joints}


def target_warnings(programme: Programme, robot: Robot) -> list[str]:
    """Warnings about targets that are possible but suspicious, and configuration data that are not read."""
    called = programme.table.called
    revolute = np.rad2deg(programme.readings[:, ~sliding(robot)])
    found = []
    if (
        programme.poses is None
        and revolute.size
        and np.abs(revolute).max() <= 2 * np.pi
        and np.ptp(revolute) > 0
    ):
        found.append(
            f"{called}: no joint reading is beyond {np.abs(revolute).max():.3g} deg; if these are radians, multiply "
            "them by 57.29578."
        )
    if programme.poses is not None and np.abs(programme.poses[:, :3, 3]).max(initial=0) < 10:
        found.append(
            f"{called}: every place is within 10 mm of the robot's root; if these are metres, multiply them by 1000."
        )
    stated = programme.table.columns.get(CONFIGURATION)
    is_unread = programme.anywhere and not programme.is_configured
    if is_unread and stated is not None and stated.dtype.kind != "f":
        found.append(
            f"{called}: the configuration data of its positions ({stated[0]}, ...) are not read; compare the joint "
            "readings with them, or state readings to start from (--start)."
        )
    return found


def _home(robot):
    """(R,) the middle of every joint's limits, 0 where unknown: where the search for a posture starts."""
    return np.nan_to_num(robot.limits.mean(1))


def _poses(table):
    place = np.stack([table.columns[name] for name in POINT], 1)
    quaternions = np.stack([table.columns[name] for name in QUATERNION], 1)
    size = np.linalg.norm(quaternions, axis=1)
    for row, column in np.argwhere(~np.isfinite(np.column_stack([place, quaternions]))):
        where = table.where(row, (POINT + QUATERNION)[column])
        raise complaint(where, "a finite number", "another", "correct the pose")
    for row in np.flatnonzero(~(np.abs(size - 1) < 1e-2)):
        raise complaint(
            table.where(row, "qw"),
            "a quaternion of length 1",
            f"length {size[row]:g}",
            "correct the pose",
        )
    from scipy.spatial.transform import Rotation

    return transform(Rotation.from_quat(quaternions, scalar_first=True).as_matrix(), place)


def corrected_columns(
    programme: Programme, robot: Robot, found, refused: Collection[int] = ()
) -> dict[str, np.ndarray]:
    """Columns of the corrected programme: the file's own, its readings replaced, and what is left of the error.

    The file's own columns keep their names and units; readings of a file without any are q1_deg ....
    refused: indices of targets that keep no readings, like those that are not reached.
    """
    is_refused = np.isin(np.arange(len(found.readings)), list(refused))
    readings = np.where(is_refused[:, None], np.nan, found.readings)
    table, slides = programme.table, sliding(robot)
    source_columns = table.columns if table.origin is None else table.origin.columns
    names = [(f"q{k}_{'mm' if is_slide else 'deg'}", 1.0) for k, is_slide in enumerate(slides, 1)]
    if table.origin is not None and table.origin.joints:
        names = table.origin.joints
    in_deg_or_mm = readings * np.where(slides, 1.0, 180 / np.pi)
    joints = {name: column / size for (name, size), column in zip(names, in_deg_or_mm.T)}
    added = {
        "correction_mm": found.correction_mm,
        "left_mm": found.left_mm,
        "position_left_mm": found.position_left_mm,
        "rotation_left_deg": found.rotation_left_deg,
        "sigma_mm": found.sigma_mm,
        "uncertainty_mm": found.uncertainty_mm,
        "expanded_uncertainty_mm": found.expanded_uncertainty_mm,
        "reached": found.reached.astype(float),
        "refused": is_refused.astype(float),
    }
    return {**source_columns, **joints, **added}


def as_csv(columns: Mapping[str, np.ndarray]) -> str:
    """Columns as CSV text, numbers with ten digits, an empty cell for nan, texts quoted and protected."""
    cells = [[_cell(value) for value in column] for column in columns.values()]
    return csv_text(columns, zip(*cells))


def _cell(value) -> str:
    if isinstance(value, str):
        return value
    return "" if np.isnan(value) else f"{value:.10g}"
