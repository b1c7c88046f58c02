"""Centres of balls by votes: every point of a thinned cloud votes for the place one radius below its surface normal."""

import numpy as np

from workbench.core.least_squares.linear_algebra import symmetric_eigen

MOST_POINTS = 40_000  # of a thinned cloud
# A ball shows at least this part of the points of a cap of 30 degrees, however it is cut.
_LEAST_SHARE = 0.2
LEAST_POINTS = 12
# About the voted centre, points may be off by this part of the radius.
WIDE = 0.25
# Cells of the thinned cloud, as a part of the smallest radius.
_CELL = 1 / 12
_DRAWN = 250_000  # points drawn at random before thinning
_NEIGHBOURS = 24  # points that make a normal
# Votes for one centre fall within this part of the radius when normals are good to some 0.1 rad.
_VOTE_CELL = 1 / 5
_RANGE_STEP = 1.5  # ratio of radii that are searched together
_PEAKS = 60
_CAP = 0.84  # area of a cap of 30 degrees in squared radii
_CONE = np.cos(np.deg2rad(30))
# Part of the neighbours' squared distances that one ball does not explain: a post leaves half, a plane all.
_MISFIT = 0.4
_SHIFTS = 3  # of a peak to the mean of its votes


class ThinnedCloud:
    """A thinned cloud with normals, and what its points vote for."""

    def __init__(self, points, rays, radius_range, seed):
        from scipy.spatial import cKDTree

        self.radius_range = radius_range
        random = np.random.default_rng(seed)
        self.chosen, self.cell = _thinned(points, radius_range[0] * _CELL, random)
        self.points = points[:, self.chosen]
        neighbours = min(_NEIGHBOURS, len(self.chosen))
        spacing, self.neighbours = cKDTree(self.points.T).query(self.points.T, neighbours)
        # points scattered at random over a surface, one a cell, are half a cell from the next
        self.cell = max(self.cell, 2 * float(np.median(spacing[:, 1])))
        self.normals = _normals(self.points, self.neighbours)
        along_ray = np.einsum("dn,dn->n", self.normals, rays[:, self.chosen])
        self.normals *= -np.sign(along_ray)

    def of_radius(self, radius):
        """Candidates (centre, radius) of one known radius."""
        votes = self.points - radius * self.normals
        return self._peaks(votes, np.full(self.points.shape[1], radius))

    def of_range(self):
        """Candidates of any radius in the range: a point and its neighbours share the ball that they lie on."""
        radius, misfit = self._local_radii()
        votes = self.points - radius * self.normals
        candidates = []
        low = self.radius_range[0]
        while low < self.radius_range[1]:
            is_above = radius > low / _RANGE_STEP**0.5
            is_below = radius < low * _RANGE_STEP**1.5
            chosen = (misfit < _MISFIT) & is_above & is_below
            candidates += self._peaks(votes[:, chosen], radius[chosen])
            low *= _RANGE_STEP
        return candidates

    def _local_radii(self):
        """(n,) mm radius of the ball through each point and its neighbours, and (n,) its relative misfit."""
        offsets = self.points[:, self.neighbours] - self.points[:, :, None]
        normal_change = self.normals[:, self.neighbours] - self.normals[:, :, None]
        bend = (normal_change**2).sum((0, 2))
        radius = (offsets * normal_change).sum((0, 2)) / np.maximum(bend, 1e-12)
        remainder = offsets - radius[:, None] * normal_change
        distances = (offsets**2).sum((0, 2))
        misfit = (remainder**2).sum((0, 2)) / np.maximum(distances, 1e-300)
        return radius, misfit

    def _peaks(self, votes, radius):
        """Clusters of votes (3, m): (count, centre, radius), most votes first."""
        from scipy.spatial import cKDTree

        if len(radius) < LEAST_POINTS:
            return []
        size = float(np.median(radius))
        reach = _VOTE_CELL * size
        min_votes = max(LEAST_POINTS, _LEAST_SHARE * _CAP * (size / self.cell) ** 2)
        cells = np.floor(votes / reach).astype(np.int64)
        places, counts = np.unique(cells, axis=1, return_counts=True)
        fullest = np.argsort(-counts, kind="stable")[:_PEAKS]
        tree = cKDTree(votes.T)
        peaks = []
        for centre in (places[:, fullest].T + 0.5) * reach:
            for _ in range(_SHIFTS):
                neighbours = tree.query_ball_point(centre, reach)
                centre = votes[:, neighbours].mean(1) if neighbours else centre
            is_new = all(np.linalg.norm(centre - other[1]) > reach for other in peaks)
            if len(neighbours) >= min_votes and is_new:
                peaks.append((len(neighbours), centre, float(np.median(radius[neighbours]))))
        return sorted(peaks, key=lambda peak: -peak[0])

    def support_of(self, centre, radius):
        """(m,) indices of points near this ball's surface, with normals that point away from its centre."""
        displacement = self.points - centre[:, None]
        distance = np.linalg.norm(displacement, axis=0)
        facing = (displacement * self.normals).sum(0) > _CONE * distance
        is_near = np.abs(distance - radius) < WIDE * radius
        return np.flatnonzero(facing & is_near)


def _thinned(points, cell, random):
    """Indices of one point a cell, and the cell's size (mm), larger where there would be too many."""
    drawn = np.arange(points.shape[1])
    if len(drawn) > _DRAWN:
        drawn = np.sort(random.choice(len(drawn), _DRAWN, replace=False))
    drawn_points = points[:, drawn]
    low = drawn_points.min(1, keepdims=True)
    while True:
        x, y, z = ((drawn_points - low) / cell).astype(np.int64)
        number_of_cell = (x * (y.max() + 1) + y) * (z.max() + 1) + z
        first_of_cell = np.unique(number_of_cell, return_index=True)[1]
        if len(first_of_cell) <= MOST_POINTS:
            return drawn[first_of_cell], cell
        cell *= 1.05 * np.sqrt(len(first_of_cell) / MOST_POINTS)


def _normals(points, neighbours):
    """(3, n) unit normals, without sense, of the planes through each point's neighbours."""
    displacements = points[:, neighbours] - points[:, neighbours].mean(2, keepdims=True)
    matrix = np.einsum("dnk,enk->nde", displacements, displacements, optimize=True)
    return symmetric_eigen(matrix)[1][:, :, 0].T.copy()


__all__ = ["LEAST_POINTS", "MOST_POINTS", "WIDE", "ThinnedCloud"]
