"""Limits of the joints in a Denavit-Hartenberg table."""

import pytest

from datasets.importers.sources.dh_tables import read_dh_table

ROWS = ["1,q1,290,0,-90,{},{}", "2,q2-90,0,270,0,{},{}"]


def limits_of(folder, header, cells):
    path = folder / "arm.csv"
    rows = [row.format(*pair) for row, pair in zip(ROWS, cells)]
    path.write_text("\n".join([f"joint,theta,d [mm],a [mm],alpha [deg],{header}", *rows, ""]))
    return [joint.get("limits_deg") for joint in read_dh_table(path)[0]["joint"]]


@pytest.mark.parametrize(
    "header", ["min [deg],max [deg]", "lower,upper", "q min,q max", "Limit low,Limit high"]
)
def test_limits_are_read_under_usual_headers(header, tmp_path):
    cells = [(-165, 165), (-110, 115)]
    assert limits_of(tmp_path, header, cells) == [[-165, 165], [-110, 115]]


def test_limits_below_one_revolution_are_radians(tmp_path):
    first, second = limits_of(tmp_path, "lower,upper", [(-3.14159, 3.14159), (-1.5, 1.5)])
    assert first == pytest.approx([-180, 180], abs=1e-3) and second[1] == pytest.approx(
        85.94, abs=0.01
    )


def test_a_table_without_limits_has_none(tmp_path):
    assert limits_of(tmp_path, "note,remark", [("a", "b"), ("c", "d")]) == [None, None]
