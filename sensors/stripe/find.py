"""The laser line in images: its centre in every row or column, to a fraction of a pixel, whole stacks at a time.

Every row is fitted separately, with an error at the Cramer-Rao bound (`stripe.profile`).
"""

from dataclasses import dataclass, field, fields, replace

import cv2
import numpy as np

from sensors.stripe.clipping import clip_level
from sensors.stripe.fit import Fits, Setting
from sensors.stripe.flags import (
    ALONE,
    NAMES,
    WEAK,
    flags,
    follow,
    noise_scale,
    others,
    usual_misfit,
)
from sensors.stripe.noise import exposure_scales, pixel_noise
from sensors.stripe.pilot import SAMPLE, Search, first_look
from sensors.stripe.profile import Noise
from sensors.stripe.rows import Rows
from sensors.stripe.surface import background_bias
from workbench.core.errors import InputError

BLOCK = 8
"""Images that are worked on at a time, so that they stay in the processor's cache."""
NOISE_ROWS = 20_000
"""Rows whose fits tell how noisy all are: chi-square to half a percent."""
NARROWEST_IMAGE = 12


@dataclass(frozen=True)
class Stripes:
    """n centres of the laser line, ordered by image and then by row or column.

    frame (n,): image; line (n,): row (or column) searched; centre (n,) px along it; sigma (n,) px,
    1 sigma; width (n,) px, Gaussian sigma of the line, the pixel's own width in it; peak and background (n,) grey
    values, the peak above the background; saturated (n,): clipped pixels were left out of the fit;
    flag (n,): sum of `stripe.flags.NAMES`, 0 where nothing speaks against it; others (n,): further
    peaks in the row; pixels (2, n) px, x right and y down; `dropped`: how many were
    left out, by flag; `noise`: grey values, of one pixel; `scan_axis`: "rows" or "columns" that were searched.
    """

    frame: np.ndarray
    line: np.ndarray
    centre: np.ndarray
    sigma: np.ndarray
    width: np.ndarray
    peak: np.ndarray
    background: np.ndarray
    saturated: np.ndarray
    flag: np.ndarray
    others: np.ndarray
    dropped: dict[str, int]
    noise: Noise
    scan_axis: str = "rows"

    def __len__(self) -> int:
        return len(self.centre)

    @property
    def pixels(self) -> np.ndarray:
        """(2, n) px."""
        return np.stack(
            [self.centre, self.line] if self.scan_axis == "rows" else [self.line, self.centre]
        ).astype(float)

    @property
    def shape(self) -> np.ndarray:
        """(2, n) width in px, and photon variance at the peak over that next to the line."""
        return np.stack(
            [self.width, self.noise.gain * self.peak / self.noise.variance(self.background)]
        ).astype(float)

    def select(self, keep: np.ndarray) -> "Stripes":
        """Those where `keep` (n,) bool says so."""
        if keep.all():
            return self
        arrays = {f.name: getattr(self, f.name)[keep] for f in fields(self)[:10]}
        return replace(self, **arrays)


@dataclass(frozen=True)
class Task:
    """A checked stack with what belongs to it; images are transposed where the line runs along the rows."""

    stack: np.ndarray
    background: np.ndarray | None
    region: np.ndarray | None
    transposed: bool
    saturation: float
    scale: np.ndarray | None
    """(F,) how much brighter the images are exposed than the background; None without one."""
    exposed: dict = field(default_factory=dict)
    """The background at some exposures."""

    @property
    def height(self) -> int:
        return self.stack.shape[2 if self.transposed else 1]

    def rows(self, frames: slice, step: int = 1) -> tuple[Rows, np.ndarray]:
        """Every `step`-th row of some images, and the image (n, width) in which the line is searched."""
        pixels = self._cut(self.stack[frames], step)
        background_rows = None
        scale = None
        if self.background is not None:
            background_images = (
                self.background[frames] if len(self.background) > 1 else self.background
            )
            background_rows = self._cut(background_images, step)
            scale = self.scale[frames]
        region = None if self.region is None else self._cut(self.region[None], step)[0]
        height = pixels.shape[1]
        flat = (
            None
            if background_rows is None
            else background_rows.reshape(-1, background_rows.shape[2])
        )
        rows = Rows(pixels.reshape(-1, pixels.shape[2]), height, flat, scale, region)
        return rows, rows.searched(self.exposed if step == 1 else None)

    def _cut(self, images, step):
        if not self.transposed:
            return np.ascontiguousarray(images[:, step // 2 :: step])
        kind = np.uint8 if images.dtype == bool else images.dtype
        cut = np.empty(
            (len(images), -(-(images.shape[2] - step // 2) // step), images.shape[1]), kind
        )
        for image, into in zip(images, cut):
            part = image[:, step // 2 :: step]
            cv2.transpose(np.ascontiguousarray(part).view(kind), dst=into)
        return cut.view(images.dtype)


def find_stripes(
    stack: np.ndarray,
    scan_axis: str = "rows",
    background: np.ndarray | None = None,
    region: np.ndarray | None = None,
    *,
    saturation: float | None = None,
    flagged: bool = False,
) -> Stripes:
    """The laser line's centre in every row ("rows", the line runs down) or column ("columns") of images.

    stack (F, H, W): uint8, uint16 or float. background (H, W) or (F, H, W): the same scene without
    laser, subtracted at a fitted exposure. region (H, W) bool: where to search. saturation: grey
    value from which a pixel counts as clipped (`clipping.Counts.full` of all images of the camera);
    None: the end of the 8, 10, 12, 14 or 16 bits that these fill. Values that pile up below it are clipped too.
    flagged: return doubtful peaks too, with their flags; else they are only counted in `dropped`.

    Noise is estimated from the images: read noise and photon noise, independent in every pixel.
    Taken for granted, and not in sigma: light around the line that slopes by s grey values a pixel
    pulls a centre by 2.8 s width^2 / peak (give a background); a reflection nearer than two widths
    shows only as a wider line.
    InputError where the stack or what comes with it is not usable.
    """
    task = _task(stack, scan_axis, background, region, saturation)
    stripes = _gathered(*_fitted(task), task)
    return stripes if flagged else stripes.select(stripes.flag == 0)


def _fitted(task: Task):
    count = len(task.stack)
    step = max(1, task.height * count // SAMPLE)
    setting, search = first_look(*task.rows(slice(0, count), step), task.saturation)
    starts = range(0, count, BLOCK)
    fitted_frames = [
        (first, *_block(*task.rows(slice(first, first + BLOCK)), setting, search))
        for first in starts
    ]
    stride = max(1, sum(len(fits.row) for _, fits, *_ in fitted_frames) // NOISE_ROWS)
    sample = _joined([fits.take(slice(None, None, stride)) for _, fits, *_ in fitted_frames])
    misfit, scale = usual_misfit(sample, setting), noise_scale(sample, setting)
    noise = replace(setting.noise, read=setting.noise.read * scale)
    parts_of_fits = []
    for first, fits, count, pull, rows in fitted_frames:
        fits.sigma = fits.sigma * scale
        flag = flags(fits, count > 0, rows, task.height, setting, misfit, pull)
        fits.sigma = np.hypot(fits.sigma, pull) if pull.any() else fits.sigma
        parts_of_fits.append((first, fits, flag, count))
    return parts_of_fits, noise


def _block(rows: Rows, image: np.ndarray, setting: Setting, search: Search):
    """Fits of the main peak of every row of a block, further peaks, the surface's pull (n,), and the number of rows."""
    found = search.brightest(image)
    fits = search.fits(found, rows, setting)
    count, place, second = others(found, rows, fits, setting, search)
    follow(fits, place, second, len(image), rows.height)
    return fits, count, background_bias(rows, fits, setting.noise.read), len(image)


def _joined(fit_sets: list[Fits]) -> Fits:
    return Fits(
        *(np.concatenate([getattr(part, f.name) for part in fit_sets]) for f in fields(Fits))
    )


def _gathered(fitted_frames, noise: Noise, task: Task) -> Stripes:
    fits = _joined([part[1] for part in fitted_frames])
    frame = np.concatenate([first + part.row // task.height for first, part, *_ in fitted_frames])
    flag, count = (np.concatenate([part[k] for part in fitted_frames]) for k in (2, 3))
    sound = ~((flag & WEAK > 0) & (flag & ALONE > 0))
    often = np.bincount(flag[sound], minlength=256)
    sums = np.arange(256)
    dropped = {name: int(often[sums & bit > 0].sum()) for bit, name in NAMES.items()}
    stripes = Stripes(
        frame,
        fits.row % task.height,
        fits.centre,
        fits.sigma,
        fits.width,
        fits.peak,
        fits.background,
        fits.saturated,
        flag,
        count,
        dropped,
        noise,
        "columns" if task.transposed else "rows",
    )
    return stripes.select(sound)


def exposures(images: np.ndarray, backgrounds: np.ndarray) -> np.ndarray:
    """(F,) how much brighter images (F, h, w) are exposed than their backgrounds (F or 1, h, w)."""
    noise = pixel_noise(images[0, :: max(1, images[0].size // 24_000)])
    return exposure_scales(images, backgrounds, noise)


def _task(stack, scan_axis, background, region, saturation) -> Task:
    if scan_axis not in ("rows", "columns"):
        raise InputError(
            f"find_stripes: expected scan_axis rows or columns, found {scan_axis}; name one of them"
        )
    stack = _images(stack, "stack", 3)
    if background is not None:
        background = _images(background, "background", np.ndim(background))
        background = background[None] if background.ndim == 2 else background
        fits = background.shape[1:] == stack.shape[1:] and len(background) in (1, len(stack))
        if not fits or background.dtype != stack.dtype:
            raise InputError(
                f"background: expected {stack.dtype} images of the stack's shape {stack.shape}, found "
                f"{background.dtype} {background.shape}; read it as the stack was read"
            )
    if region is not None:
        region = np.asarray(region)
        if region.dtype != bool or region.shape != stack.shape[1:]:
            raise InputError(
                f"region: expected a bool mask of shape {stack.shape[1:]}, found {region.dtype} "
                f"{region.shape}; draw it on one of the images"
            )
    transposed = scan_axis == "columns"
    level = clip_level(stack, saturation, 1 if transposed else 2)
    scale = None if background is None else exposures(stack, background)
    return Task(stack, background, region, transposed, level, scale)


def _images(stack, called: str, axes: int) -> np.ndarray:
    """uint8, uint16 or float32, finite, large enough; InputError else."""
    stack = np.asarray(stack)
    if stack.ndim != axes or axes not in (2, 3) or min(stack.shape, default=0) == 0:
        raise InputError(
            f"{called}: expected images (F, H, W), found shape {stack.shape}; convert colour to grey, "
            "stack single images"
        )
    if min(stack.shape[-2:]) < NARROWEST_IMAGE:
        raise InputError(
            f"{called}: expected images of at least {NARROWEST_IMAGE} px, found {stack.shape[-2:]}; "
            "check the crop"
        )
    if stack.dtype not in (np.uint8, np.uint16):
        if stack.dtype.kind not in "iuf":
            raise InputError(
                f"{called}: expected uint8, uint16 or float images, found {stack.dtype}; convert them"
            )
        stack = stack.astype(np.float32)
        if not np.isfinite(stack).all():
            raise InputError(
                f"{called}: expected finite grey values, found nan or infinity; fill them first"
            )
    return stack
