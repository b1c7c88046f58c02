"""Images as grey arrays: read, judged before they are used, and handed on one or a few at a time."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sensors.image_size import check_decoded_size
from sensors.stripe.clipping import Counts
from workbench.core.errors import InputError

CHANNELS = ("grey", "blue", "green", "red")
BLACK = 1 / 64
"""Share of full scale that no pixel of a image taken in the dark passes: 4 of 255 counts."""
FULL = 0.5
"""Share of pixels at full scale beyond which a image shows its exposure and nothing else."""
STANDS_OUT = 8.0
"""Contrast over noise; the brightest and darkest thousandth of pure noise are 6.2 sigma apart."""
_STEEPEST = 99.9
"""Per cent of the pixels with a smaller gradient than an edge: a board has edges in more than a thousandth of them."""
_SHARP_PX, _ONE_WAY = 8.0, 2.0
"""px of an edge that is blurred, and the ratio of two directions; 1.4 where two families of edges are sharp."""
_CROSSING = 0.5
"""Of the gradient energy that edges across the others would have, were they as many: a single stripe has none."""
_REMEDY = "or remove it and its row of the table of images or poses"
ENDS = ((b"\xff\xd8", b"\xff\xd9", "JPEG"), (b"\x89PNG", b"IEND\xaeB`\x82", "PNG"))


@dataclass(frozen=True, eq=False)
class Image:
    """`grey` (H, W) uint8 or uint16; `full` is its largest count; `note` says what was converted, "" for nothing."""

    grey: np.ndarray
    full: int
    note: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in px."""
        return self.grey.shape[1], self.grey.shape[0]

    @property
    def saturated(self) -> float:
        """Share of pixels at full scale."""
        return float(np.mean(self.grey >= self.full))


def check_readable(path: str | Path, called: str = "") -> None:
    """Raise InputError for a file that is missing, empty, broken off, or no image, without decoding it."""
    import cv2

    called = called or str(path)
    _content(Path(path), called)
    if not cv2.haveImageReader(str(path)):
        raise InputError(
            f"{called}: expected an image that OpenCV reads (PNG, JPEG, TIFF, BMP), found a file that "
            f"it cannot decode; save it as PNG, {_REMEDY}"
        )


def read(path: str | Path, called: str = "", channel: str = "grey") -> Image:
    """The image at `path`, 8 or 16 bits; colour becomes grey (or one `channel`), alpha is dropped.

    called: how sentences name it, `path` where not given. Raises InputError for a file that is
    missing, empty, broken off, or no image.
    """
    import cv2

    called = called or str(path)
    content = _content(Path(path), called)
    check_decoded_size(content, called)
    try:
        found = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        found = None
    if found is None or found.size == 0:
        raise InputError(
            f"{called}: expected an image that OpenCV reads (PNG, JPEG, TIFF, BMP), found a file that "
            f"it cannot decode; save it as PNG, {_REMEDY}"
        )
    if found.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{called}: expected 8 or 16 bits a pixel, found {found.dtype}; save it as 8- or 16-bit PNG"
        )
    grey, note = _one_channel(found, channel)
    full = _full_scale(grey)
    deep = f"{grey.dtype.itemsize * 8}-bit, full scale {full}" if grey.dtype == np.uint16 else ""
    return Image(grey, full, "; ".join(filter(None, (note, deep))))


def read_grey(path: str | Path, called: str = "", channel: str = "grey") -> np.ndarray:
    """(H, W) uint8 or uint16: what `read` gives, without the notes. Raises InputError."""
    return read(path, called, channel).grey


def flaw(image: Image | np.ndarray) -> str | None:
    """Why nothing can be found in a image: "all black", "saturated", "no contrast"; None where it can be used."""
    image = as_image(image)
    low, high = np.percentile(image.grey[:: _stride(image), :: _stride(image)], (0.1, 99.9))
    if high <= BLACK * image.full:
        return f"all black: no pixel above {high:.0f} of {image.full}"
    if image.saturated > FULL:
        return f"saturated: {100 * image.saturated:.0f} % of the pixels at full scale"
    if high - low <= STANDS_OUT * noise(image.grey) + 2:
        spread = f"grey values from {low:.0f} to {high:.0f} of {image.full}"
        return f"no contrast: {spread}, noise of {noise(image.grey):.2g}"
    return None


def blur(grey: np.ndarray) -> str | None:
    """Estimate the blur of an image (H, W) with straight edges in two directions; None where its edges are sharp.

    An edge is as wide as the contrast of the image over the steepest gradient across it, after smoothing by 1 px. The
    narrower of two edge directions is blurred by focus; one that is much wider, by motion across it, unless hardly
    anything in the image varies along it (a single stripe).
    """
    import cv2

    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.0)
    low, high = np.percentile(smooth[::4, ::4], (0.1, 99.9))
    down, right = np.gradient(smooth)
    gradients = (right, down, (right + down) / np.sqrt(2), (right - down) / np.sqrt(2))
    steepest = [float(np.percentile(np.abs(gradient), _STEEPEST)) for gradient in gradients]
    narrow, wide = (float(high - low) / max(f(steepest), 1e-9) for f in (max, min))
    if narrow > _SHARP_PX:
        return f"blurred: its sharpest edges are {narrow:.0f} px wide"
    is_crossed = _weaker_energy(right, down) > _CROSSING * narrow / wide
    if is_crossed and wide > max(_SHARP_PX, _ONE_WAY * narrow):
        return f"blurred along one direction, as by motion: edges are up to {wide:.0f} px wide, others {narrow:.0f}"
    return None


def _weaker_energy(right: np.ndarray, down: np.ndarray) -> float:
    """Ratio of the eigenvalues of the structure tensor: gradient energy across the main direction over along it."""
    flat = np.stack([right.ravel(), down.ravel()])
    weaker, stronger = np.linalg.eigvalsh(flat @ flat.T)
    return float(weaker / max(stronger, 1e-12))


def unlit(grey: np.ndarray) -> str | None:
    """Why no laser line can be seen in a image (H, W) taken to show one: "all black", "saturated"; None where it may.

    A line fills less of a image than `flaw` asks for: one pixel that is not black is enough.
    """
    full = 255 if grey.dtype == np.uint8 else _full_scale(grey)
    if (brightest := int(grey.max(initial=0))) <= BLACK * full:
        return f"all black: no pixel above {brightest} of {full}"
    if (share := float(np.mean(grey >= full))) > FULL:
        return f"saturated: {100 * share:.0f} % of the pixels at full scale"
    return None


def odd_sizes(sizes: Iterable[tuple[int, int]]) -> dict[int, str]:
    """Position of every image of another size than most, and the reason in words; sizes (width, height) px."""
    sizes = list(sizes)
    if len(set(sizes)) < 2:
        return {}
    usual = Counter(sizes).most_common(1)[0][0]
    words = f"px among images of {usual[0]} x {usual[1]} px"
    return {
        k: f"wrong size: {w} x {h} {words}" for k, (w, h) in enumerate(sizes) if (w, h) != usual
    }


def stacks(
    paths: Iterable[str | Path],
    frames: int = 16,
    called: Callable[[str | Path], str] = str,
) -> Iterator[np.ndarray]:
    """(F, H, W) arrays of at most `frames` images each, in order: never all of them in memory.

    Raises InputError for a image that cannot be read, or is not as large or as deep as the first one.
    """
    images = []
    shape = None
    depth = None
    for path in paths:
        grey = read_grey(path, called(path))
        shape = shape or grey.shape
        depth = depth or grey.dtype
        if grey.dtype != depth:
            raise InputError(
                f"{called(path)}: expected {8 * depth.itemsize} bits a pixel as in the images before, "
                f"found {8 * grey.dtype.itemsize}; save all of them with the same depth"
            )
        if grey.shape != shape:
            raise InputError(
                f"{called(path)}: expected {shape[1]} x {shape[0]} px as in the images before, found "
                f"{grey.shape[1]} x {grey.shape[0]} px; take it again with the same settings"
            )
        images.append(grey)
        if len(images) == frames:
            yield np.stack(images)
            images = []
    if images:
        yield np.stack(images)


def noise(grey: np.ndarray) -> float:
    """1 sigma of one pixel, counts: from second differences, whose median edges and slopes hardly move."""
    sample = grey[:, :: max(1, grey.shape[1] // 512)].astype(np.float32)
    if sample.shape[0] < 3:
        return 0.0
    second = sample[:-2] - 2 * sample[1:-1] + sample[2:]
    return float(np.median(np.abs(second)) / 0.6745 / np.sqrt(6))


def to_eight_bits(grey: np.ndarray) -> np.ndarray:
    """(H, W) uint8 for finders that take nothing else: the darkest to the brightest 0.1 % over 0-255."""
    low, high = np.percentile(grey[::4, ::4], (0.1, 99.9))
    scaled = (grey.astype(np.float32) - low) * (255 / max(high - low, 1e-6))
    return np.clip(scaled + 0.5, 0, 255).astype(np.uint8)


def as_image(image: Image | np.ndarray) -> Image:
    """An array (H, W) of 8 or 16 bits, or of floats in counts of 8 bits, as a `Image`; InputError for others."""
    if isinstance(image, Image):
        return image
    image = np.asarray(image)
    if image.ndim != 2 or not (image.dtype in (np.uint8, np.uint16) or image.dtype.kind == "f"):
        raise InputError(
            f"image: expected grey values (H, W) of 8 or 16 bits, found {image.dtype} of shape "
            f"{image.shape}; convert colour to grey, or read the file with sensors.images.read"
        )
    return Image(image, 255 if image.dtype.kind == "f" else _full_scale(image))


def _content(path: Path, called: str) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as problem:
        raise InputError(
            f"{called}: expected an image, found none to read ({problem.strerror}); put it there or "
            "correct its name"
        ) from None
    if not content:
        raise InputError(
            f"{called}: expected an image, found an empty file; copy it again, {_REMEDY}"
        )
    for start, end, kind in ENDS:
        if content.startswith(start) and end not in content[-64:]:
            raise InputError(
                f"{called}: expected a whole {kind} image, found one that breaks off; copy it again, {_REMEDY}"
            )
    if content[:2] == b"BM" and int.from_bytes(content[2:6], "little") > len(content):
        raise InputError(
            f"{called}: expected a whole BMP image, found one that breaks off; copy it again, {_REMEDY}"
        )
    return content


def _one_channel(found: np.ndarray, channel: str) -> tuple[np.ndarray, str]:
    import cv2

    if channel not in CHANNELS:
        raise InputError(
            f"channel: expected one of {', '.join(CHANNELS)}, found {channel!r}; choose one of them"
        )
    if found.ndim == 2:
        return found, ""
    dropped = found.shape[2] in (2, 4)
    text = "alpha dropped" if dropped else ""
    colours = found[:, :, :3] if found.shape[2] >= 3 else found[:, :, :1]
    if colours.shape[2] == 1:
        return np.ascontiguousarray(colours[:, :, 0]), text
    if (colours[..., 0] == colours[..., 1]).all() and (colours[..., 1] == colours[..., 2]).all():
        return np.ascontiguousarray(colours[:, :, 0]), "; ".join(
            filter(None, ("three equal channels", text))
        )
    if channel != "grey":
        layer = np.ascontiguousarray(colours[:, :, CHANNELS.index(channel) - 1])
        return layer, f"{channel} channel of a colour image"
    grey = cv2.cvtColor(np.ascontiguousarray(colours), cv2.COLOR_BGR2GRAY)
    return grey, "; ".join(filter(None, ("colour converted to grey", text)))


def _full_scale(grey: np.ndarray) -> int:
    """255, or for 16 bits what `Counts.full` says of one image alone: less than the camera's where it is dim."""
    if grey.dtype == np.uint8:
        return 255
    return Counts.of(grey).full


def _stride(image: Image) -> int:
    return max(1, min(image.grey.shape) // 512)
