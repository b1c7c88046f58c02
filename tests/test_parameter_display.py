"""Parameters as a person sees them: angles in degrees, deviations from nominal, and what has no estimate."""

from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from scenes import scene
from workbench.commands.shared import tables
from workbench.jobs.robot.calibrate import calibrate
from workbench.report.calibration import parameters as page


@pytest.fixture(scope="module")
def calibration():
    """An arm whose joint 2 has its zero 0.05 deg off, poses measured: base and tool carry what joints 1 and 6 show."""
    made = scene("external-pose", n=80, seed=3)
    columns = dict(made.recording.columns)
    columns["q2_deg"] = columns["q2_deg"] + 0.05
    rng = np.random.default_rng(1)
    columns |= {name: columns[name] + rng.normal(0, 0.02, 80) for name in ("x_mm", "y_mm", "z_mm")}
    return calibrate(replace(made.recording, columns=columns), folds=4)


@pytest.fixture(scope="module")
def rows(calibration):
    return calibration.as_json()["parameters"]


def test_every_parameter_has_one_status(calibration, rows):
    determined = calibration.solution.determined
    confounded = set(calibration.solution.single.tied())
    for row in rows:
        key = f"{row['where']}.{row['name']}"
        assert row["identifiable"] == (row["status"] == "estimated")
        if row["status"] == "estimated":
            assert key in determined and row["std"] > 0 and row["free"]
        elif row["status"] == "not identifiable":
            assert key in confounded or row["free"]
        else:
            assert row["status"] == "held" and not row["free"] and not row["tied_to"]


def test_sentence_counts_only_parameters_without_an_estimate(rows):
    """Identifiable coordinates of base and tool were counted as not identifiable, too."""
    frames = [
        row
        for row in rows
        if row["identifiable"] and row["where"] in ("base", "tool") and "." not in row["name"]
    ]
    assert frames
    missing = [row for row in rows if not row["identifiable"]]
    held = [row for row in missing if row["status"] == "held"]
    said = tables.unidentified(rows)
    assert f"{len(rows) - len(missing)} of {len(rows)} parameters are estimated" in said
    assert (
        f"{len(missing) - len(held)} are not identifiable" in said
        and f"{len(held)} are held fixed by the plan" in said
    )
    assert tables.unidentified([row for row in rows if row["identifiable"]]) == ""


def test_deviation_is_from_nominal_and_missing_where_nothing_is_nominal(rows):
    for row in rows:
        if row["where"] in ("base", "tool") and "." not in row["name"]:
            assert row["deviation"] is None
        else:
            assert row["deviation"] == pytest.approx(row["value"] - row["nominal"])


def test_terminal_shows_angles_in_degrees_with_deviation_and_std(calibration):
    console = Console(record=True, width=100)
    tables.calibration(console, calibration.as_json())
    said = console.export_text()
    line = next(line.split() for line in said.splitlines() if "theta2" in line)
    where, name, unit, value, deviation, std = line
    assert (where, name, unit) == ("joint-2", "theta2", "deg")
    assert float(value) == pytest.approx(-90.05, abs=0.01)
    assert float(deviation) == pytest.approx(-0.05, abs=0.01) and 0 < float(std) < 0.01
    assert " rad " not in said
    assert "rotation error, deg" in said and "held out deg" in said


def test_page_counts_what_the_terminal_counts(calibration, rows):
    said = page.count(calibration.parameters)
    for status in ("estimated", "not identifiable", "held"):
        assert f"{sum(row['status'] == status for row in rows)} are {status}" in said
    assert "undetermined" not in str(page.section(calibration))


@pytest.mark.parametrize(
    ("unit", "value", "std", "shown"),
    [
        ("rad", 0.0021, 1.2e-5, ["deg", "0.12032", "+0.12032", "0.00069"]),
        ("rad", -1.571, 2e-5, ["deg", "-90.0117", "-90.0117", "0.0011"]),
        ("mm", 270.4, 0.011, ["mm", "270.400", "+270.400", "0.011"]),
        ("rad/(N m)", 3.1e-5, 2e-6, ["µrad/(N m)", "31.0", "+31.0", "2"]),
    ],
)
def test_numbers_of_a_parameter_have_two_digits_of_their_std(unit, value, std, shown):
    row = {
        "where": "joint-3",
        "name": "p",
        "unit": unit,
        "value": value,
        "std": std,
        "nominal": 0.0,
        "deviation": value,
    }
    assert tables._parameter(row)[2:] == shown
