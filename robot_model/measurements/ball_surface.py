"""`ball-surface`: points on balls of a measured artefact, seen by a sensor on the flange."""

from dataclasses import dataclass, replace

import numpy as np

from robot_model.chain import Frames, cross
from robot_model.measurements.ball_centre import BallCentre
from robot_model.measurements.closure import Closure, add_delta, numbered, position_sigma
from robot_model.measurements.multistart import RotationSystem
from robot_model.poses import pose_parameters
from workbench.core.errors import InputError
from workbench.core.parameters import Parameter
from workbench.core.profiler_start import algebraic_circles, signed_centres
from workbench.core.rigid import left_jacobian, rotation_matrix, transform

_STEPS = 30
_FEWEST = 4
_LEAST_THICKNESS = 1e-3  # mm, RMS distance of points of a profile from a line
_LARGEST_SECTION = 1.1  # over the ball's radius


@dataclass(frozen=True)
class BallSurface:
    """Points (3, n) mm in the sensor frame; `balls` (K, 4) centre and radius mm, artefact frame.

    `pose_id` (n,): points with one value were measured from one static pose.
    """

    measured: np.ndarray
    index: np.ndarray
    ids: tuple[int, ...]
    balls: np.ndarray
    pose_id: np.ndarray
    place = "sensor"
    grounded = False

    @classmethod
    def of(cls, recording) -> "BallSurface":
        """From a recording with an artefact."""
        ids, index = numbered(recording.ball)
        balls = np.array([recording.balls[int(i)] for i in ids])
        return cls(
            np.ascontiguousarray(recording.points.T),
            index,
            ids,
            balls,
            _static_poses(recording),
        )

    def parameters(self) -> list[Parameter]:
        """Hand-eye transform T_flange_sensor."""
        return pose_parameters("sensor", "hand-eye")

    @property
    def numbers(self) -> np.ndarray:
        """(n,) number of the ball of each point, as in the file."""
        return np.asarray(self.ids)[self.index]

    def targets(self, values: np.ndarray) -> np.ndarray:
        """(3, n) nominal centres of the balls on the artefact, mm."""
        return self.balls[self.index, :3].T

    def sigma(self, recording) -> np.ndarray:
        """(1, n) mm; 1 where the recording does not say."""
        return position_sigma(recording)[:1]

    def at(self, samples: np.ndarray) -> "BallSurface":
        return replace(
            self,
            measured=self.measured[:, samples],
            index=self.index[samples],
            pose_id=self.pose_id[samples],
        )

    def close(self, frames: Frames, values: np.ndarray, deltas: dict) -> Closure:
        """(1, n) distance from the ball's surface, outwards, mm; the world is the artefact."""
        rotation = rotation_matrix(values[3:])
        seen = self.measured
        centre = self.balls[self.index, :3].T
        if "sensor" in deltas:  # what was measured is the true point and the sensor's error
            port_indices, change = deltas["sensor"]
            seen = add_delta(seen, (port_indices, -change))
        if "target" in deltas:
            centre = add_delta(centre, deltas["target"])
        arm = rotation @ seen
        point = frames.point(arm + values[:3, None])
        out = point - centre
        distance = np.sqrt((out**2).sum(0))
        out = out / distance
        by_flange = np.stack([(out * axis).sum(0) for axis in frames.end])
        by_rotation = cross(
            left_jacobian(values[3:]).T[:, :, None], np.broadcast_to(arm, (3, *arm.shape))
        )
        tool_rows = np.concatenate([by_flange[:, None], (by_rotation * by_flange).sum(1)[:, None]])
        ports = {"sensor": -(rotation.T @ by_flange)[:, None], "target": -out[:, None]}
        return Closure(
            (distance - self.balls[self.index, 3])[None],
            point,
            lambda rows: (rows * out).sum(1)[:, None],
            tool_rows,
            ports,
            to_world=lambda gap: out * gap,
        )

    def start(self, frames: Frames) -> tuple[np.ndarray, np.ndarray]:
        """A ball fitted to the points of each static pose; then as for ball centres.

        Profiles (y = 0 in every row) show circles: the nominal robot says on which side of the light plane the ball is.
        """
        centres, at_scans = self._centres(frames)
        return centres.start(at_scans)

    def system(self, frames: Frames) -> RotationSystem:
        """Equations of base and tool for the centres of the balls, quickly found: for many hypotheses."""
        centres, at_scans = self._centres(frames, is_quick=True)
        return centres.system(at_scans)

    def _centres(self, frames: Frames, is_quick: bool = False) -> tuple[BallCentre, Frames]:
        """Centres of the balls in each static pose that determines them, and the frames of these poses."""
        _, ball, first, centres = self.scan_centres(frames, is_quick)
        usable = np.isfinite(centres[0])
        seen = np.unique(ball[usable])
        centre = BallCentre(
            centres[:, usable],
            np.searchsorted(seen, ball[usable]),
            tuple(np.asarray(self.ids)[seen].tolist()),
            self.balls[seen, :3],
        )
        return centre, _frames_of_rows(frames, first[usable])

    def scan_centres(
        self, frames: Frames, is_quick: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Scan (n,) of each point from 0, a scan being the points of one ball in one static pose; index of the ball
        (P,) and first point (P,) of each scan, and (3, P) mm the ball's centre in the sensor frame, nan where the
        scan does not determine it. InputError where fewer than four do.
        """
        pairs, first, scan = np.unique(
            np.stack([self.pose_id, self.index]), axis=1, return_index=True, return_inverse=True
        )
        scan, ball = scan.ravel(), pairs[1]
        if (self.measured[1] == 0).all():
            centres = self._centres_of_profiles(
                scan, ball, _frames_of_rows(frames, first), is_quick
            )
        else:
            radii = self.balls[ball, 3]
            order = np.argsort(scan, kind="stable")
            ends = np.cumsum(np.bincount(scan))[:-1]
            points_of_scans = np.split(self.measured[:, order], ends, axis=1)
            fitted = [_centre(part, radius) for part, radius in zip(points_of_scans, radii)]
            centres = np.stack(fitted, axis=1)
        usable = np.isfinite(centres[0])
        if usable.sum() < _FEWEST:
            raise InputError(
                "ball-surface: expected at least 4 poses with 4 points of a ball that are not in one plane, or with "
                f"profiles (y_mm = 0) of a circle, found {usable.sum()}; measure more points a pose"
            )
        return scan, ball, first, centres

    def _centres_of_profiles(self, scan, ball, frames: Frames, is_quick: bool) -> np.ndarray:
        """(3, P) mm, nan where the points of a profile determine no circle; scan (n,) profile of each point, ball (P,)
        index of each one's ball."""
        circles = _circles(self.measured[[0, 2]], scan, len(ball))
        # a section can be no larger than its ball, but for noise
        round_ones = np.isfinite(circles[0]) & (circles[2] < _LARGEST_SECTION * self.balls[ball, 3])
        centres = np.full((3, len(ball)), np.nan)
        if round_ones.sum() >= _FEWEST:
            rotation = np.stack(frames.end, -1).transpose(1, 0, 2)
            flange = transform(rotation, frames.end_origin.T)
            centres[:, round_ones] = signed_centres(
                circles[:, round_ones],
                ball[round_ones],
                flange[round_ones],
                self.balls[:, 3],
                is_quick,
            )
        return centres

    def columns(self, residual: np.ndarray) -> dict[str, np.ndarray]:
        """A distance from a surface moves no coordinate by itself: the measured point as it was."""
        return dict(zip(("x_mm", "y_mm", "z_mm"), self.measured))


def _static_poses(recording) -> np.ndarray:
    """(n,) number of the static pose of each point: two scans with equal joint readings are not one scan."""
    if "pose" in recording.columns:
        return np.unique(recording.columns["pose"], return_inverse=True)[1]
    return recording.poses


def scan_numbers(recording, first) -> np.ndarray:
    """(P,) the number of the pose of each scan where no two have the same, else 1, 2, ...; first (P,) row of each."""
    if "pose" in recording.columns:
        numbers = recording.columns["pose"][first]
        if len(np.unique(numbers)) == len(first):
            return numbers
    return np.arange(1.0, len(first) + 1)


def numbers_of_scans(recording) -> np.ndarray:
    """(n,) int number of the scan of each point: one ball in one pose, in the order of their first points."""
    pairs = np.stack([_static_poses(recording), recording.ball])
    _, first, scan = np.unique(pairs, axis=1, return_index=True, return_inverse=True)
    in_order = np.argsort(first, kind="stable")
    place = np.argsort(in_order)
    return scan_numbers(recording, first[in_order]).astype(int)[place[scan.ravel()]]


def _centre(points, radius):
    """(3,) centre of the ball of `radius` through points (3, k), nan where they do not say; Gauss-Newton."""
    middle = points.mean(1, keepdims=True)
    if points.shape[1] < 4 or np.linalg.svd(points - middle, compute_uv=False)[-1] < 1e-3 * radius:
        return np.full(3, np.nan)
    system = np.vstack([2 * points, np.ones(points.shape[1])]).T
    centre = np.linalg.lstsq(system, (points**2).sum(0), rcond=None)[0][:3]
    for _ in range(_STEPS):
        out = points - centre[:, None]
        distance = np.linalg.norm(out, axis=0)
        centre = centre + np.linalg.lstsq((out / distance).T, distance - radius, rcond=None)[0]
    return centre


def _circles(flat, label, count) -> np.ndarray:
    """(3, count) mm: x, z and radius of the circle through the points (2, n) of each label, nan for points on a line
    and for fewer than four."""
    is_round = np.array([_is_round(flat[:, label == k]) for k in range(count)])
    place = np.cumsum(is_round) - 1
    usable = is_round[label]
    found = np.full((3, count), np.nan)
    if is_round.any():
        found[:, is_round] = algebraic_circles(
            flat[:, usable], place[label[usable]], int(is_round.sum())
        )
    return found


def _is_round(points) -> bool:
    """Whether points (2, k) determine a circle."""
    if points.shape[1] < _FEWEST:
        return False
    centred = points - points.mean(1, keepdims=True)
    thickness = np.linalg.eigvalsh(centred @ centred.T / points.shape[1])[0]
    return bool(thickness > _LEAST_THICKNESS**2)


def _frames_of_rows(frames: Frames, rows) -> Frames:
    """The flange's frames of some rows."""
    return replace(
        frames,
        end=tuple(axis[:, rows] for axis in frames.end),
        end_origin=frames.end_origin[:, rows],
    )
