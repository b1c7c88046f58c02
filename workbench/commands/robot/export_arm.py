"""A calibrated arm in the formats of other programs: texts by file, and what each format cannot hold."""

import filecmp
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from workbench.core.errors import InputError
from workbench.core.robot_files.robot_description import description_keys

PROGRAMS = ("urscript", "krl", "rapid", "fanuc")
GEOMETRY_ALONE = ("urdf", "ros", "mdh-json", "mdh-csv")
"""Formats that cannot hold effects."""
FORMATS = ("urdf", "mjcf", "python", "ros", *PROGRAMS, "mdh-json", "mdh-csv")


@dataclass(frozen=True)
class ArmOptions:
    """Options of single formats: `urdf` to be patched and its `tip` link, `targets` of a program, terms switched
    off by name (`excluded_terms`), whether a doubtful calibration is used all the same (`force`), the mapping of the
    columns of the targets (`map`), where the search for the readings of poses starts (`start`), and the load of all
    targets (`payload_kg`)."""

    urdf: Path | None = None
    tip: str | None = None
    targets: Path | None = None
    excluded_terms: Sequence[str] = ()
    force: bool = False
    map: Path | None = None
    start: str | None = None
    payload_kg: float | None = None


@dataclass(frozen=True)
class ArmExport:
    """`texts` by file; `left_out`: what the format cannot hold; `notes`: sentences for the user."""

    texts: dict[Path, str | bytes]
    left_out: list[str]
    notes: tuple[str, ...] = ()


def check_options(format_name: str, options: ArmOptions) -> None:
    """InputError for an option that the format does not take, or a program without targets."""
    if (options.urdf or options.tip) and format_name != "urdf":
        raise InputError(
            f"--urdf, --tip: expected with --to urdf, found --to {format_name}; leave them out"
        )
    if options.targets and format_name not in PROGRAMS:
        raise InputError(
            f"--targets: expected with --to {', '.join(PROGRAMS)}, found --to {format_name}; leave it out"
        )
    of_targets = (
        ("--map", options.map),
        ("--start", options.start),
        ("--payload-kg", options.payload_kg),
    )
    for name, value in of_targets:
        if value is not None and not options.targets:
            raise InputError(f"{name}: expected with --targets, found no targets; leave it out")
    if format_name in PROGRAMS and options.targets is None:
        raise InputError(
            f"--to {format_name}: expected --targets FILE with joint readings or flange poses, found none; name a table"
        )


STEPS = 3
"""Steps of an export that are reported: read the calibration, write the text, read it back."""


def export_arm(
    path: Path,
    format_name: str,
    file: Path,
    options: ArmOptions,
    step: Callable[[str], None] = lambda text: None,
) -> ArmExport:
    """The export of a solution.json in a format of `FORMATS`, read back before it is returned.

    step: called with the name of each of the `STEPS`. Raises InputError.
    """
    from workbench.files.solution_file import read_solution, without_terms
    from workbench.jobs.robot.compensation.correction_limits import checked

    check_options(format_name, options)
    step("reading the calibration")
    arm = checked(read_solution(path), path, options.force)
    arm = without_terms(arm, options.excluded_terms, str(path))
    step(f"computing {file.name}")
    read_back = partial(step, f"reading {file.name} back and comparing it with the model")
    if format_name in PROGRAMS:
        return _program(arm, format_name, file, options, read_back)
    if format_name in GEOMETRY_ALONE:
        return _geometry_alone(arm, format_name, file, options, read_back)
    makers: dict[str, Callable[..., ArmExport]] = {
        "mjcf": _mjcf,
        "python": _python,
    }
    return makers[format_name](arm, file, options, format_name, read_back)


def _geometry_alone(arm, format_name: str, file: Path, options: ArmOptions, read_back) -> ArmExport:
    """An export in a format without effects: its geometry is fitted to the complete model."""
    from workbench.files.exports.geometry_alone import fit_geometry, held_by_ur_kinematics

    makers: dict[str, Callable[..., ArmExport]] = {
        "urdf": _urdf,
        "ros": _ros,
        "mdh-json": _table,
        "mdh-csv": _table,
    }
    export = makers[format_name]
    fit = fit_geometry(arm, held_by_ur_kinematics(arm) if format_name == "ros" else None)
    if not fit:
        return export(arm, file, options, format_name, read_back)
    exported = export(fit.arm, file, options, format_name, read_back)
    return replace(exported, notes=(*exported.notes, fit.sentence))


def _table(arm, file: Path, options: ArmOptions, format_name: str, read_back) -> ArmExport:
    from workbench.files.exports import mdh_csv, mdh_json
    from workbench.files.exports.check import check_mdh
    from workbench.files.exports.mdh import left_out

    text = {"mdh-json": mdh_json, "mdh-csv": mdh_csv}[format_name](arm)
    read_back()
    check_mdh(arm, text)
    return ArmExport({file: text}, left_out(arm))


def _urdf(arm, file: Path, options: ArmOptions, format_name: str, read_back) -> ArmExport:
    """The user's own URDF with corrected numbers, where there is one; else a bare one."""
    from workbench.files.exports import urdf
    from workbench.files.exports.check import check_patched_urdf, check_urdf
    from workbench.files.exports.mdh import left_out
    from workbench.files.exports.urdf_patch import patched_urdf

    spec = _urdf_spec(arm, options)
    if spec is None:
        text = urdf(arm)
        read_back()
        check_urdf(arm, text)
        return ArmExport({file: text}, left_out(arm))
    urdf_text = patched_urdf(arm, spec)
    read_back()
    check_patched_urdf(
        arm, urdf_text.content, spec, exact=_is_own(arm, spec) and urdf_text.is_whole
    )
    joints = ", ".join(urdf_text.changed) or "none"
    note = f"Only origins were changed, of joints {joints}; all else is as in {spec['urdf']}."
    return ArmExport({file: urdf_text.content}, list(urdf_text.left_out), (note,))


def _urdf_spec(arm, options: ArmOptions) -> dict | None:
    """Key of the URDF to patch: --urdf, else the file that the arm was calibrated with; None if it is MJCF."""
    from robot_model.files.mjcf import is_mjcf

    robot_keys = dict(arm.keys["robot"])
    if "urdf" not in robot_keys or is_mjcf(Path(robot_keys["urdf"])):
        robot_keys = {}
    if options.urdf is not None:
        robot_keys |= description_keys(options.urdf)
    if options.tip is not None:
        robot_keys["tip"] = options.tip
    return robot_keys if "urdf" in robot_keys else None


def _is_own(arm, spec: dict) -> bool:
    """Whether a URDF is the one that the arm was calibrated with, or a copy of it, with the same flange."""
    robot_keys = arm.keys["robot"]
    if "urdf" not in robot_keys or robot_keys.get("tip") != spec.get("tip"):
        return False
    return filecmp.cmp(robot_keys["urdf"], spec["urdf"], shallow=False)


def _mjcf(arm, file: Path, options: ArmOptions, format_name: str, read_back) -> ArmExport:
    """The MJCF file and, where terms on joints are no springs, a module that computes the servo targets."""
    from workbench.files.exports.check import check_python
    from workbench.files.exports.mjcf import control_terms, left_out, mjcf
    from workbench.files.exports.mjcf_check import check_mjcf
    from workbench.files.exports.python import python_module
    from workbench.jobs.robot.compensation.confirmed_correction import largest_corrections

    text = mjcf(arm)
    texts: dict[Path, str | bytes] = {file: text}
    read_back()
    check_mjcf(arm, text)
    control = [effect.title for effect in control_terms(arm)]
    notes: tuple[str, ...] = ()
    if control:
        module = file.with_name(f"{file.stem.replace('-', '_')}_control.py")
        texts[module] = python_module(arm, largest_corrections(arm))
        check_python(arm, str(texts[module]))
        notes = (
            f"{', '.join(control)}: on joints and no springs, so that MJCF cannot hold them; {module.name} has them: "
            "set data.ctrl to its servo_targets(readings).",
        )
    missing = [title for title in left_out(arm) if title not in control]
    return ArmExport(texts, missing, notes)


def _python(arm, file: Path, options: ArmOptions, format_name: str, read_back) -> ArmExport:
    from workbench.files.exports.check import check_python
    from workbench.files.exports.python import python_module
    from workbench.files.exports.python.module import observed_effects
    from workbench.jobs.robot.compensation.confirmed_correction import largest_corrections

    text = python_module(arm, largest_corrections(arm))
    read_back()
    check_python(arm, text)
    observed = set(map(id, observed_effects(arm)))
    return ArmExport({file: text}, [e.title for e in arm.effects if id(e) not in observed])


def _ros(arm, file: Path, options: ArmOptions, format_name: str, read_back) -> ArmExport:
    from workbench.files.exports.check import check_ur_kinematics
    from workbench.files.exports.mdh import left_out
    from workbench.files.exports.ur_kinematics import ur_kinematics_yaml

    text = ur_kinematics_yaml(arm)
    read_back()
    check_ur_kinematics(arm, text)
    held_numbers = "length and twists between the last axis and the flange"
    return ArmExport({file: text}, [*left_out(arm), held_numbers])


def _program(arm, format_name: str, file: Path, options: ArmOptions, read_back) -> ArmExport:
    """A program whose targets are corrected; refused where `workbench compensate` would refuse one of them."""
    from robot_model.state import sliding
    from workbench.files.exports.check import check_program
    from workbench.files.exports.programs import Program, program_text
    from workbench.jobs.robot.compensation.correction_limits import (
        Limits,
        covariates_of,
        judge_targets,
    )
    from workbench.jobs.robot.compensation.unrecorded_load import compensate_programme, with_load

    programme, sentences = _targets(arm, options)
    programme = with_load(programme, options.payload_kg)
    covariates = covariates_of(arm, programme)
    found = compensate_programme(arm, programme, covariates)
    refused = {} if options.force else judge_targets(arm, programme, found, Limits()).refused
    for k in (~found.reached).nonzero()[0]:
        unattainable = f"it is not attainable with {arm.robot.mixing.shape[1]} joints"
        why = "it exceeds the joint limits" if found.beyond_limits[k] else unattainable
        refused = refused | {int(k): [why]}
    if refused:
        row = min(refused)
        raise InputError(
            f"{options.targets}, target {row + 1}: expected a target that can be corrected, found that "
            f"{'; '.join(refused[row])} ({len(refused)} such targets); correct it, or see `workbench compensate`"
        )
    largest = f"{len(found.readings)} targets, largest correction {found.position_mm.max():.3g} mm."
    notes = (largest, *sentences, *_configuration_notes(arm, programme, found))
    own_target_program = _own_program(arm, format_name, options, found, read_back)
    if own_target_program is not None:
        return ArmExport({file: own_target_program[0]}, [], (*notes, own_target_program[1]))
    if format_name == "fanuc":
        raise InputError(
            f"--to fanuc: expected --targets with a FANUC program as text (.ls), found {options.targets}; name the "
            "program whose positions are to be corrected"
        )
    name = file.stem.replace("-", "_")
    slides = tuple(sliding(arm.robot).tolist())
    program = Program(found.readings, name, arm.robot.name, arm.held_out_mm, slides)
    text = program_text(program, format_name)
    read_back()
    check_program(program, text, format_name)
    return ArmExport({file: text}, [], notes)


def _targets(arm, options: ArmOptions):
    """The targets, and sentences on their configurations and times. Raises InputError."""
    from workbench.files.corrected_targets import check_uncorrected
    from workbench.files.targets import read_programme
    from workbench.jobs.robot.compensation.stated_configuration import configured
    from workbench.jobs.robot.compensation.target_units import check_units
    from workbench.jobs.robot.session_clock import targets_on_session_clock

    programme = read_programme(options.targets, arm.robot, options.map)
    if not options.force:
        check_uncorrected(programme, options.targets)
        check_units(arm, programme)
    programme, late = targets_on_session_clock(arm, programme)
    programme, stated = configured(programme, arm, options.start)
    return programme, (*stated, *late)


def _own_program(
    arm, format_name: str, options: ArmOptions, found, read_back
) -> tuple[bytes, str] | None:
    """The user's own program with corrected numbers, and a sentence; None where the targets are no such program."""
    import numpy as np

    from datasets.importers.mapping.model import read_mapping
    from datasets.importers.sources.programs.program_patch import is_program_of, patched_program
    from datasets.importers.user_tables import frames_of
    from workbench.files.exports.check import check_patched_program
    from workbench.jobs.robot.compensation.compensate import nominal_poses

    maker = {"krl": "KUKA", "rapid": "ABB", "fanuc": "FANUC"}.get(format_name)
    if maker is None or options.targets is None or not is_program_of(options.targets, maker):
        return None
    flange = nominal_poses(arm.robot, found.readings)
    stated = frames_of(None if options.map is None else read_mapping(options.map))
    readings = np.rad2deg(found.readings)
    programme = patched_program(options.targets, maker, readings, flange, stated)
    read_back()
    check_patched_program(arm, options.targets, programme.content, found.readings, options.map)
    note = (
        f"Only the numbers of {programme.count} positions were changed: moves, names, speeds, tools "
        "and comments are those "
        f"of {options.targets.name}."
    )
    return programme.content, note


def _configuration_notes(arm, programme, found) -> list[str]:
    """Sentences on the configuration of the arm at targets that are poses."""
    from workbench.jobs.robot.compensation.configurations import (
        configuration_changes,
        configurations_json,
    )

    if programme.poses is None:
        return []
    named = [
        f"Configuration of the arm at {len(configuration['rows'])} targets: {configuration['configuration']}."
        for configuration in configurations_json(arm.robot, found.readings)
    ]
    return [*named, *configuration_changes(arm.robot, found.readings)]
