"""`workbench calibrate --session`: repeats what was edited in the app of `workbench open`."""

from collections.abc import Mapping
from pathlib import Path

from workbench.commands.shared import answer
from workbench.core.errors import InputError
from workbench.files import runs


def calibrate_session(
    path: Path,
    options: Mapping,
    out: Path | None,
    json: str | None,
    tolerance: list[str] | None,
    report: bool,
) -> None:
    """Calibrate as the session at `path` says, into a run folder that also holds the session.

    options: option of the command -> value; all of them must be None, since the session states them.
    Raises InputError.
    """
    from workbench.app.edits.apply import EditedPlan, edited_recording
    from workbench.app.edits.session import CALIBRATE, NAME, read_session
    from workbench.commands.robot.calibration_run import check_scanner, deliver, solve_into

    check_unused(path, options)
    session = read_session(path, CALIBRATE)
    with answer.progress(f"reading {session.recording}") as progress:
        import datasets

        found = edited_recording(session, datasets.read(session.recording, session.trust_data))
        scanner = Path(session.scanner) if session.scanner else None
        check_scanner(found, scanner)
        tolerances = answer.read_tolerances(tolerance, found.measures)
        keywords = {
            "plan": EditedPlan(session),
            "folds": session.folds,
            "trust_data": session.trust_data,
        }
        with runs.opened("calibrate", session.recording, out) as run:
            result = solve_into(
                run.partial,
                run.path,
                found,
                session.recording,
                keywords,
                progress,
                report,
                scanner,
                tolerances,
            )
            session.save(run.partial / NAME)
    deliver(result, run, json)


def check_unused(path: Path, options: Mapping) -> None:
    """Raise InputError where an option (name -> value, None where left out) is given that the session states."""
    for name, value in options.items():
        if value is not None:
            raise InputError(
                f"--session {path} with {name}: expected one of them, because the session names the recording and its "
                f"options; leave {name} out"
            )


def session_of(path: Path | None, command: str, recording: str | None, scanner: Path | None):
    """The session that a command takes its recording and scanner from; None where a recording is named.

    Raises InputError where both or neither are named.
    """
    if path is None:
        if recording is None:
            raise InputError(
                f"workbench {command}: expected a recording or --session FILE, found neither; name one."
            )
        return None
    from workbench.app.edits.session import read_session

    check_unused(path, {"RECORDING": recording, "--scanner": scanner})
    return read_session(path)


def session_stated(path: Path | None, command: str, given: Mapping):
    """The session that states all options of a command; None where a recording is named.

    given: option -> value, None where left out; the recording is RECORDING. Raises InputError where both or neither
    are named, and for a session of another command.
    """
    if path is None:
        if given["RECORDING"] is None:
            raise InputError(
                f"workbench {command}: expected a recording or --session FILE, found neither; name one."
            )
        return None
    from workbench.app.edits.session import read_session

    check_unused(path, given)
    return read_session(path, command)


def edited(session, recording):
    """The recording without what the session excludes; itself without a session. Raises InputError."""
    if session is None:
        return recording
    from workbench.app.edits.apply import edited_recording

    return edited_recording(session, recording)


def keep(session, folder: Path) -> None:
    """Write the session, where there is one, into the folder of a run."""
    if session is not None:
        from workbench.app.edits.session import NAME

        session.save(folder / NAME)
