"""Rows by the number of a sample."""

import numpy as np


def rows_of(ids: np.ndarray, wanted_ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row of `ids` (n,) of each wanted number (k,), and (k,) bool whether it is there; the row is any where not.

    ids: unique. Of ascending ones, as in most recordings, a row is found without sorting them.
    """
    if not len(ids):
        return np.zeros(len(wanted_ids), int), np.zeros(len(wanted_ids), bool)
    is_ascending = bool((ids[1:] > ids[:-1]).all())
    order = slice(None) if is_ascending else np.argsort(ids, kind="stable")
    place = np.minimum(np.searchsorted(ids[order], wanted_ids), len(ids) - 1)
    rows = place if is_ascending else order[place]
    return rows, ids[rows] == wanted_ids
