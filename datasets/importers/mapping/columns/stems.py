"""Columns whose headers differ in one letter or number, as "Turn X" and "Turn Y": components of one quantity."""

import re
from collections.abc import Iterable

_TOKEN = re.compile(r"[A-Za-z]+|\d+")
_JOINED = re.compile(r"(.*[a-z])([A-Z])")  # letters that are joined to a word: "giroX"


def columns_by_stem(names: Iterable[str]) -> dict[str, list[str]]:
    """Names by what they have in common, with * in the place of the letter or number; a name may be in several."""
    by_stem: dict[str, list[str]] = {}
    for name in names:
        for stem in _stems(name):
            by_stem.setdefault(stem, []).append(name)
    return by_stem


def _stems(name: str) -> list[str]:
    found = [
        f"{name[: match.start()]}*{name[match.end() :]}"
        for match in _TOKEN.finditer(name)
        if len(match[0]) == 1 or match[0].isdigit()
    ]
    joined = _JOINED.fullmatch(name)
    return [*found, f"{joined[1]}*"] if joined else found
