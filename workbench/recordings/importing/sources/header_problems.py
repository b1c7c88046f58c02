"""The refusal of a table whose headers do not say enough: every mistake found, and a mapping file to complete."""

import re

from datasets.importers.mapping.example import Wanted, example_mapping
from datasets.importers.mapping.model import Mapping
from datasets.importers.source import RawTable
from robot_model import builtin_robots, load_robot
from workbench.core.errors import InputError
from workbench.recordings.importing.robots import robot_candidates

_NUMBER = re.compile(r"[+-]?[.,]?\d")
_MOSTLY = 0.5
_MOST_CELLS = 3
_HEAD = (
    "# A mapping file from these headers. Correct the lines with CHECK and FILL IN, save it as map.toml, and add\n"
    "# --map map.toml to the command."
)


def header_error(table: RawTable, mapping: Mapping, named: str | None, sentences) -> InputError:
    """The error of what headers leave open, with other mistakes and a mapping file as an example.

    named: the robot that the user names. sentences: on missing quantities.
    """
    problem = _robot(table, named)[2]
    others = [*([problem] if problem else []), *text_in_numbers(table)]
    return _error([*sentences, *others], table_example(table, mapping, named))


def pose_error(table: RawTable, mapping: Mapping, sentences) -> InputError:
    """As `header_error`, for images whose flange poses the headers do not name; sentences: on other mistakes."""
    shown = ", ".join(list(table.columns)[:16])
    missing = (
        f"{table.file}: expected flange poses (X, Y, Z and a rotation) or joint readings for the images, found "
        f"{shown}; add [flange_point] and [flange_rotation] with their columns to a mapping file and name it with "
        "--map."
    )
    example = example_mapping(table, mapping, Wanted(("flange_point", "flange_rotation")))
    return _error([missing, *sentences, *text_in_numbers(table)], example)


def table_example(table: RawTable, mapping: Mapping, named: str | None) -> str:
    """A mapping file for a table of a measured robot; named: the robot that the user names."""
    robot, joints, _ = _robot(table, named)
    return example_mapping(table, mapping, Wanted(("joints", "point"), joints, robot))


def _error(sentences, example: str) -> InputError:
    first, *further = sentences
    text = " ".join([first, *(f"Also: {sentence}" for sentence in further)])
    return InputError(text, f"{_HEAD}\n\n{example}")


def _robot(table: RawTable, named: str | None) -> tuple[str | None, int | None, str]:
    """The robot as far as it is valid, its number of joints, and what is wrong with it."""
    if named is None:
        return (
            None,
            None,
            (
                f"{table.file}: expected the robot whose joints were read, on which columns with unknown headers are "
                f"tested, found none named; add --robot with a built-in name ({', '.join(builtin_robots())}), a "
                "robot.toml, a URDF, an MJCF file or a Denavit-Hartenberg table (CSV)."
            ),
        )
    try:
        candidates = robot_candidates(named, table.file)
        keys = next(iter(candidates.values()))
        joints = load_robot(keys, f"--robot {named}").mixing.shape[1]
        return named, joints, ""
    except InputError as problem:
        return None, None, str(problem)


def text_in_numbers(table: RawTable) -> list[str]:
    """A sentence on every column that holds numbers but for some cells."""
    found = []
    for name, cells in table.columns.items():
        if cells.dtype.kind == "f":
            continue
        filled = [row for row, cell in enumerate(cells) if str(cell).strip()]
        wrong = [row for row in filled if not _NUMBER.match(str(cells[row]))]
        if not wrong or len(wrong) > (1 - _MOSTLY) * len(filled):
            continue
        shown = ", ".join(
            f"row {table.lines[row]}: {str(cells[row])!r}" for row in wrong[:_MOST_CELLS]
        )
        if len(wrong) > _MOST_CELLS:
            unlisted = f" and {len(wrong) - _MOST_CELLS} more"
        else:
            unlisted = ""
        found.append(
            f"{table.file}, column {name}: expected numbers in all rows, found text ({shown}{unlisted}); correct or "
            "remove these rows."
        )
    return found
