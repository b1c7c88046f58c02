"""Tables with thousands of columns: a column for each sample is read, anything else is refused at once."""

import numpy as np
import pytest

from datasets.importers.source import RawTable
from datasets.importers.sources.tables.reshaped import one_row_per_sample
from workbench.core.errors import InputError

SAMPLES = 3000
NAMES = ("q1", "q2", "q3", "q4", "q5", "q6", "x", "y", "z")


def wide(first):
    """A table with a first column of text and one column of numbers for each sample."""
    rng = np.random.default_rng(0)
    columns = {"name": np.array(first)}
    for k in range(SAMPLES):
        columns[f"sample {k}"] = rng.uniform(size=len(first))
    return RawTable("wide.csv", columns, np.arange(2, len(first) + 2))


def test_a_column_for_each_sample_is_read():
    found = one_row_per_sample(wide(NAMES))
    assert tuple(found.columns) == NAMES
    assert len(found.lines) == SAMPLES


def test_thousands_of_columns_without_such_names_are_refused():
    with pytest.raises(InputError, match="wide.csv: expected one column for each quantity"):
        one_row_per_sample(wide([f"text {k}" for k in range(9)]))
