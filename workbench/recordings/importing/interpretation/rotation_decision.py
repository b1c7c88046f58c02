"""The convention of a measured rotation, decided by the fit of positions and orientations together, or asked for."""

from collections.abc import Sequence
from dataclasses import replace

from datasets.importers.mapping.candidates import (
    RotationConvention,
    reordered_candidates,
    rotation_candidates,
)
from datasets.importers.mapping.columns.column_units import unit_toml
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.recordings.importing.interpretation.decisions import (
    REMEDY,
    ROTATION_REMEDY,
    Build,
    Decision,
    compare,
    decided,
)
from workbench.recordings.importing.interpretation.fits import is_only_good, order_error
from workbench.recordings.importing.interpretation.orientation_misfits import (
    flange_rotations,
    screened_rotations,
)
from workbench.recordings.importing.interpretation.questions import Ask


def decide_rotation(
    robot: Robot,
    mapping: Mapping,
    table: RawTable,
    build: Build,
    ask: Ask | None,
    positions_fit: bool = False,
) -> Decision:
    """Convention and unit of the measured rotation by the fit of positions and orientations together.

    build: makes the recording of a complete mapping. positions_fit: whether the positions alone fit the robot. Raises
    InputError as `decide_units`.
    """
    where = f"{table.file}, columns {', '.join(mapping.rotation.columns)}"
    turns = rotation_candidates(mapping.rotation, table)
    if not turns:
        raise InputError(
            f"{where}: expected rotations, found numbers that are none (quaternions of length 1, orthogonal "
            "matrices); correct the columns or the mapping."
        )
    fits, readings = _rotation_fits(robot, mapping, table, turns, build)
    if len(turns) == 1 and not (fits and fits[0][1].is_good):
        wider = rotation_candidates(mapping.rotation, table, stated_only=False)
        better, others = _rotation_fits(robot, mapping, table, wider, build, True)
        is_other = better and others[better[0][0]][0] != turns[0].title
        if is_other and better[0][1].is_good:
            stated = fits[0][1].words if fits else turns[0].title
            line = _rotation_lines(others[better[0][0]][1])
            raise InputError(
                f"{where}: expected the rotation convention that headers, format or mapping state to fit the robot, "
                f"found {stated}, but {better[0][1].words}; add {line} to a mapping file and name it with --map."
            )
    if not any(fit.is_good for _, fit in fits):
        _refuse_other_order(robot, mapping, table, build)
    words = f"the positions fit without the rotations: {ROTATION_REMEDY}"
    remedy = words if positions_fit else REMEDY
    return decided(readings, fits, where, ask, _rotation_lines, remedy)


def _refuse_other_order(robot: Robot, mapping: Mapping, table: RawTable, build: Build) -> None:
    """Raise InputError where the columns fit the robot in one other order than that of their names."""
    turns = reordered_candidates(mapping.rotation, table)
    if not turns:  # columns of a matrix are not tried in other orders
        return
    fits, readings = _rotation_fits(robot, mapping, table, turns, build, True)
    if is_only_good(fits):
        interpretation = readings[fits[0][0]][1]
        raise order_error(
            table.file, interpretation.rotation, fits[0][1], _rotation_lines(interpretation)
        )


def _rotation_lines(mapping: Mapping) -> str:
    group = mapping.rotation
    columns = ", ".join(f'"{name}"' for name in group.columns)
    unit = f", unit = {unit_toml(group.unit)}" if group.unit else ""
    inverse = ", inverse = true" if group.inverse else ""
    return f'[rotation] columns = [{columns}], convention = "{group.convention}"{unit}{inverse}'


def _rotation_fits(
    robot, mapping, table, turns: Sequence[RotationConvention], build: Build, is_good_only=False
):
    readings = [(turn.title, replace(mapping, rotation=turn.group)) for turn in turns]
    screened = screened_rotations(
        flange_rotations(robot, build(readings[0][1])), [t.matrices(table) for t in turns]
    )
    chosen = [readings[k] for k in screened]
    fits = compare(robot, chosen, build, is_good_only=is_good_only)
    return fits, chosen
