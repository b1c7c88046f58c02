"""`workbench calibrate`: a recording in, parameters, held-out errors and a report page out."""

from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.robot.calibration_run import check_scanner, deliver, solve
from workbench.commands.shared import answer, samples
from workbench.core.errors import InputError

Plan = Annotated[
    Path | None,
    typer.Option(
        "--plan", metavar="FILE", help="Calibration plan (TOML) instead of the default stages."
    ),
]
FromDiagnosis = Annotated[
    Path | None,
    typer.Option(
        "--from-diagnosis",
        metavar="RUN",
        help="Use the corrected model of this run of `workbench diagnose` as the plan.",
    ),
]
WithoutOption = Annotated[
    list[str] | None,
    typer.Option(
        "--without",
        metavar="TERM",
        help="Omit a term of the model by name, such as joint-3.backlash; * is a wildcard. Repeatable.",
    ),
]
FitSamples = Annotated[
    Path | None,
    typer.Option(
        "--fit-samples",
        metavar="FILE",
        help="Samples to fit: a file with one sample number per line.",
    ),
]
TestSamples = Annotated[
    Path | None,
    typer.Option(
        "--test-samples",
        metavar="FILE",
        help="Samples to hold out: a file with one sample number per line.",
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
Folds = Annotated[
    int, typer.Option("--folds", min=2, help="Number of folds of the cross-validation.")
]


def command(
    recording: Annotated[str | None, answer.RECORDING] = None,
    plan: Plan = None,
    from_diagnosis: FromDiagnosis = None,
    without: WithoutOption = None,
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
    """Calibrate the arm of a recording: parameters, held-out errors in mm, and a report page.

    For a recording with images of scans, the scanner is calibrated first (without --scanner), then
    point clouds and ball centres are computed. Rows that `workbench check` names as wrong are left out
    and listed. Exit status 1 if the recording is in doubt, poses that were left out are predicted far
    worse than the noise explains, or a tolerance is not met.
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
    with answer.progress(f"reading {recording}") as progress:
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
        result, run = solve(
            found, recording, options, progress, out, not no_report, scanner, tolerances
        )
    return deliver(result, run, json)


def _plan(plan: Path | None, run: Path | None, excluded_terms: list[str] | None):
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
    if not excluded_terms:
        return named
    if named is None:
        raise InputError(
            "--without: expected --plan or --from-diagnosis, whose terms have names, found neither; name one."
        )
    from workbench.fitting.calibration_plans.plan_file import without_terms
    from workbench.fitting.calibration_plans.plans import read_plan

    return without_terms(read_plan(named), excluded_terms, str(named))
