"""Means and counts over all samples that are kept, from those over all samples and those that are excluded.

An exclusion of some samples of a million then takes the time of the excluded ones.
"""

from collections.abc import Iterable
from functools import cached_property

import numpy as np

from workbench.app.data.decimate import (
    Histogram,
    bins_of,
    drawn_always,
    histogram,
    histogram_without,
    means_of,
    sums_in,
)
from workbench.app.data.memo import Memo
from workbench.app.data.opened import Opened

_MOST_KNOWN = 64


class Summaries:
    """Quantities, lengths and their summaries of one opened run; rows count its residuals (m).

    Nothing here depends on the session: excluded rows are given.
    """

    def __init__(self, opened: Opened):
        self.opened = opened
        self.memo = Memo(_MOST_KNOWN)

    @cached_property
    def quantities(self) -> dict[str, np.ndarray]:
        """Label with unit -> (m,) values of everything that a residual can be drawn over."""
        return quantities_of(self.opened)

    def lengths(self, kind: str = "") -> np.ndarray:
        """(m,) mm, length of the residual of a kind, "" for the one that is shown; zeros without a run."""
        residuals = self.opened.residuals
        if residuals is None:
            return np.zeros(len(self.opened.rows))
        return residuals.lengths[kind] if kind in residuals.lengths else residuals.shown

    def drawn(self, max_count: int, kind: str = "") -> np.ndarray:
        """Rows that a figure of at most about `max_count` marks shows: the largest, and some evenly spread."""
        return self.memo.get(
            ("drawn", max_count, kind), lambda: drawn_always(self.lengths(kind), max_count)
        )

    def sorted_lengths(self, kind: str) -> np.ndarray:
        """(k,) mm, ascending: all finite lengths of a kind."""

        def compute():
            lengths = self.lengths(kind)
            return np.sort(lengths[np.isfinite(lengths)])

        return self.memo.get(("sorted", kind), compute)

    def means(self, name: str, kind: str, excluded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean quantity and mean length over bins of about equal count, without the rows `excluded` (k,)."""
        x = self.quantities[name]
        y = self.lengths(kind)
        place = self.memo.get(("bins", name), lambda: bins_of(x))
        total = self.memo.get(("sums", name, kind), lambda: sums_in(place, x, y))
        left_out = sums_in(place[excluded], x[excluded], y[excluded], total.shape[1])
        return means_of(total - left_out)

    def counts(self, kinds: Iterable[str], excluded: np.ndarray) -> Histogram:
        """Counts of the lengths of some kinds without the rows `excluded` (k,)."""
        kinds = list(kinds)
        if 2 * len(excluded) > len(self.opened.rows):
            is_shown = np.ones(len(self.opened.rows), bool)
            is_shown[excluded] = False
            return histogram({kind: self.lengths(kind)[is_shown] for kind in kinds})
        total = {kind: self.sorted_lengths(kind) for kind in kinds}
        return histogram_without(total, {kind: self.lengths(kind)[excluded] for kind in kinds})


def quantities_of(opened: Opened) -> dict[str, np.ndarray]:
    """Label with unit -> (m,) values of joints, time, covariates and targets, one for each row of the residuals."""
    from workbench.report.calibration.residuals import quantities

    if not opened.samples.n:  # images alone
        return {}
    rows = opened.rows
    if np.array_equal(rows, np.arange(opened.samples.n)):  # no copy of a large recording
        return dict(quantities(opened.samples))
    return {label: values[rows] for label, values in quantities(opened.samples)}
