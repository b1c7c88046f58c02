"""JSON Schema (draft 2020-12) of the files of this package: recording.toml, its tables, and the mapping of an import.

They are made from the same tables of keys and columns that the readers check with. A schema cannot say everything that
a reader checks, such as values that only go together: a file that a reader accepts passes, not the other way round.
"""

from datasets.importers.mapping.columns.spherical import CONVENTIONS as SPHERICAL_CONVENTIONS
from datasets.importers.mapping.model import FORMAT, JOINS, PLACEMENTS, QUANTITIES
from datasets.importers.mapping.placements import Controller
from datasets.importers.mapping.rotations import CONVENTIONS
from datasets.importers.units import ANGLE_NAMES
from datasets.importers.units import LENGTHS as LENGTH_UNITS
from datasets.recording_files.keys import RECORDING, SECTIONS, Key
from datasets.samples.columns import (
    AXES,
    FIXED_TO,
    FLANGE,
    GROUPS,
    INTEGERS,
    KINDS,
    LENGTHS,
    POINT,
    QUATERNION,
)
from workbench.core.text.sections import Placement

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def recording_schema() -> dict:
    """recording.toml; keys of other programs are allowed."""
    properties = {}
    for name, key in RECORDING.items():
        is_section = name in SECTIONS and SECTIONS[name]
        properties[name] = _table(SECTIONS[name]) if is_section else key.schema
    required = [name for name, key in RECORDING.items() if key.required]
    return _root("recording.toml, format recording/1", properties, required)


def mapping_schema() -> dict:
    """The mapping file of `workbench import`."""
    text = {"type": "string"}
    unit = {"enum": [*ANGLE_NAMES, *LENGTH_UNITS]}
    group = {
        "type": "object",
        "properties": {
            "columns": {"type": "array", "items": text, "minItems": 1},
            "unit": {"anyOf": [unit, {"type": "array", "items": {"enum": ["", *unit["enum"]]}}]},
            "convention": {"enum": [*CONVENTIONS, *SPHERICAL_CONVENTIONS]},
            "inverse": {"type": "boolean"},
        },
        "required": ["columns"],
        "additionalProperties": False,
    }
    join = {
        "type": "object",
        "properties": {
            "by": {"enum": list(JOINS)},
            "key": text,
            "time_offset_s": {"type": "number"},
        },
        "additionalProperties": False,
    }
    properties = {
        "format": {"const": FORMAT},
        "measures": {"enum": list(KINDS)},
        "robot": text,
        "join": join,
        **dict.fromkeys(QUANTITIES, group),
        "joints": _with_counts(group),
        "columns": {"type": "object", "additionalProperties": text},
        **dict.fromkeys(PLACEMENTS, _placements()),
        "controller": Controller.model_json_schema(),
        "board": _table(SECTIONS["board"]),
    }
    return _root("mapping of an import, format import/1", properties, []) | {
        "additionalProperties": False
    }


def _with_counts(group: dict) -> dict:
    """The schema of [joints]: counts of the encoders in one degree take the place of a unit."""
    size = {"type": "number", "not": {"const": 0}}
    counts = {"anyOf": [size, {"type": "array", "items": size, "minItems": 1}]}
    return group | {"properties": group["properties"] | {"counts_per_deg": counts}}


def _placements() -> dict:
    """[tool] and [frame] of a mapping: one transform, or one for each number or name."""
    schema = Placement.model_json_schema()
    return {
        "type": "object",
        "properties": schema["properties"],
        "additionalProperties": schema,
        "minProperties": 1,
    }


def samples_schema() -> dict:
    """One row of samples.csv as an object; any other column with numbers is a covariate of its own name."""
    number, integer = {"type": "number"}, {"type": "integer"}
    properties = {
        "sample": integer,
        **dict.fromkeys(INTEGERS[1:], integer),
        **dict.fromkeys(GROUPS, {"type": ["integer", "string"]}),
        **dict.fromkeys((*POINT, *QUATERNION, *AXES[0], *AXES[1], *FLANGE), number),
        **dict.fromkeys(LENGTHS, {"type": "number", "exclusiveMinimum": 0}),
        "fixed_to": {"enum": [*FIXED_TO, ""]},
        "note": {"type": "string"},
    }
    schema = _root("one row of samples.csv", properties, ["sample"])
    return schema | {
        "patternProperties": {
            "^q[0-9]+_(deg|mm)$": {**number, "title": "q1_deg, q2_deg, ... (q1_mm: a slide)"}
        },
        "additionalProperties": number,
    }


def _table(keys: dict[str, Key]) -> dict:
    """A section of recording.toml."""
    return {
        "type": "object",
        "properties": {name: key.schema for name, key in keys.items()},
        "required": [name for name, key in keys.items() if key.required],
    }


def _root(title: str, properties: dict, required: list[str]) -> dict:
    return {
        "$schema": DRAFT,
        "title": title,
        "type": "object",
        "properties": properties,
        "required": required,
    }
