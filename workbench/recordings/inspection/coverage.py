"""Coverage: range of every joint, extent and orientations of the flange, and coverage of images by a board."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from datasets.recording import Recording
from datasets.samples.columns import joint_columns
from robot_model import load_robot
from sensors.boards.detection import Detection
from workbench.core.errors import InputError
from workbench.core.rigid import nearest_rotation, rotation_vector
from workbench.files.images.flange import flange_poses
from workbench.machine.progress import paced

_COLUMNS, _ROWS = 8, 6


@dataclass(frozen=True)
class JointCoverage:
    """Smallest and largest reading of a joint in the unit of its column, and the limits, nan where unknown."""

    name: str
    low: float
    high: float
    lower_limit: float
    upper_limit: float

    @property
    def extent(self) -> float:
        """Range of the readings, deg or mm."""
        return self.high - self.low

    @property
    def share(self) -> float:
        """Range of the readings over the range of the limits; nan where the limits are unknown."""
        return self.extent / (self.upper_limit - self.lower_limit)

    def as_json(self) -> dict:
        """The entry under coverage.joints."""
        unit = self.name.rpartition("_")[2]
        known = np.isfinite(self.share)
        return {
            "joint": self.name,
            f"min_{unit}": self.low,
            f"max_{unit}": self.high,
            f"range_{unit}": self.extent,
            "limits": [self.lower_limit, self.upper_limit] if known else None,
            "share_of_limits": self.share if known else None,
        }


@dataclass(frozen=True)
class Coverage:
    """`joints`; `flange` (n, 4, 4) nominal or recorded poses, None where unknown; `spread_deg` of its orientations."""

    joints: tuple[JointCoverage, ...]
    flange: np.ndarray | None
    spread_deg: float

    def as_json(self) -> dict:
        """`coverage` of the answer."""
        extent = None
        if self.flange is not None and len(self.flange):
            extent = np.ptp(self.flange[:, :3, 3], axis=0)
        return {
            "joints": [joint.as_json() for joint in self.joints],
            "flange_extent_mm": extent,
            "orientation_spread_deg": self.spread_deg,
        }


def coverage_of(recording: Recording) -> Coverage:
    """Coverage of a recording; empty parts where it holds neither joint readings nor flange poses."""
    names = joint_columns(recording.columns)
    limits = _limits(recording, len(names))
    joints = []
    for name, (low, high) in zip(names, limits):
        cells = recording.columns[name]
        factor = 1.0 if name.endswith("_mm") else 180 / np.pi
        joints.append(
            JointCoverage(name, float(cells.min()), float(cells.max()), factor * low, factor * high)
        )
    flange = _flange(recording)
    if flange is None or not len(flange):
        spread = np.nan
    else:
        spread = orientation_spread(flange[:, :3, :3])
    return Coverage(tuple(joints), flange, spread)


def _limits(recording: Recording, count: int) -> np.ndarray:
    """(count, 2) limits of the readings, rad or mm; nan where unknown."""
    unknown = np.full((count, 2), np.nan)
    if not recording.robot or not count:
        return unknown
    limits = load_robot(recording.robot, f"robot of {recording.name}").limits
    return limits if len(limits) == count else unknown


def _flange(recording: Recording) -> np.ndarray | None:
    if not recording.n:
        return None
    try:
        return flange_poses(recording)
    except InputError:
        return None


def orientation_spread(rotations: np.ndarray) -> float:
    """RMS angle (deg) of rotations (n, 3, 3) from their chordal mean."""
    mean = nearest_rotation(rotations.mean(0))
    angles = np.linalg.norm(rotation_vector(mean.T @ rotations), axis=-1)
    return float(np.rad2deg(np.sqrt((angles**2).mean())))


@dataclass(frozen=True)
class ImageCoverage:
    """Images by `roles`; `found` boards, `rejected` (image, reason); `corners` (2, k) px in images of `size`.

    `detection`: what was detected in detail, None where nothing was.
    """

    roles: dict[str, int]
    found: int
    rejected: tuple[tuple[str, str], ...]
    corners: np.ndarray
    size: tuple[int, int]
    detection: Detection | None = None

    @property
    def share_of_field(self) -> float:
        """Share of the cells of a grid over the image with a corner of some board."""
        if not self.corners.size:
            return 0.0
        column = np.clip(self.corners[0] / self.size[0] * _COLUMNS, 0, _COLUMNS - 1).astype(int)
        row = np.clip(self.corners[1] / self.size[1] * _ROWS, 0, _ROWS - 1).astype(int)
        return len(set(zip(column.tolist(), row.tolist()))) / (_COLUMNS * _ROWS)

    def as_json(self) -> dict:
        """`images` of the answer."""
        return {
            "roles": self.roles,
            "boards_found": self.found,
            "rejected": [{"image": image, "why": why} for image, why in self.rejected],
            "share_of_field": self.share_of_field,
        }


def image_coverage(recording: Recording, progress: Callable[[str], None]) -> ImageCoverage | None:
    """Which images show the board, and where in the field; None for a recording without images."""
    if not recording.images:
        return None
    roles: dict[str, int] = {}
    for row in recording.images:
        roles[row["role"]] = roles.get(row["role"], 0) + 1
    if not roles.get("board") or not recording.board:
        return ImageCoverage(roles, 0, (), np.empty((2, 0)), (1, 1))
    from sensors.boards.detection import detect_all

    tick = paced(progress, "board in image")
    try:
        found = detect_all(recording, lambda done, total, name: tick(done, total))
    except InputError as problem:
        return ImageCoverage(roles, 0, (("all", str(problem)),), np.empty((2, 0)), (1, 1))
    corners = np.concatenate([view.pixels for view in found.views], axis=1)
    rejected = tuple((rejection.image, rejection.why) for rejection in found.rejected)
    return ImageCoverage(roles, len(found.views), rejected, corners, found.size, found)
