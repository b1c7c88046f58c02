"""Columns that say which rows belong together hold numbers or names."""

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

from datasets.formats.table import read_table
from datasets.samples.columns import GROUPS
from workbench.core.errors import InputError


def written(path, cells):
    path.write_text(
        "sample,reflector\n" + "".join(f"{k},{cell}\n" for k, cell in enumerate(cells, 1))
    )
    return read_table(path, path.name, groups=GROUPS)


def test_names_become_numbers_in_order_of_first_occurrence(tmp_path):
    table = written(tmp_path / "samples.csv", ["SMR3", "SMR1", "SMR3", "SMR2"])
    assert table.columns["reflector"].tolist() == [1, 2, 1, 3]
    assert table.names == {"reflector": ("SMR3", "SMR1", "SMR2")}


def test_names_of_a_parquet_table_are_read_alike(tmp_path):
    table = pyarrow.table({"sample": [1, 2, 3], "reflector": ["b", "a", "b"]})
    pyarrow.parquet.write_table(table, tmp_path / "samples.parquet")
    found = read_table(tmp_path / "samples.parquet", "samples.parquet", groups=GROUPS)
    assert found.columns["reflector"].tolist() == [1, 2, 1]
    assert found.names == {"reflector": ("b", "a")}


def test_numbers_stay_numbers(tmp_path):
    table = written(tmp_path / "samples.csv", ["2", "7", "2"])
    assert np.array_equal(table.columns["reflector"], [2, 7, 2])
    assert table.names == {}


@pytest.mark.parametrize(
    ("cells", "row"), [(["1", "2", "2a"], 4), (["SMR1", "", "SMR2"], 3), (["1,5", "2", "3"], 2)]
)
def test_a_cell_that_is_neither_is_named(tmp_path, cells, row):
    quoted = [f'"{cell}"' for cell in cells]
    with pytest.raises(InputError, match=f"row {row}, column reflector"):
        written(tmp_path / "samples.csv", quoted)
