"""Noise of the centres of stripes: what their fits state, and what their neighbours show beyond that.

A fit states the noise of grey values. Grains of speckle shift a centre, too, by as much where the line is bright as
where it is dark. How much that is here, the second differences of three neighbouring centres of a stripe tell: of
independent noise of variance s^2 they have 6 s^2, and a smooth surface leaves next to nothing of itself in them.
"""

import numpy as np

_FEWEST = 30  # triples
_SECOND = 6.0
_MEDIAN = 0.4549  # of chi-square with one degree of freedom


def centre_noise(
    centre: np.ndarray, line: np.ndarray, image: np.ndarray, sigma: np.ndarray, usual: float
) -> np.ndarray:
    """(n,) px, 1 sigma of centres (n,) px in lines (n,) of images (n,) whose fits state `sigma` (n,) px.

    usual: px, 1 sigma beyond that where too few neighbours tell.
    """
    order = np.lexsort((line, image))
    place, image_of_line = line[order], image[order]
    joined = (
        (image_of_line[2:] == image_of_line[:-2])
        & (np.diff(place)[1:] == 1)
        & (np.diff(place)[:-1] == 1)
    )
    if joined.sum() < _FEWEST:
        return np.hypot(sigma, usual)
    middle = order[1:-1][joined]
    seen = np.median(np.diff(centre[order], 2)[joined] ** 2) / _SECOND / _MEDIAN
    return np.sqrt(sigma**2 + max(float(seen - np.median(sigma[middle] ** 2)), 0.0))


__all__ = ["centre_noise"]
