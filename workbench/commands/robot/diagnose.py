"""`workbench diagnose`: unmodelled effects of a recording, their places, and their validation."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from workbench.commands.robot import edit_session as sessions
from workbench.commands.shared import answer, tables
from workbench.core.errors import InputError
from workbench.files import runs
from workbench.fitting.verdicts.verdict import parse_tolerances

_DIFFERENT = 0.1
"""Relative difference of two held-out errors from which on both are shown."""
_DEGREES = 57.29577951308232  # of a radian

Simulation = Annotated[
    Path | None,
    typer.Option(
        "--simulation",
        metavar="FILE",
        help="Compare with this simulation: a scene (TOML), an MJCF (.xml) or URDF file (FILE#LINK).",
    ),
]
Solution = Annotated[
    Path | None,
    typer.Option(
        "--solution", metavar="FILE", help="Compare with this earlier calibration (solution.json)."
    ),
]
SessionFile = Annotated[
    Path | None,
    typer.Option(
        "--session",
        metavar="FILE",
        help="Leave out the data that an edit session of `workbench open` excludes (session.toml); replaces RECORDING.",
    ),
]
ScannerFile = Annotated[
    Path | None,
    typer.Option(
        "--scanner",
        metavar="FILE",
        help="Measure ball centres in the scans with this calibrated scanner (scanner.toml) and diagnose these, "
        "instead of the images.",
    ),
]
Baseline = Annotated[
    Literal["geometry", "joint-compliance"],
    typer.Option(
        "--baseline", help="Model before the search: geometry, or geometry and joint compliance."
    ),
]


def command(
    recording: Annotated[str | None, answer.RECORDING] = None,
    simulation: Simulation = None,
    solution: Solution = None,
    baseline: Baseline = "geometry",
    scanner: ScannerFile = None,
    jobs: answer.Jobs = None,
    out: answer.OutFolder = None,
    json: answer.JsonTarget = None,
    trust_data: answer.TrustData = False,
    no_report: answer.NoReport = False,
    tolerance: answer.Tolerance = None,
    session: SessionFile = None,
) -> None:
    """Find unmodelled effects in a recording: physical cause, place, size and probability, and a corrected model."""
    answer.check_target(json)
    edits = sessions.session_of(session, "diagnose", recording, scanner)
    recording, scanner, trust_data = _subject(edits, recording, scanner, trust_data)
    with answer.progress(f"reading {recording}") as progress:
        from workbench.machine.processes import cores, one_thread

        one_thread()  # matrices are small: several threads would slow one another down
        import datasets

        found = sessions.edited(edits, datasets.read(recording, trust_data))
        _check_options(found, simulation, solution, scanner)
        tolerances = parse_tolerances(tolerance, _units(found, scanner))
        options = {
            "baseline": baseline,
            "simulation": simulation,
            "solution": solution,
            "jobs": jobs or cores(),
            "trust_data": trust_data,
        }
        with runs.opened("diagnose", recording, out) as run:
            found, sensor_keys = _subject_of(found, scanner, run, progress)
            result = _diagnosed(
                found, recording, options, tolerances, (run, edits, no_report, progress)
            )
            of_sensor = sensor_keys.get("sensor", {}).get("warnings", ())
            result["warnings"] = [*of_sensor, *result["warnings"]]
            result |= sensor_keys
            runs.replace_file(run.partial / "answer.json", answer.as_text(result))
    answer.deliver(result, json)
    console = answer.console(json)
    show(console, result)
    answer.conclude(console, result, run.path)


def _subject_of(found, scanner: Path | None, run, progress):
    """What is diagnosed: the recording, or the ball centres of its scans; and keys of the scans for the answer."""
    return (found, {}) if scanner is None else _ball_centres_of(found, scanner, run, progress)


def _ball_centres_of(found, scanner: Path, run, progress):
    """Ball centres of the scans of a recording, saved in the run; and keys of the scans for the answer."""
    from workbench.jobs.sensor import ball_centres, scan

    ball_centres.check_poses(found)
    scans = scan.scan(found, scanner, run.partial, progress)
    centres = ball_centres.required(scans)
    ball_centres.save(scans, run.partial)
    return centres, {"sensor": ball_centres.as_json(scans, run.path)}


def _diagnosed(found, recording: str, options: dict, tolerances, target) -> dict:
    """Diagnose an arm or a sensor into the folder of the run. Returns the answer.

    options: keyword arguments of `explanation.answer.diagnose`; target: run, edit session or None, whether to write
    no report, and what to call with the progress.
    """
    from workbench.diagnosis.scanner.surface import is_surface

    run, edits, no_report, progress = target
    if is_surface(found):
        return _diagnose_sensor(found, recording, run, no_report, tolerances, progress)
    from workbench.explanation.answer import diagnose
    from workbench.explanation.output.corrected_model import write_model
    from workbench.explanation.output.files import save
    from workbench.fitting.verdicts.diagnosis_verdict import check_diagnosis

    diagnosis = diagnose(
        found,
        progress=progress,
        first=progress.note,
        provisional=lambda first: _keep(first, recording, run),
        **options,
    )
    save(diagnosis, run.partial)
    sessions.keep(edits, run.partial)
    model = write_model(diagnosis, found, run.partial, progress, options["trust_data"])
    result = diagnosis.as_json()
    result |= check_diagnosis(diagnosis, found, tolerances).keys(result)
    if not no_report:
        _report(diagnosis, run.partial, progress)
    return result | {
        "model": model.as_json(run.path),
        "input": runs.input_name(recording),
        "run": run.path,
    }


def _keep(first: dict, recording: str, run) -> None:
    """Write the first result to the run folder, where it stays if the command is interrupted."""
    input_name = runs.input_name(recording)
    runs.write_provisional(run, answer.as_text({**first, "input": input_name, "run": run.path}))


def _diagnose_sensor(found, recording: str, run, no_report: bool, tolerances, progress) -> dict:
    """Diagnose a profiler, a 3-D camera or measured ball centres with flange poses. Returns the answer."""
    from workbench.diagnosis.scanner.surface import diagnose_surface
    from workbench.fitting.verdicts.verdict import Noise, Residual, judge
    from workbench.report.diagnosis.surface import page
    from workbench.report.page import write_sheet

    diagnosis = diagnose_surface(found, progress)
    result = diagnosis.as_json()
    held_out = result["held_out"]
    error = Residual(held_out["after_mm"], "mm", diagnosis.error_name)
    noise = None
    if held_out["noise_mm"] is not None:
        noise = Noise(held_out["noise_mm"], held_out["noise_from"])
    verdict = judge(error, noise, tolerances, "an effect of the sensor that no test names")
    result |= {"verdict_details": verdict.as_json(), "run": run.path}
    result["input"] = runs.input_name(recording)
    if not no_report:
        write_sheet(page(diagnosis, result), run.partial)
    return result


def _subject(edits, recording: str | None, scanner: Path | None, trust_data: bool):
    """Recording, scanner file and trust of the call, or of the edit session where one is given."""
    if edits is None:
        return recording, scanner, trust_data
    return edits.recording, Path(edits.scanner) if edits.scanner else None, edits.trust_data


def _check_options(found, simulation: Path | None, solution: Path | None, scanner) -> None:
    _check_scanner(found, scanner)
    if simulation is not None and solution is not None:
        raise InputError("--simulation and --solution: expected one of them, found both; omit one.")


def _units(recording, scanner: Path | None) -> tuple[str, ...]:
    """Residuals of calibration images are in pixels, all others, and ball centres of a scanner, in millimetres."""
    from workbench.explanation.answer import IMAGES

    return ("px",) if recording.measures in IMAGES and scanner is None else ("mm",)


def _check_scanner(found, scanner: Path | None) -> None:
    if scanner is not None and found.measures != "scan-images":
        raise InputError(
            f"--scanner {scanner} expects a scan-images recording, found one of {found.measures}; "
            "omit the option."
        )


def _report(diagnosis, folder: Path, progress) -> None:
    progress("writing the report")
    from workbench.report.diagnosis.page import page
    from workbench.report.diagnosis.summary_image import write_summary
    from workbench.report.page import write_sheet

    write_sheet(page(diagnosis), folder)
    write_summary(diagnosis, folder / "summary.png")


def show(console, result) -> None:
    """Print the answer of `diagnose --json`."""
    from workbench.explanation.noise.replicates import UNKNOWN

    unit, held_out = result["unit"], result["held_out"]
    console.print(f"{result['recording']}: {result['verdict']}", style="bold", markup=False)
    tables.warnings(console, result)
    console.print()
    for found in result["effects"]:
        console.print(f"- {found['statement']}", markup=False)
    for sentence in (result.get("turntable") or {}).get("statements", ()):
        console.print(f"- {sentence}", markup=False)
    for found in result["refused"]:
        console.print(f"- not retained: {found['statement']}", markup=False, style="dim")
    console.print()
    names = {
        "before": "baseline",
        "after": "with the findings",
        "expected": "expected of a right model",
        "noise": "noise, at most" if held_out["noise_from"] == UNKNOWN else "noise",
    }
    units = [unit, "deg"] if "after_deg" in held_out else [unit]
    rows = [
        [name, *(held_out.get(f"{key}_{unit}") for unit in units)] for key, name in names.items()
    ]
    scheme = f" ({held_out['scheme']})" if held_out["scheme"] else ""
    title = (
        f"Held-out error, RMS, {held_out['folds']} folds{scheme}; noise {held_out['noise_from']}"
    )
    tables.grid(console, title, ["error", *units], rows)
    _show_written_model(console, held_out, unit)
    _show_other_schemes(console, held_out, unit)
    _show_sensor(console, result)
    if (shares := result["against"]) is not None:
        _show_shares(console, shares)
    if result["differences"] is not None:
        _show_differences(console, result["differences"])
    console.print(f"Next: {result['next_experiment']}", markup=False)
    model = result.get("model") or {}
    for sentence in model.get("left_out", ()) if model.get("plan") else ():
        console.print(f"Corrected model: {sentence.rstrip('.')}.", markup=False)


def _show_shares(console, shares) -> None:
    """Parts of the mean squared distance from the reference; base and tool stand elsewhere in any new session."""
    rows = [
        ["base and tool", shares["placing_mm2"]],
        ["other parameters", shares["parameters_mm2"] - shares["placing_mm2"]],
        ["noise", shares["noise_mm2"]],
        ["structure", shares["structure_mm2"]],
    ]
    tables.grid(console, f"Difference from {shares['reference']}", ["", "mm²"], rows)


def _show_written_model(console, held_out, unit: str) -> None:
    """The held-out error of the model that is written, where a search in the folds finds other terms."""
    searched, written = held_out[f"after_{unit}"], held_out.get(f"after_same_terms_{unit}")
    if written and searched is not None and abs(searched - written) > _DIFFERENT * written:
        console.print(
            f"{searched:.4g} {unit} is the error where the search is repeated in every fold, and finds other terms in "
            f"some of them. The model that is written has the findings above: {written:.4g} {unit} with these in "
            "every fold.",
            markup=False,
        )


def _show_other_schemes(console, held_out, unit: str) -> None:
    """The held-out errors by the other ways to leave samples out that can judge the findings."""
    for row in held_out.get("schemes", ()):
        if not row["judges"] or row["folds_by"] == held_out["scheme"]:
            continue
        figures = [
            f"By {row['folds_by']}, {row['folds']} folds: {row['before']:.4g} {unit} for the baseline",
            f"{row['after_same_terms']:.4g} {unit} with the findings above in every fold",
        ]
        if row.get("nested", True):
            figures.insert(1, f"{row['after']:.4g} {unit} with what the search finds in each fold")
        else:
            figures[1] += ", in which the search was not repeated"
        console.print(", ".join(figures) + ".", markup=False)


def _show_sensor(console, result) -> None:
    """Held-out errors by kind of measurement, and how far ball centres move, of a sensor."""
    kinds = result["held_out"].get("by_kind", [])
    if kinds:
        _show_kinds(console, kinds)
    balls = result.get("ball_centres")
    if balls is not None and balls["moved_rms_mm"] > 0:
        console.print(_moved_balls(balls), markup=False)


def _show_kinds(console, kinds: list) -> None:
    keys = ("kind", "before_px", "after_px", "noise_px")
    head = ["", "baseline px", "with what was found px", "noise px"]
    title = "Held-out error by kind of measurement; board poses held by their corners"
    tables.grid(console, title, head, [[row[key] for key in keys] for row in kinds])


def _moved_balls(balls) -> str:
    """How far ball centres of a scanner calibrated from boards alone are off without what was found."""
    moved = f"{balls['moved_rms_mm']:.4f} mm RMS"
    if balls["error_rms_mm"] is None:
        return (
            f"Ball centres move by {moved}, at most {balls['moved_largest_mm']:.4f} mm, with what was found. This "
            "includes a rigid motion, which the hand-eye transform absorbs: there are too few balls to separate it."
        )
    worst = max(balls["centres"], key=lambda row: row["error_mm"])
    name = "a ball" if worst["ball"] is None else f"ball {worst['ball']}"
    return (
        f"Without what was found, ball centres are off by {balls['error_rms_mm']:.4f} mm RMS relative to one another, "
        f"at most {worst['error_mm']:.4f} mm ({name} of scan {worst['scan']}). With the rigid motion that the "
        f"hand-eye transform absorbs, they move by {moved}."
    )


def _show_differences(console, found) -> None:
    """Parameters, noise and physics by which a recording differs from its simulation."""
    rows = []
    for row in found["parameters"]:
        unit, factor = ("deg", _DEGREES) if row["unit"] == "rad" else (row["unit"], 1.0)
        size, std = factor * row["value"], factor * row["std"]
        rows.append([f"{row['where']} {row['name']}", size, std, unit, row["sigmas"]])
    title = f"Parameters that differ, of {found['parameters_tested']}"
    head = ["parameter", "difference", "std", "unit", "sigmas"]
    if rows:
        tables.grid(console, title, head, rows)
    else:
        console.print("No parameter of the geometry differs significantly.")
    for row in found["parameters"]:
        if others := row["confounded_with"]:
            console.print(
                f"{row['where']} {row['name']} may stand for {', or '.join(others)}: they explain this recording about "
                "as well.",
                markup=False,
            )
    noise = found["noise"]
    if noise["factor"] is not None:
        console.print(
            f"Noise: stated {noise['stated']:.3g} mm, found {noise['found']:.3g} mm, factor {noise['factor']:.3g}."
        )
    names = (
        ", ".join(f"{effect['effect']} at {effect['where']}" for effect in found["physics"])
        or "none"
    )
    console.print(f"Physics that is not in the simulation: {names}.", markup=False)
