"""Rigid registration of one set of points to another: how well an arm's points agree with those of a tracker.

With known correspondences: centring and the nearest rotation (Kabsch, Acta Cryst. A32 (1976) 922; Umeyama, IEEE PAMI 13
(1991) 376). Without: iterative closest points (Besl & McKay, IEEE PAMI 14 (1992) 239) from the four proper alignments
of the principal axes.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from workbench.core.distributions import chi2, fisher
from workbench.core.errors import InputError
from workbench.core.rigid import nearest_rotation, transform
from workbench.core.text.csv_text import csv_text

_MIN_POINTS, _ROUNDS = 3, 200
_FLAT = 1e-6  # share of the largest extent below which points lie on a line
_SIGNS = tuple(product((1, -1), repeat=3))
_CHANCE = 1e-3  # that one of all points is called an outlier with none there
_FREE = 6  # numbers of a rigid transform
_MIRROR = np.array([1.0, 1.0, -1.0])
_BETTER = (
    3.0  # RMS distance over that of another reading of the points, from which on it is suspected
)
_LARGEST = 0.1  # RMS distance over the extent of the target, above which the points have too little in common
_LEAST_SCALE = 0.01  # a smaller error of scale is one of arm or instrument, not of the unit
_NEAR_UNIT = 0.02
_UNITS = {"inches": 25.4, "metres": 1000.0, "centimetres": 10.0, "feet": 304.8}


@dataclass(frozen=True)
class Registration:
    """`matrix` (4, 4) T_target_source, mm; `target_row` (n,) the row that each source point is matched with.

    `residual` (n, 3) mm: transformed source minus target; `left_out` (n,) mm: the distance of each point under the
    transform of all others, nan where these do not determine one.
    """

    matrix: np.ndarray
    target_row: np.ndarray
    residual: np.ndarray
    left_out: np.ndarray

    @property
    def distances(self) -> np.ndarray:
        """(n,) mm."""
        return np.linalg.norm(self.residual, axis=1)

    def outliers(self) -> list[int]:
        """Numbers of the points that are farther off than chance puts one of as many points.

        Each distance is compared with the median, which a third of wrong points does not change by much: squared
        distances in units of the variance of a coordinate follow a chi-square of three degrees of freedom.
        """
        squares = self.distances**2
        variance = float(np.median(squares)) / chi2.ppf(0.5, 3)
        limit = chi2.isf(_CHANCE / len(squares), 3) * variance
        return np.flatnonzero((squares > limit) & (squares > 0)).tolist()

    def as_json(self) -> dict:
        """Figures with their unit: RMS, mean, largest distance, and the RMS of points that were left out."""
        n = len(self.residual)
        free = max(3 * n - _FREE, 1)
        known = self.left_out[np.isfinite(self.left_out)]
        return {
            "points": n,
            "rms_mm": _rms(self.distances),
            "mean_mm": float(self.distances.mean()),
            "max_mm": float(self.distances.max()),
            "std_mm": float(self.distances.std(ddof=1)),
            "sigma_mm": float(np.sqrt((self.residual**2).sum() / free)),
            "left_one_out_rms_mm": _rms(known) if known.size else None,
            "matrix": self.matrix.tolist(),
        }


def register(source: np.ndarray, target: np.ndarray, matched: bool = True) -> Registration:
    """The rigid transform that carries points (n, 3) mm onto others (m, 3) mm in the least-squares sense.

    matched: row k of one is row k of the other, n = m; else every source point goes with the nearest target point.
    Raises InputError for fewer than three points, points on a line, or numbers of points that differ.
    """
    source = np.asarray(source, float)
    target = np.asarray(target, float)
    _check(source, "source")
    _check(target, "target")
    if matched and len(source) != len(target):
        raise InputError(
            f"registration: expected as many source as target points, found {len(source)} and {len(target)}; name the "
            "points in a column `point`, or match the nearest ones"
        )
    rows = np.arange(len(source)) if matched else _nearest(source, target)
    matrix = _aligned(source, target[rows])
    residual = source @ matrix[:3, :3].T + matrix[:3, 3] - target[rows]
    return Registration(matrix, rows, residual, _left_one_out(source, target[rows]))


def suspicions(
    source: np.ndarray, target: np.ndarray, found: Registration, matched: bool = True
) -> tuple[str, ...]:
    """A sentence where a mirror image of the source, or the source in another unit, fits the target far better.

    source (n, 3) and target (m, 3) mm, as registered in `found`. Far better: RMS below a third, a ratio of variances
    that an F-test rejects at 0.1 %, and distances that are small against the extent of the target, as those of points
    that have nothing in common are not.
    """
    aim = target[found.target_row] if matched else target
    limit = _LARGEST * _spread(aim)
    mirrored = register(source * _MIRROR, target, matched)
    if _is_better(mirrored, found, limit):
        return (
            "the source looks like a mirror image of the target: with one coordinate reversed the RMS distance is "
            f"{_rms(mirrored.distances):.3g} mm instead of {_rms(found.distances):.3g} mm; one of the two is in a "
            "left-handed frame: reverse the sign of a coordinate, or exchange two columns, in one file",
        )
    ratio = _spread(aim) / _spread(source)
    scaled = register(source * ratio, target, matched)
    if abs(ratio - 1) < _LEAST_SCALE or not _is_better(scaled, found, limit):
        return ()
    return (
        f"distances between the target's points are {ratio:.4g} times those of the source{_unit_question(ratio)}: with "
        f"the source scaled by this factor the RMS distance is {_rms(scaled.distances):.3g} mm instead of "
        f"{_rms(found.distances):.3g} mm; convert both files to mm",
    )


def _unit_question(ratio: float) -> str:
    """Which file may be in another unit, where target over source is the ratio of a unit to mm."""
    for name, size in _UNITS.items():
        for file, factor in (("source", ratio), ("target", 1 / ratio)):
            if abs(factor / size - 1) < _NEAR_UNIT:
                return f" ({file} in {name}?)"
    return ""


def _spread(points: np.ndarray) -> float:
    """mm, RMS distance of the points from their mean."""
    return _rms(np.linalg.norm(points - points.mean(0), axis=1))


def _is_better(other: Registration, found: Registration, limit: float) -> bool:
    """Whether another reading of the points fits far better, with an RMS distance below `limit` mm."""
    degrees = max(3 * len(found.residual) - _FREE, 1)
    fall = max(_BETTER, float(np.sqrt(fisher.isf(_CHANCE, degrees, degrees))))
    return fall * _rms(other.distances) < _rms(found.distances) and _rms(other.distances) < limit


def _is_on_line(points: np.ndarray) -> bool:
    extent = np.linalg.svd(points - points.mean(0), compute_uv=False)
    return extent[1] <= _FLAT * max(extent[0], 1e-300)


def _check(points: np.ndarray, name: str) -> None:
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < _MIN_POINTS:
        raise InputError(
            f"registration: expected at least {_MIN_POINTS} {name} points, found {len(points)}; measure more"
        )
    if _is_on_line(points):
        raise InputError(
            f"registration: expected {name} points that do not lie on one line, found such ones, about which the "
            "rotation is not determined; measure points off that line"
        )


def _aligned(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) closed-form least-squares transform of matched points."""
    middle, aim = source.mean(0), target.mean(0)
    matrix = (target - aim).T @ (source - middle)
    turn = nearest_rotation(matrix)
    return transform(turn, aim - turn @ middle)


def _nearest(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(n,) target row nearest to each source point, after iterating from four alignments of the principal axes."""
    tree = cKDTree(target)
    trials = [_iterated(source, target, tree, start) for start in _starts(source, target)]
    return min(trials, key=lambda trial: trial[0])[1]


def _starts(source: np.ndarray, target: np.ndarray):
    axes = [np.linalg.svd(points - points.mean(0))[2] for points in (source, target)]
    for signs in _SIGNS:
        turn = axes[1].T @ (np.array(signs)[:, None] * axes[0])
        if np.linalg.det(turn) > 0:
            yield transform(turn, target.mean(0) - turn @ source.mean(0))


def _iterated(source, target, tree: cKDTree, matrix: np.ndarray) -> tuple[float, np.ndarray]:
    """Mean square distance (mm^2) and matches (n,) of iterative closest points from a start."""
    rows = None
    for _ in range(_ROUNDS):
        moved = source @ matrix[:3, :3].T + matrix[:3, 3]
        distance, found = tree.query(moved)
        if rows is not None and np.array_equal(found, rows):
            break
        rows = found
        matrix = _aligned(source, target[rows])
    return float((distance**2).mean()), rows


def _left_one_out(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(n,) mm: distance of each point under the transform of the others; nan where three or fewer are left."""
    n = len(source)
    found = np.full(n, np.nan)
    for k in range(n if n > _MIN_POINTS + 1 else 0):
        others = np.arange(n) != k
        matrix = _aligned(source[others], target[others])
        found[k] = np.linalg.norm(_carried(matrix, source[k]) - target[k])
    return found


def _carried(matrix: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(3,) mm: a point (3,) under a rigid transform (4, 4)."""
    return matrix[:3, :3] @ point + matrix[:3, 3]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def save(found: Registration, labels: list[str], folder: Path) -> None:
    """Write residuals.csv: a row a point with its residual, distance and left-one-out distance, mm."""
    head = ["point", "target_row", "dx_mm", "dy_mm", "dz_mm", "distance_mm", "left_one_out_mm"]
    numbers = np.column_stack([found.residual, found.distances, found.left_out])
    lines = list(map(_line, labels, found.target_row, numbers))
    (folder / "residuals.csv").write_text(csv_text(head, lines), encoding="utf-8")


def _line(label: str, row: int, values: np.ndarray) -> list:
    return [label, int(row) + 1, *(f"{value:.6g}" for value in values)]


__all__ = ["Registration", "register", "save", "suspicions"]
