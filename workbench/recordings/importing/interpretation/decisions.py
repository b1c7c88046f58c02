"""Units and rotation convention of an import, decided by the fit to the robot, or asked for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.importers.mapping.candidates import (
    ANGLE_WORDS,
    LENGTH_WORDS,
    angle_units,
    point_readings,
)
from datasets.importers.mapping.columns.column_units import (
    each_unit,
    joined_units,
    unit_toml,
    unit_words,
)
from datasets.importers.mapping.model import Mapping
from datasets.importers.units import DMS, LENGTHS, may_be_dms
from datasets.recording import Recording
from datasets.samples.columns import joint_columns
from datasets.trust import naming_option
from robot_model.chain import forward
from robot_model.measurements import samples_of
from robot_model.robot import Robot
from robot_model.state import sliding
from workbench.core.deadline import OutOfTime
from workbench.core.errors import InputError
from workbench.fitting.plausibility import Suspicion, check_plausibility
from workbench.fitting.plausibility.hypotheses.coupling_corrections import CAUSE
from workbench.recordings.importing.interpretation.fits import (
    AS_WIDE_AS_THE_ARM,
    CandidateFit,
    compare_readings,
)
from workbench.recordings.importing.interpretation.mixed_units import (
    MOST_COLUMNS,
    WIDEST_DEG,
    mixed_unit_mappings,
    relative_misfit,
)
from workbench.recordings.importing.interpretation.questions import Ask, Question, choose

_SHOWN, _REFINED = 5, 8
UNITS_OF_SLIDES = ("mm", "m")
"""Units in which the reading of a prismatic joint is tested where nothing states one."""
_ABOUT_AS_BAD = 1.5
_NOMINAL_SHARE = 0.02
"""Misfit of base and tool alone, as a share of the scatter of the points, up to which units fit without geometry."""
_NOMINALLY_BETTER = 5.0
_SEARCHED_UNITS = 2
_ABOUT_ONE_TURN = 7.0  # rad
_NOT_CERTAIN = ("stuck-encoder", "copied-column")

REMEDY = (
    "check the robot, the order and the units of the joint columns, the unit of the measured points, and that the rows "
    "belong together, or state all units in a mapping file and name it with --map"
)

ROTATION_REMEDY = (
    "the columns of the rotation are in another frame or convention than the point; convert them, or add measures = "
    '"external-point" to a mapping file for --map, which imports the positions alone'
)


class NoReadingFits(InputError):
    """No interpretation of the columns fits the robot."""


Build = Callable[[Mapping], Recording]
"""The recording of a mapping whose units and conventions are complete."""


@dataclass(frozen=True)
class Decision:
    """The completed mapping, the fits that it was chosen by, the chosen one first, and an assumption in words."""

    mapping: Mapping
    fits: tuple[CandidateFit, ...]
    assumed: str = ""


@dataclass(frozen=True)
class UnitCase:
    """One import whose units are to be decided.

    build: makes the recording of positions. called: file, for sentences. trust_data: a mistake that explains a misfit
    is left to the last check.
    """

    robot: Robot
    mapping: Mapping
    build: Build
    called: str
    ask: Ask | None = None
    trust_data: bool = False


def decide_units(case: UnitCase, refuse: Callable[[], None] = lambda: None) -> Decision:
    """Units of joint readings and points by the fit of the positions.

    refuse: called where no reading fits, before units are doubted; it raises InputError for a mistake that explains the
    misfit. Raises InputError where the data do not decide and nobody can be asked, or where no unit fits.
    """
    robot, build, ask = case.robot, case.build, case.ask
    readings = list(unit_readings(case.mapping, stated_only=True))
    is_stated = len(readings) == 1
    readings += _readings_with_minutes(readings, build)
    fits = compare(robot, readings, build)
    if not any(fit.is_good for _, fit in fits):
        others = _readings_of_slides(robot, readings)
        other_fits = compare(robot, others, build, is_good_only=True) if others else []
        if any(fit.is_good for _, fit in other_fits):
            where = f"{case.called}, units of the prismatic joints"
            return decided(others, other_fits, where, ask, unit_lines)
        refuse()
        if _explain_better(other_fits, fits):
            readings, fits, is_stated = others, other_fits, False
    if is_stated and not (fits and fits[0][1].is_good):
        return _contradicted_units(case, fits)
    where = f"{case.called}, units of the joint readings and the point"
    if not fits:
        by_nominal = _by_base_and_tool(case, readings)
        if by_nominal is not None:
            return by_nominal
    if not fits or any(fit.is_good for _, fit in fits):
        return decided(readings, fits, where, ask, unit_lines)
    stopped = ""
    try:
        found = _searched(case, readings, fits)
        if found is not None:
            return found
    except OutOfTime as limit:
        stopped = f" {limit}"
    try:
        return decided(readings, fits, where, ask, unit_lines)
    except InputError as problem:
        raise InputError(f"{problem}{stopped}") from None


def _by_base_and_tool(case: UnitCase, readings) -> Decision | None:
    """The units under which base and tool alone fit clearly best, where the rows are too few to fit the geometry.

    None where they do not fit clearly better than all others.
    """
    misfits = [relative_misfit(case.robot, mapping, case.build) for _, mapping in readings]
    order = np.argsort(misfits, kind="stable")
    if not misfits[order[0]] < _NOMINAL_SHARE:
        return None
    if any(misfits[k] < _NOMINALLY_BETTER * misfits[order[0]] for k in order[1:]):
        return None
    title, mapping = readings[order[0]]
    return Decision(
        mapping,
        (),
        "The rows are too few to test units together with geometry errors. With base and tool alone "
        f"{title} fits clearly best (misfit {misfits[order[0]]:.2g} of the scatter of the points). If that is wrong, "
        f"add the units to a mapping file for --map ({unit_lines(mapping)}).",
    )


def _explain_better(others, fits) -> bool:
    """Whether the first of other fits explains the points of an inaccurate arm, clearly better than all `fits`."""
    if not others or not others[0][1].explains:
        return False
    return all(others[0][1].clearly_beats(fit) for _, fit in fits)


def _searched(case: UnitCase, readings, fits) -> Decision | None:
    """The decision for columns in different units where they explain a misfit under all readings.

    Raises InputError where a mistake explains it; trusted data are read in the units under which it does.
    """
    mixed = _mixed_units(case, range(1, MOST_COLUMNS + 1))
    if mixed is not None:
        return mixed
    close = [readings[place][1] for place in close_units(case, readings)]
    found, warnings = _mistakes(case, close)
    if found is not None and case.trust_data:
        return _as_read(fits, readings, found[0])
    if found is not None:
        mapping, sentence = found
        units = f" ({_unit_title(mapping)})" if len(close) > 1 else ""
        raise InputError(naming_option(sentence.removesuffix(".") + units))
    if warnings and not case.trust_data:
        raise InputError(naming_option(warnings[0].sentence))
    if warnings and len(close) == 1:  # a joint that is locked: the last check repeats the doubt
        return _as_read(fits, readings, close[0])
    return None


def _as_read(fits, readings, mapping: Mapping) -> Decision:
    """The decision for one of the readings, its fit first."""
    ordered = sorted(fits, key=lambda item: readings[item[0]][1] != mapping)
    return Decision(mapping, tuple(fit for _, fit in ordered))


def _mixed_units(
    case: UnitCase, counts: Sequence[int], stated_only: bool = True
) -> Decision | None:
    """The answer to a question where a few joint columns in another unit make the data fit; None where none do.

    counts: numbers of such columns, tried in this order. Raises InputError where nobody can be asked.
    """
    readings, close = mixed_fits(case, counts, stated_only)
    if not close:
        return None
    question = Question(
        f"{case.called}: expected one unit of all joint readings that fits the robot, found that none does, but that "
        f"columns in different units fit ({'; '.join(fit.words for _, fit in close)})",
        tuple(fit.words for _, fit in close),
        tuple(unit_lines(readings[place][1]) for place, _ in close),
    )
    chosen = choose(question, case.ask, [place for place, _ in close])
    ordered = sorted(close, key=lambda item: item[0] != chosen)
    fits = tuple(fit for _, fit in ordered)
    return Decision(readings[chosen][1], fits)


def mixed_fits(case: UnitCase, counts: Sequence[int], stated_only: bool):
    """(title, mapping) of readings with columns in different units, and index and fit of the best ones that fit."""
    for count in counts:
        mappings = mixed_unit_mappings(case.robot, case.mapping, case.build, count, stated_only)
        readings = [(_unit_title(interpretation), interpretation) for interpretation in mappings]
        fitted = compare(case.robot, readings, case.build, is_good_only=True)
        fits = [item for item in fitted if item[1].is_good]
        if fits:
            return readings, close_fits(fits)
    return [], []


def _unit_title(mapping: Mapping) -> str:
    """A reading in words, which names the columns with another unit than most."""
    title = f"joints in {unit_words(mapping.joints.unit, mapping.joints.columns, _unit_word)}"
    if mapping.point is None:
        return title
    point = unit_words(mapping.point.unit, mapping.point.columns, _unit_word)
    return f"{title}, point in {point}"


def close_units(case: UnitCase, readings) -> list[int]:
    """Indices of the units to search for a mistake under: those that fit about as badly as the best ones.

    A wrong unit makes misfit and points small, so that the misfit is compared in relation to the extent of the points.
    Radians come first where all readings are within about one turn, degrees otherwise; gon, which is rare, only where
    it is stated, and no unit that makes more than two turns of a joint where another does not.
    """
    misfits = np.array(
        [
            relative_misfit(case.robot, interpretation, case.build, WIDEST_DEG)
            for _, interpretation in readings
        ]
    )
    if not np.isfinite(misfits).any():
        misfits = np.array(
            [
                relative_misfit(case.robot, interpretation, case.build)
                for _, interpretation in readings
            ]
        )
    limit = _ABOUT_AS_BAD * misfits.min()
    close = [place for place in range(len(readings)) if misfits[place] <= limit < np.inf]
    # the search tries all units of the point itself
    close.sort(key=lambda place: _scale_of_extent(case, readings[place][1]))
    close = list({readings[place][1].joints.unit: place for place in reversed(close)}.values())
    units = [readings[place][1].joints.unit for place in range(len(readings))]
    if len(set(units)) > 1:
        close = [place for place in close if units[place] != "gon"] or close
        close.sort(key=lambda place: _order_of_unit(case, readings[place][1]))
    return close[:_SEARCHED_UNITS]


def _scale_of_extent(case: UnitCase, mapping: Mapping) -> float:
    """Logarithm of the ratio between the extents of the measured points and of the flange's places, without sign.

    0 where the points are in the frame of a sensor on the flange: their extent is then that of its field.
    """
    if mapping.point is None or mapping.measures not in AS_WIDE_AS_THE_ARM:
        return 0.0
    recording = case.build(mapping)
    variables = case.robot.mixing @ recording.joints.T
    places = forward(case.robot, variables).end_origin
    extents = [np.linalg.norm(np.std(p, axis=1)) for p in (recording.points.T, places)]
    return float(abs(np.log(np.maximum(extents[0], 1e-9) / np.maximum(extents[1], 1e-9))))


def _order_of_unit(case: UnitCase, mapping: Mapping) -> int:
    """Rank of the unit of the joint readings by frequency of use, the most frequent 0."""
    if mapping.joints.unit != "rad":
        return 1
    widest = np.abs(case.build(mapping).joints).max()
    return 0 if widest < _ABOUT_ONE_TURN else 2


def _mistakes(case: UnitCase, mappings: Sequence[Mapping]):
    """(mapping, sentence) of a mistake, such as a reversed joint, that explains a bad fit; None where none does.

    mappings: with each of the units that are possible; of several explanations the one with the fewest mistakes is
    named. Also what looks wrong without being certain, such as the column of a joint that stands still.
    """
    found, warnings = [], []
    for mapping in mappings:
        suspicions = check_plausibility(case.robot, case.build(mapping))
        certain = certain_mistakes(suspicions, mapping)
        found += [(s.cause.count(" and "), s, mapping) for s in certain]
        warnings += [s for s in suspicions if s.cause in _NOT_CERTAIN or s.is_explanation]
        if any(count == 0 for count, _, _ in found):
            break
    if not found:
        return None, warnings
    _, suspicion, mapping = min(found, key=lambda item: item[0])
    return (mapping, suspicion.sentence), warnings


def certain_mistakes(suspicions: Sequence[Suspicion], mapping: Mapping) -> list[Suspicion]:
    """The certain suspicions of positions alone.

    A coupling of joints is none where rotations are measured, too: positions near the axis of a joint fit with nearly
    any coupling of it, which the rotations contradict. The last check compares both.
    """
    has_rotations = mapping.rotation is not None
    return [s for s in suspicions if s.certain and not (has_rotations and CAUSE in s.cause)]


def unit_readings(mapping: Mapping, stated_only: bool = True):
    """(title, mapping) for every combination of units and of conventions of spherical coordinates."""
    points = [(None, None)]
    if mapping.point is not None:
        points = list(point_readings(mapping.point, stated_only))
    for angle in angle_units(mapping.joints, stated_only):
        for words, point in points:
            interpretation = replace(mapping.updated("joints", unit=angle), point=point)
            title = f"joints in {unit_words(angle, mapping.joints.columns, _unit_word)}"
            yield title if words is None else f"{title}, point in {words}", interpretation


def _readings_of_slides(robot: Robot, readings) -> list[tuple[str, Mapping]]:
    """The readings with the unstated unit of prismatic joints in another unit than that of the measured point."""
    slides = sliding(robot)
    interpretations = []
    for _, mapping in readings:
        units = each_unit(mapping.joints.unit, len(slides))
        point_unit = mapping.point.unit if mapping.point is not None else "mm"
        for length in UNITS_OF_SLIDES:
            changed = [
                length if slide and unit not in LENGTHS else unit
                for slide, unit in zip(slides, units)
            ]
            if (
                length != point_unit
                and changed != list(units)
                and mapping.joints.counts_per_deg is None
            ):
                other = mapping.updated("joints", unit=joined_units(changed))
                interpretations.append((_unit_title(other), other))
    return interpretations


def _readings_with_minutes(readings, build: Build) -> list[tuple[str, Mapping]]:
    """The readings in degrees with the decimals as minutes and seconds, where the digits of all joints allow it."""
    interpretations = []
    for _, mapping in readings:
        if mapping.joints.unit != "deg":
            continue
        try:
            columns = build(mapping).columns
        except InputError:
            continue
        cells = [columns[name] for name in joint_columns(columns) if name.endswith("_deg")]
        if cells and may_be_dms(np.concatenate(cells)):
            changed = mapping.updated("joints", unit=DMS)
            interpretations.append((_unit_title(changed), changed))
    return interpretations


def unit_lines(mapping: Mapping) -> str:
    """The lines of a mapping file that state the units of a reading."""
    joints = f"unit = {unit_toml(mapping.joints.unit)} under [joints]"
    if mapping.point is None:
        return joints
    convention = mapping.point.convention
    convention_words = f' and convention = "{convention}"' if convention else ""
    return f"{joints} and unit = {unit_toml(mapping.point.unit)}{convention_words} under [point]"


def _unit_word(unit: str) -> str:
    return ANGLE_WORDS.get(unit) or LENGTH_WORDS[unit]


def compare(
    robot, readings, build: Build, refined: int = _REFINED, is_good_only: bool = False
) -> list[tuple[int, CandidateFit]]:
    """Fits of the readings whose numbers can be what they say; is_good_only: as of `compare_readings`."""
    recordings, places = [], []
    for place, (title, mapping) in enumerate(readings):
        try:
            recordings.append((title, samples_of(build(mapping))))
            places.append(place)
        except InputError:
            continue  # such as a quaternion that has no length 1
    return [
        (places[k], fit) for k, fit in compare_readings(robot, recordings, refined, is_good_only)
    ]


def _contradicted_units(case: UnitCase, fits) -> Decision:
    """Units that the headers state and that do not fit: another unit may, and is named; else the misfit is kept.

    No fit of the stated units: the rows are too few to fit the geometry, and say nothing against them.
    """
    _, as_stated = next(iter(unit_readings(case.mapping, stated_only=True)))
    if not fits and np.isfinite(relative_misfit(case.robot, as_stated, case.build)):
        return Decision(as_stated, ())
    others = list(unit_readings(case.mapping, stated_only=False))
    better = compare(case.robot, others, case.build, is_good_only=True)
    stated = next(iter(unit_readings(case.mapping, stated_only=True)))
    if better and better[0][1].is_good and others[better[0][0]][0] != stated[0]:
        if fits:
            found = f"{fits[0][1].words}, but {better[0][1].words}"
        else:
            found = better[0][1].words
        raise InputError(
            f"{case.called}: expected the units that the headers or the mapping state to fit the robot, found {found}; "
            f"add {unit_lines(others[better[0][0]][1])} to a mapping file and name it with --map, or correct the "
            "headers."
        )
    mixed = _mixed_units(case, (1,), stated_only=False)
    return mixed or Decision(stated[1], tuple(fit for _, fit in fits))


def decided(readings, fits, where: str, ask: Ask | None, line, remedy: str = REMEDY) -> Decision:
    """The best reading where the data decide, else the answer to a question; remedy: as of `choose_reading`."""
    lines = [line(mapping) for _, mapping in readings]
    chosen = choose_reading(lines, fits, where, ask, remedy)
    ordered = sorted(fits, key=lambda item: item[0] != chosen)
    return Decision(readings[chosen][1], tuple(fit for _, fit in ordered))


def close_fits(fits: Sequence[tuple[int, CandidateFit]]) -> list[tuple[int, CandidateFit]]:
    """The first of the fits, and those that it does not clearly beat."""
    best = fits[0][1]
    return [fits[0], *(item for item in fits[1:] if not best.clearly_beats(item[1]))]


def choose_reading(
    lines: Sequence[str],
    fits: Sequence[tuple[int, CandidateFit]],
    where: str,
    ask: Ask | None,
    remedy: str = REMEDY,
) -> int:
    """Index of the reading that fits clearly best; where several fit about equally well, the answer to a question.

    lines: of the mapping file, for every reading. fits: index and fit, the most probable first. remedy: what to do
    where no reading fits. Raises InputError where no reading can be fitted or nobody can be asked.
    """
    if not fits:
        raise InputError(
            f"{where}: expected enough rows to test them on the robot, found none that can be fitted; "
            f"add {lines[0]} to a mapping file and name it with --map."
        )
    alternatives = close_fits(fits)[1:]
    if len(lines) == 1 or not alternatives:
        return fits[0][0]
    # the usual interpretations first: where the data decide nothing, the order of the fits is chance
    close = sorted([fits[0], *alternatives], key=lambda item: item[0])[:_SHOWN]
    words = "; ".join(fit.words for _, fit in close)
    ellipsis = "; ..." if len(alternatives) + 1 > len(close) else ""
    if not any(fit.is_good for _, fit in fits):
        raise NoReadingFits(
            f"{where}: expected an interpretation that fits, found that no interpretation fits ({words}{ellipsis}); "
            f"{remedy}."
        )
    question = Question(
        f"{where}: expected one interpretation that fits clearly best, found {len(alternatives) + 1} that fit about "
        f"equally well ({words}{ellipsis})",
        tuple(fit.words for _, fit in close),
        tuple(lines[place] for place, _ in close),
    )
    return choose(question, ask, [place for place, _ in close])
