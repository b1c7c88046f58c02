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
from workbench.commands.shared.help import Command, Group
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
    cls=Group,
    help="Calibrate a robot arm and its scanner; find and correct unmodelled effects.",
    add_completion=False,
    rich_markup_mode="rich" if sys.stdout.isatty() else None,
    pretty_exceptions_enable=False,
)
# Group of the list of commands -> name, function, short help, example.
_COMMANDS = {
    "Calibrate an arm": (
        (
            "import",
            import_data,
            "Convert your tables, logs, images or clouds to a recording.",
            "joints.csv tracker.csv --robot ur10 --out my-robot",
        ),
        ("check", check, "Check the quality of a recording before calibration.", "my-robot"),
        (
            "calibrate",
            calibrate,
            "Calibrate an arm; state its held-out errors.",
            "my-robot --out arm",
        ),
        (
            "compensate",
            compensate,
            "Correct the targets of a robot program.",
            "arm targets.csv --out corrected",
        ),
        (
            "diagnose",
            diagnose,
            "Find the physical causes of the remaining errors.",
            "my-robot --out diagnosis",
        ),
        (
            "evaluate",
            evaluate,
            "Test a calibrated model on another recording.",
            "arm second-recording --tolerance 0.2mm",
        ),
        (
            "export",
            export,
            "Export a model as Python, URDF, MJCF, ROS, ...",
            "arm --to urdf --out arm.urdf",
        ),
    ),
    "Calibrate a camera or scanner": (
        ("camera", camera, "Calibrate a camera from images of a board.", "my-camera --out camera"),
        (
            "handeye",
            handeye,
            "Estimate the hand-eye transform of a sensor.",
            "my-hand-eye --out hand-eye",
        ),
        (
            "scanner",
            scanner,
            "Calibrate camera, light planes and mirror of a scanner.",
            "my-cell --out scanner.toml",
        ),
        (
            "scan",
            scan,
            "Compute point clouds and ball centres from scans.",
            "my-cell --scanner scanner.toml --out scans",
        ),
    ),
    "Plan measurements": (
        (
            "new",
            new,
            "Write a template of a recording for your own data.",
            "external-point my-robot --robot ur10",
        ),
        ("poses", poses, "Select the most informative measurement poses.", "my-robot --count 40"),
        (
            "identifiability",
            identifiability,
            "List identifiable and confounded parameters.",
            "my-robot",
        ),
        (
            "significance",
            significance,
            "Compute the effect of each parameter on the flange pose.",
            "ur10",
        ),
        ("simulate", simulate, "Simulate a recording from a scene.", "scene.toml --out simulated"),
        ("render", render, "Render images of a scene as a recording.", "scene.toml --out rendered"),
    ),
    "Compare and study": (
        (
            "compare",
            compare,
            "Compare plans by cross-validation on equal folds.",
            "my-robot --plan default --plan plan.toml",
        ),
        (
            "calibrate-large",
            calibrate_large,
            "Calibrate an arm from millions of samples.",
            "my-recording",
        ),
        (
            "register",
            register,
            "Register points to those of a tracker.",
            "arm-points.csv tracker-points.csv",
        ),
        (
            "stiffness",
            stiffness,
            "Compute compliance, and deflection under a wrench.",
            "arm poses.csv --wrench 0 0 -100 0 0 0",
        ),
        ("study", study, "Repeat simulations or fits with varied parameters.", "compliance-error"),
        ("prove", prove, "Run the blind benchmark of the diagnosis.", "--suite library --cases 20"),
    ),
    "Help and examples": (
        ("open", open, "Show and edit a run or a recording in the browser.", "arm"),
        ("demo", demo, "Run a complete example, from images to a calibrated arm.", "--bundled"),
        ("doctor", doctor, "Check the installation.", ""),
    ),
}
for _group, _entries in _COMMANDS.items():
    for _name, _module, _help, _example in _entries:
        app.command(
            _name,
            cls=Command,
            short_help=_help,
            rich_help_panel=_group,
            epilog=f"Example: workbench {_name} {_example}".rstrip(),
        )(_module.command)
app.add_typer(
    datasets.app,
    name="datasets",
    short_help="List or download public recordings.",
    rich_help_panel="Help and examples",
)


def _print_version(is_asked: bool) -> None:
    if is_asked:
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
        return _print_error(_STOPPED, INTERRUPTED) if status == INTERRUPTED else status
    except (KeyboardInterrupt, typer.Abort):
        return _print_error(_STOPPED, INTERRUPTED)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        return _failed(error)


def _failed(error: Exception) -> int:
    if isinstance(error, InputError):
        status = _print_error(str(error), 2)
        if error.example:
            print(f"\n{error.example}", file=sys.stderr)
        return status
    if isinstance(error, Stopped):
        return _print_error(str(error), INTERRUPTED)
    if isinstance(error, typer.TyperException):
        return _print_error(_wrong_call(error), 2)
    if isinstance(error, ImportError) and (sentence := missing_package(error)):
        return _print_error(sentence, 2)
    if isinstance(error, OSError) and not _has_working_directory():
        return _print_error(
            "The working directory was removed, so files cannot be found or written there. "
            "Change to another folder and repeat the command.",
            2,
        )
    if isinstance(error, OSError) and error.errno in _REFUSALS and error.filename:
        return _print_error(
            f"{error.filename} cannot be used ('{error.strerror}'). "
            "Choose another path or change its permissions.",
            2,
        )
    if isinstance(error, OSError) and error.errno in _FULL:
        return _print_error(
            f"The disk is full ('{error.strerror}'), so the result is not written. "
            "Free space or name a folder on another disk, and repeat the command.",
            2,
        )
    if isinstance(error, MemoryError):
        return _print_error(
            "The memory of this machine does not suffice for this input. "
            "Use fewer samples or smaller images, or another machine.",
            2,
        )
    return _print_error(
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


def _print_error(sentence: str, status: int) -> int:
    print(" ".join(sentence.split()), file=sys.stderr)
    return status
