"""Results of the Python API: the answer of a command, its tables, and its run folder."""

import base64
import csv
import html
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from workbench.api.answers import TABLES
from workbench.core.errors import InputError

ANSWER, SUMMARY = "answer.json", "summary.txt"
_IMAGE = "summary.png"
_NOTEBOOK_ROWS, _NOTEBOOK_COLUMNS = 12, 8
_SHOWN_ROWS = 30


class View(Mapping):
    """A part of an answer: a mapping whose keys are attributes, too (`result.held_out.rms_mm`)."""

    def __init__(self, values: Mapping[str, Any]):
        self._values = values

    def __getitem__(self, key):
        return viewed(self._values[key])

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __getattr__(self, name: str):
        if name.startswith("_") or name not in self._values:
            raise AttributeError(f"no '{name}' here; there are {', '.join(map(str, self._values))}")
        return self[name]

    def __dir__(self):
        return [*super().__dir__(), *map(str, self._values)]

    def __repr__(self) -> str:
        lines = (f"  {key}: {_short(value)}" for key, value in self._values.items())
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = ((key, _short(value)) for key, value in self._values.items())
        return _html_table(("", ""), rows)

    def to_frame(self):
        """A pandas DataFrame with one row for each key."""
        rows = [{"name": key, "value": _short(value)} for key, value in self._values.items()]
        return _pandas().DataFrame(rows)


class Table(Sequence):
    """Rows of an answer, each a mapping; `to_frame` makes a pandas DataFrame of them."""

    def __init__(self, rows: Sequence[Mapping[str, Any]]):
        self._rows = list(rows)

    def __getitem__(self, index):
        if isinstance(index, slice):
            return Table(self._rows[index])
        return View(self._rows[index])

    def __len__(self) -> int:
        return len(self._rows)

    def __repr__(self) -> str:
        return f"Table of {len(self)} rows with {', '.join(self._names())}"

    def _repr_html_(self) -> str:
        names = self._names()
        rows = ([_short(row.get(name)) for name in names] for row in self._rows[:_SHOWN_ROWS])
        return _html_table(names, rows)

    def _names(self) -> list[str]:
        return list(dict.fromkeys(key for row in self._rows for key in row))

    def to_frame(self):
        """A pandas DataFrame with a column for each key, without nested objects.

        Entries of an object are columns of their own (`noise.rms_mm`). A row with `parameters` becomes one row for each
        of them. Other lists of objects are left out; the answer has them.
        """
        rows = [flat for row in self._rows for flat in _flat_rows(row)]
        return _pandas().DataFrame(rows)


def _flat_rows(row: Mapping[str, Any]) -> list[dict[str, Any]]:
    """A row without nested objects, once for each of its `parameters` where it has such a list."""
    row_scalars = _flat({key: value for key, value in row.items() if key != "parameters"})
    inner = row.get("parameters")
    if not isinstance(inner, list | tuple) or not all(isinstance(item, Mapping) for item in inner):
        return [_flat(row)]
    return [row_scalars | _prefixed(item, row_scalars) for item in inner] or [row_scalars]


def _prefixed(inner: Mapping[str, Any], row_scalars: Mapping[str, Any]) -> dict[str, Any]:
    """Entries of a parameter; those with a name that its row has, too, and another value are `parameter.name`."""
    flat = _flat(inner)
    return {
        f"parameter.{key}" if key in row_scalars and row_scalars[key] != value else key: value
        for key, value in flat.items()
    }


def _flat(row: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """The row with entries of objects as `key.inner key`, and without lists of objects."""
    flat: dict[str, Any] = {}
    for key, value in row.items():
        name = f"{before}{key}"
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{name}.")
        elif not _holds_objects(value):
            flat[name] = value
    return flat


def _holds_objects(value: Any) -> bool:
    return isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value)


class Result:
    """Result of a command. Entries of its JSON answer are attributes: `result.held_out.rms_mm`.

    Lengths are in mm and angles in the unit at the end of a name (`_deg`, `_rad`). The functions of the commands
    say which entries their results have, and in which frame.

    Attributes:
        answer: The JSON object of the command.
        folder: The run folder; None for a command that writes none.
        passed: False where a tolerance is not met or a target was refused (exit status 1 of the command).

    Examples:
        >>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
        >>> calibration.held_out.rms_mm == calibration.answer["held_out"]["rms_mm"]
        True
        >>> made = calibration.save("my-run")
        >>> wb.load("my-run").held_out.samples
        300
        >>> bool(calibration.to_frame()["std"].min() > 0)
        True
    """

    def __init__(
        self,
        answer: Mapping[str, Any],
        folder: Path | None = None,
        text: str = "",
        passed: bool = True,
        commands: Callable[[str], Callable] | None = None,
        owner: object = None,
    ):
        self.answer, self.folder, self.passed = answer, folder, passed
        self._text, self._commands, self._owner = text, commands, owner

    @property
    def command(self) -> str:
        """Name of the command."""
        return str(self.answer.get("command", ""))

    def __getattr__(self, name: str):
        if name.startswith("_") or name not in self.answer:
            known = ", ".join(map(str, self.answer))
            raise AttributeError(f"the answer of {self.command} has no '{name}'; it has {known}")
        return viewed(self.answer[name])

    def __dir__(self):
        return [*super().__dir__(), *map(str, self.answer)]

    def summary(self) -> str:
        """The text that the command prints: tables and verdict."""
        return self._text or repr(View(self.answer))

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        """HTML for a notebook: verdict, image of the run, main table, and the text of the command folded up."""
        elements = [
            f"<p><b>{html.escape(self.verdict_sentence)}</b></p>",
            self._image(),
            self._main(),
        ]
        text = html.escape(self.summary())
        elements.append(
            f"<details><summary>workbench {self.command}</summary><pre>{text}</pre></details>"
        )
        return "".join(elements)

    @property
    def verdict_sentence(self) -> str:
        """The verdict in one sentence; empty for a command that judges nothing."""
        for key in ("verdict_details", "verdict"):
            verdict = self.answer.get(key)
            if isinstance(verdict, Mapping) and verdict.get("sentence"):
                return str(verdict["sentence"])
        return ""

    def _image(self) -> str:
        """The image of the run, at the width of a notebook; nothing where the run has none."""
        path = None if self.folder is None else self.folder / _IMAGE
        if path is None or not path.is_file():
            return ""
        data = base64.b64encode(path.read_bytes()).decode()
        return f'<img src="data:image/png;base64,{data}" style="max-width: 100%" alt="{_IMAGE}">'

    def _main(self) -> str:
        """The main table, at most so many rows."""
        name = TABLES.get(self.command, "")
        rows = self.answer.get(name)
        if name.endswith(".csv"):
            with self._file(name).open(encoding="utf-8", newline="") as lines:
                rows = list(csv.DictReader(lines))
        if not isinstance(rows, list) or not rows or not isinstance(rows[0], Mapping):
            return ""
        shown = rows[:_NOTEBOOK_ROWS]
        names = [key for key in rows[0] if _fits_a_cell([row.get(key) for row in shown])]
        shown_names = names[:_NOTEBOOK_COLUMNS]
        cells = [
            ["–" if row.get(key) is None else _short(row[key]) for key in shown_names]
            for row in shown
        ]
        note = f"<p>{len(shown)} of {len(rows)} rows; to_frame() has all.</p>"
        row_note = note if len(rows) > len(shown) else ""
        return _html_table(shown_names, cells) + row_note

    def to_frame(self):
        """The main table as a pandas DataFrame: parameters, effects, images, corrected targets, ...

        A result without a table gives one row for each entry of the answer.
        """
        name = TABLES.get(self.command, "")
        if name.endswith(".csv"):
            return self.table(name.removesuffix(".csv"))
        if isinstance(self.answer.get(name), list):
            return Table(self.answer[name]).to_frame()
        return View(self.answer).to_frame()

    def table(self, name: str):
        """A CSV file of the run folder as a pandas DataFrame, such as "residuals" or "corrected".

        Columns carry their unit in the name. Raises InputError where there is none of that name.
        """
        path = self._file(f"{name}.csv")
        return _pandas().read_csv(path)

    @property
    def residuals(self) -> "CsvTable":
        """Residuals of the n samples, predicted minus measured, in mm; `to_frame()` makes a DataFrame of n rows."""
        return CsvTable(self._file("residuals.csv"))

    def plot(self):
        """A plotly figure: the distribution of the errors (mm) where there are residuals, else the main table."""
        from workbench.api.plots import figure_of

        return figure_of(self)

    def report(self, path: str | Path) -> Path:
        """Copy the report page to `path`; the path. Raises InputError where there is no page."""
        return Path(shutil.copyfile(self._file("report.html"), path))

    def save(self, folder: str | Path) -> Path:
        """Copy the run folder to a new place, where `load` finds it; the place.

        The result of a command without a run folder is saved as its answer and its text alone. Raises InputError
        where the place holds files.
        """
        target = Path(folder)
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise InputError(f"{target} holds files; name a new folder")
        if self.folder is None:
            target.mkdir(parents=True, exist_ok=True)
        else:
            shutil.copytree(self.folder, target, dirs_exist_ok=True)
        if not (target / ANSWER).exists():
            (target / ANSWER).write_text(json.dumps(dict(self.answer)), encoding="utf-8")
        (target / SUMMARY).write_text(self.summary(), encoding="utf-8")
        return target

    def compensate(self, targets, **options) -> "Result":
        """Correct targets with this calibration, or with the model of this diagnosis: see `workbench.compensate`.

        targets: (n, J) joint readings in deg (mm for a prismatic joint), a DataFrame, or a table in a file.
        options: those of `workbench.compensate`. Raises InputError.
        """
        return self._commands("compensate")(self, targets, **options)

    def export(self, path: str | Path, to: str | None = None, **options) -> "Result":
        """Write the result in a format of another program: see `workbench.export`.

        path: of the new file. to: the format; it follows from the suffixes .urdf, .py, .xml (MJCF), .csv and
        .json (Denavit-Hartenberg table). Raises InputError for a format that the result cannot give.
        """
        return self._commands("export")(self, to or _format_of(Path(path)), Path(path), **options)

    @property
    def model(self) -> "Result":
        """The model of a diagnosis or calibration, for `compensate` and `export`: the result itself."""
        return self

    def _file(self, name: str) -> Path:
        if self.folder is None or not (self.folder / name).exists():
            raise InputError(f"the result of {self.command} has no {name}")
        return self.folder / name


class CsvTable:
    """A table in a file of the run folder, read when it is asked for."""

    def __init__(self, path: Path):
        self.path = path

    def to_frame(self):
        """The table as a pandas DataFrame."""
        return _pandas().read_csv(self.path)

    def __repr__(self) -> str:
        return f"table in {self.path.name}; to_frame() reads it"


def viewed(value):
    """Mappings become views, lists of mappings tables; everything else stays as it is."""
    if isinstance(value, Mapping):
        return View(value)
    if isinstance(value, list) and value and all(isinstance(row, Mapping) for row in value):
        return Table(value)
    return value


def _format_of(path: Path) -> str:
    formats = {
        ".urdf": "urdf",
        ".py": "python",
        ".xml": "mjcf",
        ".csv": "mdh-csv",
        ".json": "mdh-json",
    }
    if path.suffix not in formats:
        raise InputError(
            f"{path.name}: the format does not follow from the suffix; name it with `to`, such as to='ros'"
        )
    return formats[path.suffix]


def _short(value) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_short(inner)}" for key, inner in list(value.items())[:6])
    if isinstance(value, (list, tuple)):
        return f"{len(value)} entries"
    return str(value)


def _fits_a_cell(values: Sequence) -> bool:
    """Whether a column holds single numbers or short texts."""
    known = [value for value in values if value not in (None, "", [])]
    simple = all(isinstance(value, (str, int, float)) for value in known)
    return bool(known) and simple and not isinstance(known[0], bool)


def _html_table(names: Sequence[str], rows) -> str:
    head = "".join(f"<th>{html.escape(str(name))}</th>" for name in names)
    body = ""
    for row in rows:
        cells = "".join(f"<td>{html.escape(str(cell))}</td>" for cell in row)
        body += f"<tr>{cells}</tr>"
    return f"<table><tr>{head}</tr>{body}</table>"


def _pandas():
    try:
        import pandas
    except ImportError as error:
        raise InputError("to_frame needs pandas; install it with `pip install pandas`") from error
    return pandas
