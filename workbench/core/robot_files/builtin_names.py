"""Names and files of the built-in robots, for layers that may not import the robots.

The public API states them. A layer that may not import the robots, such as the recordings, then refuses an unknown
name by `check_builtin_name`, which accepts every name as long as nobody has stated any, and `builtin_keys` are empty.
"""

import difflib
from collections.abc import Callable, Mapping, Sequence

from workbench.core.errors import complaint

_SIMILARITY = 0.5
_stated: list[Callable[[], Sequence[str]]] = []
_stated_keys: list[Callable[[Mapping], Mapping]] = []


def state_builtin_names(
    names: Callable[[], Sequence[str]], keys: Callable[[Mapping], Mapping]
) -> None:
    """State the functions that list the names of the built-in robots, and that give the keys of {"builtin": name}."""
    _stated[:] = [names]
    _stated_keys[:] = [keys]


def builtin_keys(robot: Mapping) -> Mapping:
    """Keys of robot.toml of an arm; of a built-in one those of its file, or as they are where nobody stated them."""
    if "builtin" in robot and _stated_keys:
        return _stated_keys[0](robot)
    return robot


def _plain(name: str) -> str:
    """The letters and digits of a name."""
    return "".join(filter(str.isalnum, name))


def _digits(name: str) -> str:
    """The digits of a name: another number is another arm, as ur10e is for ur5e."""
    return "".join(filter(str.isdigit, name))


def check_builtin_name(
    name: object,
    where: str,
    known: Sequence[str] = (),
    files: str = "a file (robot.toml, URDF, MJCF)",
) -> None:
    """Raise InputError with the nearest names where no built-in robot has this name.

    where: what to call the place of the name in the sentence. known: the names; empty for those that are stated.
    files: which files may stand in its place.
    """
    known = known or [name for names in _stated for name in names()]
    if not known or name in known:
        return
    name_given = str(name).lower()
    similar_names = difflib.get_close_matches(name_given, known, 3, _SIMILARITY)
    similar = [name for name in similar_names if _digits(name) == _digits(name_given)]
    close_names = [
        name for name in known if _plain(name_given) in (*name.split("_"), _plain(name))
    ] or similar
    meant = f"did you mean {' or '.join(close_names)}? Otherwise " if close_names else ""
    raise complaint(
        where,
        f"one of {', '.join(known)}",
        repr(name),
        f"{meant}name one, or give {files}",
    )
