"""The exact inverse of a camera's distortion for many pixels: a fitted start, then Newton's step.

The start is a polynomial fitted to this camera over its image, good to about a ten-thousandth
of a pixel and evaluated in single precision; the gap that it leaves is measured in double
precision with the distortion itself, and one Newton step closes it to below 1e-9 px. Blocks are of
a size that stays in the processor's cache. A block with a gap that one step does not close (a wide
lens) takes another; pixels that are then still open (far outside the image) are iterated alone.
"""

from dataclasses import dataclass

import numpy as np

BLOCK = 16384
_MARGIN = 0.02  # of the image's size, by which the fitted region is wider than the image
_GRID = 24
_DEGREES = (2, 3, 4, 5, 7, 9)
_GOOD = 6e-4  # px: a start that is better gains nothing, one Newton step makes it exact
_EXACT = 2e-10  # px: what one Newton step may leave
_ROUNDS = 3


@dataclass(frozen=True)
class Inverse:
    """Polynomial start of one camera's inverse distortion.

    With a the distorted normalised point (2,), s = |a|^2 and u the unit vector along (p2, p1), the
    ideal point is a M(s, u.a) + u N(s): the distortion has no other direction than u. `radial`
    (d + 1,) coefficients of M in s, `tilt` (2,) of u.a in M, `shift` (2,) of N; `enough` the
    largest gap, in normalised units, that one Newton step closes to `_EXACT`; `reach` the s up to
    which it was fitted and beyond which Newton might find the far side of a lens that folds over.
    """

    camera: object
    radial: list[float]
    tilt: list[float]
    shift: list[float]
    direction: list[float]
    enough: float
    reach: float


def fit_inverse(camera) -> Inverse:
    """The start for this camera, by least squares over its image."""
    ideal, seen, reach = _samples(camera)
    if ideal.shape[1] < _GRID:  # hardly a pixel can be undone: a solve on its way through nonsense
        return Inverse(camera, [1.0], [0.0], [0.0], [0.0, 0.0], 0.0, 0.0)
    tangential = np.array(camera.distortion[3:1:-1])
    size = np.hypot(*tangential)
    direction = tangential / size if size else np.zeros(2)
    for degree in _DEGREES:
        basis = _basis(seen, direction, degree)
        found = np.linalg.lstsq(basis, ideal.ravel(), rcond=1e-13)[0]
        if abs(basis @ found - ideal.ravel()).max() * camera.fx < _GOOD:
            break
    coefficients = np.split(found, [degree + 1, degree + 3])
    # plain floats: a numpy scalar of double precision would drag single precision up
    return Inverse(
        camera,
        *(part.tolist() for part in coefficients),
        direction.tolist(),
        _enough(camera, ideal),
        reach,
    )


def _samples(camera):
    """Ideal points (2, k) over the image, where the lens puts them, and how far out it can be undone."""
    size = camera.size if min(camera.size) > 0 else (2 * camera.cx + 1, 2 * camera.cy + 1)
    spans = [np.linspace(-_MARGIN * s, (1 + _MARGIN) * s - 1, _GRID) for s in size]
    seen = camera.seen(np.stack(np.meshgrid(*spans)).reshape(2, -1))
    ideal = iterate(camera, seen)
    out = (seen**2).sum(0)
    is_lost = ~np.isfinite(ideal).all(0)
    reach = 0.95 * out[is_lost].min() if is_lost.any() else out.max()
    is_reached = out <= reach
    return ideal[:, is_reached], seen[:, is_reached], float(reach)


def _basis(seen, direction, degree):
    """(2 k, degree + 5) what multiplies `radial`, `tilt` and `shift`."""
    s = (seen**2).sum(0)
    tilt = direction @ seen
    columns = [seen * s**power for power in range(degree + 1)]
    columns += [seen * tilt, seen * tilt * s, direction[:, None] * s, direction[:, None] * s**2]
    return np.stack([column.ravel() for column in columns], 1)


def _enough(camera, ideal):
    """The gap from which a Newton step, whose error is half the curvature times its square, is exact."""
    small = 1e-4
    _, slope, _ = camera.distort_rows(ideal)
    curvatures = []
    for axis in (0, 1):
        shift = small * np.eye(2)[:, [axis]]
        _, shifted_slope, _ = camera.distort_rows(ideal + shift)
        curvatures.append(abs(shifted_slope - slope).max() / small)
    curvature = max(*curvatures, 1e-9)
    return float(np.sqrt(_EXACT / camera.fx / curvature))


_STEPS = 30  # of Newton's method; four to six are usual


def iterate(camera, seen: np.ndarray) -> np.ndarray:
    """(2, n) ideal points of distorted ones (2, n), by Newton's method to rounding; nan where there is none."""
    flat = seen.copy()
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            bent, slope, _ = camera.distort_rows(flat)
            step = _solved(slope, bent - seen)
            flat = flat - step
            if np.nanmax(np.abs(step), initial=0) < 1e-14:
                break
        # where both of the slope's eigenvalues are not positive the lens has folded the image over
        upright = (slope[0, 0] + slope[1, 1] > 0) & (
            slope[0, 0] * slope[1, 1] > slope[1, 0] * slope[0, 1]
        )
        return np.where((np.abs(step).max(0) < 1e-9) & upright, flat, np.nan)


def _solved(slope, gap):
    determinant = slope[0, 0] * slope[1, 1] - slope[1, 0] * slope[0, 1]
    return (
        np.stack(
            [
                slope[1, 1] * gap[0] - slope[1, 0] * gap[1],
                slope[0, 0] * gap[1] - slope[0, 1] * gap[0],
            ]
        )
        / determinant
    )


class Workspace:
    """Buffers for one block and the stages on it: start, gap, Newton step.

    The arithmetic is written into buffers that stay in the cache: a fresh array at every operation
    would cost more than the operation.
    """

    def __init__(self, inverse: Inverse):
        self.inverse, self.camera = inverse, inverse.camera
        self.centre = np.array([[self.camera.cx], [self.camera.cy]])
        self.per_px = np.array([[1 / self.camera.fx], [1 / self.camera.fy]])
        k1, k2, p1, p2, k3, k4, k5, k6 = (
            *(float(k) for k in self.camera.distortion),
            0.0,
            0.0,
            0.0,
        )[:8]
        self.p1 = p1
        self.p2 = p2
        self.straight = not (p1 or p2)
        self.top = _trimmed(1, k1, k2, k3)
        self.top_slope = _trimmed(2 * k1, 4 * k2, 6 * k3)
        self.denominator = _trimmed(1, k4, k5, k6)
        self.below_slope = _trimmed(2 * k4, 4 * k5, 6 * k6)
        self.wide = np.empty((2, 2, BLOCK)), np.empty((4, BLOCK))
        self.narrow = np.empty((4, 2, BLOCK), np.float32), np.empty((6, BLOCK), np.float32)

    def normalised(self, pixels: np.ndarray, out: np.ndarray) -> None:
        """Ideal normalised points of pixels (2, m), m at most `BLOCK`, into `out` (2, m)."""
        seen, gap = self.wide[0][:, :, : pixels.shape[1]]
        np.subtract(pixels, self.centre, out=seen)
        seen *= self.per_px
        start = self._start(seen)
        right = self.narrow[0][0, :, : pixels.shape[1]]
        size = self.narrow[1][0, : pixels.shape[1]]
        outer_reach = None if size.max() < self.inverse.reach else ~(size < self.inverse.reach)
        np.copyto(out, start)
        with np.errstate(all="ignore"):
            for _ in range(_ROUNDS):
                common, r2 = self._gap(out, seen, gap)
                np.copyto(right, gap)
                enough = (
                    outer_reach is None
                    and right.max() < self.inverse.enough
                    and right.min() > -self.inverse.enough
                )
                open_ = None if enough else ~(np.abs(right) < self.inverse.enough).all(0)
                np.copyto(gap, self._step(start, right, common, r2))
                out -= gap
                if enough:
                    return
                np.copyto(start, out)
        if outer_reach is not None:
            open_ |= outer_reach
        if open_.any():
            out[:, open_] = iterate(self.camera, seen[:, open_])

    def _start(self, seen):
        """(2, m) in single precision: the polynomial at the seen points."""
        point, start, square, _ = self.narrow[0][:, :, : seen.shape[1]]
        s, factor, part, tilt, _, _ = self.narrow[1][:, : seen.shape[1]]
        np.copyto(point, seen)
        np.multiply(point, point, out=square)
        np.add(square[0], square[1], out=s)
        _horner(self.inverse.radial, s, factor)
        if self.straight:
            return np.multiply(point, factor, out=start)
        x, y = self.inverse.direction
        _mixed(x, y, point, tilt, part)
        tilt *= _horner(self.inverse.tilt, s, part)
        factor += tilt
        np.multiply(point, factor, out=start)
        _horner(self.inverse.shift, s, part)
        part *= s
        start[0] += np.multiply(part, x, out=tilt)
        start[1] += np.multiply(part, y, out=tilt)
        return start

    def _gap(self, flat, seen, gap):
        """Into `gap` where the lens puts `flat` less where it was seen; gives m and r2 of bent = x m + p r2."""
        r2, common, part, other = self.wide[1][:, : flat.shape[1]]
        np.multiply(flat, flat, out=gap)
        np.add(gap[0], gap[1], out=r2)
        _horner(self.top, r2, common)
        if len(self.denominator) > 1:
            common /= _horner(self.denominator, r2, part)
        if not self.straight:
            common += _mixed(2 * self.p2, 2 * self.p1, flat, part, other)
        np.multiply(flat, common, out=gap)
        gap -= seen
        if not self.straight:
            gap[0] += np.multiply(r2, self.p2, out=part)
            gap[1] += np.multiply(r2, self.p1, out=part)
        return common, r2

    def _step(self, flat, right, common, r2):
        """(2, m) Newton step; single precision is enough for what is a thousandth of a pixel.

        The slope of bent = x m + p r2 is the symmetric m I + steep x x' + 2 (x p' + p x').
        """
        slope, step = self.narrow[0][2:, :, : flat.shape[1]]
        m, steep, cross, part, r2_narrow, _ = self.narrow[1][:, : flat.shape[1]]
        np.copyto(m, common)
        np.copyto(r2_narrow, r2)
        self._steepness(flat, m, r2_narrow, steep)
        np.multiply(flat, steep, out=slope)
        np.multiply(flat[0], slope[1], out=cross)
        if not self.straight:
            cross += _mixed(2 * self.p1, 2 * self.p2, flat, part, steep)
            slope[0] += 4 * self.p2
            slope[1] += 4 * self.p1
        slope *= flat
        slope += m
        np.multiply(slope[0], slope[1], out=m)
        m -= np.multiply(cross, cross, out=part)
        np.multiply(slope[1], right[0], out=step[0])
        np.multiply(slope[0], right[1], out=step[1])
        right *= cross
        step[0] -= right[1]
        step[1] -= right[0]
        step /= m
        return step

    def _steepness(self, flat, m, r2, steep):
        """Into `steep` twice the slope of the radial factor by r2."""
        _horner(self.top_slope, r2, steep)
        if len(self.denominator) == 1:
            return
        part = self.narrow[1][3, : len(r2)]
        other = self.narrow[1][5, : len(r2)]
        _horner(self.below_slope, r2, part)
        part *= m
        if not self.straight:  # m holds the tangential part too: taken out again
            part -= _horner(self.below_slope, r2, other) * (
                2 * (self.p2 * flat[0] + self.p1 * flat[1])
            )
        steep -= part
        steep /= _horner(self.denominator, r2, other)


def _trimmed(*coefficients) -> list[float]:
    """Without the zeros at its end, the first one kept."""
    while len(coefficients) > 1 and coefficients[-1] == 0:
        coefficients = coefficients[:-1]
    return [float(c) for c in coefficients]


def _horner(coefficients, values, out):
    """Polynomial with `coefficients` from the constant term up, into `out`."""
    if len(coefficients) == 1:
        out[:] = coefficients[0]
        return out
    np.multiply(values, coefficients[-1], out=out)
    for coefficient in coefficients[-2:0:-1]:
        out += coefficient
        out *= values
    out += coefficients[0]
    return out


def _mixed(a, b, pair, out, part):
    """a x + b y of a pair of rows, into `out`."""
    np.multiply(pair[0], a, out=out)
    out += np.multiply(pair[1], b, out=part)
    return out
