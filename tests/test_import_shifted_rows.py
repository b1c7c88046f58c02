"""Measurements and joint readings that are shifted against each other from a row on: the row and the columns are named."""

import numpy as np
import pytest

from import_scenes import SCENE, degrees, simulated, write_rows
from workbench.core.errors import InputError
from workbench.recordings.importing import ImportOptions, import_recording


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("scene"), SCENE)


@pytest.mark.parametrize(
    ("at", "missing", "words", "unit"),
    [
        (17, "joints", "are late", ""),
        (12, "point", "are early", " [mm]"),
        (12, "joints", "are late", " [mm]"),
    ],
)
def test_the_row_where_a_shift_begins_is_named(at, missing, words, unit, truth, tmp_path):
    """Cells of one instrument are removed at row `at`, and the cells below move up."""
    joints, points = degrees(truth), truth.points
    joints = np.delete(joints, at if missing == "joints" else len(joints) - 1, axis=0)
    points = np.delete(points, at if missing == "point" else len(points) - 1, axis=0)
    names = [*(f"J{k} [deg]" for k in range(1, 7)), *(f"{c}{unit}" for c in "XYZ")]
    path = write_rows(tmp_path / "t.csv", names, np.column_stack([joints, points]))
    with pytest.raises(InputError) as refusal:
        import_recording([path], tmp_path / "out", ImportOptions(robot="ur10"))
    said = str(refusal.value)
    assert (
        f"From row {at + 2} on the columns 'X{unit}' to 'Z{unit}' {words} against 'J1 [deg]'"
        in said
    )
    named = "'J1 [deg]' to 'J6 [deg]'" if missing == "joints" else f"'X{unit}' to 'Z{unit}'"
    assert f"cells of {named} are missing there" in said


def test_the_advice_on_another_zero_states_the_unit():
    """The column of the user may be in gon."""
    from robot_model import load_robot
    from workbench.fitting.plausibility.hypotheses.joint_corrections import _offsets

    remedies = [correction.remedy for correction in _offsets(load_robot("ur5"), ["q2_deg"])]
    assert any(text.startswith("add -90 degrees (-100 gon) to it") for text in remedies)
