"""Errors that the points of one stripe share, which no number of points along a stripe averages out.

A printed edge under the light, light that falls unevenly on a tilted board, blur that changes with
depth: each moves many points of a stripe, or all stripes of a board pose, alike. They are random
effects: a shift of each stripe, a tilt of it along itself, and a shift of each board pose, each with
one variance for all, and stand in the covariance of the measurements as blocks.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sensors.light.grouping import centred, groups
from workbench.core.text.uncertain import with_std

NAMES = ("stripe", "tilt", "placement")
WORDS = (
    "shift of a whole stripe",
    "tilt of a stripe, at its ends",
    "shift of all stripes of a board pose",
)


@dataclass(frozen=True)
class SharedStripeErrors:
    """Shared errors of n points: `sigma` (3,) px of each of `NAMES`, `std` (3,) px of these sigmas themselves.

    `labels` (3, n) int which error of its kind a point has, `shapes` (3, n) what a unit of it does
    to the point; `number` (n,) int names a point: one that stands there twice counts once.
    """

    sigma: np.ndarray
    std: np.ndarray
    labels: np.ndarray
    shapes: np.ndarray
    number: np.ndarray

    @property
    def named(self) -> dict[str, float]:
        """1 sigma, px, by kind."""
        return dict(zip(NAMES, self.sigma.tolist()))

    @property
    def sentence(self) -> str:
        """State which of these errors the covariance includes."""
        estimates = zip(WORDS, self.sigma, self.std)
        components = [
            f"{word} {with_std(1000 * sigma, 1000 * std)}"
            for word, sigma, std in estimates
            if np.isfinite(std)
        ]
        if not components:
            return (
                "too few stripes to tell what the points of a stripe err by together: the sigmas of light planes "
                "do not hold it"
            )
        return (
            "errors that points of a stripe share (1 sigma, in 0.001 px): "
            f"{', '.join(components)}; the standard deviations include them"
        )

    def too_much(self, centre_px: float) -> list[str]:
        """A sentence where board poses err by more than a single centre, of 1 sigma `centre_px`, does.

        Uneven light and blur pull a centre by parts of what speckle does to it, and not all stripes alike.
        """
        sigma = self.sigma[2]
        std = self.std[2]
        if not sigma - 2 * std > centre_px:
            return []
        return [
            f"all stripes of a board pose are off together by {with_std(sigma, std)} px (1 sigma), a single "
            f"centre by {centre_px:.2g} px: no light on a board does that; something that changed from board pose "
            "to board pose is missing, as the direction or speed of the mirror's sweep, or temperature: see "
            "`workbench diagnose`"
        ]

    @classmethod
    def of(cls, labels: Mapping[str, np.ndarray], stripe_place: np.ndarray) -> "SharedStripeErrors":
        """Of points with `placement` and `step`, at places `stripe_place` (n,) px their stripes; none erring yet."""
        stripe, count = groups(labels["placement"], labels["step"])
        ones = np.ones(len(stripe_place))
        return cls(
            np.zeros(3),
            np.full(3, np.inf),
            np.stack([stripe, stripe, groups(labels["placement"])[0]]),
            np.stack([ones, centred(stripe_place, stripe, count), ones]),
            np.arange(len(stripe_place)),
        )

    def at(self, samples: np.ndarray) -> "SharedStripeErrors":
        """Of some of the points (indices or mask)."""
        return replace(
            self,
            labels=self.labels[:, samples],
            shapes=self.shapes[:, samples],
            number=self.number[samples],
        )

    def averaged(
        self, first: np.ndarray, mean: Callable[[np.ndarray], np.ndarray]
    ) -> "SharedStripeErrors":
        """Shared errors of weighted means over blocks of points of one stripe.

        first (blocks,): one point of each block, whose labels the block has. mean: (n,) -> (blocks,).
        The mean of points that share an error shares it in proportion to their mean shape.
        """
        shapes = np.stack([mean(shape) for shape in self.shapes])
        return replace(
            self, labels=self.labels[:, first], shapes=shapes, number=np.arange(len(first))
        )

    def steps(self, sigma: np.ndarray) -> list["Step"]:
        """Both of `steps_apart`, one after the other."""
        within_stripes, between_stripes = self.steps_apart(sigma)
        return [*within_stripes, *between_stripes]

    def steps_apart(self, sigma: np.ndarray) -> tuple[list["Step"], list["Step"]]:
        """The factors of V^-1/2 but for the division by sigma (n,) px, in their order, of the kinds that err.

        First those within stripes, then that of board poses. Of independent errors and one shared by a
        group with the shape b, V = D^2 + t^2 b b', that
        factor is r - c b (b'w r) / (b'w b), w = 1 / sigma^2 and c = 1 - 1 / sqrt(1 + t^2 b'w b): what
        is done to panels with random effects (Fuller & Battese, J. Econometrics 2 (1974)). Further
        kinds follow in turn, their shapes first taken through those before.
        """
        weight = sigma**-2.0 / np.bincount(self.number)[self.number]
        steps: list[Step] = []
        kinds = [kind for kind in range(len(NAMES)) if self.sigma[kind] > 0]
        for kind in kinds:
            steps.append(
                random_effect(
                    self.sigma[kind],
                    self.labels[kind],
                    decorrelated(steps, self.shapes[kind]),
                    weight,
                )
            )
        within_count = len(kinds) - (2 in kinds)
        return steps[:within_count], steps[within_count:]


@dataclass(frozen=True)
class Step:
    """One factor: sums (groups, n) sparse, and what of its group's sum a point (n,) of group `label` loses."""

    sums: object
    label: np.ndarray
    share: np.ndarray


def random_effect(spread: float, label: np.ndarray, shape: np.ndarray, weight: np.ndarray) -> Step:
    """The factor of errors of 1 sigma `spread` that points (n,) of one label share, in proportion to `shape`."""
    from scipy.sparse import csr_array

    n = len(label)
    count = int(label.max(initial=-1)) + 1
    known = np.maximum(np.bincount(label, weight * shape**2, count), 1e-300)
    share_lost = 1 - 1 / np.sqrt(1 + spread**2 * known)
    sums = csr_array((weight * shape, (label, np.arange(n))), shape=(count, n))
    return Step(sums, label, shape * (share_lost / known)[label])


def decorrelated(steps: list[Step], rows: np.ndarray) -> np.ndarray:
    """(..., n) residuals or their derivatives, made as independent as their points' own noise."""
    shape = rows.shape
    rows = rows.reshape(-1, shape[-1])
    for step in steps:
        rows = rows - (step.sums @ rows.T)[step.label].T * step.share
    return rows.reshape(shape)
