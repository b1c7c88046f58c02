"""Search for joint columns in another unit than the others, where no unit of all of them fits the robot."""

from collections.abc import Callable, Iterator
from itertools import combinations, permutations

import numpy as np

from datasets.importers.mapping.candidates import ANGLE_UNITS, length_units
from datasets.importers.mapping.columns.column_units import each_unit, joined_units
from datasets.importers.mapping.model import Mapping
from datasets.importers.units import ANGLES, LENGTHS
from datasets.recording import Recording
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility.fitting import nominal_scale, scatter_of_points
from workbench.fitting.plausibility.sampling import even_rows

Build = Callable[[Mapping], Recording]

_PAIRS = (("deg", "rad"), ("rad", "deg"))
"""Units of most columns and of several others; gon, which is rare, is tried for single columns only."""
MOST_COLUMNS = 3
WIDEST_DEG = 800.0
"""No joint turns further."""
_SCREENED_ROWS = 40
_KEPT = 6


def mixed_unit_mappings(
    robot: Robot, mapping: Mapping, build: Build, count: int, stated_only: bool = True
) -> list[Mapping]:
    """The mappings with `count` joint columns in another unit that leave the least misfit, the best first.

    build: makes the recording of positions. stated_only: keep to the units that headers or mapping state. The misfit
    is compared in relation to the scatter of the measured points: a wrong unit makes both small.
    """
    screened = []
    for interpretation in _mixed(mapping, count, stated_only):
        misfit = relative_misfit(robot, interpretation, build, WIDEST_DEG)
        if np.isfinite(misfit):
            screened.append((misfit, interpretation))
    screened.sort(key=lambda item: item[0])
    return [interpretation for _, interpretation in screened[:_KEPT]]


def _mixed(mapping: Mapping, count: int, stated_only: bool) -> Iterator[Mapping]:
    """Every mapping with a few columns in another unit and every unit of the point."""
    points = [None] if mapping.point is None else length_units(mapping.point, stated_only)
    for units in dict.fromkeys(_unit_choices(mapping, count, stated_only)):
        interpretation = mapping.updated("joints", unit=joined_units(units))
        for point in points:
            yield interpretation if point is None else interpretation.updated("point", unit=point)


def _unit_choices(mapping: Mapping, count: int, stated_only: bool) -> Iterator[tuple[str, ...]]:
    """Units of all columns, `count` of them in another one; what is stated stays where stated_only."""
    stated = each_unit(mapping.joints.unit, len(mapping.joints.columns))
    fixed = LENGTHS | ANGLES if stated_only else LENGTHS
    free = [k for k, unit in enumerate(stated) if unit not in fixed]
    pairs = _PAIRS if count > 1 else permutations(ANGLE_UNITS, 2)
    for major_unit, minor_unit in pairs:
        for chosen in combinations(free, count) if count < len(free) else ():
            units = [minor_unit if k in chosen else major_unit for k in range(len(stated))]
            yield tuple(unit if k in free else stated[k] for k, unit in enumerate(units))


def relative_misfit(
    robot: Robot, mapping: Mapping, build: Build, widest_deg: float = np.inf
) -> float:
    """Misfit at the nominal geometry as a fraction of the scatter of the measured points; inf where it cannot be.

    widest_deg: a larger angle cannot be either.
    """
    try:
        recording = build(mapping)
    except InputError:
        return np.inf
    if np.abs(np.rad2deg(recording.joints)).max() > widest_deg and not robot.prismatic.any():
        return np.inf
    rows = recording.select(even_rows(recording, _SCREENED_ROWS))
    try:
        misfit = nominal_scale(robot, rows)
    except (np.linalg.LinAlgError, InputError):
        return np.inf
    scatter = scatter_of_points(rows)
    return misfit if np.isnan(scatter) else misfit / scatter
