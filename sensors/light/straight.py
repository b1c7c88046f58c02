"""Stripes on tilted boards are asymmetric: the bias of their centres is subtracted before planes are fitted to them.

A tilted board is imaged larger and lit more where it is nearer. `surface_bias.surface_line` computes the bias of the
centre, some thousandths of a pixel, equal for all stripes of a board pose: planes from many stripes are known better
than that.
"""

from dataclasses import replace

import numpy as np

from sensors.light.board_chain import BoardStripeChain
from sensors.stripe.surface_bias.surface_line import (
    SMOOTH,
    UNKNOWN_SCATTER,
    LineShape,
    SurfaceLine,
    line_on_boards,
)
from workbench.core.distributions import chi2
from workbench.core.rigid import rotation_matrix

_FEWEST_ROWS = 20  # of an image, whose median is then known well enough
_FEWEST_IMAGES = 5
_LEAST_SCATTER = 1e-3
_LOW_TAIL = 0.16  # of the distribution of a variance: 1 sigma


def straightened(
    chain: BoardStripeChain, shape: np.ndarray | None
) -> tuple[BoardStripeChain, LineShape]:
    """The chain without the pull of perspective, and the line's shape, of widths 0 where its lines do not tell it.

    shape (2, n): width of the line in px, and photon variance at its peak over that next to it; None where unknown.
    """
    if shape is None:
        return chain, LineShape(0.0, 0.0)
    bend = _bend(chain, None)
    line = bend.line_shape(shape[0])
    line = replace(line, scatter=_scatter_of_images(chain, bend, line, shape[0]))
    return _without_pull(chain, bend.centre_bias(line, *shape)), line


def unshaded(chain: BoardStripeChain, plane_width: float, light: np.ndarray) -> BoardStripeChain:
    """The chain without the pull of light from the point `light` (3,) mm; `plane_width` 1 sigma, mm.

    How fast the light itself fans out is not known: where its source stands behind the mirror, no board tells.
    """
    if not plane_width:
        return chain
    bend = _bend(chain, light)
    return _without_pull(chain, (plane_width / bend.slope) ** 2 * bend.shade)


def _scatter_of_images(chain, bend: SurfaceLine, line: LineShape, width: np.ndarray) -> float:
    """1 sigma of ln(width^2 / expected^2) that the rows of one image have in common, see `LineShape`.

    RMS of the images' medians over the degrees of freedom that the two widths of the line leave. Zero is not known from
    few images: the upper end of the 68 % confidence interval of a standard deviation counts (chi-square).
    """
    is_smooth = (bend.incidence_cosine > SMOOTH) & (bend.facing > SMOOTH)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(width**2 / bend.width_square(line))
    usable = np.flatnonzero(np.isfinite(ratio) & is_smooth)
    image = chain.labels["placement"] * (chain.labels["step"].max() + 1) + chain.labels["step"]
    usable = usable[np.argsort(image[usable], kind="stable")]
    first = np.flatnonzero(np.diff(image[usable], prepend=-1))
    of_images = [part for part in np.split(ratio[usable], first[1:]) if len(part) >= _FEWEST_ROWS]
    degrees = len(of_images) - 2
    if degrees < _FEWEST_IMAGES:
        return UNKNOWN_SCATTER
    squares = float(np.square([np.median(part) for part in of_images]).sum())
    return float(max(np.sqrt(squares / chi2.ppf(_LOW_TAIL, degrees)), _LEAST_SCATTER))


def _bend(chain, light) -> SurfaceLine:
    rotations = rotation_matrix(chain.poses[:, 3:])
    placement = chain.labels["placement"]
    heights = (rotations[:, :, 2] * chain.poses[:, :3]).sum(1)
    return line_on_boards(
        chain.camera,
        rotations[placement, :, 2].T,
        heights[placement],
        chain.pixels,
        chain.planes[:, chain.labels["step"]],
        chain.scan[:, 0],
        light,
    )


def _without_pull(chain, pull):
    return replace(chain, pixels=chain.pixels - chain.scan * np.nan_to_num(pull))
