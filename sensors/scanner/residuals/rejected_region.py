"""The region that holds most points of the laser line that were left out as wrong: place, shape and size in words."""

import numpy as np

_BINS = 24  # along each side
_CERTAIN = 4.0  # standard deviations of a binomial share above that of all points
_LONG = 4.0  # length over width from which on a region is a line
_ENDS = (0.05, 0.95)  # quantiles between which a region is said to reach
_FEWEST = 8  # points


def region_of(place: np.ndarray, wrong: np.ndarray, unit: str) -> str:
    """Sentence part on where wrong (n,) bool points lie densely, of places (2, n) in a unit; "" where nowhere."""
    dense = _in_dense_bins(place, wrong)
    chosen = place[:, dense & wrong]
    if chosen.shape[1] < _FEWEST:
        return ""
    middle = np.median(chosen, axis=1)
    axes = np.linalg.eigh(np.cov(chosen))[1][:, ::-1]
    lengthwise, crosswise = axes.T @ (chosen - middle[:, None])
    ends = np.quantile(lengthwise, _ENDS)
    sides = np.quantile(crosswise, _ENDS)
    length = np.ptp(ends)
    width = np.ptp(sides)
    is_inside = _is_inside(axes.T @ (place - middle[:, None]), ends, sides)
    shares = (
        f"{100 * wrong[is_inside].mean():.0f} % of the points there are wrong, "
        f"{100 * wrong[~is_inside].mean():.1f} % elsewhere"
    )
    if length > _LONG * width:
        first, last = (middle + axes[:, 0] * end for end in ends)
        return f"along a line from {_text(first)} to {_text(last)} {unit}, {width:.2g} {unit} wide: {shares}"
    centre = middle + axes @ np.array([ends.mean(), sides.mean()])
    size = f"{_size(length)} x {_size(width)} {unit}"
    return f"in an area of {size} about {_text(centre)} {unit}: {shares}"


def _in_dense_bins(place: np.ndarray, wrong: np.ndarray) -> np.ndarray:
    """(n,) bool, whether a point lies in a bin with significantly more wrong points than all have."""
    low = np.nanmin(place, axis=1)
    high = np.nanmax(place, axis=1)
    size = max(float((high - low).max()) / _BINS, 1e-9)
    column, row = np.nan_to_num((place - low[:, None]) / size).astype(int)
    label = np.unique(np.stack([column, row]), axis=1, return_inverse=True)[1].ravel()
    count = np.bincount(label)
    share = wrong.mean()
    expected = count * share
    excess = np.bincount(label, wrong) - expected
    return (excess > _CERTAIN * np.sqrt(expected * (1 - share)))[label]


def _is_inside(turned: np.ndarray, ends: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(n,) bool, whether places (2, n) in the axes of the region lie in its rectangle."""
    lengthwise, crosswise = turned
    in_length = (lengthwise >= ends[0]) & (lengthwise <= ends[1])
    return in_length & (crosswise >= sides[0]) & (crosswise <= sides[1])


def _text(place: np.ndarray) -> str:
    return f"({place[0]:.0f}, {place[1]:.0f})"


def _size(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def classes_of(values: np.ndarray, wrong: np.ndarray, called: str) -> str:
    """Sentence part on the share of wrong (n,) bool points in the lowest and the highest tenth of values (n,)."""
    low, high = np.quantile(values, [0.1, 0.9])
    lowest = wrong[values <= low].mean()
    highest = wrong[values >= high].mean()
    return (
        f"of the tenth with the least {called} {100 * lowest:.0f} % are wrong, of the tenth with the most "
        f"{100 * highest:.0f} %"
    )


def steps_of(step: np.ndarray, wrong: np.ndarray) -> str:
    """Sentence part on the steps (n,) with most wrong (n,) bool points."""
    share = np.bincount(step, wrong) / np.maximum(np.bincount(step), 1)
    worst = np.sort(np.argsort(-share)[:3])
    named = ", ".join(f"{k} ({100 * share[k]:.0f} %)" for k in worst)
    return f"planes with most of them, from 0 on: {named}"
