"""Whether centres of the laser line depend on its width and brightness: evidence of blooming or overexposure.

Bright and dark squares of a board make one stripe wide and narrow, bright and dark, at places that its light plane does
not know. A centre of a symmetric line is the same for all. Where light overflows from bright pixels to one side, or the
line is clipped or asymmetric, bright parts of each stripe are displaced against dark ones, and planes with them.
Neighbours share the displacement only within a square, so that it passes for noise.
"""

from dataclasses import dataclass

import numpy as np

_ORDERS = (
    4  # polynomials of degree 0 to 3 along each stripe, which the light plane and the board explain
)
_FEWEST_POINTS = 12
_FEWEST_STRIPES = 8
_LEVEL = 1e-3
_RELEVANT = 0.5  # of the noise of a single centre, as for other lack of fit


@dataclass(frozen=True)
class LineDependence:
    """`rms_px` displacement of centres by width and brightness of the line; `p_value` of none; `noise_px` of what
    these do not explain, 1 sigma of one centre."""

    rms_px: float
    p_value: float
    noise_px: float

    @property
    def is_relevant(self) -> bool:
        """Whether it is significant and not small compared with the noise of a single centre."""
        return self.p_value < _LEVEL and self.rms_px > _RELEVANT * self.noise_px

    @property
    def sentence(self) -> str:
        """Size and possible causes, in words."""
        return (
            f"centres of the laser line are displaced by {self.rms_px:.2g} px RMS with its width and brightness along "
            f"each stripe (noise of one centre otherwise: {self.noise_px:.2g} px): light overflows from bright pixels "
            "(blooming), the line is overexposed, or it is not symmetric; expose less, and see that no pixel is full"
        )

    def as_json(self) -> dict:
        """The object `line_dependence` of the JSON contract."""
        return {
            "rms_px": self.rms_px,
            "p_value": self.p_value,
            "noise_px": self.noise_px,
            "relevant": self.is_relevant,
        }


def line_covariates(shape: np.ndarray) -> dict[str, np.ndarray]:
    """Covariates (n,) of `Blooming`: logarithms of width and brightness, `shape` (2, n) as of `Stripes.shape`."""
    width, brightness = np.log(np.maximum(shape, 1e-6))
    return {"line_brightness": brightness, "line_width": width}


def line_dependence(
    residual: np.ndarray, stripe: np.ndarray, stripe_place: np.ndarray, shape: np.ndarray
) -> LineDependence | None:
    """Of residuals (n,) px along the scan line on the line's shape (2, n), width and brightness (`Stripes.shape`).

    stripe (n,) int: label of the stripe of each centre. along (n,) px: its place along the stripe. One slope on the
    logarithm of each for all stripes, conditional on a cubic polynomial along each; Wald's test with stripes as
    clusters (Liang & Zeger, Biometrika 73 (1986) 13). None where there are too few stripes.
    """
    rows = []
    values = []
    for label in np.unique(stripe):
        points_of_stripe = np.flatnonzero(stripe == label)
        if len(points_of_stripe) >= _FEWEST_POINTS:
            place = stripe_place[points_of_stripe] - stripe_place[points_of_stripe].mean()
            powers = np.vander(place / max(np.abs(place).max(), 1e-9), _ORDERS)
            basis = np.linalg.qr(powers)[0]
            shape_and_residual = np.vstack(
                [np.log(np.maximum(shape[:, points_of_stripe], 1e-6)), residual[points_of_stripe]]
            ).T
            remainder = shape_and_residual - basis @ (basis.T @ shape_and_residual)
            rows.append(remainder[:, :-1])
            values.append(remainder[:, -1])
    if len(rows) < _FEWEST_STRIPES:
        return None
    return _tested(rows, values)


def _tested(rows: list[np.ndarray], values: list[np.ndarray]) -> LineDependence:
    """Rows (k, 2) and values (k,) of each stripe."""
    from scipy.special import fdtrc

    scores = np.stack([row.T @ value for row, value in zip(rows, values)])
    normal = sum(row.T @ row for row in rows)
    slope = np.linalg.lstsq(normal, scores.sum(0), rcond=None)[0]
    count = sum(len(value) for value in values)
    squares = sum(float(value @ value) for value in values)
    explained = float(slope @ scores.sum(0))
    spread = np.linalg.pinv(scores.T @ scores)
    wald = float(scores.sum(0) @ spread @ scores.sum(0))
    size = scores.shape[1]
    residual_degrees = len(rows) - scores.shape[1]
    # the sum of scores under no dependence: Hotelling's T^2 of their mean, whose covariance is about zero
    ratio = wald / max(1 - wald / len(rows), 1e-12) * residual_degrees / size / len(rows)
    p_value = float(fdtrc(size, residual_degrees, ratio))
    noise = np.sqrt(max(squares - explained, 0.0) / max(count - _ORDERS * len(rows), 1))
    return LineDependence(float(np.sqrt(max(explained, 0.0) / count)), p_value, float(noise))
