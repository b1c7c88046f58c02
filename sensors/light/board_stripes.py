"""Stripe points on boards: gathered from images, sorted out where they cannot be, averaged in short blocks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sensors.boards.board import Board
from sensors.light.board_chain import BoardStripeChain, Evaluation
from sensors.light.grouping import centred, groups
from workbench.core.distributions import MEDIAN_TO_SIGMA
from workbench.core.errors import InputError

_MAX_DEVIATION = (
    5.0  # robust sigmas from the centreline of its own stripe beyond which a point is wrong
)
_ROUNDS = 6
_RELATED = 0.05  # correlation below which noise of points along a stripe counts as independent
_FARTHEST = 100  # points


@dataclass(frozen=True)
class BoardStripes:
    """n stripe points: `pixels` (2, n) px, `placement` (n,) text, `step` (n,) int, `sigma` (n,) px.

    `scan_axis`: "rows" where a centre was measured along each row of the image, else "columns".
    `mirror` (n,) rad as commanded, nan where unknown; `covariates` (n,) by column of images.csv; `shape` (2, n) as
    `Stripes.shape`, None where unknown.
    """

    pixels: np.ndarray
    placement: np.ndarray
    step: np.ndarray
    sigma: np.ndarray
    scan_axis: str = "rows"
    mirror: np.ndarray | None = None
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)
    shape: np.ndarray | None = None

    @classmethod
    def of(
        cls,
        stripes,
        placements: Sequence[str],
        steps: Sequence[int],
        mirror_deg: Sequence[float] | None = None,
        covariates: Mapping[str, Sequence[float]] | None = None,
    ) -> "BoardStripes":
        """From `stripe.Stripes` of F images and what images.csv says of each of them (F,)."""
        frame = stripes.frame
        angles = None if mirror_deg is None else np.deg2rad(np.asarray(mirror_deg, float))[frame]
        columns = {
            name: np.asarray(values, float)[frame] for name, values in (covariates or {}).items()
        }
        return cls(
            stripes.pixels,
            np.asarray(placements, str)[frame],
            np.asarray(steps, int)[frame],
            np.asarray(stripes.sigma, float),
            stripes.scan_axis,
            angles,
            columns,
            stripes.shape,
        )

    @property
    def n(self) -> int:
        return self.pixels.shape[1]

    @property
    def scan(self) -> np.ndarray:
        """(2, 1) unit vector of the line in which centres were measured."""
        return np.array([[1.0], [0.0]]) if self.scan_axis == "rows" else np.array([[0.0], [1.0]])

    def at(self, keep: np.ndarray) -> "BoardStripes":
        """Some of them (mask or indices)."""
        return replace(
            self,
            pixels=self.pixels[:, keep],
            placement=self.placement[keep],
            step=self.step[keep],
            sigma=self.sigma[keep],
            mirror=None if self.mirror is None else self.mirror[keep],
            covariates={name: column[keep] for name, column in self.covariates.items()},
            shape=None if self.shape is None else self.shape[:, keep],
        )

    def angles(self, steps: np.ndarray) -> np.ndarray | None:
        """(S,) rad of steps (S,), None where a step has none; InputError where a step has two."""
        if self.mirror is None or not np.isfinite(self.mirror).all():
            return None
        place = np.searchsorted(steps, self.step)
        low = np.full(len(steps), np.inf)
        high = np.full(len(steps), -np.inf)
        np.minimum.at(low, place, self.mirror)
        np.maximum.at(high, place, self.mirror)
        if (odd := np.flatnonzero(high - low > 1e-9)).size:
            first = np.rad2deg([low[odd[0]], high[odd[0]]])
            raise InputError(
                f"images.csv, step {steps[odd[0]]}: expected one mirror_deg, found {first[0]:g} and "
                f"{first[1]:g}; give every angle a step of its own"
            )
        return low


def joined(stripe_sets: Sequence[BoardStripes]) -> BoardStripes:
    """Several as one; InputError where there is none, or they were not measured along one and the same direction."""
    if not stripe_sets or len({part.scan_axis for part in stripe_sets}) > 1:
        found = "none" if not stripe_sets else "some along rows and some along columns"
        raise InputError(
            f"stripes on boards: expected stripes measured in one direction, found {found}; "
            "take images of the board under the laser, all with one setting"
        )
    known, shaped = (
        all(getattr(part, name) is not None for part in stripe_sets) for name in ("mirror", "shape")
    )
    names = set.intersection(*(set(part.covariates) for part in stripe_sets))
    gather = {
        name: np.concatenate([part.covariates[name] for part in stripe_sets])
        for name in sorted(names)
    }
    columns = (
        np.concatenate([getattr(part, name) for part in stripe_sets])
        for name in ("placement", "step", "sigma")
    )
    return BoardStripes(
        np.hstack([part.pixels for part in stripe_sets]),
        *columns,
        stripe_sets[0].scan_axis,
        np.concatenate([part.mirror for part in stripe_sets]) if known else None,
        gather,
        np.hstack([part.shape for part in stripe_sets]) if shaped else None,
    )


def on_the_board(board: Board, points: np.ndarray) -> np.ndarray:
    """(n,) whether points (2 or 3, n) mm, board frame, lie on what is known to be board.

    A chessboard reaches one square beyond its inner corners, a grid of circles half a step beyond its centres.
    """
    margin = board.square_mm * (0.5 if board.kind.endswith("circles") else 1.0)
    low = board.points.min(1)[:2] - margin
    high = board.points.max(1)[:2] + margin
    return ((points[:2] >= low[:, None]) & (points[:2] <= high[:, None])).all(0)


def wrong_points(chain: BoardStripeChain, evaluation: Evaluation) -> np.ndarray:
    """(n,) True where a point is far from the centreline of its own stripe.

    The residual of a good stripe against any nearly right plane is smooth along the stripe: a
    parabola, fitted with Cauchy's weights to each stripe by itself. Wrong is what lies farther
    from it than five robust sigmas of all stripes together (one in two million good points).
    """
    group, count = groups(chain.labels["placement"], chain.labels["step"])
    stripe_place = chain.pixels[1] * chain.scan[0] + chain.pixels[0] * chain.scan[1]
    place = centred(stripe_place, group, count)
    shape = np.stack([np.ones_like(place), place, place**2])
    residual = evaluation.residual[0]
    sigma = np.broadcast_to(chain.sigma, (1, chain.n))[0]
    deviation = residual
    weights = np.ones(chain.n)
    for _ in range(_ROUNDS):
        centreline = _fitted(shape, residual, weights / sigma**2, group, count)
        deviation = np.abs(residual - centreline) / sigma
        spread = max(MEDIAN_TO_SIGMA * np.median(deviation), 1e-12)
        weights = 1 / (1 + (deviation / (2 * spread)) ** 2)
    return deviation > _MAX_DEVIATION * spread


def _fitted(shape, values, weights, group, count):
    """(n,) weighted least squares of values by shape (3, n) in each group."""
    normal = np.empty((count, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            normal[:, i, j] = normal[:, j, i] = np.bincount(
                group, weights * shape[i] * shape[j], count
            )
    right = np.stack([np.bincount(group, weights * row * values, count) for row in shape], 1)
    ridge = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3) + 1e-300 * np.eye(
        3
    )
    found = np.linalg.solve(normal + ridge, right[..., None])[..., 0]
    return (shape * found.T[:, group]).sum(0)


def thinned(
    chain: BoardStripeChain, max_points: int = 60_000
) -> tuple[BoardStripeChain, np.ndarray]:
    """At most about `max_points` points that say what all of them say, and the block (n,) that each point went into.

    Neighbours along one stripe become one point: their weighted mean, with the sigma of that mean,
    shifted along the scan line so that its residual against the start is the mean of theirs (so
    that a bent stripe is not shortcut). Every derivative of the residual is smooth along the
    stripe, so what is lost is its change within a block: of b blocks a stripe, 1 / b^2 of what is
    known of a plane's tilt. Speckle has grains of several rows: blocks are then so long that their
    means err independently.
    """
    size = max(-(-chain.n // max_points), _independent(chain))
    if size <= 1:
        return chain, np.arange(chain.n)
    stripe_place = chain.pixels[1] * chain.scan[0] + chain.pixels[0] * chain.scan[1]
    group, count = groups(chain.labels["placement"], chain.labels["step"])
    order = np.lexsort((stripe_place, group))
    number = np.bincount(group, minlength=count)
    rank = np.arange(chain.n) - np.repeat(np.cumsum(number) - number, number)
    blocks = -(-number // size)  # equal blocks in each stripe
    first = np.cumsum(blocks) - blocks
    block = np.empty(chain.n, int)
    block[order] = first[group[order]] + rank * blocks[group[order]] // number[group[order]]
    return _averaged(chain, block, int(blocks.sum())), block


def _independent(chain: BoardStripeChain) -> int:
    """Points along a stripe whose mean hardly depends on the next mean: four times the memory of the noise.

    Memory: 1 + 2 times the sum of the autocorrelations up to the first that is less than a twentieth
    (after Geyer, Statistical Science 7 (1992)), of the residuals against each stripe's own centreline.
    """
    group, count = groups(chain.labels["placement"], chain.labels["step"])
    stripe_place = chain.pixels[1] * chain.scan[0] + chain.pixels[0] * chain.scan[1]
    order = np.lexsort((stripe_place, group))
    place = centred(stripe_place, group, count)
    residual = chain.evaluate(chain.parameters.values, {}).residual[0]
    sigma = np.broadcast_to(chain.sigma, (1, chain.n))[0]
    shape = np.stack([np.ones_like(place), place, place**2])
    white = ((residual - _fitted(shape, residual, 1 / sigma**2, group, count)) / sigma)[order]
    group, memory = group[order], 1.0
    for lag in range(1, _FARTHEST):
        is_same_stripe = group[lag:] == group[:-lag]
        share = (
            (white[lag:] * white[:-lag])[is_same_stripe].mean() / (white**2).mean()
            if is_same_stripe.any()
            else 0.0
        )
        if share < _RELATED:
            break
        memory += 2 * share
    return int(np.ceil(4 * memory)) if memory > 1 else 1


def _averaged(chain: BoardStripeChain, block: np.ndarray, count: int) -> BoardStripeChain:
    """The chain of `count` weighted means over the points with one number in `block` (n,)."""
    weights = 1 / np.broadcast_to(chain.sigma, (1, chain.n))[0] ** 2
    total = np.bincount(block, weights, count)

    def mean(values):
        return np.bincount(block, weights * values, count) / total

    first = np.zeros(count, int)
    first[block] = np.arange(chain.n)
    # Everything that has one entry a point: labels and shared errors included.
    average = replace(
        chain.at(first),
        pixels=np.stack([mean(row) for row in chain.pixels]),
        sigma=total[None] ** -0.5,
        covariates={name: mean(column) for name, column in chain.covariates.items()},
        shared_errors=None
        if chain.shared_errors is None
        else chain.shared_errors.averaged(first, mean),
        _start=None if chain._start is None else _averaged(chain._start, block, count),
    )
    values = chain.parameters.values
    missing = (
        mean(chain.evaluate(values, {}).residual[0]) - average.evaluate(values, {}).residual[0]
    )
    side = np.sign((average.at_start.by_pixel * average.scan).sum(0))
    return replace(average, pixels=average.pixels + average.scan * (missing * side))
