"""Points and joint readings that were joined in different orders: numbers sorted as text, poses in reverse order."""

from dataclasses import replace

import numpy as np
import pytest

from erring_scenes import erring
from workbench.fitting.plausibility import check_plausibility
from workbench.fitting.plausibility.hypotheses.row_corrections import row_corrections

TEXT_ORDER = np.argsort([str(number) for number in range(1, 61)], kind="stable")
POINT = ("x_mm", "y_mm", "z_mm", "reflector")


@pytest.fixture(scope="module")
def made():
    return erring("external-point", 5, n=60)


def reordered(recording, order, names):
    return replace(
        recording,
        columns={n: v[order] if n in names else v for n, v in recording.columns.items()},
    )


@pytest.mark.parametrize("sorted_part, names", [("measurements", POINT), ("joint readings", None)])
def test_numbers_sorted_as_text_in_one_part_are_named(made, sorted_part, names):
    robot, recording = made
    names = names or [name for name in recording.columns if name.startswith("q")]
    (found,) = check_plausibility(robot, reordered(recording, TEXT_ORDER, names))
    assert found.cause == "rows-sorted-as-text" and found.certain
    assert "(1, 10, 11, 12 ...)" in found.sentence
    assert f"sort the {sorted_part} by number" in found.sentence


def test_poses_of_several_rows_in_reverse_order_are_corrected(made):
    """Three reflectors a pose: the poses are reversed, and the reflectors within a pose are not."""
    _, recording = made
    columns = {
        n: np.repeat(v, 3) if n.startswith("q") else np.arange(180.0)
        for n, v in recording.columns.items()
    }
    three = replace(recording, columns=columns)
    corrections = [c for c in row_corrections(three) if c.cause == "rows-reversed"]
    corrected = corrections[1].apply(None, three)[1]
    assert corrected.columns["x_mm"][:6].tolist() == [177, 178, 179, 174, 175, 176]
    assert (corrected.columns["q1_deg"] == three.columns["q1_deg"]).all()


def test_up_to_nine_poses_have_one_order(made):
    _, recording = made
    few = recording.select(np.arange(60) < 9)
    assert not [c for c in row_corrections(few) if c.cause == "rows-sorted-as-text"]
