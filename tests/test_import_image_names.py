"""Images and rows of a pose table are connected by names that only differ in notation."""

from pathlib import Path

import numpy as np
import pytest

from datasets.importers.source import ImageFile, RawTable
from workbench.recordings.importing.board_images.image_rows import file_link, matched_rows

NUMBERS = [k for k in range(1, 15) if k != 5]
IMAGES = [ImageFile(Path(f"img_{k:03d}.png"), f"img_{k:03d}.png") for k in NUMBERS]


def table_of(cells, lines=None) -> RawTable:
    cells = np.array(cells)
    columns = {"X": np.linspace(0.5, 9.0, len(cells)), "Bild": cells}
    return RawTable("p.csv", columns, np.arange(2, 2 + len(cells)) if lines is None else lines)


@pytest.mark.parametrize(
    "name",
    [
        float,
        "Bild {}",
        "{:03d}",
        "{}.png",
        "img_{}.png",
        "IMG_{:03d}.PNG",
        r"C:\cam\img_{:03d}.png",
    ],
)
def test_names_that_differ_in_notation_are_one_name(name):
    """15 rows in another order, 13 images of which the fifth is missing."""
    order = np.random.default_rng(1).permutation(15)
    cells = [float(k + 1) if name is float else name.format(k + 1) for k in order]
    pairs, said = matched_rows(IMAGES, table_of(cells))
    assert [
        (image.name, order[row] + 1) for image, row in sorted(pairs, key=lambda p: p[0].name)
    ] == [(image.name, number) for image, number in zip(IMAGES, NUMBERS)]
    without = sorted(int(np.flatnonzero(order == k)[0]) + 2 for k in (4, 14))
    assert said == (
        f"Rows of p.csv without an image are left out (2 of 15): {without[0]}, {without[1]}.",
    )
    assert file_link(IMAGES, table_of(cells))[0] == ("Bild",)


def test_the_names_decide_also_where_counts_are_equal():
    pairs, said = matched_rows(IMAGES, table_of(np.arange(1.0, 14.0)))
    assert [row for image, row in pairs] == [0, 1, 2, 3, *range(5, 13)]
    assert len(said) == 2 and "img_014.png" in said[0] and "6" in said[1]


def test_numbers_that_count_from_another_start_are_no_names():
    images = [ImageFile(Path(f"img_{k}.png"), f"img_{k}.png") for k in range(1, 11)]
    pairs, said = matched_rows(images, table_of(np.arange(10.0)))
    assert [row for _, row in pairs] == list(range(10)) and not said


def test_coordinates_are_no_names():
    images = IMAGES[:6]
    pairs, _ = matched_rows(images, table_of([538.0, 606.0, 662.0, 413.0, 629.0, 500.0]))
    assert [row for _, row in pairs] == list(range(6))
