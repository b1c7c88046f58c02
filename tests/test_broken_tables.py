"""Tables that are not what their ending says, in another encoding, or of column types that hold no numbers."""

import datetime
import decimal

import numpy as np
import pytest

from datasets.errors import InputError
from datasets.formats.table import read_table
from datasets.samples import chunks

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

OTHER_BYTES = pa.Array.from_buffers(
    pa.string(), 2, pa.array([b"\xff\xfe", b"ok"], pa.binary()).buffers()
)
COLUMNS = {
    "list": pa.array([[1.0], [2.0]]),
    "struct": pa.array([{"a": 1}, {"a": 2}]),
    "text": pa.array(["a", "b"]),
    "category": pa.array(["a", "b"]).dictionary_encode(),
    "timestamp": pa.array([datetime.datetime(2020, 1, 1)] * 2),
    "date": pa.array([datetime.date(2020, 1, 1)] * 2),
    "duration": pa.array([datetime.timedelta(1)] * 2),
    "binary": pa.array([b"\xff", b"a"]),
    "bool": pa.array([True, False]),
    "null": pa.nulls(2),
}


def both_readers(path):
    """Whole, as `calibrate` reads it, and in chunks, as `calibrate-large` does."""
    yield lambda: read_table(path, path.name, ("note",))
    yield lambda: list(chunks._tables(path))


def check_sentence(path, words):
    for read in both_readers(path):
        with pytest.raises(InputError, match=words) as found:
            read()
        assert "\n" not in str(found.value)


def test_a_parquet_column_name_that_is_not_utf_8_is_a_sentence(tmp_path):
    path = tmp_path / "samples.parquet"
    pq.write_table(pa.table({"sample": [1.0], "q1_degX": [2.0]}), path)
    path.write_bytes(path.read_bytes().replace(b"q1_degX", b"q1_d\xff\xfeX"))
    check_sentence(
        path,
        r"column q1_d\\xff\\xfeX: expected column names in UTF-8, found another encoding; rename",
    )


def test_a_parquet_text_that_is_not_utf_8_is_a_sentence(tmp_path):
    path = tmp_path / "samples.parquet"
    pq.write_table(pa.table({"sample": [1.0, 2.0], "note": OTHER_BYTES}), path)
    check_sentence(path, "column note: expected text in UTF-8, found a cell in another encoding")


@pytest.mark.parametrize("kind", COLUMNS)
def test_a_parquet_column_without_numbers_is_a_sentence(tmp_path, kind):
    path = tmp_path / "samples.parquet"
    pq.write_table(pa.table({"sample": [1.0, 2.0], "x_mm": COLUMNS[kind]}), path)
    check_sentence(path, "column x_mm: expected numbers, found the column type")


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["a", "a"], "column a: expected every column once"),
        (["a", " a"], "column a: expected every column once"),
        (["a", ""], "column 2: expected a column name, found an empty one"),
    ],
)
def test_parquet_names_that_clash_are_a_sentence(tmp_path, names, words):
    path = tmp_path / "samples.parquet"
    pq.write_table(pa.Table.from_arrays([pa.array([1.0]), pa.array([2.0])], names=names), path)
    check_sentence(path, words)


def test_categories_and_decimals_are_read(tmp_path):
    path = tmp_path / "samples.parquet"
    decimals = pa.array([decimal.Decimal("1.5"), decimal.Decimal("-2.25")])
    pq.write_table(pa.table({"x_mm": decimals, "note": COLUMNS["category"]}), path)
    table = read_table(path, path.name, ("note",))
    np.testing.assert_array_equal(table.columns["x_mm"], [1.5, -2.25])
    assert table.columns["note"].tolist() == ["a", "b"]


@pytest.mark.parametrize("cut", [0, 8, 60, -20, -1])
def test_a_parquet_file_that_was_cut_off_is_a_sentence(tmp_path, cut):
    path = tmp_path / "samples.parquet"
    pq.write_table(pa.table({"sample": [1.0, 2.0]}), path)
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(InputError, match="expected a (Parquet file|file with content)"):
        read_table(path, path.name)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            "sample,note\n1,Müller\n".encode("cp1252"),
            "byte 16: expected UTF-8 text, found another encoding",
        ),
        ("sample\n1\n".encode("utf-16"), "byte 1: expected UTF-8 text, found UTF-16 text"),
        ("sample\n1\n".encode("utf-16-le"), "row 1: expected UTF-8 text, found zero bytes"),
        (b"sample,note\n1,a\0b\n", "row 2, column note: expected text, found a zero byte"),
        (b"", "expected a file with content, found an empty file"),
        (b"\xef\xbb\xbf", "expected a header row"),
        (b" \n\n", "expected a header row"),
        (b"a, a\n1,2\n", "column a: expected every column once"),
        (b"a,\n1,2\n", "column 2: expected a column name"),
        (b"a;b\n1;2\n", "columns separated by semicolons"),
        (b"a,b\n", "expected at least one row"),
        (b'a,b\n1,"2\n', "a row that breaks off"),
        (b"\x1f\x8b\x08\0", "another encoding"),
    ],
)
def test_a_csv_file_that_is_none_is_a_sentence(tmp_path, content, words):
    path = tmp_path / "samples.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=words):
        read_table(path, "samples.csv", ("note",))


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("payload_kg", -0.5, "a mass of 0 kg or more, found -0.5"),
        ("payload_kg", np.nan, "a finite number, found nan"),
        ("payload_kg", np.inf, "a finite number, found inf"),
        ("temperature_c", -300.0, "a temperature above -273.15 °C"),
        ("temperature_j2_c", -1e4, "a temperature above -273.15 °C"),
    ],
)
def test_no_recording_has_a_negative_load(tmp_path, column, value, words):
    from datasets import read, write
    from scenes import scene

    made = scene("external-point", n=12).recording
    values = np.full(12, 2.0)
    values[4] = value
    write(
        type(made)(
            "external-point", dict(made.columns) | {column: values}, made.robot, sigma_mm=0.02
        ),
        tmp_path / "r",
    )
    with pytest.raises(
        InputError, match=rf"samples.csv, row 6 \(sample 5\), column {column}: expected {words}"
    ):
        read(tmp_path / "r")
