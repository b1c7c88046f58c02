"""Writes docs/schemas/*.json and docs/reference/files.md: the keys of every file that a person writes.

The schemas come from the models and tables that the readers themselves check with. Run by `make docs`; the results are
not kept in the repository.
"""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from datasets.recording_files.schemas import DRAFT, mapping_schema, recording_schema, samples_schema
from sensors.rendering.scene import Scene as SensorScene
from sensors.scanner.file import _File as ScannerFile
from workbench.core.robot_files.robot_file import RobotFile
from workbench.files.scene import Scene as RobotScene
from workbench.fitting.calibration_plans.plans import plan_schema
from workbench.studies.spec import Study

DOCS = Path(__file__).resolve().parent.parent / "docs"
HEAD = """# Keys of every file

Each table is made from the checks of the reader itself, and so is the JSON Schema next to it. Editors with a TOML
language server complete and check keys with it: write `#:schema <path or address of the schema>` into the first line of
the file. A reader also checks what a schema cannot say, such as numbers that only go together.

![Kinds of file and the number of their keys](../images/files.png)

"""


@dataclass(frozen=True)
class File:
    """A kind of file: name of its schema, what it is for, and the schema."""

    name: str
    purpose: str
    schema: Mapping


def files() -> list[File]:
    """All kinds of file that have keys."""
    return [
        File("recording", "`recording.toml` of every recording", recording_schema()),
        File("samples", "One row of `samples.csv`", samples_schema()),
        File("robot", "`robot.toml`", _of_model(RobotFile)),
        File("import", "Mapping for `workbench import --map`", mapping_schema()),
        File("plan", "Plan for `workbench calibrate --plan`", plan_schema()),
        File("scene", "Scene of an arm for `workbench simulate`", _of_model(RobotScene)),
        File("sensor-scene", "Scene of a sensor for `workbench render`", _of_model(SensorScene)),
        File("study", "Study for `workbench study`", _of_model(Study)),
        File("scanner", "`scanner.toml`, a result of `workbench scanner`", _of_model(ScannerFile)),
    ]


def main() -> None:
    """Write the page and the schemas."""
    folder = DOCS / "schemas"
    folder.mkdir(exist_ok=True)
    parts = [HEAD]
    for file in files():
        text = json.dumps(file.schema, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        (folder / f"{file.name}.schema.json").write_text(text, encoding="utf-8")
        parts.append(section(file))
    (DOCS / "reference" / "files.md").write_text("\n".join(parts), encoding="utf-8")


def section(file: File) -> str:
    """Heading, link and table of one kind of file."""
    lines = [
        f"## {file.purpose}",
        "",
        f"[JSON Schema](../schemas/{file.name}.schema.json)",
        "",
        "| key | value | required | default |",
        "|---|---|---|---|",
    ]
    for key, rule, is_required in _keys(file.schema, file.schema.get("$defs", {})):
        default = "" if rule.get("default") is None else f"`{json.dumps(rule['default'])}`"
        cells = (f"`{key}`", _value(rule), "yes" if is_required else "", default)
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def _of_model(model) -> dict:
    return {"$schema": DRAFT, **_finite(model.model_json_schema())}


def _finite(value):
    """The value without defaults that JSON has no word for, such as infinity."""
    if isinstance(value, Mapping):
        return {key: _finite(inner) for key, inner in value.items() if _is_json(inner)}
    return [_finite(inner) for inner in value] if isinstance(value, list) else value


def _is_json(value) -> bool:
    return not isinstance(value, float) or math.isfinite(value)


def _keys(schema: Mapping, definitions: Mapping, prefix: str = "") -> Iterator[tuple]:
    """Key with its tables in front, rule, and whether it is required; tables before their keys."""
    for name, rule in schema.get("properties", {}).items():
        yield f"{prefix}{name}", rule, name in schema.get("required", ())
        inner, is_list = _table_of(rule, definitions)
        if inner is not None:
            yield from _keys(inner, definitions, f"{prefix}{name}{'[]' if is_list else ''}.")
    for rule in schema.get("patternProperties", {}).values():
        yield f"{prefix}{rule.get('title', '...')}", rule, False


def _table_of(rule: Mapping, definitions: Mapping) -> tuple[Mapping | None, bool]:
    """The table that a rule describes, and whether it is a list of them; (None, False) for a plain value."""
    for one in (rule, *rule.get("anyOf", ())):
        is_list = one.get("type") == "array"
        inner = one.get("items", {}) if is_list else one
        if "$ref" in inner:
            inner = definitions[inner["$ref"].rpartition("/")[2]]
        if inner.get("properties"):
            return inner, is_list
    return None, False


def _value(rule: Mapping) -> str:
    """The rule in words."""
    if "enum" in rule:
        return ", ".join(f"`{json.dumps(word)}`" for word in rule["enum"])
    if "const" in rule:
        return f"`{json.dumps(rule['const'])}`"
    if "anyOf" in rule:
        kinds = [_value(one) for one in rule["anyOf"] if one.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if "$ref" in rule:
        return "table"
    return _kind(rule) + _bounds(rule)


def _kind(rule: Mapping) -> str:
    kind = rule.get("type", "any value")
    if isinstance(kind, list):
        return " or ".join(kind)
    if kind == "array":
        items = rule.get("items", {})
        return "tables" if "$ref" in items else f"list of {_value(items) if items else 'values'}"
    return {"object": "table", "string": "text"}.get(kind, kind)


def _bounds(rule: Mapping) -> str:
    words = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
        "minItems": "at least",
        "maxItems": "at most",
    }
    if "minItems" in rule and rule["minItems"] == rule.get("maxItems"):
        return f", exactly {rule['minItems']}"
    found = [f"{word} {rule[name]:g}" for name, word in words.items() if name in rule]
    found = [text for text in found if not text.endswith("1e+12")]
    return f", {', '.join(found)}" if found else ""


if __name__ == "__main__":
    main()
