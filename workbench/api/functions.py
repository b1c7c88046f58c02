"""Commands as Python functions, made from the commands' own signatures.

A function takes the arguments and options of its command under the same names, runs it in a
temporary run folder (or in `out`), and returns a `Result`. Nothing is written to standard output. Linear algebra uses
one thread meanwhile, unless the environment (OPENBLAS_NUM_THREADS, ...) says otherwise: the matrices are small.
"""

import contextlib
import inspect
import io
import json
import tempfile
import typing
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path

import typer

from workbench.api.examples import example
from workbench.api.inputs import as_argument, sample_list
from workbench.api.results import Result
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_json
from workbench.machine.processes import limited_blas_threads

COMMANDS = {
    "calibrate": "robot.calibrate",
    "calibrate_large": "robot.calibrate_large",
    "compare": "robot.compare",
    "compensate": "robot.compensate",
    "diagnose": "robot.diagnose",
    "export": "robot.export",
    "identifiability": "robot.identifiability",
    "poses": "robot.poses",
    "register": "robot.register",
    "significance": "robot.significance",
    "simulate": "robot.simulate",
    "stiffness": "robot.stiffness",
    "camera": "sensor.camera",
    "hand_eye": "sensor.handeye",
    "render": "sensor.render",
    "scan": "sensor.scan",
    "scanner": "sensor.scanner",
    "check": "data.check",
    "import_data": "data.import_data",
    "new": "data.new",
    "study": "data.study",
    "prove": "data.prove",
    "doctor": "data.doctor",
    "datasets": "data.datasets:listing",
    "demo": "data.demo",
}
"""Function -> module of its command below `workbench.commands`, with the name of its function where it is no `command`.

`workbench open` serves pages until it is interrupted and has no answer, therefore it has no function."""
_SAMPLE_LISTS = ("fit_samples", "test_samples")


@cache
def function(name: str) -> Callable[..., Result]:
    """The function of a command, with its parameters, defaults and a docstring that explains each."""
    module, _, attribute = COMMANDS[name].partition(":")
    command = getattr(import_module(f"workbench.commands.{module}"), attribute or "command")
    own = inspect.signature(command)
    parameters = [parameter for parameter in own.parameters.values() if parameter.name != "json"]

    def call(*args, **options) -> Result:
        bound = signature.bind(*args, **options)
        return run(command, bound.arguments)

    plain = [_without_typer(parameter) for parameter in parameters]
    signature = inspect.Signature(plain, return_annotation=Result)
    call.__signature__ = signature
    call.__name__ = call.__qualname__ = name
    call.__module__ = "workbench"
    call.__doc__ = _docstring(command, parameters, name)
    return call


def run(command: Callable, arguments: dict) -> Result:
    """Run a command in this process; its answer, its text and its folder. Raises InputError."""
    owner = tempfile.TemporaryDirectory(prefix="workbench-", ignore_cleanup_errors=True)
    folder = Path(owner.name)
    accepted = inspect.signature(command).parameters
    given = {
        name: _as_path(_argument(name, value, folder), accepted[name])
        for name, value in arguments.items()
    }
    if "out" in accepted and given.get("out") is None and accepted["out"].default is None:
        given["out"] = folder / "run"
    if "jobs" in accepted and "jobs" not in given:
        given["jobs"] = (
            1  # worker processes import the caller's script again, which may not expect it
        )
    answer_file = folder / "answer.json"
    if "json" in accepted:
        given["json"] = str(answer_file)
    text, status = io.StringIO(), 0
    with contextlib.redirect_stdout(text), limited_blas_threads():
        try:
            command(**given)
        except typer.Exit as end:
            status = end.exit_code
    answer = json.loads(answer_file.read_text(encoding="utf-8")) if answer_file.exists() else {}
    out = given.get("out")
    written = Path(out) if out is not None and Path(out).is_dir() else None
    return Result(
        answer, written, _without_path(text.getvalue(), folder), status == 0, function, owner
    )


def _without_path(text: str, folder: Path) -> str:
    """The text of a command without its last line where that names the temporary folder."""
    lines = text.rstrip().splitlines()
    if lines and str(folder) in lines[-1]:
        lines = lines[:-1]
    return "\n".join(lines).rstrip()


def load(folder: str | Path) -> Result:
    """The result in a run folder, of a command line or of `Result.save`.

    Raises InputError where the folder has no answer.json.
    """
    path = Path(folder) / "answer.json"
    try:
        answer = read_json(path)
    except (OSError, ContentError) as error:
        raise InputError(
            f"{path}: expected the answer of a workbench command, found {error}; name a run folder"
        ) from error
    return Result(answer, Path(folder), commands=function)


def _argument(name: str, value, folder: Path):
    if name in _SAMPLE_LISTS:
        return sample_list(value, name, folder)
    if name == "tolerance":
        return [value] if isinstance(value, str) else value
    if name == "out" and value is not None:
        return Path(value)
    return as_argument(value, name, folder)


def _as_path(value, parameter: inspect.Parameter):
    """Text as a path, where the command takes a path or a list of them."""
    wanted = _without_typer(parameter).annotation
    kinds = {wanted, *typing.get_args(wanted)}
    if isinstance(value, str) and Path in kinds and str not in kinds:
        return Path(value)
    if isinstance(value, list | tuple) and any(typing.get_args(kind) == (Path,) for kind in kinds):
        return [Path(item) for item in value]
    return value


def _without_typer(parameter: inspect.Parameter) -> inspect.Parameter:
    """The parameter with its plain type; required ones stay positional."""
    annotation = parameter.annotation
    if typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    return parameter.replace(annotation=annotation)


def _docstring(command: Callable, parameters, name: str) -> str:
    """The description of the command, one line for each parameter, and an example."""
    lines = [inspect.cleandoc(command.__doc__ or ""), "", "Args:"]
    for parameter in parameters:
        lines.append(f"    {parameter.name}: {_help(parameter)}")
    lines += ["", "Returns:", "    The answer as a `Result`.", "", "Raises:"]
    lines.append("    InputError: the input or the call is wrong; the sentence says what to do.")
    lines += example(name)
    return "\n".join(lines)


def _help(parameter: inspect.Parameter) -> str:
    for extra in getattr(parameter.annotation, "__metadata__", ()):
        if getattr(extra, "help", None):
            return extra.help
    return "see the command"
