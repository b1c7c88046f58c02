"""`workbench compensate`: targets in, corrected targets out, with their expected error."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibrate import WithoutOption
from workbench.commands.shared import answer, tables
from workbench.commands.shared.target_map import PayloadKg, TargetMap
from workbench.files import runs

Solution = Annotated[
    Path,
    typer.Argument(
        help="Run folder of `workbench calibrate` or `workbench diagnose`, or its solution.json."
    ),
]
Force = Annotated[
    bool,
    typer.Option(
        "--force", help="Accept a calibration and corrections that would be refused as implausible."
    ),
]
MaxPosition = Annotated[
    float | None,
    typer.Option(
        "--max-correction-mm",
        metavar="MM",
        help="Refuse larger corrections of the flange's position. Default: 10 mm, more if measured.",
    ),
]
MaxRotation = Annotated[
    float | None,
    typer.Option(
        "--max-correction-deg",
        metavar="DEG",
        help="Refuse larger corrections of the flange's orientation. Default: 1 deg, more if measured.",
    ),
]
MaxJointChange = Annotated[
    float,
    typer.Option(
        "--max-joint-change-deg",
        metavar="DEG",
        help="Refuse a joint target if a joint would change by more than this.",
    ),
]
MaxSigma = Annotated[
    float | None,
    typer.Option(
        "--max-sigma-mm",
        metavar="MM",
        help="Refuse targets with a larger standard uncertainty; default: three times the held-out error.",
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        "--start",
        metavar="READINGS|RECORDING",
        help="Start of the inverse kinematics for targets that are flange poses; it selects the configuration of the "
        "arm: joint readings (0,-90,90,0,90,0), or a recording (its nearest pose). Default: the middle of the joint "
        "ranges.",
    ),
]
_NAMED = 12
_EXPECTED_ERROR = "expected position error (RMS, 1 sigma) of the worst target"


def command(
    solution: Solution,
    targets: Annotated[
        Path,
        typer.Argument(
            help="Joint readings or flange poses, one row per target: any table that `workbench import` reads."
        ),
    ],
    force: Force = False,
    without: WithoutOption = None,
    max_correction_mm: MaxPosition = None,
    max_correction_deg: MaxRotation = None,
    max_sigma_mm: MaxSigma = None,
    max_joint_change_deg: MaxJointChange = 10.0,
    map: TargetMap = None,
    start: Start = None,
    payload_kg: PayloadKg = None,
    tolerance: answer.Tolerance = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    no_report: answer.NoReport = False,
) -> None:
    """Correct the targets of a robot program with a calibrated model: a table of corrected joint readings.

    A target beyond reach or limits, or with an implausible correction, has no joint readings in corrected.csv.
    The exit status is then 1: the program is incomplete and must not be run.
    """
    answer.check_target(json)
    runs.check_place(out)
    with answer.progress(f"reading {solution}") as progress:
        from workbench.files.solution_file import read_solution, without_terms
        from workbench.files.targets import as_csv, corrected_columns, target_warnings
        from workbench.fitting.verdicts.verdict import parse_tolerances
        from workbench.jobs.robot.compensation.correction_limits import (
            Limits,
            checked,
            covariates_of,
            judge_targets,
        )
        from workbench.jobs.robot.compensation.elapsed_time import elapsed_time_words
        from workbench.jobs.robot.compensation.switched_off import switched_off_warnings
        from workbench.jobs.robot.compensation.unrecorded_load import compensate_programme
        from workbench.machine.progress import paced

        tolerances = parse_tolerances(tolerance)
        limits = Limits(max_correction_mm, max_correction_deg, max_sigma_mm, max_joint_change_deg)
        solution_keys = checked(read_solution(solution), solution, force, limits)
        arm = without_terms(solution_keys, without or (), str(solution))
        programme, stated = _read_targets(arm, targets, map, start, force, payload_kg)
        covariates = covariates_of(arm, programme)
        tick = paced(progress, f"inverting the model at {len(programme.readings)} targets, step")
        found = compensate_programme(arm, programme, covariates, tick)
        assessment = judge_targets(arm, programme, found, limits)
        refused = {} if force else assessment.refused
        notes = [*stated, *elapsed_time_words(arm, found, covariates), *assessment.warnings]
        notes += [*_changes(arm, programme, found), *_forced(assessment.refused if force else {})]
        notes += switched_off_warnings(solution_keys, arm, found.readings, covariates)
        with runs.opened("compensate", targets.stem, out) as run:
            result = {
                **_summary(arm, found, refused),
                "configurations": _configurations(arm, programme, found),
                "warnings": [*target_warnings(programme, arm.robot), *notes],
                "remarks": _remarks(arm),
                "unattainable": _unattainable(arm, programme, found, covariates),
                "verdict": _verdict(arm, found, refused, tolerances).as_json(),
                **{"targets": targets, "solution": solution, "run": run.path},
                "corrected": run.path / "corrected.csv",
            }
            columns = as_csv(corrected_columns(programme, arm.robot, found, refused))
            runs.replace_file(run.partial / "corrected.csv", columns)
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
            if not no_report:
                _write_page(run.partial, arm, programme, found, result)
    answer.deliver(result, json)
    _show(answer.console(json), result)
    if result["unreached_rows"] or result["refused"] or result["verdict"]["pass"] is False:
        raise typer.Exit(1)


def _write_page(folder: Path, arm, programme, found, result) -> None:
    from workbench.report.page import write_sheet
    from workbench.report.planning import corrections

    write_sheet(corrections.page(arm, programme, found, result), folder)


def _remarks(arm) -> list[str]:
    """To which point the stated errors refer, where the data leave the flange open."""
    from robot_model.tool_points import undetermined_points_remark

    return list(filter(None, [undetermined_points_remark(arm.values)]))


def _read_targets(arm, targets: Path, mapping, start, force: bool, payload_kg: float | None):
    """The programme, under the stated load, and sentences on its configurations.

    Raises InputError, also for a unit that cannot be.
    """
    from workbench.files.corrected_targets import check_uncorrected
    from workbench.files.targets import read_programme
    from workbench.jobs.robot.compensation.stated_configuration import configured
    from workbench.jobs.robot.compensation.target_units import check_units
    from workbench.jobs.robot.compensation.unrecorded_load import with_load
    from workbench.jobs.robot.session_clock import targets_on_session_clock

    programme = with_load(read_programme(targets, arm.robot, mapping), payload_kg)
    if not force:
        check_uncorrected(programme, targets)
        check_units(arm, programme)
    programme, late = targets_on_session_clock(arm, programme)
    programme, stated = configured(programme, arm, start)
    return programme, [*stated, *late]


def _forced(reasons: Mapping[int, list[str]]) -> list[str]:
    """Warning on targets that only --force accepts."""
    if not reasons:
        return []
    row = min(reasons)
    return [
        f"--force: {len(reasons)} targets are corrected that would be refused; target {row + 1}: "
        f"{'; '.join(reasons[row])}."
    ]


def _unattainable(arm, programme, found, covariates) -> list[str]:
    from workbench.jobs.robot.compensation.unattainable import unattainable_targets

    unattainable = unattainable_targets(arm, programme.readings, found, covariates)
    return [target.sentence for target in unattainable]


def _configurations(arm, programme, found) -> list[dict]:
    """Which configuration the targets take that are poses; targets with readings state their own."""
    from workbench.jobs.robot.compensation.configurations import configurations_json

    return [] if programme.poses is None else configurations_json(arm.robot, found.readings)


def _changes(arm, programme, found) -> list[str]:
    from workbench.jobs.robot.compensation.configurations import configuration_changes

    return [] if programme.poses is None else configuration_changes(arm.robot, found.readings)


def _summary(arm, found, refused) -> dict:
    """The main figures; errors are 3-D, of the flange, in mm."""
    from robot_model.tool_points import corrected_point_name
    from workbench.jobs.robot.compensation.compensate import COVERAGE_FACTOR
    from workbench.jobs.robot.compensation.model_error import known_noise, model_error_mm

    noise = known_noise(arm).noise
    reached = found.reached
    is_usable = reached.copy()
    is_usable[list(refused)] = False
    return {
        "command": "compensate",
        "count": len(reached),
        "reached": int(reached.sum()),
        "corrected_count": int(is_usable.sum()),
        "unreached_rows": _rows(~reached),
        "beyond_limits_rows": _rows(found.beyond_limits),
        "unattainable_rows": _rows(~reached & ~found.beyond_limits),
        "point": corrected_point_name(arm.values) if found.is_deficient else "flange",
        "joints": arm.robot.mixing.shape[1],
        "refused": [{"row": k + 1, "why": "; ".join(why)} for k, why in sorted(refused.items())],
        "largest_correction_mm": _largest(found.position_mm[reached]),
        "largest_correction_deg": _largest(found.rotation_deg[reached]),
        "correction_rms_mm": _rms(found.correction_mm[is_usable]),
        "left_rms_mm": _rms(found.left_mm[is_usable]),
        "position_left_rms_mm": _rms(found.position_left_mm[is_usable]),
        "rotation_left_rms_deg": _rms(found.rotation_left_deg[is_usable]),
        "sigma_rms_mm": _rms(found.sigma_mm[is_usable]),
        "uncertainty_rms_mm": _rms(found.uncertainty_mm[is_usable]),
        "coverage_factor": COVERAGE_FACTOR,
        "expanded_uncertainty_max_mm": _largest(found.expanded_uncertainty_mm[is_usable]),
        "expected_error_mm": arm.held_out_mm,
        "model_error_mm": model_error_mm(arm),
        "noise_mm": None if noise is None else float(noise.value),
        "nominal_error_mm": arm.keys["nominal"]["rms_mm"],
        "why_expected": "held-out RMS of the calibration, which contains the noise of the instrument; model_error_mm "
        "is the same without it and without what uncertain parameters and considered terms make, and remains at every "
        "target",
    }


def _rows(chosen) -> list[int]:
    """Numbers of the chosen targets, counted from 1."""
    return [int(k) + 1 for k in chosen.nonzero()[0]]


def _verdict(arm, found, refused, tolerances):
    """The verdict on the largest standard uncertainty of a target: what the model misses and its uncertainty there.

    The noise of the instrument is an error of the measurements and moves no arm: where it is known, it is not part of
    the expected error.
    """
    from workbench.fitting.verdicts.verdict import Residual, judge, no_verdict
    from workbench.jobs.robot.compensation.model_error import known_noise, remaining_error_mm

    is_usable = found.reached.copy()
    is_usable[list(refused)] = False
    if not is_usable.any():
        return no_verdict("No target is corrected, so there is no error to judge.")
    largest_variance = float(
        (found.sigma_mm[is_usable] ** 2 + found.position_left_mm[is_usable] ** 2).max()
    )
    remaining = remaining_error_mm(arm)
    largest = math.hypot(remaining, math.sqrt(largest_variance))
    residual = Residual(largest, "mm", _EXPECTED_ERROR, has_noise=False)
    known = known_noise(arm)
    verdict = judge(residual, known.noise, tolerances)
    return replace(
        verdict, sentence=f"{verdict.sentence} {_composition(remaining, largest_variance, known)}"
    )


def _composition(remaining: float, own_error: float, known) -> str:
    """Components of the largest expected error, and where the noise of the instrument is included."""
    components = (
        f"It combines {_remaining_words(remaining)} and {math.sqrt(own_error):.3g} mm of uncertainty at that target "
        "(parameters, extrapolation, effects found and not retained, inverse-kinematics residual)"
    )
    noise = known.noise
    if noise is not None:
        return (
            f"{components}; the noise of the instrument, {noise.value:.3g} mm ({noise.source}), is no error of the arm "
            "and is not part of it."
        )
    if known.refuted is not None:
        return (
            f"{components}. The noise of {known.refuted.value:.3g} mm ({known.refuted.source}) is not subtracted, "
            "since the held-out error is significantly smaller: it is stated too large. "
            "Correct sigma_mm or repeat some poses."
        )
    return (
        f"{components}. The first contains the noise of the instrument, which is not known: state sigma_mm or repeat "
        "some poses to separate them."
    )


def _remaining_words(remaining: float) -> str:
    return (
        f"{remaining:.3g} mm on unseen poses"
        if remaining
        else "no error beyond the noise on unseen poses"
    )


def _rms(values) -> float | None:
    return float((values**2).mean() ** 0.5) if len(values) else None


def _largest(values) -> float | None:
    return float(values.max()) if len(values) else None


def _show(console, result) -> None:
    head = ["", "RMS mm"]
    point, residual, kind = result["point"], result["left_rms_mm"], ""
    if point == "flange":
        point = "the flange"
    else:  # the orientation that the joints cannot reach is no error of this point
        residual, kind = result["position_left_rms_mm"], ", position"
    rows = [
        ["error of the nominal arm, held out", result["nominal_error_mm"]],
        ["calibrated arm on held-out samples, measured", result["expected_error_mm"]],
        *_without_noise(result),
        ["standard uncertainty at these targets", result["uncertainty_rms_mm"]],
        [f"the corrections, at {point}", result["correction_rms_mm"]],
        [f"inverse-kinematics residual{kind}", residual],
    ]
    tables.grid(
        console, f"{result['corrected_count']} of {result['count']} targets corrected", head, rows
    )
    if result["largest_correction_mm"] is not None:
        console.print(
            f"Largest correction: {result['largest_correction_mm']:.3g} mm, "
            f"{result['largest_correction_deg']:.3g} deg.",
            markup=False,
        )
    for configuration in result["configurations"]:
        count = len(configuration["rows"])
        console.print(
            f"Configuration of the arm at {count} target{'s' if count > 1 else ''}: "
            f"{configuration['configuration']} (--start chooses another).",
            markup=False,
        )
    for sentence in (*result["warnings"], *result["remarks"]):
        console.print(sentence, markup=False)
    _show_unreached(console, result)
    _show_refused(console, result["refused"])
    answer.show_verdict(console, result["verdict"])
    console.print(str(result["run"]), soft_wrap=True, markup=False)


def _without_noise(result) -> list[list]:
    """Rows on the two parts of the held-out error, none where the noise of the instrument is unknown."""
    if result["noise_mm"] is None:
        return []
    return [
        ["  of which noise of the instrument", result["noise_mm"]],
        ["  of which error of the model", result["model_error_mm"]],
    ]


def _show_unreached(console, result) -> None:
    """Targets without readings: beyond the limits of the joints, or not attainable at all."""
    rows = result["beyond_limits_rows"]
    if rows:
        unlisted = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
        named = ", ".join(map(str, rows[:_NAMED]))
        console.print(
            "The corrected readings exceed the limits of the joints, no readings in corrected.csv: target "
            f"{named}{unlisted}."
        )
    for sentence in result["unattainable"]:
        console.print(sentence, markup=False)
    unlisted = len(result["unattainable_rows"]) - len(result["unattainable"])
    if unlisted:
        console.print(f"{unlisted} more targets are not attainable; the JSON answer names them.")


def _show_refused(console, refused) -> None:
    if not refused:
        return
    for refusal in refused[:_NAMED]:
        why = f"Target {refusal['row']} is refused and has no readings in corrected.csv: {refusal['why']}."
        console.print(why, markup=False)
    unnamed = len(refused) - _NAMED
    if unnamed > 0:
        sentence = f"{unnamed} more targets are refused; the JSON answer names them."
        console.print(sentence, markup=False)
    console.print(
        "Check these targets and the calibration; --max-correction-mm, --max-correction-deg and "
        "--max-sigma-mm set other limits, --force ignores them.",
        markup=False,
    )
