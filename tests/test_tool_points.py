"""Points on the tool that a calibration determined, and what those on one line leave open."""

import pytest

from robot_model.tool_points import undetermined_points_remark

LINE = {1: (0.0, 0.0, 100.0), 2: (0.0, 0.0, 150.0), 3: (0.5, 0.0, 200.0)}


def reflectors(places):
    return {
        f"tool.reflector{number}_{axis}": value
        for number, place in places.items()
        for axis, value in zip("xyz", place)
    }


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (reflectors({1: LINE[1]}), "those of the reflector (at 0, 0, 100 mm"),
        (reflectors(LINE), "those of the 3 reflectors, which are on one line"),
        ({f"tool.tip_{axis}": 10.0 for axis in "xyz"}, "those of the tip (at 10, 10, 10 mm"),
    ],
)
def test_points_on_a_line_leave_the_flange_open(values, words):
    remark = undetermined_points_remark(values)
    assert words in remark and "The flange, and a tool at another place, have errors" in remark


@pytest.mark.parametrize(
    "values",
    [
        reflectors(LINE | {3: (40.0, 0.0, 100.0)}),
        {f"sensor.{axis}": 1.0 for axis in "xyz"},
        {f"tool.{axis}": 1.0 for axis in "xyz"},
        {"base.x": 1.0},
    ],
)
def test_nothing_is_said_where_the_tool_is_determined(values):
    assert undetermined_points_remark(values) == ""
