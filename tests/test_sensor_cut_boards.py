"""Where a laser's line is looked for on a board of which some corners were not seen."""

from dataclasses import replace

import numpy as np

import datasets
from sensor_recordings import scanner_recording
from sensors.boards.detection import detect_all
from workbench.jobs.sensor.scanner import region_of


def test_a_board_that_is_cut_keeps_its_stripes():
    """With the corners of its left half alone, the region still holds the right half of the board."""
    found = detect_all(datasets.read(scanner_recording()[0]))
    view, board = found.views[0], found.board
    left = np.flatnonzero(board.points[0, view.index] < board.points[0].mean())
    half = replace(view, index=view.index[left], pixels=view.pixels[:, left])
    whole, part = region_of(view, board), region_of(half, board)
    assert part[whole].mean() > 0.8
    assert whole[part].mean() > 0.85
    right = np.setdiff1d(np.arange(len(view.index)), left)
    columns, rows = np.round(view.pixels[:, right]).astype(int)
    assert part[rows, columns].all()


def test_a_few_corners_place_no_board():
    found = detect_all(datasets.read(scanner_recording()[0]))
    view = found.views[0]
    few = replace(view, index=view.index[:6], pixels=view.pixels[:, :6])
    assert region_of(few, found.board).sum() < region_of(view, found.board).sum()
