"""Which keys recording.toml has, what each must hold, and the walk that checks it."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime

from datasets.errors import complaint
from datasets.samples.columns import KINDS
from workbench.core.text.key_names import closest_key


@dataclass(frozen=True)
class Key:
    """One key: a test of its value, in words what passes, and whether it must be there."""

    passes: Callable[[object], bool]
    expected: str
    required: bool = False

    @property
    def schema(self) -> dict:
        """The test as JSON Schema (draft 2020-12)."""
        words = getattr(self.passes, "words", None)
        rule = {"enum": list(words)} if words else dict(_SCHEMAS[self.passes])
        return {**rule, "description": self.expected}


def is_number(value) -> bool:
    """A finite int or float that is no bool and small enough to be a measurement."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e12 and math.isfinite(value)


def _numbers(count: int) -> Callable[[object], bool]:
    return lambda v: isinstance(v, list) and len(v) == count and all(map(is_number, v))


def _one_of(*words) -> Callable[[object], bool]:
    def passes(value) -> bool:
        return isinstance(value, str) and value in words

    passes.words = words
    return passes


def _is_flag(value) -> bool:
    return isinstance(value, bool)


def _are_names(value) -> bool:
    return isinstance(value, list) and all(map(_is_text, value))


def _is_text(value) -> bool:
    return isinstance(value, str)


def _is_table(value) -> bool:
    return isinstance(value, dict)


def _is_unit(value) -> bool:
    return _numbers(3)(value) and abs(math.hypot(*value) - 1) < 1e-3


def _is_moment(value) -> bool:
    return is_number(value) or (isinstance(value, str) and is_time_stamp(value))


def is_time_stamp(text: str) -> bool:
    """Whether a text is a date and a time of day in ISO 8601."""
    try:
        return datetime.fromisoformat(text) is not None
    except ValueError:
        return False


def _is_count(value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value < 10**6


def _above_zero(value) -> bool:
    return is_number(value) and value > 0


_SCHEMAS = {
    _is_text: {"type": "string"},
    _is_table: {"type": "object"},
    _is_moment: {"type": ["number", "string"]},
    _is_flag: {"type": "boolean"},
    _are_names: {"type": "array", "items": {"type": "string"}},
    _is_unit: {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
    _is_count: {"type": "integer", "minimum": 1, "exclusiveMaximum": 10**6},
    _above_zero: {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1e12},
}
TEXT = Key(_is_text, "text in quotes")
TABLE = Key(_is_table, "a table in square brackets")
WORDS = ", ".join(KINDS)
_SIMILARITY = 0.9
"""From which a key counts as misspelt; lower would refuse keys that a recording may hold for its own use."""
DICTIONARIES = (
    *(f"DICT_{k}X{k}_{n}" for k in (4, 5, 6, 7) for n in (50, 100, 250, 1000)),
    "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5",
    "DICT_APRILTAG_25h9",
    "DICT_APRILTAG_36h10",
    "DICT_APRILTAG_36h11",
    "DICT_ARUCO_MIP_36h12",
)

RECORDING = {
    "format": Key(_one_of("recording/1"), '"recording/1"', True),
    "measures": Key(_one_of(*KINDS), f"one of {WORDS}", True),
    "title": TEXT,
    "name": TEXT,
    "source": TEXT,
    "licence": TEXT,
    "remarks": Key(_are_names, "a list of sentences in quotes"),
    "sigma_mm": Key(_above_zero, "1 sigma of a coordinate above 0, in mm"),
    "robot": TABLE,
    "samples": TABLE,
    "artefact": TABLE,
    "images": TABLE,
    "board": TABLE,
    "guess": TABLE,
}
SECTIONS = {
    "samples": {
        "file": Key(_is_text, "a file name in quotes", True),
        "small_range": Key(_is_flag, "true or false"),
        "time_origin": Key(
            _is_moment, 's of a clock, or a time stamp such as "2026-09-14T08:12:05"'
        ),
    },
    "artefact": {"file": Key(_is_text, "a file name in quotes", True)},
    "images": {"file": Key(_is_text, "a file name in quotes", True)},
    "board": {
        "kind": Key(
            _one_of("chessboard", "charuco", "circles", "aprilgrid"),
            "one of chessboard, charuco, circles, aprilgrid",
            True,
        ),
        "columns": Key(_is_count, "a number of columns, 1 or more", True),
        "rows": Key(_is_count, "a number of rows, 1 or more", True),
        "square_mm": Key(_above_zero, "a length above 0 in mm", True),
        "asymmetric": Key(_is_flag, "true or false"),
        "legacy": Key(_is_flag, "true or false"),
        "flatness_mm": Key(_above_zero, "a length above 0 in mm"),
        "marker_mm": Key(_above_zero, "a length above 0 in mm"),
        "dictionary": Key(_one_of(*DICTIONARIES), "one of OpenCV's, such as DICT_5X5_250"),
        "fixed_to": Key(_one_of("tool", "base", "floor"), "one of tool, base, floor"),
    },
    "robot": {
        "file": TEXT,
        "builtin": TEXT,
        "tip": TEXT,
        "mimic": TABLE,
        "gravity": Key(_is_unit, "three numbers, a unit vector"),
        "payload": TABLE,
        "joints": Key(_are_names, "a list of joint names"),
    },
    "guess": {},
}


def check_keys(found: Mapping, wanted: Mapping[str, Key], where: str) -> None:
    """Raise InputError for the first key of `found` that is missing, misspelt or holds nonsense."""
    for name, key in wanted.items():
        if name in found:
            if not key.passes(found[name]):
                raise complaint(
                    f"{where}, key {name}", key.expected, shown(found[name]), "correct the value"
                )
        elif key.required:
            similar_key = _similar_key(name, found, wanted)
            do = (
                f"rename {similar_key} to {name} and mind the unit"
                if similar_key
                else f"add {name}"
            )
            raise complaint(
                f"{where}, key {name}",
                key.expected,
                f"the key {similar_key}" if similar_key else "no such key",
                do,
            )
    for name in found:
        if name not in wanted and (similar_key := _similar_key(name, wanted, found)):
            raise complaint(
                f"{where}, key {name}",
                f"the key {similar_key}",
                name,
                f"rename it to {similar_key} and mind the unit",
            )


def _similar_key(name: str, candidates: Mapping, taken: Mapping) -> str | None:
    """A candidate that `name` was probably meant to be and that is not in `taken`."""
    free = [c for c in candidates if c not in taken]
    return closest_key(name, free, _SIMILARITY)


def shown(value) -> str:
    """A value as it may stand in a sentence: short, on one line."""
    text = "a table" if isinstance(value, dict) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
