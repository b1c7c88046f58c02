"""The session that an opened run or recording starts with."""

from dataclasses import replace
from pathlib import Path

from workbench.app.data.opened import Opened
from workbench.app.edits.session import (
    CALIBRATE,
    CAMERA,
    HAND_EYE,
    NAME,
    Session,
    read_session,
)
from workbench.core.errors import InputError


def first_session(opened: Opened, path: Path) -> Session:
    """The session at `path`, else the one that the run was made with, else a new one. Raises InputError."""
    if path.is_file():
        session = read_session(path)
        if session.recording != opened.subject:
            raise InputError(
                f"session {path}, key recording: expected '{opened.subject}', found '{session.recording}'; "
                "name another file with --session"
            )
        if HAND_EYE in (opened.command, session.command) and session.command != opened.command:
            raise InputError(
                f"session {path}, key command: expected that of the opened run, '{opened.command or 'none'}', found "
                f"'{session.command}'; name another file with --session"
            )
        return located(session)
    if opened.folder is not None and (opened.folder / NAME).is_file():
        return located(read_session(opened.folder / NAME))
    options = (opened.answer or {}).get("options", {})
    session = Session(
        opened.subject,
        options.get("plan") or "",
        options.get("scanner") or "",
        int(options.get("folds") or 10),
        bool(options.get("trust_data")),
        command=_command_of(opened),
        camera=options.get("camera") or "",
        kind=options.get("kind") or "",
    )
    return located(session)


def _command_of(opened: Opened) -> str:
    """The command that a rerun calls."""
    if opened.command == HAND_EYE:
        return HAND_EYE
    return CAMERA if opened.recording.measures == "board-images" else CALIBRATE


def located(session: Session) -> Session:
    """The session with whole paths of its plan and scanner: a rerun runs in the folder of the session."""
    from workbench.fitting.calibration_plans.plans import plan_location

    plan = plan_location(session.plan) if session.plan else ""
    scanner = str(Path(session.scanner).resolve()) if session.scanner else ""
    camera = str(Path(session.camera).resolve()) if session.camera else ""
    return replace(session, plan=plan, scanner=scanner, camera=camera)
