"""`workbench calibrate`: a recording in, parameters, held-out errors and a report page out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.shared import answer, samples, tables
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts.verdict import Tolerance

Plan = Annotated[
    Path | None, typer.Option("--plan", metavar="FILE", help="Stages to solve (TOML).")
]
FromDiagnosis = Annotated[
    Path | None,
    typer.Option(
        "--from-diagnosis",
        metavar="RUN",
        help="Calibrate the model that a run of `workbench diagnose` found.",
    ),
]
Without = Annotated[
    list[str] | None,
    typer.Option(
        "--without",
        metavar="TERM",
        help="Switch off a term by name, as joint-3.backlash; * is a wildcard. Once for each.",
    ),
]
FitSamples = Annotated[
    Path | None,
    typer.Option(
        "--fit-samples", metavar="FILE", help="Samples to fit: one sample number per line."
    ),
]
TestSamples = Annotated[
    Path | None,
    typer.Option(
        "--test-samples", metavar="FILE", help="Samples to hold out: one sample number per line."
    ),
]
SessionFile = Annotated[
    Path | None,
    typer.Option(
        "--session",
        metavar="FILE",
        help="Repeat an edit session of `workbench open` (session.toml); replaces RECORDING, --plan and --folds.",
    ),
]
Folds = Annotated[int, typer.Option("--folds", min=2, help="Blocks of the cross-validation.")]


def command(
    recording: Annotated[
        str | None, typer.Argument(help="Folder of a recording, or a known name.")
    ] = None,
    plan: Plan = None,
    from_diagnosis: FromDiagnosis = None,
    without: Without = None,
    fit_samples: FitSamples = None,
    test_samples: TestSamples = None,
    folds: Folds = 10,
    scanner: answer.ScannerFile = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    trust_data: answer.TrustData = False,
    no_report: answer.NoReport = False,
    tolerance: answer.Tolerance = None,
    session: SessionFile = None,
) -> None:
    """Calibrate the robot of a recording and state the held-out errors in mm.

    For a recording with images of scans, the scanner is calibrated first (without --scanner), then
    point clouds and ball centres are computed.
    """
    answer.check_target(json)
    if session is not None:
        from workbench.commands.robot.edit_session import calibrate_session

        options = {"RECORDING": recording, "--plan": plan, "--scanner": scanner}
        options |= {"--fit-samples": fit_samples, "--test-samples": test_samples}
        return calibrate_session(session, options, out, json, tolerance, not no_report)
    if recording is None:
        raise InputError(
            "workbench calibrate: expected a recording or --session FILE, found neither; name one."
        )
    with answer.progress(f"reading {recording}") as say:
        import datasets

        found = datasets.read(recording, trust_data)
        known = frozenset(found.sample_ids.tolist())
        fit = samples.read_list(fit_samples, known, "--fit-samples")
        test = samples.read_list(test_samples, known, "--test-samples")
        samples.check_apart(fit, test, test_samples)
        tolerances = answer.read_tolerances(tolerance, found.measures)
        stages = _plan(plan, from_diagnosis, without)
        options = dict(
            plan=stages, fit_samples=fit, test_samples=test, folds=folds, trust_data=trust_data
        )
        check_scanner(found, scanner)
        result, run = solve(found, recording, options, say, out, not no_report, scanner, tolerances)
    return deliver(result, run, json)


def _plan(plan: Path | None, run: Path | None, without: list[str] | None):
    """Stages of a plan file or of a diagnosis run, without the terms that are switched off; None: the default plan.

    Raises InputError.
    """
    if plan is not None and run is not None:
        raise InputError(
            "--plan and --from-diagnosis: expected one of them, found both; leave one out."
        )
    if run is not None and not (run / "plan.toml").is_file():
        raise InputError(
            f"--from-diagnosis {run}: expected the run folder of `workbench diagnose` with a plan.toml, found none; "
            "name the folder that the diagnosis printed."
        )
    named = run if run is not None else plan
    if not without:
        return named
    if named is None:
        raise InputError(
            "--without: expected --plan or --from-diagnosis, whose terms have names, found neither; name one."
        )
    from workbench.fitting.plan_file import without_terms
    from workbench.fitting.plans import read_plan

    return without_terms(read_plan(named), without, str(named))


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
    say,
    out: Path | None,
    report: bool,
    scanner: Path | None = None,
    tolerances: Sequence[Tolerance] = (),
):
    """Calibrate, save and report into a run folder. Returns the answer and the run.

    found: a `datasets.recording.Recording`; options: keyword arguments of `workbench.jobs.calibrate.calibrate`;
    scanner: scanner file for a recording of scans; None calibrates one. tolerances: of the verdict. Raises InputError.
    """
    with runs.opened("calibrate", name, out) as run:
        result = solve_into(
            run.partial, run.path, found, name, options, say, report, scanner, tolerances
        )
    return result, run


def solve_into(
    folder: Path,
    path: Path,
    found,
    name: str,
    options: dict,
    say,
    report: bool,
    scanner: Path | None = None,
    tolerances: Sequence[Tolerance] = (),
) -> dict:
    """Calibrate, save and report into an existing folder with the final name `path`. Returns the answer.

    Arguments as in `solve`. Raises InputError.
    """
    from workbench.fitting.verdicts.calibration_verdict import calibration_verdict
    from workbench.jobs.calibrate import calibrate, save

    scans, sensor_keys = None, {}
    if found.measures == "scan-images":
        scans, sensor_keys, found, options = _centres(found, scanner, folder, path, options, say)
    say(f"calibrating {name}")
    calibration = calibrate(found, progress=say, **options)
    verdict = calibration_verdict(calibration.held_out, calibration.noise, tolerances)
    result = {
        **calibration.as_json(),
        **sensor_keys,
        "verdict": verdict.as_json(),
        "input": runs.input_name(name),
        "options": _stated_options(options, scanner),
        "run": path,
    }
    save(calibration, folder)
    if report:
        say("writing the report")
        _report(calibration, scans, folder)
    runs.replace_file(folder / "answer.json", answer.as_text(result))
    return result


def _stated_options(options: dict, scanner: Path | None) -> dict:
    """What the command line said of the calibration: plan, folds, scanner, trust_data."""
    plan = options.get("plan")
    return {
        "plan": str(plan) if isinstance(plan, str | Path) else None,
        "folds": options.get("folds", 10),
        "scanner": None if scanner is None else str(scanner),
        "trust_data": options.get("trust_data", False),
    }


def _centres(found, scanner, folder, path, options, say):
    """Scans, their part of the answer, the recording of ball centres, and the options for its calibration."""
    from workbench.jobs import ball_centres, scan

    ball_centres.check_arm(found)
    scans = scan.scan(found, scanner, folder, say)
    ball_centres.save(scans, folder)
    made = ball_centres.required(scans)
    sensor_keys = {"sensor": ball_centres.as_json(scans, path)}
    if scans.calibration is not None:
        from workbench.jobs.scanner import as_json

        sensor_keys["sensor"]["calibration"] = as_json(scans.calibration)
    lists = {
        key: ball_centres.renumbered(scans, made, options.get(key))
        for key in ("fit_samples", "test_samples")
    }
    return scans, sensor_keys, made, {**options, **lists}


def deliver(result: dict, run: runs.Run, json: str | None) -> None:
    """Print the answer, write the JSON, print the folder last, and exit with status 1 if a tolerance is not met."""
    answer.deliver(result, json)
    console = answer.console(json)
    tables.calibration(console, result)
    answer.conclude(console, result, run.path)


def _report(calibration, scans, folder: Path) -> None:
    from workbench.report import write_report

    more = ()
    if scans is not None:
        from workbench.report.sensor.scan import chain

        more = chain(scans)
    write_report(calibration, folder, more)
