"""Random effects that corners of many images share: displaced board points, an uneven board, an unmodelled lens."""

from dataclasses import dataclass

import numpy as np

COMPONENTS = ("lines of the board", "points of the board", "height of the board", "lens")
"""Names of the components of variance: the first three are in mm, the last in px."""
UNITS = ("mm", "mm", "mm", "px")
_HEIGHT_NODES = (4, 3)
_LENS_NODES = (3, 3), (5, 4), (9, 7)  # displacement fields of three correlation lengths
_SAME = 1e-6  # of the size of the board: two coordinates on one line


@dataclass(frozen=True)
class BoardLine:
    """A row (`axis` 1) or column (`axis` 0) of the board's points at `at_mm`, the `number`-th from 1 in the order of
    that coordinate; `members` (2, m) numbers of the effects that displace its points in x and in y."""

    axis: int
    number: int
    at_mm: float
    members: np.ndarray


@dataclass(frozen=True)
class SharedEffects:
    """Sparse derivative of n corners by q effects.

    `rows` (2 n, q), CSR, px per unit: u of all corners, then v; `component` (q,) index into `names`; `lines`
    of the board.
    """

    rows: object
    component: np.ndarray
    names: tuple[str, ...]
    units: tuple[str, ...]
    lines: tuple[BoardLine, ...] = ()


def shared_effects(
    points: np.ndarray, by_point: np.ndarray, pixels: np.ndarray, size, has_bow: bool = False
) -> SharedEffects:
    """Effects of corners with board coordinates points (3, n) mm and expected pixels (2, n) in an image of `size` px.

    by_point (3, 2, n): px by the board's x, y, z. Every line of points across the board has one displacement, every
    point has two, and the height is a bilinear field on the board. The lens displaces pixels by bilinear fields of
    three mesh sizes. has_bow: a quadratic height of the board is estimated; the effects are what remains of the height.
    """
    from scipy.sparse import csr_matrix, hstack

    blocks = [*_lines(points, by_point), *_points(points, by_point)]
    height = _field(points[:2], _box(points[:2]), _HEIGHT_NODES)
    blocks.append((2, _beyond_bow(height, points) if has_bow else height, by_point[2]))
    image = np.array([[-0.5, -0.5], [size[0] - 0.5, size[1] - 0.5]]).T
    names = list(COMPONENTS)
    units = list(UNITS)
    for step, nodes in enumerate(_LENS_NODES):
        field = _field(pixels, image, nodes)
        for axis in (0, 1):
            direction = np.zeros((2, pixels.shape[1]))
            direction[axis] = 1.0
            blocks.append((3 + step, field, direction))
    names += [COMPONENTS[3]] * (len(_LENS_NODES) - 1)
    units += [UNITS[3]] * (len(_LENS_NODES) - 1)
    stacked = [_stacked(field, rows) for _, field, rows in blocks]
    component = np.concatenate(
        [np.full(part.shape[1], k) for (k, _, _), part in zip(blocks, stacked)]
    )
    lines = tuple(_board_lines(points, int((component == 0).sum())))
    return SharedEffects(csr_matrix(hstack(stacked)), component, tuple(names), tuple(units), lines)


def _beyond_bow(field, points):
    """Columns of a field (n, k) less their best plane and quadratic surface over the points."""
    from scipy.sparse import csr_matrix

    low, high = _box(points[:2]).T
    x, y = (points[:2] - low[:, None]) / np.maximum(high - low, 1e-300)[:, None]
    surface = np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], axis=1)
    columns = field.toarray()
    return csr_matrix(columns - surface @ np.linalg.lstsq(surface, columns, rcond=None)[0])


def _stacked(field, rows):
    """(2 n, q) of weights (n, q) and derivatives (2, n)."""
    from scipy.sparse import diags, vstack

    return vstack([diags(rows[0]) @ field, diags(rows[1]) @ field])


def _lines(points, by_point):
    """One displacement across each line."""
    return [(0, _indicator(_labels(points[axis])), by_point[axis]) for axis in _line_axes(points)]


def _line_axes(points):
    """Axes along which lines are counted: not where hardly two points share a coordinate."""
    count = np.unique(_point_labels(points)).size
    return [axis for axis in (0, 1) if 1 < _labels(points[axis]).max() + 1 <= count / 2]


def _board_lines(points, first):
    """The lines, with the effects of their points, of which those in x begin at number `first` and those in y next."""
    point = _point_labels(points)
    count = int(point.max()) + 1
    for axis in _line_axes(points):
        label = _labels(points[axis])
        for number in range(int(label.max()) + 1):
            is_on_line = label == number
            members = first + np.unique(point[is_on_line])
            coordinate = float(points[axis][is_on_line].mean())
            yield BoardLine(axis, number + 1, coordinate, np.stack([members, members + count]))


def _points(points, by_point):
    label = _point_labels(points)
    return [(1, _indicator(label), by_point[axis]) for axis in (0, 1)]


def _point_labels(points):
    column = _labels(points[0])
    row = _labels(points[1])
    return np.unique(column * (row.max() + 1) + row, return_inverse=True)[1].ravel()


def _labels(values):
    step = _SAME * max(float(np.ptp(values)), 1e-300)
    return np.unique(np.round(values / step / 10), return_inverse=True)[1].ravel()


def _indicator(label):
    from scipy.sparse import csr_matrix

    n = len(label)
    return csr_matrix((np.ones(n), (np.arange(n), label)), shape=(n, int(label.max()) + 1))


def _box(points):
    return np.stack([points.min(1), points.max(1)], axis=1)


def _field(points, box, nodes):
    """(n, nodes) bilinear weights of points (2, n) on a regular mesh over box (2, 2)."""
    from scipy.sparse import csr_matrix

    lower = []
    share = []
    for row, (low, high), count in zip(points, box, nodes):
        place = np.clip((row - low) / max(high - low, 1e-300), 0, 1) * (count - 1)
        first = np.minimum(place.astype(int), count - 2)
        lower.append(first)
        share.append(place - first)
    n = points.shape[1]
    columns = nodes[0]
    index = []
    weight = []
    for right in (0, 1):
        for down in (0, 1):
            index.append((lower[1] + down) * columns + lower[0] + right)
            weight_u = share[0] if right else 1 - share[0]
            weight_v = share[1] if down else 1 - share[1]
            weight.append(weight_u * weight_v)
    sample = np.tile(np.arange(n), 4)
    shape = (n, nodes[0] * nodes[1])
    return csr_matrix((np.concatenate(weight), (sample, np.concatenate(index))), shape=shape)
