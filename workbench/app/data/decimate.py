"""Fewer points than samples: what the server sends, whatever the size of the recording."""

from dataclasses import dataclass

import numpy as np

MOST_POINTS = 4000
MOST_ARROWS = 1500
MOST_BINS = 60
_FEWEST_BINS = 8
_LEAST_IN_BIN = 8


def thinned(
    n: int, most: int = MOST_POINTS, important: np.ndarray | None = None, always=()
) -> np.ndarray:
    """Indices, in order, of at most about `most` of n samples.

    Half of them are the samples with the largest `important` (n,), so that no outlier is hidden, the others are
    spread evenly over the rows; `always` are added. Without `important` all are spread evenly.
    """
    if n <= most:
        return np.arange(n)
    extra = np.asarray(list(always)[:most], int)
    if important is None:
        even = np.linspace(0, n - 1, most).astype(int)
        return np.union1d(even, extra)
    return np.union1d(drawn_always(important, most), extra)


def drawn_always(important: np.ndarray, most: int) -> np.ndarray:
    """About `most` indices of n samples: half evenly spread, half those with the largest `important` (n,)."""
    n = len(important)
    if n <= most:
        return np.arange(n)
    even = np.linspace(0, n - 1, most // 2).astype(int)
    values = np.where(np.isfinite(important), important, -np.inf)
    largest = np.argpartition(values, n - most // 2)[n - most // 2 :]
    return np.union1d(even, largest)


@dataclass(frozen=True)
class Histogram:
    """`edges` (B + 1,) and counts (B,) of each kind over the same bins."""

    edges: np.ndarray
    counts: dict[str, np.ndarray]


def histogram(values: dict[str, np.ndarray], bins: int | None = None) -> Histogram:
    """Counts of all finite values of each kind, from zero to the largest.

    bins: their number; where left out that of Rice's rule, 2 n^(1/3), with at most `MOST_BINS`.
    """
    if bins is None:
        largest = max((len(row) for row in values.values()), default=1)
        bins = int(np.clip(np.ceil(2 * largest ** (1 / 3)), _FEWEST_BINS, MOST_BINS))
    top = max(
        (float(np.nanmax(row)) for row in values.values() if np.isfinite(row).any()), default=1.0
    )
    ends = (0.0, top * (1 + 1e-9) or 1.0)
    counts = {name: np.histogram(row, bins, ends)[0] for name, row in values.items()}
    return Histogram(np.linspace(*ends, bins + 1), counts)


def bins_of(x: np.ndarray, bins: int = 24) -> np.ndarray:
    """(n,) number of the bin of each sample, at most `bins` of about equal count; -1 where x is not finite."""
    finite = np.isfinite(x)
    if not finite.any():
        return np.full(len(x), -1)
    bins = int(np.clip(finite.sum() // _LEAST_IN_BIN, 1, bins))
    edges = np.unique(np.quantile(x[finite], np.linspace(0, 1, bins + 1)[1:-1]))
    return np.where(finite, np.searchsorted(edges, x, side="right"), -1).astype(np.int16)


def means_in(place: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of x and y (n,) over the samples of each bin `place` (n,); -1 and what is not finite are left out."""
    used = (place >= 0) & np.isfinite(y)
    place, x, y = place[used], x[used], y[used]
    count = np.bincount(place)
    filled = count > 0
    means = [np.bincount(place, row)[filled] / count[filled] for row in (x, y)]
    return means[0], means[1]


def bin_means(x: np.ndarray, y: np.ndarray, bins: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Mean of x and y (n,) over at most `bins` bins of about equal count; all finite samples count."""
    return means_in(bins_of(x, bins), x, y)


def within(
    x: np.ndarray, y: np.ndarray, x_range: tuple[float, float], y_range: tuple[float, float]
) -> np.ndarray:
    """(n,) bool: which of all samples lie in a rectangle, also those that are not drawn."""
    low_x, high_x = sorted(x_range)
    low_y, high_y = sorted(y_range)
    return (x >= low_x) & (x <= high_x) & (y >= low_y) & (y <= high_y)
