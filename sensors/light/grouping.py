"""Samples grouped by their labels: the number of each group, and positions relative to its middle."""

import numpy as np


def groups(*labels: np.ndarray) -> tuple[np.ndarray, int]:
    """(n,) number of each combination of labels (n,), from 0, and how many there are."""
    code = labels[0]
    for label in labels[1:]:
        code = code * (int(label.max(initial=0)) + 1) + label
    found, place = np.unique(code, return_inverse=True)
    return place, len(found)


def centred(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """(n,) values about the middle of their group (n,), of `count`, over its half width."""
    low = np.full(count, np.inf)
    high = np.full(count, -np.inf)
    np.minimum.at(low, group, values)
    np.maximum.at(high, group, values)
    return (values - (low + high)[group] / 2) / np.maximum((high - low)[group] / 2, 1e-9)
