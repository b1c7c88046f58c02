"""Possible readings of the flange poses or joint readings of a hand-eye set: units and rotation conventions."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datasets.importers.mapping.candidates import (
    RotationConvention,
    angle_units,
    length_units,
    rotation_candidates,
)
from datasets.importers.mapping.columns.column_units import unit_toml, unit_words
from datasets.importers.mapping.conversion import joint_columns, point_columns, rotation_columns
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from datasets.recording import Recording
from robot_model import load_robot
from robot_model.chain import forward
from workbench.core.errors import InputError
from workbench.core.rigid import transform
from workbench.recordings.importing.robots import robot_keys


def possible_readings(rows: RawTable, mapping: Mapping, options):
    """Robot keys, mapping, and (title, mapping, poses (n, 4, 4)) of every reading of poses or joint readings."""
    if mapping.flange_point is not None and mapping.flange_rotation is not None:
        return {}, replace(mapping, joints=None), flange_readings(rows, mapping)
    named = options.robot or mapping.robot
    keys = robot_keys(named, rows.file)
    robot = load_robot(keys, f"--robot {named}")
    readings = []
    for unit in angle_units(mapping.joints):
        candidate = replace(
            mapping.updated("joints", unit=unit),
            robot=named,
            flange_point=None,
            flange_rotation=None,
        )
        columns = joint_columns(rows, candidate.joints, robot.prismatic, "mm")
        recorded = Recording("board-images", columns, keys)
        frames = forward(robot, robot.mixing @ recorded.joints.T)
        rotation = np.stack(frames.end, -1).transpose(1, 0, 2)
        poses = transform(rotation, frames.end_origin.T)
        words = unit_words(unit, candidate.joints.columns, str)
        readings.append((f"joints in {words}", candidate, poses))
    return keys, mapping, readings


def flange_readings(
    rows: RawTable, mapping: Mapping, turns: Sequence[RotationConvention] | None = None
):
    """(title, mapping, poses (n, 4, 4)) of every reading of the flange poses. Raises InputError where none is one.

    turns: readings of the rotation; None: those of its columns in their order.
    """
    readings = []
    for turn in rotation_candidates(mapping.flange_rotation, rows) if turns is None else turns:
        turned = turn.matrices(rows)
        for unit in length_units(mapping.flange_point):
            candidate = replace(mapping, flange_rotation=turn.group)
            candidate = candidate.updated("flange_point", unit=unit)
            places = np.stack(list(point_columns(rows, candidate.flange_point).values()), axis=1)
            words = unit_words(unit, candidate.flange_point.columns, str)
            readings.append(
                (f"{turn.title}, flange in {words}", candidate, transform(turned, places))
            )
    if not readings:
        raise InputError(
            f"{rows.file}, columns {', '.join(mapping.flange_rotation.columns)}: expected rotations, found numbers "
            "that are none (quaternions of length 1, orthogonal matrices); correct the columns or the mapping."
        )
    return readings


def reading_line(mapping: Mapping) -> str:
    """Line of a mapping file that states this interpretation."""
    if mapping.flange_rotation is None:
        return f"unit = {unit_toml(mapping.joints.unit)} under [joints]"
    group = mapping.flange_rotation
    columns = ", ".join(f'"{name}"' for name in group.columns)
    unit = f", unit = {unit_toml(group.unit)}" if group.unit else ""
    turned = ", inverse = true" if group.inverse else ""
    return (
        f'[flange_rotation] columns = [{columns}], convention = "{group.convention}"{unit}{turned} and unit = '
        f"{unit_toml(mapping.flange_point.unit)} under [flange_point]"
    )


def pose_columns(rows: RawTable, mapping: Mapping, keys) -> dict[str, np.ndarray]:
    """Columns of samples.csv: flange poses, or joint readings of the robot `keys`."""
    if mapping.flange_rotation is None:
        robot = load_robot(keys, "robot")
        return joint_columns(rows, mapping.joints, robot.prismatic, "mm")
    return {
        **point_columns(rows, mapping.flange_point, "flange_"),
        **rotation_columns(rows, mapping.flange_rotation, "flange_"),
    }
