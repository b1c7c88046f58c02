"""Points that a controller calculated from its own kinematics, imported as if an instrument had measured them.

The geometry of a real arm differs from its nominal values by far more than rounding does. A controller that holds
calibrated values shows points that differ from the nominal kinematics, too; then the geometry of the model explains
them to the last printed digit, which no gear and no instrument allows.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Group, Mapping
from datasets.samples.columns import joint_columns
from datasets.trust import accepted_by_option, naming_option
from robot_model.chain import forward
from robot_model.measurements import samples_of
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import (
    FAILURES,
    fit_recording,
    nominal_scale,
    reach_of,
)
from workbench.fitting.plausibility.sampling import even_rows
from workbench.recordings.importing.builder import Builder
from workbench.recordings.importing.interpretation import decisions

_EXTERNAL = ("external-point", "external-pose")
_LEAST_MM, _MOST_MM = 0.003, 0.03
_ROUNDING_FACTOR = 1.5
_MOST_DECIMALS = 6
_ROWS, _MOST_TRIPLES = 240, 20
_ARC_SECOND = np.deg2rad(1 / 3600)
"""Rotation at the reach of the arm that gears and encoders leave at least, rad."""
_REMEDY = "name the columns of the instrument under [point] in a mapping file for --map, if the table has them"


def calculated_points(builder: Builder, mapping: Mapping, recording, options) -> tuple[str, ...]:
    """A sentence where the points are most likely positions that the controller calculated; () otherwise.

    builder, mapping: of the recording. options: `ImportOptions`. Raises InputError, unless the user trusts the data,
    where the points equal the nominal kinematics, and where further columns of the table may be the measured point.
    """
    recording = samples_of(recording)
    if recording.measures not in _EXTERNAL:
        return ()
    try:
        found = _how_calculated(builder.robot, recording)
    except FAILURES:
        return ()
    if found is None:
        return ()
    words, is_nominal = found
    others = list(_other_points(builder, mapping))
    sentence = (
        f"{words} They are most likely positions that the controller calculated, and a calibration with them finds no "
        f"error of the arm; {'; '.join(others) if others else _REMEDY}."
    )
    is_stated = options.mapping.point is not None
    if options.trust_data:
        return (accepted_by_option(sentence),)
    if is_nominal or (others and not is_stated):
        raise InputError(naming_option(sentence))
    return (sentence,)


def guessed_robot(builder: Builder, recording, calculated, options) -> tuple[str, ...]:
    """A sentence on a robot that no option names; calculated: sentences of `calculated_points`.

    Raises InputError where the points are the controller's and not the nominal kinematics of the built-in robot: then
    they are those of another arm, or of one whose calibrated lengths only the controller knows.
    """
    name = builder.robot.name
    misfit = nominal_scale(builder.robot, samples_of(recording))
    sentence = (
        f"No robot was named; '{name}' is a guess: of the built-in ones it fits best, with a misfit of {misfit:.2g} mm "
        "at its nominal lengths. If the arm is another one, name its file with --robot."
    )
    if calculated and not options.trust_data:
        raise InputError(naming_option(f"{builder.table.file}: {sentence} {calculated[0]}"))
    return (sentence,)


def _how_calculated(robot, recording) -> tuple[str, bool] | None:
    """A sentence on points that fit better than measured ones, and whether they equal the nominal kinematics."""
    rounding = _LEAST_MM + _ROUNDING_FACTOR * _rounding_mm(robot, recording)
    found = nominal_scale(robot, recording)
    if found <= min(_MOST_MM, rounding):
        return (
            f"The points equal the nominal kinematics of '{robot.name}' within {found:.2g} mm.",
            True,
        )
    points = replace(recording, measures="external-point")
    fit = fit_recording(robot, points.select(even_rows(points, _ROWS)))
    limit = max(rounding, _ARC_SECOND * reach_of(robot, recording))
    if not fit.scale <= min(_MOST_MM, limit):
        return None
    return (
        f"The points fit '{robot.name}' within {fit.scale:.2g} mm with other lengths and angles than the nominal ones "
        f"({found:.2g} mm with those). No gear and no instrument is as accurate.",
        False,
    )


def _other_points(builder: Builder, mapping: Mapping) -> Iterator[str]:
    """Lines of a mapping file for every unused triple of columns that fits the robot as a measured point."""
    for names in _unused_triples(builder.table, mapping):
        for measures in ("external-point", "ball-centre"):
            changed = replace(
                mapping,
                measures=measures,
                point=Group(names),
                rotation=None,
                reflectors={},
            )
            fits = decisions.compare(
                builder.robot, list(decisions.unit_readings(changed)), builder.positions, 1
            )
            if fits and fits[0][1].is_good and fits[0][1].scale > _MOST_MM:
                columns = ", ".join(f'"{name}"' for name in names)
                yield (
                    f"the columns {', '.join(names)} fit as a measured point of kind {measures} "
                    f'({fits[0][1].rms_mm:.2g} mm): add measures = "{measures}" and [point] columns = [{columns}] to a '
                    "mapping file for --map"
                )
                break


def _unused_triples(table, mapping: Mapping) -> list[tuple[str, ...]]:
    """Three neighbouring columns of numbers each that are unused and hold no commanded value."""
    headers = headers_of(table)
    unused = set(unused_columns(table, mapping))
    usable = [
        name in unused
        and cells.dtype.kind == "f"
        and bool(np.isfinite(cells).all())
        and not (headers[name].is_nominal or headers[name].is_deviation)
        for name, cells in table.columns.items()
    ]
    names = list(table.columns)
    places = [k for k in range(len(names) - 2) if all(usable[k : k + 3])]
    return [tuple(names[k : k + 3]) for k in places[:_MOST_TRIPLES]]


def _rounding_mm(robot, recording) -> float:
    """RMS mm that the last digits of joint readings and points explain; an error uniform in a step h has h^2 / 12."""
    names = joint_columns(recording.columns)
    angles = [recording.columns[name] for name in names if name.endswith("_deg")]
    step = np.deg2rad(max((_last_digit(cells) for cells in angles), default=0.0))
    places = forward(robot, robot.mixing @ recording.joints.T).end_origin
    lever = np.sqrt((places**2).sum(0).mean())
    digit = max(_last_digit(axis) for axis in recording.points.T)
    return float(np.sqrt(len(angles) * (lever * step) ** 2 / 12 + digit**2 / 4))


def _last_digit(cells: np.ndarray) -> float:
    """The largest power of ten, at most 1, of which all cells are multiples; 0 for more than six decimals."""
    for decimals in range(_MOST_DECIMALS + 1):
        if np.abs(cells - np.round(cells, decimals)).max() < 1e-9:
            return 10.0**-decimals
    return 0.0
