"""Fewer points than samples: what the server sends, whatever the size of the recording."""

from dataclasses import dataclass

import numpy as np

MOST_POINTS = 4000
MOST_ARROWS = 1500
MOST_BINS = 60
_FEWEST_BINS = 8
_LEAST_IN_BIN = 8
_MOST_ORDERED = 50_000
"""Values that the edges of bins of equal count are computed from."""


def thinned(
    n: int, max_count: int = MOST_POINTS, important: np.ndarray | None = None, always=()
) -> np.ndarray:
    """Indices, in order, of at most about `max_count` of n samples.

    Half of them are the samples with the largest `important` (n,), so that no outlier is hidden, the others are
    spread evenly over the rows; `always` are added. Without `important` all are spread evenly.
    """
    if n <= max_count:
        return np.arange(n)
    extra = np.asarray(list(always)[:max_count], int)
    if important is None:
        spaced = np.linspace(0, n - 1, max_count).astype(int)
        return np.union1d(spaced, extra)
    return np.union1d(drawn_always(important, max_count), extra)


def drawn_always(important: np.ndarray, max_count: int) -> np.ndarray:
    """About `max_count` indices of n samples: half evenly spread, half those with the largest `important` (n,)."""
    n = len(important)
    if n <= max_count:
        return np.arange(n)
    count = max_count // 2
    spaced = np.linspace(0, n - 1, count).astype(int)
    return np.union1d(spaced, _indices_of_largest(important, count))


def _indices_of_largest(values: np.ndarray, count: int) -> np.ndarray:
    """(count,) indices of the largest finite values (n,), in no order."""
    finite = np.where(np.isfinite(values), values, -np.inf)
    first = len(values) - count
    return np.argpartition(finite, first)[first:]


@dataclass(frozen=True)
class Histogram:
    """`edges` (B + 1,) and counts (B,) of each kind over the same bins."""

    edges: np.ndarray
    counts: dict[str, np.ndarray]


def histogram(values: dict[str, np.ndarray], bins: int | None = None) -> Histogram:
    """Counts of all finite values of each kind, from zero to the largest.

    bins: their number; where left out that of Rice's rule, 2 n^(1/3), with at most `MOST_BINS`.
    """
    largest_count = max((int(np.isfinite(row).sum()) for row in values.values()), default=1)
    edges = _edges(largest_count, [_largest(row) for row in values.values()], bins)
    counts = {name: np.histogram(row, edges)[0] for name, row in values.items()}
    return Histogram(edges, counts)


def histogram_without(ordered: dict[str, np.ndarray], left_out: dict[str, np.ndarray]) -> Histogram:
    """Counts of the finite values of each kind without some of them, as `histogram` gives them for the others.

    ordered: kind -> (k,) all finite values, ascending; left_out: kind -> (l,) those not counted, nan among them.
    The time is that of the values left out, not that of all values.
    """
    excluded_values = {name: np.sort(row[np.isfinite(row)]) for name, row in left_out.items()}
    counts_left = [len(row) - len(excluded_values[name]) for name, row in ordered.items()]
    largest = [_largest_left(row, excluded_values[name]) for name, row in ordered.items()]
    edges = _edges(max(counts_left, default=1), largest, None)
    counts = {}
    for name, row in ordered.items():
        remaining = np.searchsorted(row, edges) - np.searchsorted(excluded_values[name], edges)
        counts[name] = np.diff(remaining)
    return Histogram(edges, counts)


def _edges(count: int, largest: list[float], bins: int | None) -> np.ndarray:
    """(B + 1,) edges of bins from zero to the largest value; their number by Rice's rule for `count` values."""
    bins = _rice_bins(count) if bins is None else bins
    finite = [value for value in largest if np.isfinite(value)]
    top = max(finite, default=1.0)
    return np.linspace(0.0, top * (1 + 1e-9) or 1.0, bins + 1)


def _rice_bins(count: int) -> int:
    """Number of bins for `count` values by Rice's rule, within what a histogram shows well."""
    return int(np.clip(np.ceil(2 * count ** (1 / 3)), _FEWEST_BINS, MOST_BINS))


def _largest(values: np.ndarray) -> float:
    """The largest finite value; nan where there is none."""
    return float(np.nanmax(values)) if np.isfinite(values).any() else np.nan


def _largest_left(ordered: np.ndarray, excluded_values: np.ndarray) -> float:
    """The largest of the ascending values that are not among `gone`, ascending too; nan where none is left."""
    index = len(ordered) - len(excluded_values)
    if index == 0:
        return np.nan
    tail = ordered[index - 1 :]  # one more than are gone
    missing = tail[1:] != excluded_values if len(excluded_values) else np.zeros(0, bool)
    last_kept = np.flatnonzero(missing)
    return float(tail[1 + last_kept[-1]]) if len(last_kept) else float(tail[0])


def bins_of(x: np.ndarray, bins: int = 24) -> np.ndarray:
    """(n,) number of the bin of each sample, at most `bins` of about equal count; -1 where x is not finite."""
    finite = np.isfinite(x)
    if not finite.any():
        return np.full(len(x), -1)
    edges = _inner_edges(x[finite], bins)
    return np.where(finite, np.searchsorted(edges, x, side="right"), -1).astype(np.int8)


def _inner_edges(values: np.ndarray, max_bins: int) -> np.ndarray:
    """Edges between at most `max_bins` bins of about equal count of finite values (n,)."""
    count = len(values)
    bins = int(np.clip(count // _LEAST_IN_BIN, 1, max_bins))
    ordered = values[thinned(count, _MOST_ORDERED)]
    return np.unique(np.quantile(ordered, np.linspace(0, 1, bins + 1)[1:-1]))


def sums_in(place: np.ndarray, x: np.ndarray, y: np.ndarray, bins: int = 0) -> np.ndarray:
    """(3, B) count, sum of x and sum of y (n,) over each bin `place` (n,); -1 and what is not finite are left out.

    bins: least number of bins B.
    """
    used = (place >= 0) & np.isfinite(y)
    place, x, y = place[used], x[used], y[used]
    return np.stack([np.bincount(place, row, bins) for row in (None, x, y)])


def bin_means(x: np.ndarray, y: np.ndarray, bins: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Mean of x and y (n,) over at most `bins` bins of about equal count; all finite samples count."""
    return means_of(sums_in(bins_of(x, bins), x, y))


def means_of(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of x and of y over each bin that is not empty, from `sums_in` (3, B)."""
    count, sum_x, sum_y = sums
    filled = count > 0
    return sum_x[filled] / count[filled], sum_y[filled] / count[filled]


def is_within_ranges(
    x: np.ndarray, y: np.ndarray, x_range: tuple[float, float], y_range: tuple[float, float]
) -> np.ndarray:
    """(n,) bool: which of all samples lie in a rectangle, also those that are not drawn."""
    low_x, high_x = sorted(x_range)
    low_y, high_y = sorted(y_range)
    return (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y)
