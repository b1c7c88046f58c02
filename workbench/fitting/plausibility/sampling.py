"""Which rows a plausibility check looks at."""

import numpy as np

_POINTS_OF_SCAN = 8
_ROWS_OF_SCAN = 2.0
"""Samples of another kind that a scan of a ball stands for: its points say three numbers together."""


def even_rows(recording, max_count: int) -> np.ndarray:
    """At most about `max_count` row numbers in ascending order, evenly among the rows of every ball or reflector.

    Of kind ball-surface: several points of each of at most half as many scans, as one point alone says little.
    """
    if recording.measures == "ball-surface":
        return _rows_of_scans(recording, int(max_count / _ROWS_OF_SCAN))
    label = recording.ball if recording.measures == "ball-centre" else recording.reflector
    return _evenly_spaced(label, max_count)


def _evenly_spaced(label: np.ndarray, max_count: int) -> np.ndarray:
    first = np.unique(label, return_index=True)[1]
    order = np.argsort(label, kind="stable")
    spaced = np.linspace(0, len(label) - 1, min(max_count, len(label))).astype(int)
    return np.unique(np.concatenate([order[spaced], first]))


def _rows_of_scans(recording, max_count: int) -> np.ndarray:
    """Rows of at most about `max_count` scans, a scan being the points of one ball in one pose."""
    scans, first, scan = np.unique(
        np.stack([recording.poses, recording.ball]), axis=1, return_index=True, return_inverse=True
    )
    chosen = _evenly_spaced(scans[1], max_count)
    order = np.argsort(scan.ravel(), kind="stable")
    ends = np.cumsum(np.bincount(scan.ravel(), minlength=len(first)))
    rows = []
    for number in chosen:
        start = 0 if number == 0 else ends[number - 1]
        count = ends[number] - start
        spaced = np.linspace(0, count - 1, min(_POINTS_OF_SCAN, count)).astype(int)
        rows.append(order[start + spaced])
    return np.sort(np.concatenate(rows))
