"""Times of imported rows: notations, dates in a column of their own, and columns that a mapping calls times."""

import numpy as np
import pytest

from datasets.importers.mapping.joined_tables.time_stamps import seconds_of_stamps
from datasets.importers.mapping.model import read_mapping
from import_scenes import SCENE, degrees, simulated
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["14/09/2026 08:12:05", "14/09/2026 08:12:29"], 24),
        (["09/14/2026 11:59:50 AM", "09/14/2026 12:00:10 PM"], 20),
        (["30/04/2026 23:59:50", "01/05/2026 00:00:10"], 20),
        (["04/05/2026 08:00:00", "05/05/2026 08:00:00"], 86400),  # a day, not a month
        (["2026-09-14T08:12:05.5", "2026-09-14T08:12:06"], 0.5),
        (["14.09.2026 08:12:05,25", "14.09.2026 08:12:06"], 0.75),
        (["08:12:05", "08:12:05.5"], 0.5),
    ],
)
def test_stamps_are_read_in_one_notation(texts, seconds):
    assert np.ptp(seconds_of_stamps(texts)) == pytest.approx(seconds)


def test_what_is_no_stamp_is_not_read():
    assert seconds_of_stamps(["31/02/2026 08:00:00", "08:00:01"]) is None


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


def table(path, truth, header: str, stamps):
    """A table of joint readings and points with texts of times in front."""
    names = [header, *(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"]
    numbers = np.hstack([degrees(truth), truth.points])
    rows = [";".join([stamp, *map(str, row)]) for stamp, row in zip(stamps, numbers)]
    path.write_text("\n".join([";".join(names), *rows]), encoding="utf-8")
    return path


def test_a_date_in_a_column_of_its_own_counts_whatever_it_is_called(tmp_path, truth):
    stamps = [f"{14 + (k > 2)}/09/2026;08:{k % 60:02d}:00" for k in range(truth.n)]
    path = table(tmp_path / "log.csv", truth, "Data;Ora", stamps)
    made = import_recording([path], tmp_path / "out", ImportOptions(robot="ur10"))
    assert np.diff(made.recording.covariates["time_s"])[:4] == pytest.approx([60, 60, 86460, 60])


MAPPING = '[columns]\n"Moment" = "time_s"\n'


def mapped(tmp_path, truth, stamps):
    path = table(tmp_path / "log.csv", truth, "Moment", stamps)
    file = tmp_path / "map.toml"
    file.write_text(MAPPING, encoding="utf-8")
    options = ImportOptions(mapping=read_mapping(file), robot="ur10")
    return import_recording([path], tmp_path / "out", options).recording


def test_a_column_that_a_mapping_calls_a_time_is_read_as_one(tmp_path, truth):
    """It was numbered like names: 1, 2, 3."""
    stamps = [f"14/09/2026 08:{2 * k // 60:02d}:{2 * k % 60:02d}" for k in range(truth.n)]
    assert mapped(tmp_path, truth, stamps).covariates["time_s"][:3] == pytest.approx([0, 2, 4])


def test_a_time_that_cannot_be_read_is_one_sentence(tmp_path, truth):
    with pytest.raises(InputError, match="column Moment.*time stamps such as.*'early'"):
        mapped(tmp_path, truth, ["early"] * truth.n)
