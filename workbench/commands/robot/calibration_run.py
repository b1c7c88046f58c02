"""A calibration as the commands run it: the job, its run folder, report and answer."""

from collections.abc import Sequence
from pathlib import Path

from workbench.commands.shared import answer, tables
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts.verdict import Tolerance


def check_scanner(found, scanner: Path | None) -> None:
    """Raise InputError if a scanner is given for a recording without images of scans."""
    if scanner is not None and found.measures != "scan-images":
        raise InputError(
            f"--scanner {scanner} expects a scan-images recording, found one of {found.measures}; "
            "omit the option."
        )


def solve(
    found,
    name: str,
    options: dict,
    progress,
    out: Path | None,
    report: bool,
    scanner: Path | None = None,
    tolerances: Sequence[Tolerance] = (),
):
    """Calibrate, save and report into a run folder. Returns the answer and the run.

    found: a `datasets.recording.Recording`; options: keyword arguments of `workbench.jobs.robot.calibrate.calibrate`;
    scanner: scanner file for a recording of scans; None calibrates one. tolerances: of the verdict. Raises InputError.
    """
    with runs.opened("calibrate", name, out) as run:
        result = solve_into(
            run.partial, run.path, found, name, options, progress, report, scanner, tolerances
        )
    return result, run


def solve_into(
    folder: Path,
    path: Path,
    found,
    name: str,
    options: dict,
    progress,
    report: bool,
    scanner: Path | None = None,
    tolerances: Sequence[Tolerance] = (),
) -> dict:
    """Calibrate, save and report into an existing folder with the final name `path`. Returns the answer.

    Arguments as in `solve`. Raises InputError.
    """
    from workbench.fitting.verdicts.calibration_verdict import (
        calibration_verdict,
        remark_on_kind,
        with_doubts,
        with_remark,
        with_sensor,
    )
    from workbench.jobs.robot.calibrate import calibrate, save

    scans, sensor_keys = None, {}
    if found.measures == "scan-images":
        scans, sensor_keys, found, options = _centres(
            found, scanner, folder, path, options, progress
        )
    progress(f"calibrating {name}")
    calibration = calibrate(found, progress=progress, **options)
    progress("comparing the residual with the noise")
    verdict = calibration_verdict(calibration.held_out, calibration.noise, tolerances)
    stated = calibration.as_json()
    verdict = with_remark(verdict, remark_on_kind(stated["measures"]))
    verdict = with_doubts(verdict, calibration.suspicions, options.get("trust_data", False))
    verdict = with_sensor(with_remark(verdict, calibration.far_geometry), sensor_keys.get("sensor"))
    of_sensor = sensor_keys.get("sensor", {}).get("warnings", ())
    result = {
        **stated,
        "warnings": [*of_sensor, *stated.get("warnings", ())],
        **sensor_keys,
        "verdict": verdict.as_json(),
        "input": runs.input_name(name),
        "options": _stated_options(options, scanner),
        "run": path,
    }
    save(calibration, folder)
    if report:
        progress("writing the report")
        _report(calibration, scans, folder, progress, verdict.sentence)
    runs.replace_file(folder / "answer.json", answer.as_text(result))
    return result


def _stated_options(options: dict, scanner: Path | None) -> dict:
    """Options of the command line, with files as whole paths, so that a rerun in another folder finds them."""
    from workbench.fitting.calibration_plans.plans import plan_location

    plan = options.get("plan")
    return {
        "plan": plan_location(plan) if isinstance(plan, str | Path) else None,
        "folds": options.get("folds", 10),
        "scanner": None if scanner is None else str(Path(scanner).resolve()),
        "trust_data": options.get("trust_data", False),
    }


def _centres(found, scanner, folder, path, options, progress):
    """Scans, their part of the answer, the recording of ball centres, and the options for its calibration."""
    from workbench.jobs.sensor import ball_centres, scan

    ball_centres.check_arm(found)
    scans = scan.scan(found, scanner, folder, progress)
    ball_centres.save(scans, folder)
    centres = ball_centres.required(scans)
    sensor_keys = {"sensor": ball_centres.as_json(scans, path)}
    if scans.calibration is not None:
        from workbench.jobs.sensor.scanner import as_json

        sensor_keys["sensor"]["calibration"] = as_json(scans.calibration)
    lists = {
        key: ball_centres.renumbered(scans, centres, options.get(key))
        for key in ("fit_samples", "test_samples")
    }
    return scans, sensor_keys, centres, {**options, **lists}


def deliver(result: dict, run: runs.Run, json: str | None) -> None:
    """Print the answer, write the JSON, print the folder last, and exit with status 1 if a tolerance is not met."""
    answer.deliver(result, json)
    console = answer.console(json)
    tables.calibration(console, result)
    answer.conclude(console, result, run.path)


def _report(calibration, scans, folder: Path, progress, verdict: str) -> None:
    from workbench.report.page import write_report

    sections = ()
    if scans is not None:
        from workbench.report.sensor.scan import chain

        sections = chain(scans)
    write_report(calibration, folder, sections, progress, verdict)
