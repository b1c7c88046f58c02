"""Commands as Python functions, made from the commands' own signatures.

A function takes the arguments and options of its command under the same names, runs it in a
temporary run folder (or in `out`), and returns a `Result`. Nothing is written to standard output. Linear algebra uses
one thread meanwhile, unless the environment (OPENBLAS_NUM_THREADS, ...) says otherwise: the matrices are small.
"""

import contextlib
import inspect
import io
import json
import shutil
import tempfile
import types
import typing
from collections.abc import Callable
from difflib import get_close_matches
from enum import Enum
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import typer

from workbench.api.inputs import as_argument, sample_list, sources_list
from workbench.api.results import ANSWER, SUMMARY, Result
from workbench.api.signatures import accepted_type, docstring_of, plain_type, signature_of
from workbench.core.errors import InputError
from workbench.core.text.structured_text import ContentError, read_json
from workbench.files import runs
from workbench.machine.processes import limited_blas_threads

COMMANDS = {
    "calibrate": "robot.calibrate",
    "calibrate_large": "robot.calibrate_large",
    "compare": "robot.compare",
    "compensate": "robot.compensate",
    "diagnose": "robot.diagnose",
    "evaluate": "robot.evaluate",
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
_PROCESSES = ("jobs", "workers")


@cache
def function(name: str) -> Callable[..., Result]:
    """The function of a command, with its parameters, defaults and a docstring that explains each."""
    module, _, attribute = COMMANDS[name].partition(":")
    command = getattr(import_module(f"workbench.commands.{module}"), attribute or "command")
    signature = signature_of(command, Result)

    def call(*args, **options) -> Result:
        try:
            bound = signature.bind(*args, **options)
        except TypeError as problem:
            raise TypeError(f"{name}(): {problem}{_suggestion(options, signature)}") from None
        return run(command, bound.arguments)

    call.__signature__ = signature
    call.__name__ = call.__qualname__ = name
    call.__module__ = "workbench"
    call.__doc__ = docstring_of(command, name)
    return call


def _suggestion(options: dict, signature: inspect.Signature) -> str:
    """The parameter that an unknown name nearly is, as the end of a sentence."""
    for option in options:
        close = get_close_matches(option, signature.parameters, 1)
        if option not in signature.parameters and close:
            return f"; did you mean {close[0]}?"
    return ""


def run(command: Callable, arguments: dict) -> Result:
    """Run a command in this process; its answer, its text and its folder. Raises InputError."""
    owner = tempfile.TemporaryDirectory(prefix="workbench-", ignore_cleanup_errors=True)
    folder = Path(owner.name)
    accepted = inspect.signature(command).parameters
    given = {
        name: _checked(_converted(_argument(name, value, folder), accepted[name]), accepted[name])
        for name, value in arguments.items()
    }
    if "out" in accepted and given.get("out") is None and _is_run_folder(accepted["out"]):
        given["out"] = folder / "run"
    for (
        name
    ) in _PROCESSES:  # worker processes import the caller's script again, which may not expect it
        if name in accepted and given.get(name) is None:
            given[name] = 1
    answer_file = folder / "answer.json"
    if "json" in accepted:
        given["json"] = str(answer_file)
    text, status = io.StringIO(), 0
    with contextlib.redirect_stdout(text), limited_blas_threads(), runs.placed_in(folder):
        try:
            command(**given)
        except typer.Exit as end:
            status = end.exit_code
    answer = json.loads(answer_file.read_text(encoding="utf-8")) if answer_file.exists() else {}
    _keep_recording(given.get("recording"), _folder_of(answer, given), folder)
    printed = _without_path(text.getvalue(), folder)
    return Result(answer, _folder_of(answer, given), printed, status == 0, function, owner)


def _keep_recording(recording, run: Path | None, folder: Path) -> None:
    """Keep a recording that existed in memory alone, and was written into the temporary folder, with its run."""
    if (
        run is None
        or not isinstance(recording, str | Path)
        or folder not in Path(recording).parents
    ):
        return
    kept_recording = run / runs.KEPT_RECORDING
    if not kept_recording.exists():
        shutil.copytree(recording, kept_recording)


def _is_run_folder(out: inspect.Parameter) -> bool:
    """Whether --out names an optional folder, and not a file."""
    extras = getattr(out.annotation, "__metadata__", ())
    return out.default is None and not any("FILE" in str(extra.metavar) for extra in extras)


def _folder_of(answer: dict, given: dict) -> Path | None:
    """The run folder: what the command says, else the folder of its parameter `out`."""
    for place in (answer.get("run"), given.get("out")):
        if isinstance(place, str | Path) and Path(place).is_dir():
            return Path(place)
    return None


def _without_path(text: str, folder: Path) -> str:
    """The text of a command without its last line where that names the temporary folder."""
    lines = text.rstrip().splitlines()
    if lines and str(folder) in lines[-1]:
        lines = lines[:-1]
    return "\n".join(lines).rstrip()


def load(folder: str | Path) -> Result:
    """The result in a run folder, of a command line or of `Result.save`.

    Raises:
        InputError: The folder has no answer.json.

    Examples:
        >>> wb.calibrate("elastic-arm", plan="ye-mdh", folds=4, out="arm").samples
        300
        >>> wb.load("arm").recording
        'elastic-arm'
    """
    path = Path(folder) / ANSWER
    try:
        answer = read_json(path)
    except (OSError, ContentError) as error:
        raise InputError(
            f"{path}: expected the answer of a workbench command, found {error}; name a run folder"
        ) from error
    text = Path(folder) / SUMMARY
    stated_text = text.read_text(encoding="utf-8") if text.exists() else ""
    return Result(answer, Path(folder), stated_text, commands=function)


def _argument(name: str, value, folder: Path):
    if name in _SAMPLE_LISTS:
        return sample_list(value, name, folder)
    if name == "tolerance":
        return [value] if isinstance(value, str) else value
    if name == "out" and value is not None:
        return Path(value)
    if name == "sources":
        return sources_list(value, folder)
    if isinstance(value, list):
        return [as_argument(item, f"{name}-{k}", folder) for k, item in enumerate(value, 1)]
    return as_argument(value, name, folder)


def _converted(value, parameter: inspect.Parameter):
    """Text as a path or as the member of an enumeration, where the command takes one; lists likewise."""
    plain_kind = plain_type(parameter)
    kinds = {plain_kind, *typing.get_args(plain_kind)}
    if isinstance(value, str) and isinstance(plain_kind, type) and issubclass(plain_kind, Enum):
        return _member(value, plain_kind, parameter.name)
    if isinstance(value, str) and Path in kinds and str not in kinds:
        return Path(value)
    if isinstance(value, list | tuple):
        if any(typing.get_args(kind) == (Path,) for kind in kinds):
            return [Path(item) for item in value]
        if any(typing.get_args(kind) == (str,) for kind in kinds):
            return [str(item) for item in value]
    if isinstance(value, Path) and str in kinds and Path not in kinds:
        return str(value)
    return value


def _checked(value, parameter: inspect.Parameter):
    """The value; InputError where the command takes other types, as a number where a path or a text is expected."""
    kind = plain_type(parameter)
    if isinstance(kind, types.UnionType):
        kinds = typing.get_args(kind)
    else:
        kinds = (kind,)
    plain = tuple(typing.get_origin(member) or member for member in kinds)
    plain = tuple(member for member in plain if isinstance(member, type))
    others = {float: (int, np.number), int: (np.integer,), list: (tuple, set)}
    fitting = (*plain, *(other for member in plain for other in others.get(member, ())))
    if len(plain) < len(kinds) or value is None or isinstance(value, fitting):
        return value
    raise InputError(
        f"{parameter.name}: expected {accepted_type(parameter)}, found {value!r}; give one of these types"
    )


def _member(value: str, kind: type[Enum], name: str) -> Enum:
    try:
        return kind(value)
    except ValueError as error:
        known = ", ".join(str(member.value) for member in kind)
        raise InputError(f"{name}: expected one of {known}, found {value}; name one") from error
