"""Location of rejected points of the laser line: in a part of the image, on the board, or in one plane.

A scratch on the optics or a reflection spoils points at one place of the image, a glossy print at one place of the
board, an obstacle before the laser those of some light planes, and blooming those of a bright line. Of these the one is
named whose groups differ most significantly in their share of wrong points, by the likelihood ratio of binomial counts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sensors.scanner.residuals.rejected_region import classes_of, region_of, steps_of
from workbench.core.distributions import chi2

_BINS = 8  # along each side of the image or the board
_CLASSES = 10  # of brightness and width of the line
_LEVEL = 1e-3
_CALLED = {
    ("u", "v"): "place in the image",
    ("board_x", "board_y"): "place on the board",
    ("mirror",): "light plane",
    ("line_brightness",): "brightness of the line",
    ("line_width",): "width of the line",
}
Place = tuple[str, tuple[str, ...]]


@dataclass(frozen=True)
class RejectedPoints:
    """`share` of the points that was left out; `where` most of them lie, by `depends_on`, with the `p_value` of no
    dependence; "sensor" and () where nothing is significant.

    `region`: where they lie in words, "" where nothing is significant; `is_bright`: whether they lie where the line is
    bright; `pixels` (2, n) of all points and `wrong` (n,), None where unknown.
    """

    share: float
    where: str
    depends_on: tuple[str, ...]
    p_value: float
    region: str = ""
    is_bright: bool = False
    pixels: np.ndarray | None = None
    wrong: np.ndarray | None = None

    @property
    def called(self) -> str:
        """Coordinate that they depend on, in words."""
        return _CALLED.get(self.depends_on, "")

    def as_json(self) -> dict:
        """The object `rejected_points` of the JSON contract."""
        return {
            "share": self.share,
            "where": self.where,
            "depends_on": list(self.depends_on),
            "p_value": self.p_value,
            "region": self.region,
        }


def rejected_points(chain, wrong: np.ndarray, shape: np.ndarray | None) -> RejectedPoints:
    """Of the stripes on boards of a `BoardStripeChain`, wrong (n,) bool, shape (2, n) width and brightness or None."""
    share = float(wrong.mean()) if wrong.size else 0.0
    length = _mean_run(wrong, chain)
    best = RejectedPoints(share, "sensor", (), 1.0)
    highest = 0.0
    groups = _groups(chain, shape)
    for (where, depends_on), label in groups.items():
        deviance, degrees = _deviance(wrong, label)
        # neighbours along a stripe are wrong together: a run of them counts once
        statistic = deviance / length
        freedom = max(degrees, 1)
        p_value = min(1.0, len(groups) * float(chi2.sf(statistic, freedom)))
        score = _normal_score(statistic, freedom)
        if degrees and score > highest and p_value < _LEVEL:
            best = RejectedPoints(share, where, depends_on, max(p_value, 1e-300))
            highest = score
    region = _region(best, chain, wrong, shape)
    is_bright = best.depends_on == ("line_brightness",) and _rises(shape[1], wrong)
    return replace(best, region=region, is_bright=is_bright, pixels=chain.pixels, wrong=wrong)


def _rises(values: np.ndarray, wrong: np.ndarray) -> bool:
    """Whether the upper half of values (n,) holds most of the wrong points."""
    return bool(wrong[values > np.median(values)].sum() > wrong.sum() / 2)


def _region(found: RejectedPoints, chain, wrong: np.ndarray, shape: np.ndarray | None) -> str:
    """Region of the rejected points, in the coordinate that they depend on."""
    match found.depends_on:
        case ("u", "v"):
            return region_of(chain.pixels, wrong, "px")
        case ("board_x", "board_y"):
            return region_of(chain.state.target[:2], wrong, "mm")
        case ("mirror",):
            return steps_of(chain.labels["step"], wrong)
        case ("line_brightness",):
            return classes_of(shape[1], wrong, "brightness")
        case ("line_width",):
            return classes_of(shape[0], wrong, "width")
    return ""


def _normal_score(statistic: float, degrees: int) -> float:
    """Of chi-square with so many degrees of freedom, to compare p-values that are zero: Wilson & Hilferty (1931)."""
    spread = 2 / (9 * degrees)
    return float((np.cbrt(statistic / degrees) - (1 - spread)) / np.sqrt(spread))


def _groups(chain, shape) -> Mapping[Place, np.ndarray]:
    """Labels (n,) of the groups of points by what may spoil them."""
    image = [_bins(row, _BINS) for row in chain.pixels]
    board = [_bins(row, _BINS) for row in chain.state.board]
    found = {
        ("camera", ("u", "v")): image[0] * _BINS + image[1],
        ("artefact", ("board_x", "board_y")): board[0] * _BINS + board[1],
        ("laser", ("mirror",)): chain.labels["step"],
    }
    if shape is not None:
        found["camera", ("line_brightness",)] = _classes(shape[1])
        found["laser", ("line_width",)] = _classes(shape[0])
    return found


def _bins(values: np.ndarray, count: int) -> np.ndarray:
    """(n,) number of the bin of equal width."""
    low = np.nanmin(values)
    high = np.nanmax(values)
    return np.clip(
        ((np.nan_to_num(values, nan=low) - low) / max(high - low, 1e-9) * count), 0, count - 1
    ).astype(int)


def _classes(values: np.ndarray) -> np.ndarray:
    """(n,) number of the class of equal size."""
    edges = np.quantile(values, np.linspace(0, 1, _CLASSES + 1)[1:-1])
    return np.searchsorted(edges, values)


def _mean_run(wrong: np.ndarray, chain) -> float:
    """Mean length of runs of wrong points along their stripes; 1 or more."""
    stripe = (
        chain.labels["placement"] * (chain.labels["step"].max(initial=0) + 1) + chain.labels["step"]
    )
    order = np.lexsort((chain.stripe_place, stripe))
    ordered = wrong[order]
    of_stripe = stripe[order]
    starts = ordered.copy()
    starts[1:] &= ~(ordered[:-1] & (of_stripe[1:] == of_stripe[:-1]))
    return max(float(ordered.sum()) / max(int(starts.sum()), 1), 1.0)


def _deviance(wrong: np.ndarray, label: np.ndarray) -> tuple[float, int]:
    """2 log likelihood ratio of a share for each group against one share, and its degrees of freedom."""
    _, label = np.unique(label, return_inverse=True)
    count = np.bincount(label)
    bad = np.bincount(label, wrong)
    likelihood_of_groups = _log_likelihood(bad, count).sum()
    return 2 * float(likelihood_of_groups - _log_likelihood(bad.sum(), count.sum())), len(count) - 1


def _log_likelihood(bad, count):
    from scipy.special import xlogy

    share = bad / count
    return xlogy(bad, share) + xlogy(count - bad, 1 - share)
