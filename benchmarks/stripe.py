"""The laser line in a stack of images against OpenCV's subtract-and-centroid and a scikit-image ridge.

Run `python benchmarks/stripe.py` in an environment with the extra `bench`. Every side gets the same
uint8 images, of which it knows nothing but that there is one line, on one thread; OpenCV's side
is given the best threshold and its buffers beforehand, ours finds noise, width and doubtful rows too.
"""

import os
import sys
from functools import lru_cache, partial
from pathlib import Path

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def main() -> int:
    """Print the table; 1 where the two sides of a row give different answers, else 0."""
    os.environ.update(dict.fromkeys(THREADS, "1"))  # read by numpy when it is first imported, below
    root = str(Path(__file__).resolve().parents[1])
    if root not in sys.path:
        sys.path.insert(0, root)
    from benchmarks import table
    from workbench.core.memory import keep_freed_memory

    keep_freed_memory()  # as the command line does
    return table.show(comparisons())


def comparisons():
    """The rows' functions."""
    return [stripe_budget, stripe_centroid, stripe_lean, stripe_background, stripe_hessian]


FRAMES, HEIGHT, WIDTH = 120, 1024, 1280
WIDE, SNR, NOISE, GROUND = 2.0, 25, 3.0, 20.0
PER_SECOND, LEAST_RATIO, LEAST_RIDGE = 1500, 1, 30


def stripe_budget():
    """Images a second and core; the peer is the time that is allowed."""
    from benchmarks.table import Row, fastest

    stack, truth = _scan()
    seconds = fastest(5, partial(_ours, stack))
    one_pass = fastest(5, partial(_largest_of_pieces, stack))
    note = (
        f"{len(stack) / seconds:,.0f} images a second (largest pixel of every 64 alone: "
        f"{len(stack) / one_pass:,.0f}); {_quality(stack, truth)}"
    )
    return Row(f"stripe, {_size(stack)}, allowed", seconds, len(stack) / PER_SECOND, 1, note)


def stripe_centroid():
    """cv2.subtract, then the moments as one product with (1, x)."""
    from benchmarks.table import Row, compare

    stack, truth = _scan()
    peer = partial(_centroids, stack, _product())
    note = _better(stack, truth, peer)
    times = compare(partial(_ours, stack), partial(peer, _threshold(peer, truth)), (5, 5))
    return Row(f"stripe, {_size(stack)}, subtract and centroid", *times, LEAST_RATIO, note)


def stripe_lean():
    """For information: the leanest way that we know; cv2.reduce for the sum, one product with a vector."""
    from benchmarks.table import Row, compare

    stack, truth = _scan()
    peer = partial(_centroids, stack, _vector())
    note = _better(stack, truth, peer)
    times = compare(partial(_ours, stack), partial(peer, _threshold(peer, truth)), (5, 5))
    return Row(f"stripe, {_size(stack)}, leanest centroid", *times, None, note)


def stripe_background():
    """For information: an image without laser is subtracted on both sides; ours fits its exposure too."""
    from benchmarks.table import Row, compare

    stack, truth = _scan()
    background = _background()
    peer = partial(_centroids, stack, _product(), background=background)
    ours = partial(_ours, stack, background=background)
    times = compare(ours, partial(peer, _threshold(peer, truth)), (3, 5))
    return Row(
        f"stripe less background, {_size(stack)}",
        *times,
        None,
        _better(stack, truth, peer, background),
    )


def stripe_hessian():
    """skimage.feature.hessian_matrix and its eigenvalues; the ridge's largest pixel and a parabola through it."""
    from benchmarks.table import Row, fastest

    stack, truth = _scan()
    few = stack[:2]
    note = f"its RMS {_rms(_hessian(few), truth[:2]):.4f} px, of some seven rows together; {_quality(stack, truth)}"
    seconds = fastest(5, partial(_ours, stack)) / len(stack)
    return Row(
        "stripe, an image, scikit-image Hessian",
        seconds,
        fastest(3, partial(_hessian, few)) / len(few),
        LEAST_RIDGE,
        note,
    )


@lru_cache(maxsize=1)
def _scan():
    """Images (F, H, W) uint8 of a line that bends and walks, and its centres (F, H)."""
    import numpy as np

    random, x = np.random.default_rng(0), np.arange(WIDTH, dtype=np.float32)
    row = np.arange(HEIGHT)
    truth = np.stack(
        [200 + 860 * k / FRAMES + 0.1 * row + 8 * np.sin(row / 97 + k) for k in range(FRAMES)]
    )
    stack = np.empty((FRAMES, HEIGHT, WIDTH), np.uint8)
    for centre, image in zip(truth, stack):
        line = SNR * NOISE * np.exp(-0.5 * ((x - centre[:, None].astype(np.float32)) / WIDE) ** 2)
        noise = random.standard_normal((HEIGHT, WIDTH), dtype=np.float32)
        image[:] = np.clip(np.rint(GROUND + line + NOISE * noise), 0, 255)
    return stack, truth


def _background():
    """(H, W) uint8, the same scene without laser, the mean of many images."""
    import numpy as np

    return np.full((HEIGHT, WIDTH), int(GROUND), np.uint8)


def _ours(stack, background=None):
    from sensors.stripe.find import find_stripes

    return find_stripes(stack, background=background)


def _largest_of_pieces(stack):
    """The one pass over all pixels that finding the line needs: what memory and `cv2.reduce` allow at most."""
    import cv2

    return cv2.reduce(stack.reshape(-1, 64), 1, cv2.REDUCE_MAX)


def _size(stack):
    return f"{len(stack)} of {stack.shape[2]} x {stack.shape[1]}"


def _centroids(stack, moments, level, background=None):
    """(F, H) centres of gravity of what is above `level`, image by image, in buffers that are used again."""
    import cv2
    import numpy as np

    cv2.setNumThreads(1)
    above, single = np.empty(stack.shape[1:], np.uint8), np.empty(stack.shape[1:], np.float32)
    made = np.empty(stack.shape[:2])
    for image, centre in zip(stack, made):
        if background is not None:
            image = cv2.subtract(image, background, dst=above)
        cv2.subtract(image, level, dst=above)
        np.copyto(single, above)
        total, first = moments(above, single)
        with np.errstate(divide="ignore", invalid="ignore"):
            np.divide(first, total, out=centre)
    return made


def _product():
    import numpy as np

    columns = np.stack([np.ones(WIDTH), np.arange(WIDTH)], 1).astype(np.float32)
    return lambda above, single: (single @ columns).T


def _vector():
    import cv2
    import numpy as np

    column = np.arange(WIDTH, dtype=np.float32)
    return lambda above, single: (
        cv2.reduce(above, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)[:, 0],
        single @ column,
    )


def _hessian(stack):
    """(F, H) the largest pixel of the ridge in every row, moved by a parabola through it and its neighbours."""
    import numpy as np
    from skimage.feature import hessian_matrix, hessian_matrix_eigvals

    made = np.empty(stack.shape[:2])
    for image, centre in zip(stack, made):
        second = hessian_matrix(
            image.astype(np.float32), sigma=WIDE, order="rc", use_gaussian_derivatives=False
        )
        ridge = -hessian_matrix_eigvals(second)[1]
        row, column = np.arange(len(ridge)), np.clip(ridge.argmax(1), 1, WIDTH - 2)
        left, top, right = ridge[row, column - 1], ridge[row, column], ridge[row, column + 1]
        centre[:] = column + 0.5 * (left - right) / (left - 2 * top + right)
    return made


def _threshold(peer, truth):
    """The level, in whole grey values, that makes OpenCV's centres best."""
    levels = [int(start + k * NOISE) for start in (0, GROUND) for k in (1, 2, 3, 4, 5)]
    return min(levels, key=lambda level: _rms(peer(level), truth))


def _better(stack, truth, peer, background=None):
    """A note on both errors; Disagreement where ours is not the smaller one."""
    import numpy as np

    from benchmarks.table import Disagreement

    made = _ours(stack, background)
    ours = float(np.sqrt(np.mean((made.centre - truth[made.frame, made.line]) ** 2)))
    theirs = _rms(peer(_threshold(peer, truth)), truth)
    if not ours < theirs:
        raise Disagreement(f"our RMS {ours:.4f} px, expected less than {theirs:.4f} px")
    return f"RMS {ours:.4f} px (bound {_bound():.4f}, {len(made) / truth.size:.2%} of the rows), theirs {theirs:.4f} px"


def _quality(stack, truth):
    import numpy as np

    made = _ours(stack)
    ratio = (made.centre - truth[made.frame, made.line]) / made.sigma
    seen = f"{len(made) / truth.size:.2%} of the rows"
    return f"{seen}, chi-square {np.mean(ratio**2):.3f}, largest {abs(ratio).max():.1f} sigma"


def _rms(found, truth):
    import numpy as np

    return float(np.sqrt(np.nanmean((found - truth) ** 2)))


def _bound():
    from benchmarks.cramer_rao import centre_bound
    from sensors.stripe.profile import Noise

    return centre_bound(WIDE, SNR * NOISE, Noise((NOISE**2 + 1 / 12) ** 0.5), GROUND)


if __name__ == "__main__":
    sys.exit(main())
