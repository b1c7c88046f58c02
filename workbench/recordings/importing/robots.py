"""The robot and the artefact that an import names: what the recording will say of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from datasets.errors import complaint
from datasets.importers.sources.dh_tables import is_dh_table, read_dh_table
from datasets.importers.sources.tables.text_tables import read_text_table
from datasets.recording_files.arms import check_robot
from robot_model import builtin_robots
from workbench.core.errors import InputError
from workbench.core.robot_files.builtin_names import check_builtin_name
from workbench.core.robot_files.robot_description import description_keys, is_description
from workbench.core.text.structured_text import ContentError, read_toml

_MACRO = b"<xacro:"


def robot_keys(name: str | None, file: str) -> Mapping:
    """Value of `Recording.robot` for a built-in name, a file of a robot, or a table of one convention.

    Raises InputError where nothing is named or the file cannot be right.
    """
    candidates = robot_candidates(name, file)
    if len(candidates) > 1:
        raise complaint(
            f"--robot {name}",
            "a Denavit-Hartenberg table whose convention is stated",
            "none",
            'write "modified" (Craig) or "standard" into the name of the file, or name a robot.toml',
        )
    return next(iter(candidates.values()))


def robot_candidates(name: str | None, file: str) -> dict[str, Mapping]:
    """Title and keys of every robot that a name may mean: several for a table whose convention is open.

    Raises InputError as `robot_keys`.
    """
    if name is not None:
        _refuse_macros(Path(name))
    if name is not None and is_dh_table(Path(name)):
        _check_there(Path(name))
        tables = read_dh_table(Path(name))
        return {f"{name}, convention {keys['convention']}": keys for keys in tables}
    return {name or "": _plain_keys(name, file)}


def _refuse_macros(path: Path) -> None:
    """Raise InputError for a file whose macros `xacro` has to expand."""
    is_urdf = path.suffix.lower() in (".urdf", ".xacro") and path.is_file()
    if is_urdf and _MACRO in path.read_bytes():
        raise complaint(
            f"--robot {path}",
            "a URDF",
            "macros of xacro",
            f"expand them with `xacro {path.name} > robot.urdf`, where ROS is installed, and name robot.urdf",
        )


def _plain_keys(name: str | None, file: str) -> Mapping:
    known = ", ".join(builtin_robots())
    if name is None:
        raise InputError(
            f"{file}: expected the robot whose joints were read, found none named; add --robot with a built-in name "
            f"({known}), a robot.toml, a URDF, an MJCF file or a Denavit-Hartenberg table (CSV)."
        )
    path = Path(name)
    if is_description(path):
        keys = description_keys(path)
        _check_there(Path(keys["urdf"]))
        return keys
    if path.suffix.lower() == ".toml":
        _check_there(path)
        try:
            keys = read_toml(path)
        except (OSError, ContentError) as problem:
            raise complaint(
                f"--robot {name}", "TOML", f"a mistake ({problem})", "correct it there"
            ) from None
        check_robot(keys, path.name)
        return keys
    check_builtin_name(
        name,
        f"--robot {name}",
        builtin_robots(),
        "a robot.toml, a URDF, an MJCF file, a Denavit-Hartenberg table (.csv, .xlsx)",
    )
    return {"builtin": name}


def _check_there(path: Path) -> None:
    if not path.is_file():
        raise complaint(f"--robot {path}", "a file", "no such file", "correct the name")


def read_artefact(path: Path) -> dict[int, tuple[float, float, float, float]]:
    """Balls by number from a table with the columns of artefact.csv. Raises InputError for missing columns."""
    table = read_text_table(path)
    names = ("ball", "x_mm", "y_mm", "z_mm", "radius_mm")
    for name in names:
        if name not in table.columns:
            raise complaint(
                f"{path.name}, column {name}", "this column", "no such column", "add it"
            )
    rows = zip(*(table.numbers(name) for name in names))
    found = {}
    for ball, x, y, z, r in rows:
        found[int(ball)] = (float(x), float(y), float(z), float(r))
    return found


def check_balls(path: Path | None, file: str, numbers: Sequence[int]) -> None:
    """Raises InputError where a table has several balls without an artefact's file, or one that is not in the file.

    path: of the artefact's file. file: name of the table. numbers: of its balls.
    """
    known = read_artefact(path) if path else None
    if known is None:
        if len(numbers) > 1:
            raise complaint(
                f"{file}, column ball",
                "one ball, or a file with the nominal centres of all",
                f"balls {', '.join(map(str, numbers))} and no such file",
                "state --artefact artefact.csv with columns ball, x_mm, y_mm, z_mm and radius_mm",
            )
        return
    missing = [number for number in numbers if number not in known]
    if missing:
        raise complaint(
            f"{path}",
            f"a row for each ball of {file}",
            f"none for ball {missing[0]}",
            "add its nominal centre and radius, or correct the column ball",
        )
