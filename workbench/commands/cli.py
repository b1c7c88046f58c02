"""The command line: its commands and the handling of failures.

Exit status: 0 success; 1 the command ran and the answer is "no"; 2 the input or the call is wrong,
with one message on standard error; 70 an internal error of the workbench, with its traceback in a
file; 130 interrupted.
"""

import errno
import os
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from workbench.commands.data import (
    check,
    datasets,
    demo,
    doctor,
    import_data,
    new,
    open,
    prove,
    study,
)
from workbench.commands.robot import (
    calibrate,
    calibrate_large,
    compare,
    compensate,
    diagnose,
    evaluate,
    export,
    identifiability,
    poses,
    register,
    significance,
    simulate,
    stiffness,
)
from workbench.commands.sensor import camera, handeye, render, scan, scanner
from workbench.core import VERSION
from workbench.core.errors import InputError, Stopped
from workbench.machine.doctor import missing_package
from workbench.machine.processes import one_blas_thread

BUG = 70
INTERRUPTED = 130
_STOPPED = "Interrupted; nothing was written."
# Errors of the system that the user can correct; they are not internal errors.
_REFUSALS = {
    errno.EACCES,
    errno.EPERM,
    errno.ENOSPC,
    errno.EROFS,
    errno.EDQUOT,
    errno.ENAMETOOLONG,
    errno.ELOOP,
    errno.ENOTDIR,
    errno.EIO,
    errno.EMFILE,
    errno.ENFILE,
}
_FULL = {errno.ENOSPC, errno.EDQUOT}

# rich takes a quarter of a second to load; without a terminal it is not used.
app = typer.Typer(
    name="workbench",
    help="Calibrate a robot arm and its scanner; find and correct unmodelled effects.",
    add_completion=False,
    rich_markup_mode="rich" if sys.stdout.isatty() else None,
    pretty_exceptions_enable=False,
)
app.command("new", short_help="Write a template of a recording for your own data.")(new.command)
app.command("import", short_help="Make a recording from tables, logs, images or clouds.")(
    import_data.command
)
app.command("check", short_help="Check the quality of a recording before calibration.")(
    check.command
)
app.command("calibrate", short_help="Calibrate an arm; state its held-out errors.")(
    calibrate.command
)
app.command("calibrate-large", short_help="Calibrate an arm from millions of samples.")(
    calibrate_large.command
)
app.command("compare", short_help="Compare plans by cross-validation on equal folds.")(
    compare.command
)
app.command("evaluate", short_help="Test a calibrated model on another recording.")(
    evaluate.command
)
app.command("camera", short_help="Calibrate a camera from images of a board.")(camera.command)
app.command("scanner", short_help="Calibrate camera, light planes and mirror of a scanner.")(
    scanner.command
)
app.command("scan", short_help="Compute point clouds and ball centres from scans.")(scan.command)
app.command("handeye", short_help="Estimate the hand-eye transform of a sensor.")(handeye.command)
app.command("render", short_help="Render images of a scene as a recording.")(render.command)
app.command("simulate", short_help="Simulate a recording from a scene.")(simulate.command)
app.command("study", short_help="Repeat simulations or fits with varied parameters.")(study.command)
app.command("diagnose", short_help="Identify unmodelled effects of a recording.")(diagnose.command)
app.command("prove", short_help="Run the blind benchmark of the diagnosis.")(prove.command)
app.command("poses", short_help="Select the most informative measurement poses.")(poses.command)
app.command("compensate", short_help="Correct the targets of a robot program.")(compensate.command)
app.command("export", short_help="Export a model as Python, URDF, MJCF, ROS, ...")(export.command)
app.command("identifiability", short_help="List identifiable and confounded parameters.")(
    identifiability.command
)
app.command("significance", short_help="Compute the effect of each parameter on the flange pose.")(
    significance.command
)
app.command("register", short_help="Register points to those of a tracker.")(register.command)
app.command("stiffness", short_help="Compute compliance, and deflection under a wrench.")(
    stiffness.command
)
app.add_typer(datasets.app, name="datasets", short_help="List or download public recordings.")
app.command("open", short_help="Show and edit a run or a recording in the browser.")(open.command)
app.command("doctor", short_help="Check the installation.")(doctor.command)
app.command("demo", short_help="Run a complete example, from images to a calibrated arm.")(
    demo.command
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"vision-sensor-workbench {VERSION}")
        raise typer.Exit()


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Calibrate a robot arm and its scanner; find and correct unmodelled effects."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command line and return its exit status; all exceptions become messages.

    arguments: the words after `workbench`; None takes them from the process.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # warnings of numpy would hide the message
    one_blas_thread()
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        status = int(app(args=words, prog_name="workbench", standalone_mode=False) or 0)
        return _say(_STOPPED, INTERRUPTED) if status == INTERRUPTED else status
    except (KeyboardInterrupt, typer.Abort):
        return _say(_STOPPED, INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return _failed(error)


def _failed(error: Exception) -> int:
    if isinstance(error, InputError):
        status = _say(str(error), 2)
        if error.example:
            print(f"\n{error.example}", file=sys.stderr)
        return status
    if isinstance(error, Stopped):
        return _say(str(error), INTERRUPTED)
    if isinstance(error, typer.TyperException):
        return _say(_wrong_call(error), 2)
    if isinstance(error, ImportError) and (sentence := missing_package(error)):
        return _say(sentence, 2)
    if isinstance(error, OSError) and not _has_working_directory():
        return _say(
            "The working directory was removed, so files cannot be found or written there. "
            "Change to another folder and repeat the command.",
            2,
        )
    if isinstance(error, OSError) and error.errno in _REFUSALS and error.filename:
        return _say(
            f"{error.filename} cannot be used ('{error.strerror}'). "
            "Choose another path or change its permissions.",
            2,
        )
    if isinstance(error, OSError) and error.errno in _FULL:
        return _say(
            f"The disk is full ('{error.strerror}'), so the result is not written. "
            "Free space or name a folder on another disk, and repeat the command.",
            2,
        )
    if isinstance(error, MemoryError):
        return _say(
            "The memory of this machine does not suffice for this input. "
            "Use fewer samples or smaller images, or another machine.",
            2,
        )
    return _say(
        f"This is a bug of the workbench, not of your input ({type(error).__name__}). "
        f"Please report it with the file {_traceback_file(error)}, which holds the traceback.",
        BUG,
    )


def _has_working_directory() -> bool:
    try:
        return bool(os.getcwd())
    except OSError:
        return False


def _wrong_call(error: typer.TyperException) -> str:
    """One sentence on the error that the command-line parser reports."""
    context = getattr(error, "ctx", None)
    path = context.command_path if context else "workbench"
    found = " ".join(error.format_message().split()).rstrip(".?")
    return f"{path}: {found}; `{path} --help` lists the arguments and options."


def _traceback_file(error: Exception) -> Path:
    import traceback

    with tempfile.NamedTemporaryFile(
        "w", prefix="workbench-bug-", suffix=".txt", delete=False, encoding="utf-8"
    ) as file:
        file.write(f"vision-sensor-workbench {VERSION}, Python {sys.version}\n")
        file.write(f"arguments: {sys.argv[1:]}\n")
        file.writelines(traceback.format_exception(error))
    return Path(file.name)


def _say(sentence: str, status: int) -> int:
    print(" ".join(sentence.split()), file=sys.stderr)
    return status
