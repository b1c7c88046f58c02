"""Signature and docstring of the function of a command, from the command's own signature and help."""

import inspect
import re
import textwrap
import types
import typing
from collections.abc import Callable, Sequence
from enum import Enum
from pathlib import Path

from workbench.api.answers import ANSWERS, SOURCES
from workbench.api.examples import example

_WIDTH = 96
_RECORDING = "Recording | Path | str"
_RUN = "Result | Path | str"
_TABLE = "DataFrame | ndarray | Path | str"
_SAMPLES = "Sequence[int] | Path | str"
_ACCEPTED = {
    "recording": _RECORDING,
    "candidates": f"Recording | {_RUN}",
    "robot": _RECORDING,
    "tasks": _RECORDING,
    "solution": _RUN,
    "from_diagnosis": _RUN,
    "scene": _RUN,
    "targets": _TABLE,
    "source": _TABLE,
    "target": _TABLE,
    "sources": f"Sequence[{_TABLE}]",
    "fit_samples": _SAMPLES,
    "test_samples": _SAMPLES,
    "tolerance": "Sequence[str] | str",
}
"""Parameters that take more in Python than on a command line: what `workbench.api.inputs` turns into a file."""


_IN_PYTHON = {
    "Run folder to write; default: a new folder under runs/.": "Folder to write; default: a temporary one, "
    "which is removed with the result.",
    "exit status 1 if it is exceeded. Once per unit.": "`passed` is False if it is exceeded. One per unit.",
    "a file with one sample number per line.": "their numbers, or a file with one number per line.",
    "default: one per core.": "default: 1.",
    "default: all cores.": "default: 1.",
    "replaces RECORDING": "replaces `recording`",
    " Repeatable.": "",
}
"""Words of the help of a command line, and what they are in Python."""


_OPTION = re.compile(r"(?<!\w)--([a-z][a-z-]*)")


def parameters_of(command: Callable) -> list[inspect.Parameter]:
    """Parameters of the function of a command; those of the command without --json."""
    signature_parameters = inspect.signature(command).parameters.values()
    return [parameter for parameter in signature_parameters if parameter.name != "json"]


def signature_of(command: Callable, result: type) -> inspect.Signature:
    """The signature of the function of a command; annotations are texts, as in a module with postponed evaluation."""
    shown = []
    for parameter in parameters_of(command):
        default = parameter.default
        if isinstance(default, Enum):
            default = default.value
        shown.append(parameter.replace(annotation=accepted_type(parameter), default=default))
    return inspect.Signature(shown, return_annotation=result)


def plain_type(parameter: inspect.Parameter):
    """The type that the command takes, without what a command line needs."""
    annotation = parameter.annotation
    if typing.get_origin(annotation) is typing.Annotated:
        return typing.get_args(annotation)[0]
    return annotation


def accepted_type(parameter: inspect.Parameter) -> str:
    """The types that the function takes, as text: `Recording | Path | str | None`."""
    kind = plain_type(parameter)
    if parameter.name not in _ACCEPTED:
        return _text(kind)
    optional = type(None) in typing.get_args(kind)
    return _ACCEPTED[parameter.name] + (" | None" if optional else "")


def _text(kind) -> str:
    """A type as text; a path may be a text, a list any sequence, an enumeration one of its values."""
    if kind in (None, type(None)):
        return "None"
    if kind is Path:
        return "Path | str"
    if isinstance(kind, types.UnionType):
        return " | ".join(_text(inner) for inner in typing.get_args(kind))
    if typing.get_origin(kind) is typing.Literal:
        return f"Literal[{', '.join(map(repr, typing.get_args(kind)))}]"
    inner = [_text(part) for part in typing.get_args(kind)]
    if typing.get_origin(kind) is list:
        return f"Sequence[{inner[0]}]"
    if typing.get_origin(kind) is tuple:
        return f"tuple[{', '.join(inner)}]"
    if isinstance(kind, type) and issubclass(kind, Enum):
        return f"Literal[{', '.join(repr(str(value.value)) for value in kind)}]"
    return kind.__name__


def docstring_of(command: Callable, name: str) -> str:
    """Description of the command, its parameters, entries of the answer, errors, source and an example."""
    lines = _paragraphs(_in_python(command.__doc__ or ""))
    parameters = parameters_of(command)
    if parameters:
        lines += ["", "Args:"]
    for parameter in parameters:
        lines += _item(f"{parameter.name}: {_help(parameter)}", "    ")
    lines += ["", "Returns:", *_item("The answer of the command, with the entries below.", "    ")]
    lines += ["", "Raises:"]
    lines += _item(
        "InputError: the input or the call is wrong; the message states what to correct.", "    "
    )
    lines += ["", "Entries of the result:", ""]
    for entry, meaning in ANSWERS[name].items():
        lines += textwrap.wrap(f"- `{entry}`: {meaning}", _WIDTH, subsequent_indent="  ")
    if name in SOURCES:
        lines += ["", *textwrap.wrap(f"Method: {SOURCES[name]}", _WIDTH)]
    return "\n".join([*lines, *example(name)])


def _paragraphs(text: str) -> list[str]:
    paragraphs = inspect.cleandoc(text).split("\n\n")
    wrapped = [textwrap.fill(" ".join(part.split()), _WIDTH) for part in paragraphs]
    return "\n\n".join(wrapped).splitlines()


def _item(text: str, indent: str) -> Sequence[str]:
    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_on_hyphens=False,
        break_long_words=False,
    )


def _help(parameter: inspect.Parameter) -> str:
    for extra in getattr(parameter.annotation, "__metadata__", ()):
        if getattr(extra, "help", None):
            return _in_python(extra.help)
    return "see the command"


def _in_python(text: str) -> str:
    """A text of the command line with the names that its options have in Python."""
    for words, meaning in _IN_PYTHON.items():
        text = text.replace(words, meaning)
    return _OPTION.sub(lambda found: f"`{found[1].replace('-', '_')}`", text)
