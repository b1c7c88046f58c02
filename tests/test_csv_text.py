"""CSV files: every text comes back as it was, in its own column, and no cell is run as a formula."""

import ast
import csv
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import ROOT
from datasets.formats.recording1_writer import write_csv
from datasets.formats.table import read_table
from workbench.core.text.csv_text import (
    csv_text,
    protect_cell,
    protect_text_columns,
    unprotect_cell,
)
from workbench.files.targets import as_csv

# What a UTF-8 file can hold; NUL is refused by every reader of text files.
CHARACTERS = st.characters(blacklist_categories=("Cs",), blacklist_characters="\0")
AWKWARD = st.sampled_from(
    [
        "=1+1",
        "+49 30",
        "-",
        "@cmd",
        "'=x",
        "''-y",
        "a, b",
        'say "no"',
        "a\nb",
        "a\rb",
        "\r\n",
        "\t=1",
        "＝1",
        "-5",
        "1e5",
        "",
        "Шов 球",
        ";",
        "'",
    ]
)
TEXTS = st.one_of(
    AWKWARD,
    st.text(CHARACTERS, max_size=30),
    st.builds(str.__add__, AWKWARD, st.text(CHARACTERS, max_size=9)),
)
STARTS_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True


@given(TEXTS)
def test_a_protected_cell_is_no_formula_and_comes_back(text):
    written = protect_cell(text)
    assert unprotect_cell(written) == text
    assert not written.startswith(STARTS_FORMULA) or is_number(written)


def test_numbers_are_not_touched():
    assert [protect_cell(cell) for cell in ("-5", "+1.5e-3", "-inf", "-.5")] == [
        "-5",
        "+1.5e-3",
        "-inf",
        "-.5",
    ]
    assert protect_cell(-5.0) == -5.0 and protect_cell(None) is None


@given(st.lists(st.tuples(TEXTS, TEXTS), max_size=5))
def test_python_reads_the_rows_that_were_written(rows):
    text = csv_text(["a", "b"], rows)
    read = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    assert [[unprotect_cell(cell) for cell in row] for row in read] == [
        ["a", "b"],
        *map(list, rows),
    ]


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(TEXTS, st.floats(-1e6, 1e6)), min_size=1, max_size=5))
def test_a_programme_written_and_read_again_keeps_every_joint_in_its_column(tmp_path_factory, rows):
    """A note with a comma once moved every joint one column to the right."""
    path = tmp_path_factory.getbasetemp() / "programme.csv"
    notes, angles = (list(column) for column in zip(*rows))
    columns = {"note": np.array(notes), "q1_deg": np.array(angles), "q2_deg": -np.array(angles)}
    path.write_text(as_csv(columns), encoding="utf-8", newline="")
    table = read_table(path, "programme.csv", ("note",))
    assert table.columns["note"].tolist() == [
        note if protect_cell(note) != note else note.strip() for note in notes
    ]
    np.testing.assert_allclose(table.columns["q1_deg"], angles, rtol=1e-9)
    np.testing.assert_allclose(table.columns["q2_deg"], -np.array(angles), rtol=1e-9)


def test_a_recording_with_an_awkward_note_and_column_comes_back(tmp_path):
    notes = np.array(["weld, left 5", "first\nsecond", "=HYPERLINK(1)", "'-x"])
    columns = {"sample": np.arange(4.0), "=load": np.arange(4.0), "note": notes}
    write_csv(tmp_path / "samples.csv", columns)
    read = read_table(tmp_path / "samples.csv", "samples.csv", ("note",))
    assert list(read.columns) == list(columns)
    assert read.columns["note"].tolist() == notes.tolist()
    assert "'=HYPERLINK" in (tmp_path / "samples.csv").read_text(encoding="utf-8")


def test_texts_of_a_study_and_of_a_proof_are_protected(tmp_path):
    import pyarrow

    table = protect_text_columns(
        pyarrow.table({"=case": ["=a", "b", None], "size": [1.0, -2.0, None]})
    )
    assert table.column_names == ["'=case", "size"]
    assert table.column(0).to_pylist() == ["'=a", "b", None]
    assert table.column(1).to_pylist() == [1.0, -2.0, None]


def written_by_hand(path: Path) -> list[int]:
    """Lines that join cells with a comma alone, or write CSV without the one module that quotes and protects."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        owner, name = node.func.value, node.func.attr
        joins = name == "join" and isinstance(owner, ast.Constant) and owner.value == ","
        own_writer = (
            name in ("writer", "DictWriter") and isinstance(owner, ast.Name) and owner.id == "csv"
        )
        if joins or own_writer:
            found.append(node.lineno)
    return found


@pytest.mark.parametrize("package", ["workbench", "sensors", "robot_model", "datasets"])
def test_every_table_of_the_product_goes_through_one_writer(package):
    """The makers of recordings write numbers only, and may not import the workbench."""
    allowed = {ROOT / "workbench/core/text/csv_text.py"}
    paths = [
        path
        for path in (ROOT / package).rglob("*.py")
        if "makers" not in path.parts and path not in allowed
    ]
    found = {
        str(path.relative_to(ROOT)): lines for path in paths if (lines := written_by_hand(path))
    }
    # Column names of our own and numbers, written by numpy for speed.
    found.pop("workbench/files/results.py", None)
    assert found == {}
