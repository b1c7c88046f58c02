"""Joint readings and measured points whose headers are unknown: found by how well they fit the robot.

Candidates are neighbouring columns of numbers that nothing else is read from. A set is used only where it fits and no
other set does; a wrong set of columns leaves a misfit of many millimetres.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product

import numpy as np

from datasets.importers.mapping.columns.column_units import each_unit, joined_units
from datasets.importers.mapping.columns.headers import Header
from datasets.importers.mapping.columns.reflectors import POSE, REFLECTOR
from datasets.importers.mapping.columns.sets import headers_of
from datasets.importers.mapping.conversion import complete_rows
from datasets.importers.mapping.left_out import unused_columns
from datasets.importers.mapping.model import Group, Mapping
from datasets.importers.mapping.proposal import measures_of
from datasets.importers.source import RawTable
from datasets.importers.units import ANGLES, LENGTHS
from robot_model.robot import Robot
from robot_model.state import sliding
from workbench.core.errors import InputError
from workbench.recordings.importing.interpretation import decisions
from workbench.recordings.importing.interpretation.fits import CandidateFit
from workbench.recordings.importing.interpretation.label_columns import label_columns, labelled
from workbench.recordings.importing.interpretation.questions import Question, choose
from workbench.recordings.importing.sources.point_files import keep_their_distance

_MOST_TESTED = 300
_SCREENED_FITS = 4
_MOST_OF_POINT = 3
_ABOUT_ONE_TURN = 400.0  # deg, which radians never reach


@dataclass(frozen=True)
class _Found:
    """A completed mapping, its fit to a robot, and the mapping in words."""

    mapping: Mapping
    fit: CandidateFit
    robot: Robot

    @property
    def words(self) -> str:
        point, joints = self.mapping.point, self.mapping.joints
        return (
            f"joints {', '.join(joints.columns)}, point {', '.join(point.columns)} "
            f"({self.fit.words})"
        )


def find_unnamed(
    table: RawTable,
    mapping: Mapping,
    robots: Sequence[Robot],
    positions: Callable[[Robot, RawTable, Mapping], object],
    ask,
) -> tuple[Mapping, tuple[str, ...]]:
    """The mapping with joint readings and point where headers name none, and a sentence; unchanged where none fit.

    robots: those that may be meant. positions: makes the recording of the positions under a mapping. ask: as of
    `ImportOptions`. Raises InputError where several sets fit and nobody can be asked.
    """
    has_surplus = _has_surplus(mapping, robots)
    is_open = mapping.joints is None or mapping.point is None or has_surplus
    is_open = is_open or _lacks_slides(mapping, robots)
    is_other = mapping.measures not in (None, "external-point", "external-pose")
    if not is_open or is_other or mapping.flange_point is not None:
        return mapping, ()
    found = [
        candidate for robot in robots for candidate in _fitting(table, mapping, robot, positions)
    ]
    best = _best_of_each(found)
    if not best:
        return mapping, ()
    if mapping.joints is None:
        best += _exchanged(table, best[0], positions)
    chosen = best[0]
    if mapping.point is None:
        reflectors = _as_reflectors(table, best[0], found)
    else:
        reflectors = None
    if reflectors is not None:
        chosen, best = reflectors, best[:1]
    if len(best) > 1:
        lines = [
            f"[joints] columns = {list(candidate.mapping.joints.columns)}, "
            f"[point] columns = {list(candidate.mapping.point.columns)}"
            for candidate in best
        ]
        question = Question(
            f"{table.file}: expected headers that name joint readings and the measured point, found several sets of "
            f"columns that fit the robot ({'; '.join(candidate.words for candidate in best)})",
            tuple(candidate.words for candidate in best),
            tuple(lines),
        )
        chosen = choose(question, ask, best)
    return chosen.mapping, (_sentence(table, mapping, chosen, has_surplus),)


def _sentence(table: RawTable, mapping: Mapping, chosen: _Found, has_surplus: bool) -> str:
    """What the headers leave open, and which columns are read; mapping: from the headers."""
    read = chosen.mapping
    all_joints = "joint readings" if mapping.joints is None else "the readings of all joints"
    if has_surplus:
        all_joints = f"the readings of the {len(read.joints.columns)} joints"
    if mapping.joints != read.joints:
        columns_of_role = [(all_joints, read.joints.columns)]
    else:
        columns_of_role = []
    if read.reflectors:
        columns = [name for names in read.reflectors.values() for name in names]
        columns_of_role += [
            (f"the points of {len(read.reflectors)} reflectors on one tool", tuple(columns))
        ]
    elif mapping.point is None:
        columns_of_role += [("the measured point", read.point.columns)]
    labels = tuple(name for name in read.columns if name not in mapping.columns)
    columns_of_role += (
        [("the reflector of each row", labels)] if labels and not read.reflectors else []
    )
    named = " and ".join(f"{', '.join(columns)} as {role}" for role, columns in columns_of_role)
    *first, last = (role for role, _ in columns_of_role)
    missing = f"{', '.join(first)} or {last}" if first else last
    return (
        f"No header names {missing}. Of the columns with numbers only one set fits the "
        f"robot, and the import reads {named} ({chosen.fit.words})."
        f"{_handedness(table, read.point)} If that is wrong, state the "
        "columns in a mapping file and name it with --map."
    )


def _handedness(table: RawTable, point: Group) -> str:
    """A sentence where the coordinates are not in the order of the file."""
    place = [list(table.columns).index(name) for name in point.columns]
    if place == sorted(place):
        return ""
    return (
        " In the order of the file the axes of the point form a left-handed frame: the first two are exchanged, which "
        "is right for northing before easting; where one axis is inverted instead, invert it in the file."
    )


def _as_reflectors(table: RawTable, best: _Found, found: Sequence[_Found]) -> _Found | None:
    """The first of several sets with the points of all as reflectors on one tool; None where they are none.

    found: all that fit, also where the best one fits clearly better than reflectors far from the flange.

    Reflectors keep their distances from one another, and the vectors between them rotate with the tool.
    """
    ordered = _side_by_side(
        table, [found_set for found_set in found if found_set.mapping.joints == best.mapping.joints]
    )
    if len(ordered) < 2 or best.mapping.columns != ordered[0].mapping.columns:
        return None
    first = ordered[0].mapping
    points = [candidate.mapping.point.columns for candidate in ordered]
    rows, _ = complete_rows(table, first)
    seen = [np.stack([rows.columns[name] for name in names], axis=1) for names in points]
    if not all(
        keep_their_distance(found_set - other) for found_set, other in combinations(seen, 2)
    ):
        return None
    names = {str(place): columns for place, columns in enumerate(points, 1)}
    columns = {**first.columns, REFLECTOR: REFLECTOR, POSE: POSE}
    return replace(ordered[0], mapping=replace(first, reflectors=names, columns=columns))


def _side_by_side(table: RawTable, found: Sequence[_Found]) -> list[_Found]:
    """The largest number of sets that share no column, in the order of the file; [] where several choices are as large.

    Where a tool hardly rotates, y and z of one reflector fit with x of the next one, too.
    """
    places = list(table.columns)
    starts = {}
    for candidate in found:
        place = places.index(candidate.mapping.point.columns[0])
        if candidate.mapping.point.columns == tuple(places[place : place + 3]):
            starts.setdefault(place, candidate)
    chains = []
    for first in starts:
        chain = [first]
        chain += [place for place in range(first + 3, len(places), 3) if place in starts]
        chains.append(chain)
    largest = max(map(len, chains), default=0)
    longest = [chain for chain in chains if len(chain) == largest]
    if len(longest) == 1:
        return [starts[place] for place in longest[0]]
    return []


def _exchanged(table: RawTable, best: _Found, positions) -> list[_Found]:
    """The set with two joint columns exchanged, for each pair where it fits about as well: joints that hardly move."""
    columns = best.mapping.joints.columns
    found = []
    moving = [k for k, name in enumerate(columns) if _changes(table.columns[name])]
    for i, j in combinations(moving, 2):
        order = list(columns)
        order[i], order[j] = order[j], order[i]
        joints = replace(best.mapping.joints, columns=tuple(order))
        exchanged = _fitted(table, replace(best.mapping, joints=joints), best.robot, positions)
        if exchanged is not None and not best.fit.clearly_beats(exchanged.fit):
            found.append(exchanged)
    return found


def _best_of_each(found: Sequence[_Found]) -> list[_Found]:
    """The best fit of each set of columns, the most probable first; without those that fit clearly worse."""
    ordered = sorted(found, key=lambda candidate: candidate.fit.improbability)
    best: dict[tuple, _Found] = {}
    for candidate in ordered:
        columns = (candidate.mapping.joints.columns, candidate.mapping.point.columns)
        best.setdefault(columns, candidate)
    candidates_of_columns = list(best.values())
    return [
        candidate
        for candidate in candidates_of_columns
        if candidate is candidates_of_columns[0]
        or not candidates_of_columns[0].fit.clearly_beats(candidate.fit)
    ]


def _fitting(table, mapping: Mapping, robot: Robot, positions) -> Iterator[_Found]:
    """Mappings that fit a robot, with their units undecided."""
    tried = 0
    groups = sorted(_joint_groups(table, mapping, robot), key=lambda g: not _may_turn(table, g))
    for joints, point in product(groups, _points(table, mapping)):
        if set(joints.columns) & set(point.columns) or tried >= _MOST_TESTED:
            continue
        tried += 1
        columns = replace(mapping, joints=joints, point=point)
        found = _fitted(table, columns, robot, positions)
        for name in () if found is not None else label_columns(table, columns):
            found = found or _fitted(table, labelled(columns, name), robot, positions)
        if found is not None:
            yield found


def _fitted(table, mapping: Mapping, robot: Robot, positions) -> _Found | None:
    """A mapping with its best fit to a robot, its units undecided; None where it does not fit."""
    complete_mapping = replace(mapping, measures=measures_of(mapping))
    rows = complete_rows(table, complete_mapping)[0]
    readings = list(decisions.unit_readings(complete_mapping))
    build = partial(positions, robot, rows)
    fits = decisions.compare(robot, readings, build, _SCREENED_FITS, is_good_only=True)
    if fits and fits[0][1].is_good:
        return _Found(complete_mapping, fits[0][1], robot)
    return None


def _lacks_slides(mapping: Mapping, robots: Sequence[Robot]) -> bool:
    """Whether headers name the readings of all rotating joints of a robot, and not those of its slides."""
    known = len(mapping.joints.columns)
    return any(0 < known == int((~sliding(robot)).sum()) < len(sliding(robot)) for robot in robots)


def _has_surplus(mapping: Mapping, robots: Sequence[Robot]) -> bool:
    """Whether headers name more joint readings than any robot has joints, as a file name does for all its columns."""
    if mapping.joints is None or mapping.joints.counts_per_deg is not None:
        return False
    return all(len(mapping.joints.columns) > len(sliding(robot)) for robot in robots)


def _joint_groups(table: RawTable, mapping: Mapping, robot: Robot) -> list[Group]:
    """Columns that may be the readings of all joints; headers may name them all, or those of the rotating ones."""
    slides = sliding(robot)
    if mapping.joints is None:
        units = [LENGTHS if slide else ANGLES for slide in slides]
        orders = _neighbours(table, mapping, units)
    elif len(mapping.joints.columns) >= len(slides):
        names, count = mapping.joints.columns, len(slides)
        orders = [names[k : k + count] for k in range(len(names) - count + 1)]
    elif len(mapping.joints.columns) + sum(slides) == len(slides):
        orders = _orders_with_slides(table, mapping, slides)
    else:
        orders = []
    stated = mapping.joints or Group((), None, None)
    return [group for names in orders for group in _groups_of(table, names, stated, slides)]


def _orders_with_slides(table: RawTable, mapping: Mapping, slides) -> list[tuple[str, ...]]:
    """Columns of the rotating joints, which headers name, with columns of lengths in the places of the slides."""
    lengths = [name for (name,) in _neighbours(table, mapping, [LENGTHS])]
    found = []
    for chosen in combinations(lengths, sum(slides)):
        known = iter(mapping.joints.columns)
        others = iter(chosen)
        found.append(tuple(next(others if slide else known) for slide in slides))
    return found


def _groups_of(table: RawTable, names, stated: Group, slides) -> list[Group]:
    """Joint columns with the units that mapping or headers state; slides without one in each of the usual units."""
    headers = headers_of(table)
    known = dict(zip(stated.columns, each_unit(stated.unit, len(stated.columns))))
    units = [known.get(name) or headers[name].unit for name in names]
    groups = {}
    for length in decisions.UNITS_OF_SLIDES:
        words = [
            length if slide and unit not in (*LENGTHS, *ANGLES) else unit
            for slide, unit in zip(slides, units)
        ]
        groups[tuple(words)] = replace(stated, columns=tuple(names), unit=joined_units(words))
    return list(groups.values())


def _points(table: RawTable, mapping: Mapping) -> list[Group]:
    """Three neighbouring columns in their order, and with the first two exchanged (northing before easting)."""
    if mapping.point is not None:
        return [mapping.point]
    found = []
    for first, second, third in _neighbours(table, mapping, 3 * [LENGTHS]):
        found.append(_group(table, (first, second, third)))
        found.append(_group(table, (second, first, third)))
    return found


def _group(table: RawTable, names: Sequence[str]) -> Group:
    headers = headers_of(table)
    units = [headers[name].unit for name in names]
    return Group(tuple(names), joined_units(units), None)


def _may_turn(table: RawTable, group: Group) -> bool:
    """Whether columns stay within about one turn in either direction: such sets are tested first."""
    cells = np.stack([table.columns[name] for name in group.columns])
    return bool(np.nanmax(np.abs(cells)) < _ABOUT_ONE_TURN)


def _changes(cells: np.ndarray) -> bool:
    return bool(np.nanmax(cells) > np.nanmin(cells))


def _neighbours(table: RawTable, mapping: Mapping, units) -> list[tuple[str, ...]]:
    """Neighbouring columns of numbers that hold no commanded value and no number of the row.

    units: those that the header of each of them may state. Of the joints of an arm, half may stand still; else all
    columns change.
    """
    headers = headers_of(table)
    unused = unused_columns(table, mapping)
    count = len(units)
    usable = []
    for name in table.columns:
        cells = table.columns[name]
        header = headers[name]
        is_number = name in unused and cells.dtype.kind == "f" and np.isfinite(cells).sum() > count
        fits = is_number and (_changes(cells) or count > _MOST_OF_POINT)
        is_named = header.is_nominal or header.is_deviation or header.kind == "time"
        usable.append(name if fits and not is_named and not _is_row_number(cells, header) else None)
    windows = [tuple(usable[k : k + count]) for k in range(len(usable) - count + 1)]
    return [
        names
        for names in windows
        if None not in names
        and 2 * sum(_changes(table.columns[name]) for name in names) >= count
        and all(
            headers[name].unit in (None, *unit_of_group)
            for name, unit_of_group in zip(names, units)
        )
    ]


def _is_row_number(cells: np.ndarray, header: Header) -> bool:
    """Whether a header such as "No." or "N" stands above whole numbers; a northing has decimals."""
    known = cells[np.isfinite(cells)]
    return header.kind == "sample" and header.unit is None and bool(np.all(known == known.round()))


def refuse_wrong_slides(table: RawTable, mapping: Mapping, robot: Robot, is_sliding) -> None:
    """Raise InputError where the header of a prismatic joint states an angle, and no mapping file a length.

    is_sliding (R,): of the readings. A JointState of ROS has no units: its prismatic joints have the header [rad], too.
    """
    headers, columns = headers_of(table), mapping.joints.columns
    stated = each_unit(mapping.joints.unit, len(columns))
    for name, slides, word in zip(columns, is_sliding, stated):
        unit = headers[name].unit if name in headers else None
        if slides and unit in ANGLES and word not in LENGTHS:
            raise InputError(
                f"{table.file}, column {name}: expected a length of a prismatic joint of '{robot.name}', found the "
                f"unit {unit}; correct the header or the order of the joint columns, or state the units under [joints] "
                "in a mapping file for --map."
            )
