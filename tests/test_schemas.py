"""The JSON Schemas of the documentation accept the files of the project and refuse what the readers refuse."""

import csv
import json
import subprocess
import sys
import tomllib
from importlib import util

import pytest

from conftest import ROOT
from datasets.recording_files.keys import SECTIONS
from datasets.recording_files.schemas import mapping_schema, recording_schema, samples_schema
from workbench.core.errors import InputError
from workbench.core.robot_files.robot_file import RobotFile, checked_robot_file
from workbench.recordings.templates import write_template

jsonschema = pytest.importorskip("jsonschema")
KINDS = ["external-point", "external-pose", "ball-centre", "touch-point", "distance"]


@pytest.fixture(scope="module")
def schemas():
    """Every schema of the documentation by its name."""
    spec = util.spec_from_file_location("schema_page", ROOT / "tools" / "schema_page.py")
    page = util.module_from_spec(spec)
    sys.modules["schema_page"] = page
    spec.loader.exec_module(page)
    return {file.name: file.schema for file in page.files()}


def accepts(schema, value) -> bool:
    return jsonschema.Draft202012Validator(schema).is_valid(value)


def test_every_schema_is_one(schemas):
    for schema in schemas.values():
        jsonschema.Draft202012Validator.check_schema(schema)
        json.dumps(schema, allow_nan=False)


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_templates_pass(kind, schemas, tmp_path):
    write_template(kind, tmp_path / "made")
    keys = tomllib.loads((tmp_path / "made" / "recording.toml").read_text())
    jsonschema.validate(keys, schemas["recording"], jsonschema.Draft202012Validator)
    robot = tomllib.loads((tmp_path / "made" / "robot.toml").read_text())
    jsonschema.validate(robot, schemas["robot"], jsonschema.Draft202012Validator)
    with (tmp_path / "made" / "samples.csv").open() as file:
        for row in csv.DictReader(file):
            cells = {name: _cell(cell) for name, cell in row.items()}
            jsonschema.validate(cells, schemas["samples"], jsonschema.Draft202012Validator)


def _cell(text: str):
    try:
        return int(text) if text.lstrip("-").isdigit() else float(text)
    except ValueError:
        return text


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("robot_model/robots", "robot"),
        ("workbench/fitting/calibration_plans/plan_files", "plan"),
        ("workbench/studies/study_files", "study"),
    ],
)
def test_files_of_the_project_pass(folder, name, schemas):
    paths = [
        path
        for path in sorted((ROOT / folder).glob("*.toml"))
        if name == path.stem or _is(path, name)
    ]
    assert len(paths) >= 5
    for path in paths:
        keys = tomllib.loads(path.read_text(encoding="utf-8"))
        jsonschema.validate(keys, schemas[name], jsonschema.Draft202012Validator)


def _is(path, name) -> bool:
    """Whether a file of the studies is a study: scenes and plans lie next to them."""
    return name != "study" or not path.stem.startswith(("plan-", "scene-"))


@pytest.mark.parametrize(
    "change",
    [
        {"format": "recording/2"},
        {"measures": "pictures"},
        {"sigma_mm": 0},
        {"sigma_mm": "0.02"},
        {"board": {"kind": "chess", "columns": 9, "rows": 6, "square_mm": 3.0}},
        {"board": {"kind": "chessboard", "columns": 9, "rows": 6}},
        {"samples": {"file": "samples.csv", "small_range": 1}},
    ],
)
def test_a_wrong_recording_is_refused_by_schema_and_reader(change):
    from datasets.recording_files.keys import RECORDING, check_keys

    keys = {"format": "recording/1", "measures": "external-point", "samples": {"file": "s.csv"}}
    assert accepts(recording_schema(), keys)
    wrong = keys | change
    assert not accepts(recording_schema(), wrong)
    with pytest.raises(InputError):
        check_keys(wrong, RECORDING, "recording.toml")
        for name, section in SECTIONS.items():
            if name in wrong:
                check_keys(wrong[name], section, name)


@pytest.mark.parametrize(
    "change", [{"convention": "dh"}, {"joint": []}, {"joints": 3}, {"gravity": [0.0, 1.0]}]
)
def test_a_wrong_robot_is_refused_by_schema_and_reader(change):
    row = {"theta_deg": 0.0, "d_mm": 1.0, "a_mm": 2.0, "alpha_deg": 90.0}
    keys = {"name": "r", "convention": "distal", "joint": [row]}
    assert accepts(RobotFile.model_json_schema(), keys)
    assert not accepts(RobotFile.model_json_schema(), keys | change)
    with pytest.raises(InputError):
        checked_robot_file(keys | change, "robot.toml")


@pytest.mark.parametrize(
    "change",
    [
        {"joints": {"columns": []}},
        {"joints": {"columns": ["A1"], "unit": "turns"}},
        {"joinz": {}},
        {"join": {"by": "luck"}},
    ],
)
def test_a_wrong_mapping_is_refused_by_schema_and_reader(change):
    from datasets.importers.mapping.model import mapping_from_keys

    keys = {"format": "import/1", "joints": {"columns": ["A1", "A2"], "unit": "deg"}}
    assert accepts(mapping_schema(), keys)
    assert not accepts(mapping_schema(), keys | change)
    with pytest.raises(InputError):
        mapping_from_keys(keys | change, "map.toml")


def test_text_is_no_covariate():
    assert accepts(samples_schema(), {"sample": 1, "q1_deg": 2.5, "humidity": 40})
    assert not accepts(samples_schema(), {"sample": 1, "q1_deg": "2,5"})


def test_the_page_is_written(tmp_path):
    code = (
        "import sys, pathlib; sys.path.insert(0, 'tools'); import schema_page;"
        f"schema_page.DOCS = pathlib.Path({str(tmp_path)!r}); schema_page.main()"
    )
    (tmp_path / "reference").mkdir()
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=120)
    page = (tmp_path / "reference" / "files.md").read_text(encoding="utf-8")
    assert "| `joint[].alpha_deg` | number | yes |" in page
    assert (
        json.loads((tmp_path / "schemas" / "robot.schema.json").read_text())["title"] == "RobotFile"
    )
