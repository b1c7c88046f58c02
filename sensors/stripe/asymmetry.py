"""Asymmetry of the laser line's profile: evidence of a second line, blooming or stray light that no residual shows.

The centre of a symmetric line is the same by every definition. An asymmetric one has its mode at another place than
its centroid, so that its centre depends on how it is fitted, on its width and on its brightness. Residuals against
light planes do not show this: planes and scans are displaced alike, as long as the line looks alike.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from sensors.stripe.find import Stripes

_REACH = 4.0  # widths each side of the centre
_BINS = 32
_EDGES = np.linspace(-_REACH, _REACH, _BINS + 1)
PLACES = (_EDGES[1:] + _EDGES[:-1]) / 2
_MODE_WIDTHS = 0.8  # widths each side within which the mode is read
_FEWEST = 8  # images
_LEAST_STD = 1e-5  # of the peak
_SIGNIFICANT = 5.0  # standard errors
# Share of the noise of a single centre: an error common to all centres does not average out, as noise does.
_RELEVANT = 0.25


@dataclass(frozen=True)
class Profiles:
    """Profiles of the line in F images: `sums` and `weights` (F, bins) over bins, `width` (F,) px."""

    sums: np.ndarray
    weights: np.ndarray
    width: np.ndarray

    @classmethod
    def of(cls, stack: np.ndarray, stripes: Stripes, background: np.ndarray | None = None):
        """Of images (F, H, W) and their centres; background (F, H, W): grey values without the laser."""
        turned = stripes.scan_axis == "columns"
        images = stack.transpose(0, 2, 1) if turned else stack
        background_windows = (
            None if background is None else background.transpose(0, 2, 1) if turned else background
        )
        usable = np.flatnonzero(~stripes.saturated & (stripes.peak > 0))
        width = float(np.median(stripes.width[usable])) if usable.size else 1.0
        half = int(np.ceil(_REACH * width)) + 1
        columns = np.rint(stripes.centre[usable]).astype(int)[:, None] + np.arange(-half, half + 1)
        is_inside = (columns[:, 0] >= 0) & (columns[:, -1] < images.shape[2])
        usable, columns = usable[is_inside], columns[is_inside]
        place = stripes.frame[usable][:, None], stripes.line[usable][:, None], columns
        values = images[place].astype(float)
        if background_windows is not None:
            values -= background_windows[place]
        values -= stripes.background[usable][:, None]
        return cls._binned(values, columns, stripes, usable, len(stack))

    @classmethod
    def _binned(cls, values, columns, stripes, usable, frames):
        """Sums over bins of the distance from the centre, in widths of the line; rows count by their squared peak."""
        peak = stripes.peak[usable][:, None]
        offset = (columns - stripes.centre[usable][:, None]) / stripes.width[usable][:, None]
        bins = np.floor((offset + _REACH) / (2 * _REACH) * _BINS).astype(int)
        label = stripes.frame[usable][:, None] * _BINS + bins
        in_range = (bins >= 0) & (bins < _BINS)
        weight = np.broadcast_to(peak**2, values.shape)[in_range]
        size = frames * _BINS
        sums = np.bincount(label[in_range], (values * peak)[in_range], size)
        weights = np.bincount(label[in_range], weight, size)
        count = np.maximum(np.bincount(stripes.frame[usable], minlength=frames), 1)
        width = np.bincount(stripes.frame[usable], stripes.width[usable], frames) / count
        return cls(sums.reshape(frames, -1), weights.reshape(frames, -1), width)

    @classmethod
    def joined(cls, stacks: Iterable["Profiles"]) -> "Profiles":
        """Those of several stacks as one."""
        profiles = list(stacks)
        return cls(
            np.concatenate([part.sums for part in profiles]),
            np.concatenate([part.weights for part in profiles]),
            np.concatenate([part.width for part in profiles]),
        )


@dataclass(frozen=True)
class Asymmetry:
    """`ambiguity_px` distance between mode and centroid of the mean profile, with standard error `std_px`.

    `odd` largest odd part of the profile over its peak.
    """

    ambiguity_px: float
    std_px: float
    odd: float

    def is_relevant(self, noise_px: float) -> bool:
        """Whether it is significant and not small compared with the noise of a single centre (px)."""
        certain = abs(self.ambiguity_px) > _SIGNIFICANT * self.std_px
        return certain and abs(self.ambiguity_px) > _RELEVANT * noise_px

    def as_json(self) -> dict:
        """The object `line_asymmetry` of the JSON contract."""
        return {"ambiguity_px": self.ambiguity_px, "std_px": self.std_px, "odd_share": self.odd}


def asymmetry(profiles: Profiles) -> Asymmetry | None:
    """Of the mean profile of all images; standard error by the jackknife over images. None where there are too few."""
    if (found := _usable(profiles)) is None:
        return None
    sums, weights, width = found
    all_images = _ambiguity(sums.sum(0), weights.sum(0))
    by_image = np.array(
        [
            _ambiguity(sums.sum(0) - image_sums, weights.sum(0) - weight)
            for image_sums, weight in zip(sums, weights)
        ]
    )
    std = np.sqrt((len(by_image) - 1) * by_image.var())
    odd = np.abs(_odd(sums.sum(0) / weights.sum(0))).max()
    return Asymmetry(float(all_images * width), float(std * width), float(odd))


def mean_odd_profile(profiles: Profiles) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Odd part (bins,) of the mean profile, its standard errors by jackknife over images, and the mean width, px."""
    if (found := _usable(profiles)) is None:
        return None
    sums, weights, width = found
    by_image = np.array(
        [
            _odd((sums.sum(0) - image_sums) / (weights.sum(0) - weight))
            for image_sums, weight in zip(sums, weights)
        ]
    )
    std = np.sqrt((len(by_image) - 1) * by_image.var(0))
    return _odd(sums.sum(0) / weights.sum(0)), np.maximum(std, _LEAST_STD), width


def _usable(profiles: Profiles) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Sums and weights (F, bins) of the images that hold all bins, and the mean width; None where there are too few."""
    used = (profiles.weights > 0).all(1)
    if used.sum() < _FEWEST:
        return None
    return profiles.sums[used], profiles.weights[used], float(profiles.width[used].mean())


def _odd(profile: np.ndarray) -> np.ndarray:
    """(bins,) odd part of a profile about the fitted centre."""
    return (profile - profile[::-1]) / 2


def _ambiguity(sums: np.ndarray, weights: np.ndarray) -> float:
    """Centroid less mode, in widths, of the mean profile: a unit Gaussian with a small odd part.

    The mode of g + o is at o'(0), since g'' = -1 there; the centroid at the first moment of o over sqrt(2 pi).
    """
    odd = _odd(sums / weights)
    is_near_mode = np.abs(PLACES) < _MODE_WIDTHS
    slope = (odd[is_near_mode] @ PLACES[is_near_mode]) / (
        PLACES[is_near_mode] @ PLACES[is_near_mode]
    )
    moment = (odd @ PLACES) * (_EDGES[1] - _EDGES[0]) / np.sqrt(2 * np.pi)
    return float(moment - slope)
