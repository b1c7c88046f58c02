"""The robot of an import where several are possible: built-in ones, or a table under several conventions."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.importers.mapping.model import Mapping
from datasets.trust import naming_option
from robot_model.robot import Robot
from workbench.core.errors import InputError
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.fitting import FAILURES, nominal_scale
from workbench.fitting.plausibility.suspicion import Suspicion
from workbench.recordings.importing.interpretation.decisions import (
    REMEDY,
    Build,
    UnitCase,
    certain_mistakes,
    choose_reading,
    close_units,
    compare,
    mixed_fits,
    unit_lines,
    unit_readings,
)
from workbench.recordings.importing.interpretation.fits import CandidateFit
from workbench.recordings.importing.interpretation.questions import Ask

_CLEARLY = 5.0
"""Ratio of misfits with base and tool alone from which on a convention is clearly better."""
STATE_CONVENTION = 'write "modified" (Craig) or "standard" into the name of its file'


@dataclass(frozen=True)
class ConventionCase:
    """One import whose table of the robot has an open convention; the other fields as of `UnitCase`.

    build_with: robot and builder of a title. refuse_changes: raises InputError for a title where units, signs or order
    of columns change at a row, or rows are shifted, and the rows then fit.
    """

    mapping: Mapping
    build_with: Callable[[str], tuple[Robot, Build]]
    titles: Sequence[str]
    called: str
    refuse_changes: Callable[[str], None]
    ask: Ask | None = None
    trust_data: bool = False


def decide_robot(
    mapping: Mapping, build_with: Callable[[str], tuple[Robot, Build]], names, where, ask
):
    """Name of the built-in robot that fits clearly best under any units.

    build_with: robot and builder of a name. names: of robots with the right number of joints. Raises InputError where
    none fits, or several do and nobody can be asked.
    """
    fits = _fits_of_robots(mapping, build_with, names)
    good = [item for item in fits if item[1].is_good]
    if not good:
        _refuse_mixed_units(mapping, build_with, names, where)
        raise InputError(
            f"{where}: expected one of the robots ({'; '.join(names)}) to fit, found none; check units, order and "
            "signs of the joint columns, or add --robot with a robot.toml, a URDF, an MJCF file or a "
            "Denavit-Hartenberg table."
        )
    lines = [f'robot = "{name}"' for name in names]
    return names[choose_reading(lines, good, f"{where}, robot", ask)]


def _refuse_mixed_units(mapping: Mapping, build_with, names, where: str) -> None:
    """Raise InputError where a robot of the library fits with one joint column in another unit than the others."""
    found = []
    for name in names:
        robot, build = build_with(name)
        readings, close = mixed_fits(UnitCase(robot, mapping, build, where), (1,), stated_only=True)
        found += [(fit, name, readings[place][1]) for place, fit in close]
    if found:
        fit, name, interpretation = min(found, key=lambda item: item[0].improbability)
        raise InputError(
            f"{where}: expected one of the robots to fit with one unit of all joint readings, found that only {name} "
            f"with columns in different units fits ({fit.words}); name it with --robot, and add "
            f"{unit_lines(interpretation)} to a mapping file for --map."
        )


def decide_convention(case: ConventionCase) -> tuple[str, str]:
    """Title of the convention of one table under which its robot fits clearly best, and a sentence on the choice.

    Where none fits, one mistake of the data is searched for under every convention. Raises InputError for it, as
    `decide_robot` where the data do not decide, and where nothing fits. Trusted data: it is then the convention under
    which the mistake explains the misfit, or that fits best, and the last check says what is wrong.
    """
    titles, where = case.titles, case.called
    fits = _fits_of_robots(case.mapping, case.build_with, titles)
    good = [item for item in fits if item[1].is_good]
    if good:
        lines = [f'robot = "{title}"' for title in titles]
        chosen = titles[choose_reading(lines, good, f"{where}, robot", case.ask)]
        return chosen, f"The convention of the table was open: of the two, {chosen} fits."
    if len(fits) < len(titles):
        decided = _by_base_and_tool(case, {titles[place] for place, _ in fits})
        if decided is not None:
            return decided
    ordered = [titles[place] for place, _ in fits]
    found = []
    for title in ordered:
        robot, build = case.build_with(title)
        found += [(title, s) for s in _mistakes_under_any_unit(robot, case.mapping, build)]
        if any(suspicion.cause != "robot-file" for _, suspicion in found):
            break
    # a mistake of the data before another robot
    found.sort(key=lambda item: item[1].cause == "robot-file")
    if case.trust_data and fits:
        chosen = found[0][0] if found else ordered[0]
        return chosen, f"The convention of the table was open: of the two, {chosen} fits best."
    if found:
        raise InputError(naming_option(_mistake_sentence(*found[0])))
    _refuse_changed_rows(case, ordered)
    shown = "; ".join(fit.words for _, fit in fits)
    raise InputError(
        f"{where}: expected the robot of the table to fit under one of its conventions, found none ({shown}), and no "
        "single mistake in units, signs, order or coupling of joints was found that explains the misfit under either "
        f"of them; {REMEDY}. If you know the convention, {STATE_CONVENTION}: the search then keeps to it."
    )


def _by_base_and_tool(case: ConventionCase, tested: Collection[str]) -> tuple[str, str] | None:
    """The convention where the rows are too few to fit the geometry under one that fits well with base and tool alone.

    tested: titles whose geometry could be fitted; none of them fits. None where the best convention is one of them.
    Raises InputError where the rows do not decide.
    """
    misfits = {}
    for title in case.titles:
        robot, build = case.build_with(title)
        scales = [_nominal_misfit(robot, build, m) for _, m in unit_readings(case.mapping)]
        misfits[title] = min(scales, default=np.inf)
    best, *others = sorted(misfits, key=misfits.get)
    shown = ", ".join(f"{title}: {misfits[title]:.3g} mm" for title in (best, *others))
    if best in tested or not np.isfinite(misfits[best]):
        return None
    if any(misfits[title] < _CLEARLY * misfits[best] for title in others):
        raise InputError(
            f"{case.called}: expected enough rows to decide the convention of the table, found too few to test it with "
            f"geometry errors, and about the same misfit with base and tool alone ({shown}); {STATE_CONVENTION}, or "
            "measure more rows."
        )
    return best, (
        "The convention of the table was open, and the rows are too few to test it with geometry errors. With base and "
        f"tool alone {best} fits clearly best ({shown}). If that is wrong, {STATE_CONVENTION}."
    )


def _nominal_misfit(robot: Robot, build: Build, mapping: Mapping) -> float:
    """mm with base and tool alone; inf where the reading cannot be fitted."""
    try:
        return nominal_scale(robot, build(mapping))
    except FAILURES:
        return np.inf


def _refuse_changed_rows(case: ConventionCase, titles: Sequence[str]) -> None:
    """Raise InputError where rows are shifted, or units, signs or order change at a row, under one convention."""
    for title in titles:
        try:
            case.refuse_changes(title)
        except InputError as problem:
            raise InputError(f"{problem} {_fits_under(title)}") from None


def _fits_of_robots(mapping: Mapping, build_with, names) -> list[tuple[int, CandidateFit]]:
    """Index and best fit under any units of each robot, the most probable first."""
    fits = []
    for place, name in enumerate(names):
        robot, build = build_with(name)
        found = compare(robot, list(unit_readings(mapping, stated_only=True)), build, 1)
        if found:
            best = found[0][1]
            fits.append((place, replace(best, title=f"robot {name}, {best.title}")))
    return sorted(fits, key=lambda item: item[1].improbability)


def _mistakes_under_any_unit(robot: Robot, mapping: Mapping, build: Build) -> list[Suspicion]:
    """Certain mistakes that explain the misfit, under the most usual of the units that fit about equally badly.

    None that includes the convention: the other convention is tried by itself.
    """
    readings = list(unit_readings(mapping, stated_only=True))
    fits = compare(robot, readings, build)
    if not fits:
        return []
    places = close_units(UnitCase(robot, mapping, build, ""), readings) or [fits[0][0]]
    recording = build(readings[places[0]][1])
    found = check_plausibility(robot, recording)
    return [s for s in certain_mistakes(found, mapping) if "convention" not in s.cause]


def _mistake_sentence(title: str, suspicion: Suspicion) -> str:
    """The mistake and the convention under which it explains the misfit."""
    sentence = suspicion.sentence
    if suspicion.cause == "robot-file":
        return sentence
    return f"{sentence} {_fits_under(title)}"


def _fits_under(title: str) -> str:
    return f"The Denavit-Hartenberg table then fits under {title.rpartition(', ')[2]}."
