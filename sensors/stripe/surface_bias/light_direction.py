"""Origin of the light of a single light plane, from the brightness of its stripes on a matt ball.

Planes of a mirror meet where the light comes from (`sensors.light.planes.light_origin`); one plane says no more than
that the light is in it. A matt surface is as bright as the cosine of the light's incidence (Lambert). The brightness of
stripes on known normals is therefore linear in the direction of the light, as in photometric stereo (Woodham, Optical
Engineering 19 (1980) 139), here with the two components in the plane alone.
"""

import numpy as np

from sensors.state import stripe_direction
from workbench.core.distributions import MEDIAN_TO_SIGMA

_DISTANT_MM = 1e6  # mm
_DARK = 0.2  # of the brightest, below which blur and shadow fill what is measured
_FEWEST = 60
_ROUNDS = 5
_MATT = 0.25  # RMS deviation from the cosine, of the mean, beyond which the surface is not matt
_SPREAD = 0.1  # second over first singular value of the normals' components in the plane


def light_on_ball(plane: np.ndarray, outward: np.ndarray, flux: np.ndarray) -> np.ndarray | None:
    """(3,) mm, a distant point that the light of a plane (4,) comes from, camera frame; None where brightness does not
    say it.

    outward (3, n) unit normals of the ball at points of the plane's stripes; flux (n,) light per area there, of any
    unit.
    """
    stripe_axis = stripe_direction(plane[:, None])[:, 0]
    axes = np.stack([stripe_axis, np.cross(plane[:3], stripe_axis)])
    rows = axes @ outward
    usable = np.isfinite(rows).all(0) & np.isfinite(flux) & (flux > 0)
    direction = None
    for _ in range(_ROUNDS):
        if usable.sum() < _FEWEST:
            return None
        sides = np.linalg.svd(rows[:, usable], compute_uv=False)
        if sides[1] < _SPREAD * sides[0]:
            return None
        direction = np.linalg.lstsq(rows[:, usable].T, flux[usable], rcond=None)[0]
        predicted = direction @ rows
        misfit = flux - predicted
        scale = MEDIAN_TO_SIGMA * float(np.median(np.abs(misfit[usable])))
        usable = (predicted > _DARK * np.linalg.norm(direction)) & (np.abs(misfit) <= 3 * scale)
    if usable.sum() < _FEWEST or misfit[usable].std() > _MATT * flux[usable].mean():
        return None
    return _DISTANT_MM * (direction @ axes) / np.linalg.norm(direction)
